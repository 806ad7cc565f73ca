//! Eight float64 numbers at a time, for loops that the compiler does not vectorise by itself.

/// Number of values in an octet.
pub const WIDTH: usize = 8;

/// Number of values in two octets, which as float32 fill one AVX-512 register.
pub const PAIR: usize = 2 * WIDTH;

/// The places of the bits that are set, ascending.
#[inline(always)]
pub fn set_bits(mut bits: u8) -> impl Iterator<Item = u32> {
    std::iter::from_fn(move || {
        let place = (bits != 0).then(|| bits.trailing_zeros());
        bits &= bits.wrapping_sub(1);
        place
    })
}

/// Eight numbers, in an array or in a register.
///
/// # Safety
/// All functions require the instructions of the implementation.
pub trait Octet: Copy {
    unsafe fn splat(value: f64) -> Self;
    unsafe fn load(values: &[f64; 8]) -> Self;
    unsafe fn store(self, values: &mut [f64; 8]);
    unsafe fn plus(self, other: Self) -> Self;
    unsafe fn times(self, other: Self) -> Self;
    /// self - a b, with one rounding if the implementation has an instruction for it.
    unsafe fn minus_product(self, a: Self, b: Self) -> Self;
    /// Bits of the numbers above zero.
    unsafe fn positive(self) -> u8;
}

/// For any CPU.
#[derive(Clone, Copy)]
pub struct Array([f64; 8]);

impl Octet for Array {
    #[inline(always)]
    unsafe fn splat(value: f64) -> Self {
        Array([value; 8])
    }
    #[inline(always)]
    unsafe fn load(values: &[f64; 8]) -> Self {
        Array(*values)
    }
    #[inline(always)]
    unsafe fn store(self, values: &mut [f64; 8]) {
        *values = self.0;
    }
    #[inline(always)]
    unsafe fn plus(self, other: Self) -> Self {
        Array(std::array::from_fn(|i| self.0[i] + other.0[i]))
    }
    #[inline(always)]
    unsafe fn times(self, other: Self) -> Self {
        Array(std::array::from_fn(|i| self.0[i] * other.0[i]))
    }
    #[inline(always)]
    unsafe fn minus_product(self, a: Self, b: Self) -> Self {
        Array(std::array::from_fn(|i| self.0[i] - a.0[i] * b.0[i]))
    }
    #[inline(always)]
    unsafe fn positive(self) -> u8 {
        (0..8).fold(0, |bits, i| bits | u8::from(self.0[i] > 0.0) << i)
    }
}

#[cfg(target_arch = "x86_64")]
pub use register::Register;

#[cfg(target_arch = "x86_64")]
mod register {
    use super::Octet;
    use std::arch::x86_64::*;

    /// For AVX-512.
    #[derive(Clone, Copy)]
    pub struct Register(__m512d);

    // SAFETY, for all: the trait requires the instructions; references to eight values are valid.
    impl Octet for Register {
        #[inline(always)]
        unsafe fn splat(value: f64) -> Self {
            unsafe { Register(_mm512_set1_pd(value)) }
        }
        #[inline(always)]
        unsafe fn load(values: &[f64; 8]) -> Self {
            unsafe { Register(_mm512_loadu_pd(values.as_ptr())) }
        }
        #[inline(always)]
        unsafe fn store(self, values: &mut [f64; 8]) {
            unsafe { _mm512_storeu_pd(values.as_mut_ptr(), self.0) }
        }
        #[inline(always)]
        unsafe fn plus(self, other: Self) -> Self {
            unsafe { Register(_mm512_add_pd(self.0, other.0)) }
        }
        #[inline(always)]
        unsafe fn times(self, other: Self) -> Self {
            unsafe { Register(_mm512_mul_pd(self.0, other.0)) }
        }
        #[inline(always)]
        unsafe fn minus_product(self, a: Self, b: Self) -> Self {
            unsafe { Register(_mm512_fnmadd_pd(a.0, b.0, self.0)) }
        }
        #[inline(always)]
        unsafe fn positive(self) -> u8 {
            unsafe { _mm512_cmp_pd_mask::<_CMP_GT_OQ>(self.0, _mm512_setzero_pd()) }
        }
    }
}

/// Compiles a function, generic over `Octet`, for each instruction set and calls the right version.
macro_rules! octets {
    ($(#[$meta:meta])* $vis:vis fn $name:ident<$octet:ident>($($arg:ident: $ty:ty),* $(,)?) $(-> $ret:ty)? $body:block) => {
        $(#[$meta])*
        $vis fn $name(level: $crate::simd::Level, $($arg: $ty),*) $(-> $ret)? {
            /// # Safety
            /// The CPU must have the instructions of the octet.
            #[inline(always)]
            unsafe fn generic<$octet: $crate::octet::Octet>($($arg: $ty),*) $(-> $ret)? $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,bmi1,bmi2,popcnt")]
            fn avx2($($arg: $ty),*) $(-> $ret)? {
                // SAFETY: arrays need no special instructions.
                unsafe { generic::<$crate::octet::Array>($($arg),*) }
            }

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,bmi1,bmi2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
            fn avx512($($arg: $ty),*) $(-> $ret)? {
                // SAFETY: this function has the instructions.
                unsafe { generic::<$crate::octet::Register>($($arg),*) }
            }

            match level.kind() {
                // SAFETY: arrays need no special instructions.
                $crate::simd::Kind::Portable => unsafe {
                    generic::<$crate::octet::Array>($($arg),*)
                },
                // SAFETY: a level proves that this CPU has its instructions.
                #[cfg(target_arch = "x86_64")]
                $crate::simd::Kind::Avx2 => unsafe { avx2($($arg),*) },
                // SAFETY: as above.
                #[cfg(target_arch = "x86_64")]
                $crate::simd::Kind::Avx512 => unsafe { avx512($($arg),*) },
            }
        }
    };
}
pub(crate) use octets;
