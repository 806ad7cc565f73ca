//! The patterns of the frames of a video, up to sixteen together: a few steps of least squares in bounds.
//!
//! min over p in [0, most] of 1/2 ||S p + b - y||^2_W + r/2 ||p||^2 for each frame. y is the light that the
//! camera is to see of the projector, S the sparse part of T, and b the background's light of the pattern
//! that the steps start from. The steps hardly change b, and it would take most of their time. On three
//! bundled scenes with up to a fifth of their light in the background this costs 0.1 dB at most.
//!
//! With L = S' W S most + r, the eigenvalues of L^-1 (S' W S + r) lie in (0, 1] where S has no negative
//! entries (else L takes their magnitudes). The steps are those of the Chebyshev iteration for eigenvalues
//! in [`LEAST`, 1] (Golub & Varga 1961), each cut off at the bounds.

use crate::images::{add, by_block, lanes, Lanes, Light, BLOCK, LANES, TASK};
use crate::simd::{multiversion, Level};
use rayon::prelude::*;

/// Directions of smaller eigenvalues are left to the frames that follow. With four steps, 0.07 and 0.14
/// lose up to 0.2 dB more than 0.1 on one of the bundled scenes at 64 x 64, or in `benchmarks/video.py`.
const LEAST: f32 = 0.1;

#[repr(align(64))]
struct CacheLine;

/// What is known of a camera sample.
pub const SAMPLE: usize = 4;
/// What is known of a projector pixel.
pub const PIXEL: usize = 3;

/// The scene, and what all frames share.
pub struct Scene<'a> {
    pub light: Light<'a>,
    /// For each camera sample: the light of wanted white, the ambient light, the weight W >= 0, and the
    /// light under a white pattern, above 0 where W is.
    pub samples: &'a [[f32; SAMPLE]],
    /// For each projector pixel: L, what the samples that count have of it in S, and the most light.
    pub pixels: &'a [[f32; PIXEL]],
    /// r
    pub ridge: f32,
    /// Samples are reached that differ by at most this share of wanted white.
    pub tolerance: f32,
}

/// How close frames come, up to sixteen.
pub struct Scores {
    /// The sum of squared errors of the samples that count.
    pub squares: Vec<f64>,
    /// How many samples count and are reached.
    pub reached: Vec<f64>,
}

impl Scene<'_> {
    /// The number of values that `frames` needs room for.
    pub fn room(&self) -> usize {
        LANES * (1 + 2 * (self.light.height() + self.light.width()))
    }

    /// Writes the patterns (frames, width) of wanted pictures in [0, 1], (height) each, after a frame of
    /// a known pattern, (width), and wanted picture, (height). What is in the `room` does not matter.
    ///
    /// # Panics
    /// If the lengths do not fit, or there are no frames or more than sixteen.
    pub fn frames(
        &self,
        wanted: &[&[f32]],
        before: (&[f32], &[f32]),
        steps: usize,
        out: &mut [f32],
        room: &mut [f32],
    ) -> Scores {
        let (height, width) = (self.light.height(), self.light.width());
        let frames = out.len() / width;
        assert!((1..=LANES).contains(&frames) && out.len() == frames * width);
        assert_eq!(wanted.len(), frames);
        assert!(wanted.iter().all(|picture| picture.len() == height));
        assert_eq!((before.0.len(), before.1.len()), (width, height));
        assert_eq!((self.pixels.len(), self.samples.len()), (width, height));
        let level = Level::detect();
        // So that the values of a pixel fill a cache line.
        let begin = room.as_ptr().align_offset(align_of::<CacheLine>());
        let (room, _) = room[begin..].as_chunks_mut::<LANES>();
        let room = &mut room[..2 * (height + width)];
        let (of_camera, of_projector) = room.split_at_mut(2 * height);
        let (goal, misfit) = of_camera.split_at_mut(height);
        let (patterns, ahead) = of_projector.split_at_mut(width);

        // The start: the earlier pattern, and what gains of single pixels make of the difference.
        let near = self.asked(level, wanted, before.1, goal, misfit);
        self.backward(misfit, patterns, ahead, |at, back, patterns, ahead| {
            start(
                level,
                &near,
                &before.0[at..],
                &self.pixels[at..],
                back,
                patterns,
            );
            ahead.fill([0.0; LANES]);
        });
        let start_means = self.light.means(patterns);
        let minus: Vec<_> = start_means.iter().map(|m| lanes(|k| -m[k])).collect();
        by_block(
            goal,
            || (),
            |at, goal, ()| self.light.add_background(at, &minus, goal),
        );

        let half = (1.0 - LEAST) / 2.0;
        let (middle, mut rate) = (1.0 - half, 0.0);
        for step in 0..steps {
            let kept = match step {
                0 => 0.0,
                1 => f32::powi(half * rate, 2) / 2.0,
                _ => f32::powi(half * rate, 2) / 4.0,
            };
            rate = 1.0
                / if step == 0 {
                    middle
                } else {
                    middle - kept / rate
                };
            self.light.forward(
                patterns,
                misfit,
                || (),
                |at, block, ()| {
                    weigh(level, &goal[at..], &self.samples[at..], block);
                },
            );
            let rates = (rate, kept, self.ridge);
            self.backward(misfit, patterns, ahead, |at, back, patterns, ahead| {
                descend(level, rates, &self.pixels[at..], back, patterns, ahead);
            });
        }

        let mut means = self.light.means(patterns);
        for (mean, start) in means.iter_mut().zip(&start_means) {
            add(mean, -1.0, start);
        }
        let begin = || [[0f64; LANES]; 2];
        let scores = self
            .light
            .forward(patterns, misfit, begin, |at, block, sums| {
                self.light.add_background(at, &means, block);
                let mut part = [[0.0; LANES]; 2];
                let (goal, samples) = (&goal[at..], &self.samples[at..]);
                score(level, self.tolerance, goal, samples, block, &mut part);
                add_double(sums, &part);
            });
        by_frame(patterns, out);
        let [squares, reached] = total(&scores);
        Scores {
            squares: squares[..frames].to_vec(),
            reached: reached[..frames].to_vec(),
        }
    }

    /// Fills `goal` with y, and `asked` with what gains of single pixels ask for: the light that is missing
    /// over that of a white pattern. Returns 1 for each frame that is near the one before, else 0: after a
    /// cut, or before black, the earlier pattern is no help.
    fn asked(
        &self,
        level: Level,
        wanted: &[&[f32]],
        last: &[f32],
        goal: &mut [Lanes],
        asked: &mut [Lanes],
    ) -> Lanes {
        let begin = || [[0f64; LANES]; 2];
        let distances = by_block(goal, begin, |at, goal, sums| {
            goal.fill([0.0; LANES]);
            for (k, frame) in wanted.iter().enumerate() {
                for (goal, value) in goal.iter_mut().zip(&frame[at..]) {
                    goal[k] = *value;
                }
            }
            let mut part = [[0.0; LANES]; 2];
            distance(level, &self.samples[at..], &last[at..], goal, &mut part);
            add_double(sums, &part);
        });
        let [far, all] = total(&distances);
        let near = lanes(|k| f32::from(u8::from(far[k] < all[k])));
        by_block(
            asked,
            || (),
            |at, asked, ()| {
                gains(
                    level,
                    &near,
                    &self.samples[at..],
                    &last[at..],
                    &goal[at..],
                    asked,
                );
            },
        );
        near
    }

    /// Changes patterns by S' c; `change` takes the first pixel of a block, its part of S' c, and those of
    /// the patterns and of `ahead`.
    fn backward(
        &self,
        images: &[Lanes],
        patterns: &mut [Lanes],
        ahead: &mut [Lanes],
        change: impl Fn(usize, &[Lanes], &mut [Lanes], &mut [Lanes]) + Sync,
    ) {
        let tasks = patterns
            .par_chunks_mut(TASK)
            .zip(ahead.par_chunks_mut(TASK));
        tasks.enumerate().for_each(|(task, (patterns, ahead))| {
            let mut back = [[0.0; LANES]; BLOCK];
            let blocks = patterns.chunks_mut(BLOCK).zip(ahead.chunks_mut(BLOCK));
            for (block, (patterns, ahead)) in blocks.enumerate() {
                let at = task * TASK + block * BLOCK;
                let back = &mut back[..patterns.len()];
                self.light.adjoint(at, images, back);
                change(at, back, patterns, ahead);
            }
        });
    }
}

multiversion! {
    /// Wanted pictures become y; squared distances from the last target and from black are added up.
    fn distance(
        samples: &[[f32; SAMPLE]],
        last: &[f32],
        goal: &mut [Lanes],
        sums: &mut [Lanes; 2],
    ) {
        let [far, all] = sums;
        for ((goal, [white, ambient, ..]), last) in goal.iter_mut().zip(samples).zip(last) {
            let target = lanes(|k| white * goal[k]);
            let change = lanes(|k| target[k] - white * last);
            *far = lanes(|k| far[k] + change[k] * change[k]);
            *all = lanes(|k| all[k] + target[k] * target[k]);
            *goal = lanes(|k| target[k] - ambient);
        }
    }
}

multiversion! {
    /// The light that is missing, as a share of that of a white pattern.
    fn gains(
        near: &Lanes,
        samples: &[[f32; SAMPLE]],
        last: &[f32],
        goal: &[Lanes],
        asked: &mut [Lanes],
    ) {
        let rows = goal.iter().zip(samples).zip(last).zip(asked);
        for (((goal, [white, ambient, weight, full]), last), asked) in rows {
            let known = white * last - ambient;
            let gain = if *weight > 0.0 { 1.0 / full } else { 0.0 };
            *asked = lanes(|k| gain * (goal[k] - near[k] * known));
        }
    }
}

multiversion! {
    /// The last pattern for frames near it, plus what gains of single pixels make of the difference.
    fn start(
        near: &Lanes,
        last: &[f32],
        pixels: &[[f32; PIXEL]],
        back: &[Lanes],
        patterns: &mut [Lanes],
    ) {
        let rows = patterns.iter_mut().zip(back).zip(last).zip(pixels);
        for (((pattern, back), last), [_, seen, most]) in rows {
            let share = if *seen > 0.0 { 1.0 / seen } else { 0.0 };
            let value = lanes(|k| near[k] * last + share * back[k]);
            *pattern = lanes(|k| value[k].max(0.0).min(*most));
        }
    }
}

multiversion! {
    /// The weighted misfit W (T p - y) of T p
    fn weigh(goal: &[Lanes], samples: &[[f32; SAMPLE]], block: &mut [Lanes]) {
        for ((light, goal), [_, _, weight, _]) in block.iter_mut().zip(goal).zip(samples) {
            *light = lanes(|k| weight * (light[k] - goal[k]));
        }
    }
}

multiversion! {
    /// A step of the Chebyshev iteration: ahead = kept ahead - (back + r p) / L, p = p + rate ahead
    fn descend(
        rates: (f32, f32, f32),
        pixels: &[[f32; PIXEL]],
        back: &[Lanes],
        patterns: &mut [Lanes],
        ahead: &mut [Lanes],
    ) {
        let (rate, kept, ridge) = rates;
        let rows = patterns.iter_mut().zip(ahead).zip(back).zip(pixels);
        for (((pattern, ahead), back), [bound, _, most]) in rows {
            let scale = 1.0 / bound;
            let gradient = lanes(|k| back[k] + ridge * pattern[k]);
            *ahead = lanes(|k| kept * ahead[k] - scale * gradient[k]);
            let value = lanes(|k| pattern[k] + rate * ahead[k]);
            *pattern = lanes(|k| value[k].max(0.0).min(*most));
        }
    }
}

multiversion! {
    /// Adds the squared errors of T p where samples count, and the samples that are reached.
    fn score(
        tolerance: f32,
        goal: &[Lanes],
        samples: &[[f32; SAMPLE]],
        block: &[Lanes],
        sums: &mut [Lanes; 2],
    ) {
        let [squares, reached] = sums;
        for ((light, goal), [white, _, weight, _]) in block.iter().zip(goal).zip(samples) {
            if *weight > 0.0 {
                let missed = lanes(|k| light[k] - goal[k]);
                *squares = lanes(|k| squares[k] + missed[k] * missed[k]);
                let most = tolerance * white;
                let close = lanes(|k| if missed[k].abs() <= most { 1.0 } else { 0.0 });
                add(reached, 1.0, &close);
            }
        }
    }
}

/// Sums in double precision: a camera has millions of samples.
fn add_double(sums: &mut [[f64; LANES]; 2], part: &[Lanes; 2]) {
    for (sums, part) in sums.iter_mut().zip(part) {
        for (sum, value) in sums.iter_mut().zip(part) {
            *sum += f64::from(*value);
        }
    }
}

fn total(tasks: &[[[f64; LANES]; 2]]) -> [[f64; LANES]; 2] {
    std::array::from_fn(|which| {
        std::array::from_fn(|k| tasks.iter().map(|sums| sums[which][k]).sum())
    })
}

/// Lanes (n) as one image after the other, (frames, n).
fn by_frame(lanes: &[Lanes], out: &mut [f32]) {
    let mut tasks: Vec<Vec<&mut [f32]>> = lanes.chunks(TASK).map(|_| Vec::new()).collect();
    for image in out.chunks_mut(lanes.len()) {
        for (task, part) in tasks.iter_mut().zip(image.chunks_mut(TASK)) {
            task.push(part);
        }
    }
    (tasks.into_par_iter().zip(lanes.par_chunks(TASK))).for_each(|(mut parts, lanes)| {
        for (block, lanes) in lanes.chunks(BLOCK).enumerate() {
            for (k, part) in parts.iter_mut().enumerate() {
                for (out, lanes) in part[block * BLOCK..].iter_mut().zip(lanes) {
                    *out = lanes[k];
                }
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::Sparse;

    /// A camera that sees each of its pixels in one of the projector, half as bright: patterns are known.
    #[test]
    fn a_plain_wall_is_solved() {
        let count = 2 * TASK + 3;
        let starts: Vec<i64> = (0..=count as i64).collect();
        let places: Vec<i32> = (0..count as i32).rev().collect();
        let (values, cells) = (vec![0.5; count], vec![0; count]);
        let wall = Sparse {
            indptr: &starts,
            indices: &places,
            values: &values,
        };
        let background = vec![0.0; count];
        let (samples, pixels) = (
            vec![[0.5, 0.1, 1.0, 0.5]; count],
            vec![[0.26, 0.5, 0.9]; count],
        );
        let scene = Scene {
            light: Light::new(wall, wall, &background, &cells, 1),
            samples: &samples,
            pixels: &pixels,
            ridge: 0.01,
            tolerance: 0.05,
        };
        let frames: Vec<Vec<f32>> = (0..3)
            .map(|k| {
                (0..count)
                    .map(|i| ((i + 5 * k) % 11) as f32 / 10.0)
                    .collect()
            })
            .collect();
        let wanted: Vec<&[f32]> = frames.iter().map(|frame| &frame[..]).collect();
        let mut out = vec![f32::NAN; 3 * count];
        let mut room = vec![f32::NAN; scene.room()];
        let black = (&vec![0.0; count][..], &vec![0.0; count][..]);
        let found = scene.frames(&wanted, black, 40, &mut out, &mut room);
        for (k, frame) in frames.iter().enumerate() {
            let mut squares = 0.0;
            for (i, light) in frame.iter().enumerate() {
                let best = (0.5 * (0.5 * light - 0.1) / 0.26).clamp(0.0, 0.9);
                assert!((out[k * count + count - 1 - i] - best).abs() < 1e-5);
                squares += f64::from((0.5 * best + 0.1 - 0.5 * light).powi(2));
            }
            assert!((found.squares[k] - squares).abs() < 1e-3 * squares);
            // Darker pictures than the ambient light are not reached.
            let bright = frame.iter().filter(|light| **light > 0.15).count();
            assert!((found.reached[k] - bright as f64).abs() < 0.5);
        }
    }
}
