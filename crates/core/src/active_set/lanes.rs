//! Solves several rows at a time, so that they share passes over the patterns.

use super::restricted::Restricted;
use super::row::{Next, Problem, RowSolver};
use crate::correlate::{Scores, Scratch};
use crate::problem::{Dictionary, Rows, Settings, Solution};
use crate::simd::Level;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

struct Lane {
    solver: RowSolver,
    scores: Scores,
    /// The row that this lane is solving.
    row: usize,
}

/// Solves rows until none is left; `waiting` is the next row that no thread has begun. Rows do not
/// depend on each other, so it does not matter which thread solves which.
pub fn solve_rows(
    dictionary: &Dictionary,
    rows: Rows,
    settings: Settings,
    waiting: &AtomicUsize,
    cancelled: &AtomicBool,
    finished: &AtomicUsize,
) -> Vec<(usize, Solution)> {
    let problem = Problem {
        dictionary,
        settings: &settings,
    };
    let mut solutions = Vec::new();
    let mut scratch = Scratch::default();
    // These buffers are large. Lanes share them, which leaves the caches to the patterns.
    let mut restricted = Restricted::new(dictionary.level);
    // Batches are full until the rows run out. Where there are few rows, every thread gets some.
    let batch = dictionary.correlator.batch();
    let lanes = batch.min(rows.count.div_ceil(rayon::current_num_threads()));
    let mut lanes: Vec<Lane> = (0..lanes)
        .map(|_| Lane {
            solver: RowSolver::new(),
            scores: Scores::default(),
            row: 0,
        })
        .collect();
    // Advances a lane until it needs a pass (returns true) or no row is left for it (false).
    let mut advance = |lane: &mut Lane, next: Option<Next>, restricted: &mut Restricted| {
        let mut next = next;
        loop {
            match next {
                Some(Next::Pass) => return true,
                Some(Next::Done) => {
                    solutions.push((lane.row, lane.solver.solution(problem)));
                    finished.fetch_add(1, Ordering::Relaxed);
                }
                None => {}
            }
            lane.row = waiting.fetch_add(1, Ordering::Relaxed);
            if lane.row >= rows.count {
                return false;
            }
            next = Some(lane.solver.begin(problem, rows, lane.row, restricted));
        }
    };
    lanes.retain_mut(|lane| advance(lane, None, &mut restricted));
    while !lanes.is_empty() && !cancelled.load(Ordering::Relaxed) {
        let (residuals, mut scores): (Vec<&[f64]>, Vec<&mut Scores>) = lanes
            .iter_mut()
            .map(|lane| {
                lane.scores.filter = lane.solver.filter();
                (lane.solver.dual(), &mut lane.scores)
            })
            .unzip();
        dictionary
            .correlator
            .run(&dictionary.columns, &residuals, &mut scores, &mut scratch);
        lanes.retain_mut(|lane| {
            let next = lane
                .solver
                .after_pass(problem, &lane.scores, &mut restricted);
            advance(lane, Some(next), &mut restricted)
        });
    }
    solutions
}

/// Solves one row at a time, each with a dictionary of its own, in the same memory.
pub struct SingleRowSolver {
    solver: RowSolver,
    scores: Scores,
    scratch: Scratch,
    restricted: Restricted,
}

impl SingleRowSolver {
    pub fn new(level: Level) -> Self {
        SingleRowSolver {
            solver: RowSolver::new(),
            scores: Scores::default(),
            scratch: Scratch::default(),
            restricted: Restricted::new(level),
        }
    }

    /// Solves the only row of `rows`.
    pub fn solve(&mut self, dictionary: &Dictionary, rows: Rows, settings: Settings) -> Solution {
        let problem = Problem {
            dictionary,
            settings: &settings,
        };
        let SingleRowSolver {
            solver,
            scores,
            scratch,
            restricted,
        } = self;
        let Dictionary {
            columns,
            correlator,
            ..
        } = dictionary;
        let mut next = solver.begin(problem, rows, 0, restricted);
        while let Next::Pass = next {
            scores.filter = solver.filter();
            correlator.run(columns, &[solver.dual()], &mut [scores], scratch);
            next = solver.after_pass(problem, scores, restricted);
        }
        solver.solution(problem)
    }
}
