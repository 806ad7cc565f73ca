//! The two float types that camera samples come in.

use std::ops::{Add, AddAssign, Sub};

/// `f32` or `f64`.
pub trait Float:
    Copy + Default + PartialEq + Send + Sync + Add<Output = Self> + Sub<Output = Self> + AddAssign
{
}

impl Float for f32 {}
impl Float for f64 {}
