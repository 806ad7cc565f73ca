//! Coordinate descent on the quadratic model. Where it converges slowly the exact method takes over.

use super::exact::Exact;
use super::factor::subtract_rows;
use super::model::Model;
use super::packed::Packed;
use super::progress::Progress;
use crate::octet::{set_bits, WIDTH};
use crate::problem::{Dictionary, Settings};
use crate::simd::{multiversion, Level};
use crate::vector::add_scaled;

// These numbers were chosen by hand for speed; measure it with `python -m benchmarks`.

/// Rounds of one run. Each round chooses the pixels that take part and sweeps over them.
const ROUNDS: usize = 3;
/// Limit of sweeps right after new pixels were chosen. Many of these return to zero at once, so the
/// set is shrunk before the other sweeps.
const FIRST_SWEEPS: usize = 3;
/// Limit of sweeps over the remaining pixels of a round.
const SWEEPS: usize = 12;
/// The exact method can pay if the required accuracy is finer than this, in units of lambda.
const EXACT_ACCURACY: f64 = 0.01;
/// Descent has converged when a sweep changes no slope by more than this share of the accuracy.
const SETTLED_SHARE: f64 = 0.3;

pub struct Descent {
    pub progress: Progress,
    packed: Packed,
    /// Bits of the pixels that differ from zero or are pulled away from it.
    chosen: Vec<u8>,
    /// Bits of the pixels that are zero.
    at_zero: Vec<u8>,
    moves: Vec<f64>,
    places: Vec<usize>,
    exact: Exact,
    /// Whether to use the exact method whatever the accuracy.
    pub exactly: bool,
    /// Whether the last run reached its accuracy.
    pub settled: bool,
    /// Pixels along which the model has no curvature, though they differ from zero.
    pub flat: Vec<usize>,
}

impl Descent {
    pub fn new(level: Level) -> Self {
        Descent {
            progress: Progress::default(),
            packed: Packed::default(),
            chosen: Vec::new(),
            at_zero: Vec::new(),
            moves: Vec::new(),
            places: Vec::new(),
            exact: Exact::new(level),
            exactly: false,
            settled: false,
            flat: Vec::new(),
        }
    }

    /// Minimises the model from `x`, where minus its slopes are `gradient - shift coupling`, until the
    /// optimality conditions hold within `accuracy`.
    #[allow(clippy::too_many_arguments)]
    pub fn run(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        model: &mut Model,
        pixels: &[u32],
        x: &[f64],
        gradient: &[f64],
        shift: f64,
        accuracy: f64,
    ) {
        let level = model.level;
        let lambda = settings.regularization;
        let settled = SETTLED_SHARE * accuracy;
        let progress = &mut self.progress;
        progress.target.clear();
        progress.target.extend_from_slice(x);
        progress.target.resize(model.stride, 0.0);
        progress.slope.clear();
        progress.slope.extend_from_slice(gradient);
        progress.slope.resize(model.stride, 0.0);
        add_scaled(level, &mut progress.slope, -shift, &model.coupling);
        self.flat.clear();
        self.settled = false;
        let mut change = f64::INFINITY;
        let mut stale = true;
        for round in 0..ROUNDS {
            let entering = self.choose(dictionary, settings, model, pixels, settled);
            if change <= settled && !entering {
                self.settled = true;
                return;
            }
            let progress = &mut self.progress;
            let signed = !settings.nonnegative;
            if stale || entering {
                stale = false;
                let (target, slope) = (&progress.target, &progress.slope);
                self.packed
                    .load(model, &self.chosen, lambda, signed, target, slope);
            } else {
                self.packed.renew(level, &progress.target, &progress.slope);
            }
            // Many of the pixels that enter return to zero at once.
            if entering {
                change = self.packed.sweep(level, settled, FIRST_SWEEPS);
                if change > settled {
                    self.packed.shrink(model, &progress.target);
                }
            }
            if !entering || change > settled {
                change = self.packed.sweep(level, settled, SWEEPS);
            }
            let order = &self.packed.set;
            self.moves.clear();
            self.places.clear();
            for (place, &j) in order.iter().enumerate() {
                let target = &mut progress.target[j as usize];
                let x = self.packed.moved(place, *target);
                self.moves.push(x - *target);
                self.places.push(model.place(j));
                *target = x;
            }
            subtract_rows(
                level,
                &mut progress.slope,
                &model.rows,
                &self.places,
                &self.moves,
            );
            let exactly = self.exactly || accuracy <= EXACT_ACCURACY * lambda;
            if round > 0 && change > settled && exactly {
                let Progress { target, order, .. } = progress;
                let away = |&&j: &&u32| target[j as usize] != 0.0;
                order.clear();
                order.extend(self.packed.set.iter().filter(away));
                stale = true;
                if self
                    .exact
                    .run(dictionary, settings, model, pixels, progress, settled)
                {
                    self.settled = true;
                    return;
                }
            }
        }
    }

    /// Chooses the pixels that take part: those that differ from zero or are pulled away from it.
    /// Returns whether there are any of the second kind.
    fn choose(
        &mut self,
        dictionary: &Dictionary,
        settings: &Settings,
        model: &mut Model,
        pixels: &[u32],
        settled: f64,
    ) -> bool {
        let lambda = settings.regularization;
        let Progress { target, slope, .. } = &self.progress;
        self.chosen.resize(model.stride / WIDTH, 0);
        let limit = lambda + settled;
        let signed = !settings.nonnegative;
        self.at_zero.resize(model.stride / WIDTH, 0);
        let (chosen, at_zero) = (&mut self.chosen, &mut self.at_zero);
        choose(model.level, target, slope, limit, signed, chosen, at_zero);
        for (group, chosen) in self.chosen.iter_mut().enumerate() {
            for place in set_bits(*chosen & !model.ready[group]) {
                let j = group * WIDTH + place as usize;
                model.make_row(dictionary, pixels, j);
                if model.inverse[j] != 0.0 {
                    continue;
                }
                *chosen &= !(1 << place);
                if target[j] != 0.0 && slope[j].abs() < lambda && !self.flat.contains(&j) {
                    self.flat.push(j);
                }
            }
        }
        let at_zero = self.chosen.iter().zip(&self.at_zero);
        at_zero.fold(0, |any, (chosen, zero)| any | chosen & zero) != 0
    }
}

multiversion! {
    /// Sets the bits of the pixels that differ from zero or are pulled by more than `limit`, and the bits
    /// of the pixels that are zero.
    fn choose(
        target: &[f64], slope: &[f64], limit: f64, signed: bool, chosen: &mut [u8], at_zero: &mut [u8]
    ) {
        let groups = target.as_chunks::<WIDTH>().0.iter().zip(slope.as_chunks::<WIDTH>().0);
        let bits = chosen.iter_mut().zip(at_zero);
        for ((chosen, at_zero), (target, slope)) in bits.zip(groups) {
            let (mut pulled, mut zero) = (0, 0);
            for i in 0..WIDTH {
                let pull = if signed { slope[i].abs() } else { slope[i] };
                pulled |= u8::from(pull > limit) << i;
                zero |= u8::from(target[i] == 0.0) << i;
            }
            *chosen = pulled | !zero;
            *at_zero = zero;
        }
    }
}
