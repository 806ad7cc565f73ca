//! The state of the minimisation of the quadratic model.

/// The state that coordinate descent and the exact method hand to each other.
#[derive(Default)]
pub struct Progress {
    /// The current x; padded.
    pub target: Vec<f64>,
    /// Minus the slope of the model at `target`, without the l1 term; padded.
    pub slope: Vec<f64>,
    /// The pixels that take part.
    pub order: Vec<u32>,
}
