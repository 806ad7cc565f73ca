//! The choice of vector instructions at run time.
//!
//! Only `detect`, `available` and `named` create a `Level`, so a `Level` proves that this CPU has its
//! instructions. Every `unsafe` call of a vector routine relies on this proof.

/// A set of vector instructions that this CPU has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Level {
    kind: Kind,
    /// Whether the CPU also multiplies tiles of bytes (AMX).
    tiles: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Level {
    /// The best level of this CPU.
    pub fn detect() -> Self {
        *Self::available().last().expect("portable is always there")
    }

    /// Every level of this CPU, slowest first.
    pub fn available() -> Vec<Self> {
        let level = |kind| Level { kind, tiles: false };
        let mut levels = vec![level(Kind::Portable)];
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected as has;
            if has!("avx2") && has!("bmi1") && has!("bmi2") && has!("popcnt") {
                levels.push(level(Kind::Avx2));
                if has!("avx512f")
                    && has!("avx512bw")
                    && has!("avx512dq")
                    && has!("avx512vl")
                    && has!("avx512vpopcntdq")
                    && has!("avx512vbmi")
                    && has!("avx512vbmi2")
                {
                    levels.push(level(Kind::Avx512));
                    if amx::available() {
                        levels.push(Level {
                            kind: Kind::Avx512,
                            tiles: true,
                        });
                    }
                }
            }
        }
        levels
    }

    /// The level of this name, if this CPU has it.
    pub fn named(name: &str) -> Option<Self> {
        Self::available().into_iter().find(|l| l.name() == name)
    }

    /// "portable", "avx2", "avx512" or "amx" (AVX-512 with products of tiles).
    pub fn name(self) -> &'static str {
        match self.kind {
            _ if self.tiles => "amx",
            Kind::Portable => "portable",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 => "avx512",
        }
    }

    pub(crate) fn kind(self) -> Kind {
        self.kind
    }

    pub(crate) fn tiles(self) -> bool {
        self.tiles
    }
}

/// Whether the processor multiplies tiles of bytes (AMX). On Linux a process must ask to use them.
#[cfg(target_arch = "x86_64")]
mod amx {
    use std::sync::LazyLock;

    /// Whether this process may use tiles.
    pub fn available() -> bool {
        static AVAILABLE: LazyLock<bool> = LazyLock::new(|| has_instructions() && allowed());
        *AVAILABLE
    }

    fn has_instructions() -> bool {
        use std::arch::x86_64::{__cpuid, __cpuid_count};
        const FEATURES: u32 = 7;
        const TILES_AND_BYTES: u32 = 1 << 24 | 1 << 25;
        // SAFETY: every x86-64 processor has this instruction. (Newer compilers know: no `unsafe`.)
        #[allow(unused_unsafe)]
        let (last, features) = unsafe { (__cpuid(0).eax, __cpuid_count(FEATURES, 0).edx) };
        // The kernel expands bits to bytes with GFNI.
        let expands = std::arch::is_x86_feature_detected!("gfni");
        expands && last >= FEATURES && features & TILES_AND_BYTES == TILES_AND_BYTES
    }

    /// Asks the system. An older kernel, which does not know tiles, refuses.
    #[cfg(target_os = "linux")]
    fn allowed() -> bool {
        const ARCH_PRCTL: i64 = 158;
        const REQUEST_PERMISSION: u64 = 0x1023;
        const TILE_DATA: u64 = 18;
        let answer: i64;
        // SAFETY: the system call changes only which registers this process may use.
        unsafe {
            std::arch::asm!(
                "syscall",
                inlateout("rax") ARCH_PRCTL => answer,
                in("rdi") REQUEST_PERMISSION,
                in("rsi") TILE_DATA,
                out("rcx") _,
                out("r11") _,
                options(nostack),
            );
        }
        answer == 0
    }

    #[cfg(not(target_os = "linux"))]
    fn allowed() -> bool {
        false
    }
}

/// Compiles a plain function for each instruction set and calls the right version.
///
/// All versions give the same results bit for bit: they have the same body, sums run in a fixed number
/// of lanes, and no multiplication is fused with an addition.
macro_rules! multiversion {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $ty:ty),* $(,)?) $(-> $ret:ty)? $body:block) => {
        $(#[$meta])*
        #[allow(clippy::too_many_arguments)]
        $vis fn $name(level: $crate::simd::Level, $($arg: $ty),*) $(-> $ret)? {
            #[inline(always)]
            #[allow(clippy::too_many_arguments)]
            fn plain($($arg: $ty),*) $(-> $ret)? $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,bmi1,bmi2,popcnt")]
            #[allow(clippy::too_many_arguments)]
            fn avx2($($arg: $ty),*) $(-> $ret)? {
                plain($($arg),*)
            }

            #[cfg(target_arch = "x86_64")]
            #[target_feature(
                enable = "avx2,bmi1,bmi2,popcnt,avx512f,avx512bw,avx512dq,avx512vl,avx512vpopcntdq"
            )]
            #[allow(clippy::too_many_arguments)]
            fn avx512($($arg: $ty),*) $(-> $ret)? {
                plain($($arg),*)
            }

            match level.kind() {
                $crate::simd::Kind::Portable => plain($($arg),*),
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
pub(crate) use multiversion;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_have_names_of_their_own() {
        for level in Level::available() {
            assert_eq!(Level::named(level.name()), Some(level));
        }
        assert_eq!(Level::named("abacus"), None);
    }
}
