//! The processor's tiles: what they hold, and the instructions that expand patterns and multiply them.

use std::arch::asm;

/// Rows that one product takes.
pub const LANES: usize = 16;
/// Bytes of a line of a tile, and patterns that one product takes.
pub const LINE: usize = 64;
/// Bytes of a tile.
pub const TILE: usize = 16 * LINE;
/// Pixels of a tile.
pub const COLUMNS: usize = 16;
/// Tiles of sums that are worked on at a time, and their pixels.
pub const TILES: usize = 4;
pub const BLOCK: usize = TILES * COLUMNS;
/// Bytes of the codes that a step takes: of 64 patterns and a block of pixels.
pub const STEP: usize = BLOCK * LINE / 8;

/// The patterns of a step, a byte each.
pub type Planes = [[u8; TILE]; TILES];
/// Of the rows and pixels of a block.
pub type Sums = [[i32; BLOCK]; LANES];

/// What the tiles are: 16 lines of 64 bytes, all eight.
#[repr(C, align(64))]
struct Configuration {
    palette: [u8; 16],
    line_bytes: [u16; 16],
    lines: [u8; 16],
}

const CONFIGURATION: Configuration = {
    let mut all = Configuration {
        palette: [0; 16],
        line_bytes: [0; 16],
        lines: [0; 16],
    };
    all.palette[0] = 1;
    let mut tile = 0;
    while tile < 8 {
        all.line_bytes[tile] = LINE as u16;
        all.lines[tile] = 16;
        tile += 1;
    }
    all
};

/// Matrices of 8 x 8 bits: each takes one bit of a byte for the lowest and zeros for the others.
static BITS: [u64; 8] = [
    1 << 56,
    2 << 56,
    4 << 56,
    8 << 56,
    16 << 56,
    32 << 56,
    64 << 56,
    128 << 56,
];

/// Instructions that load `BITS`.
macro_rules! load_bits {
    () => {
        concat!(
            load_bits!(16, 0),
            load_bits!(17, 1),
            load_bits!(18, 2),
            load_bits!(19, 3),
            load_bits!(20, 4),
            load_bits!(21, 5),
            load_bits!(22, 6),
            load_bits!(23, 7),
        )
    };
    ($register:literal, $bit:literal) => {
        concat!(
            "vpbroadcastq zmm",
            $register,
            ", [{bits} + 8 * ",
            $bit,
            "]\n"
        )
    };
}

/// Instructions that expand codes of half a tile each (`$half`): each bit of the bytes to a line.
macro_rules! expand {
    ($($half:literal)*) => {
        concat!($(
            "vmovdqu64 zmm0, [{codes} + 64 * ", $half, "]\n",
            expand!($half, 16, 0), expand!($half, 17, 1), expand!($half, 18, 2), expand!($half, 19, 3),
            expand!($half, 20, 4), expand!($half, 21, 5), expand!($half, 22, 6), expand!($half, 23, 7),
        )*)
    };
    ($half:literal, $register:literal, $bit:literal) => {
        concat!(
            "vgf2p8affineqb zmm1, zmm0, zmm", $register, ", 0\n",
            "vmovdqa64 [{next} + 512 * ", $half, " + 64 * ", $bit, "], zmm1\n",
        )
    };
}

/// Expands the codes of a step.
///
/// # Safety
/// There are `STEP` bytes of them, and the processor has AVX-512.
#[target_feature(enable = "avx512f,avx512bw")]
pub unsafe fn expand(codes: *const u8, next: &mut Planes) {
    // SAFETY: reads a step's codes, writes its planes.
    unsafe {
        asm!(
            load_bits!(),
            expand!(0 1 2 3 4 5 6 7),
            bits = in(reg) &BITS,
            codes = in(reg) codes,
            next = in(reg) next,
            out("zmm0") _, out("zmm1") _,
                out("zmm16") _, out("zmm17") _, out("zmm18") _, out("zmm19") _,
                out("zmm20") _, out("zmm21") _, out("zmm22") _, out("zmm23") _,
            options(nostack),
        );
    }
}

/// The tiles of this thread's processor, set up for `multiply`: nothing else uses any.
pub struct Tiles;

impl Tiles {
    /// # Safety
    /// The processor has tiles, and the system lets this process use them.
    pub unsafe fn configured() -> Self {
        // SAFETY: reads the configuration, and all tiles become zero.
        unsafe { asm!("ldtilecfg [{}]", in(reg) &CONFIGURATION, options(nostack, readonly)) };
        Tiles
    }

    /// Sums of `LANES` rows over a block of pixels.
    ///
    /// `planes` are those of its first step. They change places with `next` at every step: what is
    /// expanded last is the step behind the block.
    ///
    /// # Safety
    /// There are `chunks` tiles of integers, and codes of as many steps behind the first.
    #[target_feature(enable = "avx512f,avx512bw")]
    pub unsafe fn multiply(
        &self,
        codes: *const u8,
        integers: *const [u8; LINE],
        chunks: usize,
        planes: &mut Planes,
        next: &mut Planes,
        sums: &mut Sums,
    ) {
        // SAFETY: reads what the caller says there is, writes planes and sums. Tiles are zero before
        // and after.
        unsafe {
            asm!(
                load_bits!(),
                "2:", // multiplies the patterns of a step, and expands those of the next meanwhile
                "tileloadd tmm4, [{integers} + {line} * 1]",
                "tileloadd tmm5, [{planes} + {line} * 1]",
                "tdpbsud tmm0, tmm4, tmm5",
                expand!(0 1),
                "tileloadd tmm6, [{planes} + {line} * 1 + 1024]",
                "tdpbsud tmm1, tmm4, tmm6",
                expand!(2 3),
                "tileloadd tmm7, [{planes} + {line} * 1 + 2048]",
                "tdpbsud tmm2, tmm4, tmm7",
                expand!(4 5),
                "tileloadd tmm5, [{planes} + {line} * 1 + 3072]",
                "tdpbsud tmm3, tmm4, tmm5",
                expand!(6 7),
                "xchg {planes}, {next}",
                "add {codes}, 512",
                "add {integers}, 1024",
                "dec {chunks}",
                "jnz 2b",
                "mov {line:e}, 256",
                "tilestored [{sums} + {line} * 1], tmm0",
                "tilestored [{sums} + {line} * 1 + 64], tmm1",
                "tilestored [{sums} + {line} * 1 + 128], tmm2",
                "tilestored [{sums} + {line} * 1 + 192], tmm3",
                "tilezero tmm0",
                "tilezero tmm1",
                "tilezero tmm2",
                "tilezero tmm3",
                codes = inout(reg) codes => _,
                integers = inout(reg) integers => _,
                chunks = inout(reg) chunks => _,
                planes = inout(reg) planes => _,
                next = inout(reg) next => _,
                sums = in(reg) sums,
                line = inout(reg) LINE => _,
                bits = in(reg) &BITS,
                out("zmm0") _, out("zmm1") _,
                out("zmm16") _, out("zmm17") _, out("zmm18") _, out("zmm19") _,
                out("zmm20") _, out("zmm21") _, out("zmm22") _, out("zmm23") _,
                out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
                out("tmm4") _, out("tmm5") _, out("tmm6") _, out("tmm7") _,
                options(nostack),
            );
        }
    }
}

impl Drop for Tiles {
    fn drop(&mut self) {
        // SAFETY: there are tiles.
        unsafe { asm!("tilerelease", options(nomem, nostack)) };
    }
}
