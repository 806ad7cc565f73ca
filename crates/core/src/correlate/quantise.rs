//! Rounding to integers whose sums fit 16 bits, with a sure bound on what it does to any sum.

/// Which sums of the integers have to fit.
#[derive(Clone, Copy, PartialEq)]
pub enum Sums {
    /// Sums over subsets (0/1 patterns).
    OfSubsets,
    /// Sums with any signs (+1/-1 patterns).
    Signed,
}

/// Up to so many values rounding to nearest is worth its share of the range.
const NEAREST: usize = 16_384;
const LARGEST: f64 = 32_700.0;
/// Covers the float64 rounding of the bounds themselves, in units.
const SLACK: f64 = 1e-3;

pub struct Rounded {
    pub unit: f64,
    /// Most that the exact sum over any subset may lie above the rounded one, in units.
    pub up: f64,
    /// Most that it may lie below, in units.
    pub down: f64,
}

/// Rounds `e` to integers times a unit.
pub fn quantise(e: &[f64], sums: Sums, out: &mut Vec<i16>) -> Rounded {
    let positive: f64 = e.iter().map(|v| v.max(0.0)).sum();
    let negative: f64 = e.iter().map(|v| (-v).max(0.0)).sum();
    let range = match sums {
        Sums::OfSubsets => positive.max(negative),
        Sums::Signed => positive + negative,
    };
    out.clear();
    // Denormal residuals would make the unit zero; as zeros they change no decision.
    if range < f64::MIN_POSITIVE * 1e6 {
        out.resize(e.len(), 0);
        return Rounded {
            unit: 1.0,
            up: SLACK,
            down: SLACK,
        };
    }
    let nearest = e.len() <= NEAREST;
    let room = if nearest { e.len() as f64 / 2.0 } else { 0.0 };
    let unit = range / (LARGEST - room);
    let scale = 1.0 / unit;
    // Adding and taking away this number rounds to the nearest integer.
    const MAGIC: f64 = 6_755_399_441_055_744.0;
    let (mut up, mut down) = ([SLACK / 16.0; 16], [SLACK / 16.0; 16]);
    let mut round = |lane: usize, value: f64| {
        let exact = value * scale;
        let q = if nearest {
            (exact + MAGIC) - MAGIC
        } else {
            exact.trunc()
        };
        let lost = exact - q;
        up[lane] += lost.max(0.0);
        down[lane] += (-lost).max(0.0);
        // The range keeps |q| below 32,767.
        q as i32 as i16
    };
    out.extend(e.iter().enumerate().map(|(k, &v)| round(k % 16, v)));
    Rounded {
        unit,
        up: up.iter().sum(),
        down: down.iter().sum(),
    }
}
