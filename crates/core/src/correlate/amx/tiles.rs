//! The processor's tiles: their layout, and the instructions that expand patterns and multiply.

use std::arch::asm;

/// Number of rows of a tile of integers.
pub const ROWS: usize = 16;
/// Bytes of a line of a tile, and number of patterns of one product.
pub const LINE: usize = 64;
/// Bytes of a tile.
pub const TILE: usize = 16 * LINE;
/// Number of pixels of a tile of patterns.
pub const COLUMNS: usize = 16;
/// Number of tiles of each kind that are used at a time: each one is in two products.
pub const TILES: usize = 2;
/// Number of rows of a run.
pub const LANES: usize = TILES * ROWS;
/// Number of pixels of a block.
pub const BLOCK: usize = TILES * COLUMNS;
/// Bytes of the codes of a step, one bit for each of 64 patterns and each pixel of a block.
pub const STEP: usize = BLOCK * LINE / 8;
/// Patterns are expanded this many steps before they are used. A load of data that was stored just before
/// would wait until all earlier instructions are done, products included.
pub const AHEAD: usize = 3;

/// The expanded patterns of a step, one byte each.
pub type Planes = [[u8; TILE]; TILES];
/// The expanded patterns of this step and of those ahead.
pub type Ring = [Planes; AHEAD + 1];
/// Sums of the rows and pixels of a block.
pub type Sums = [[i32; BLOCK]; LANES];

/// The configuration of the eight tiles: each has 16 lines of 64 bytes.
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

/// Matrices of 8 x 8 bits: each moves one bit of a byte to the lowest place and clears the others.
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

/// Instructions that expand the codes of half a tile (`$half`): each bit of the bytes fills a line.
macro_rules! expand {
    ($half:literal) => {
        concat!(
            "vmovdqu64 zmm0, [{codes} + 64 * ",
            $half,
            "]\n",
            expand!($half, 16, 0),
            expand!($half, 17, 1),
            expand!($half, 18, 2),
            expand!($half, 19, 3),
            expand!($half, 20, 4),
            expand!($half, 21, 5),
            expand!($half, 22, 6),
            expand!($half, 23, 7),
        )
    };
    ($half:literal, $register:literal, $bit:literal) => {
        concat!(
            "vgf2p8affineqb zmm1, zmm0, zmm",
            $register,
            ", 0\n",
            "vmovdqa64 [{next} + 512 * ",
            $half,
            " + 64 * ",
            $bit,
            "], zmm1\n",
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
            expand!(0),
            expand!(1),
            expand!(2),
            expand!(3),
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

const _: () = assert!(size_of::<Ring>().is_power_of_two());

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

    /// Computes the sums of `LANES` rows (without `ALL`, of half of them) over a block of pixels. They stay
    /// in the tiles until `store`.
    ///
    /// `at` is the place in `ring` of the patterns of the block's first step. Returns the place of the
    /// patterns after its last step.
    ///
    /// # Safety
    /// There are `chunks` times `LANES` lines of integers, and codes of as many steps, the first of
    /// them `AHEAD` steps ahead.
    #[target_feature(enable = "avx512f,avx512bw")]
    pub unsafe fn multiply<const ALL: bool>(
        &mut self,
        codes: *const u8,
        integers: *const [u8; LINE],
        chunks: usize,
        ring: &mut Ring,
        mut at: usize,
    ) -> usize {
        // SAFETY: reads what the caller guarantees, writes expanded patterns to the ring.
        unsafe {
            asm!(
                load_bits!(),
                "2:", // one step: multiplies its patterns and expands those of a later step
                "lea {next}, [{at} + {behind}]",
                "and {next}, {last}",
                "add {next}, {ring}",
                "add {at}, {ring}",
                "tileloadd tmm4, [{integers} + {line} * 1]",
                "tileloadd tmm5, [{at} + {line} * 1]",
                "tdpbsud tmm0, tmm4, tmm5",
                expand!(0),
                "tileloadd tmm6, [{at} + {line} * 1 + 1024]",
                "tdpbsud tmm1, tmm4, tmm6",
                expand!(1),
                ".if {all}",
                "tileloadd tmm7, [{integers} + {line} * 1 + 1024]",
                "tdpbsud tmm2, tmm7, tmm5",
                ".endif",
                expand!(2),
                ".if {all}",
                "tdpbsud tmm3, tmm7, tmm6",
                ".endif",
                expand!(3),
                "sub {at}, {ring}",
                "add {at}, {planes}",
                "and {at}, {last}",
                "add {codes}, {step}",
                "add {integers}, 2048",
                "dec {chunks}",
                "jnz 2b",
                all = const ALL as i32,
                planes = const size_of::<Planes>(),
                behind = const AHEAD * size_of::<Planes>(),
                last = const size_of::<Ring>() - 1,
                step = const STEP,
                codes = inout(reg) codes => _,
                integers = inout(reg) integers => _,
                chunks = inout(reg) chunks => _,
                at = inout(reg) at,
                next = out(reg) _,
                ring = in(reg) ring,
                line = in(reg) LINE,
                bits = in(reg) &BITS,
                out("zmm0") _, out("zmm1") _,
                out("zmm16") _, out("zmm17") _, out("zmm18") _, out("zmm19") _,
                out("zmm20") _, out("zmm21") _, out("zmm22") _, out("zmm23") _,
                out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
                out("tmm4") _, out("tmm5") _, out("tmm6") _, out("tmm7") _,
                options(nostack),
            );
        }
        at
    }

    /// Stores the sums and sets the tiles to zero.
    pub fn store(&mut self, sums: &mut Sums) {
        // SAFETY: `configured` guarantees that there are tiles; a line of sums has 128 bytes.
        unsafe {
            asm!(
                "tilestored [{sums} + {line} * 1], tmm0",
                "tilestored [{sums} + {line} * 1 + 64], tmm1",
                "tilestored [{sums} + {line} * 1 + 2048], tmm2",
                "tilestored [{sums} + {line} * 1 + 2112], tmm3",
                "tilezero tmm0",
                "tilezero tmm1",
                "tilezero tmm2",
                "tilezero tmm3",
                line = in(reg) size_of::<[i32; BLOCK]>(),
                sums = in(reg) sums,
                out("tmm0") _, out("tmm1") _, out("tmm2") _, out("tmm3") _,
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
