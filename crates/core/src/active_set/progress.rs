//! How far the minimisation of the quadratic model has come.

/// What coordinate descent hands to the exact solution, and gets back.
#[derive(Default)]
pub struct Progress {
    pub target: Vec<f64>,
    /// Minus the slope of the model at `target`, without lambda; padded.
    pub slope: Vec<f64>,
    /// Pixels that take part.
    pub order: Vec<u32>,
}
