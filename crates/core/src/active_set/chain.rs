//! Chains of rows, each started from the one before, that share passes over the patterns.

use super::row::{Next, RowSolver};
use super::{Dictionary, Rows, Settings, Solution};
use crate::correlate::{Scores, Scratch, BATCH};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

pub struct Chain<'a> {
    rows: Rows<'a>,
    first: usize,
    done: usize,
    solutions: &'a mut [Solution],
    solver: RowSolver<'a>,
    scores: Scores,
}

impl<'a> Chain<'a> {
    pub fn new(
        dictionary: &'a Dictionary,
        rows: Rows<'a>,
        settings: Settings,
        first: usize,
        solutions: &'a mut [Solution],
    ) -> Self {
        Chain {
            rows,
            first,
            done: 0,
            solutions,
            solver: RowSolver::new(dictionary, settings),
            scores: Scores::default(),
        }
    }

    /// Goes on until a pass is needed (true) or all rows are solved (false).
    fn advance(&mut self, mut next: Option<Next>, finished: &AtomicUsize) -> bool {
        loop {
            match next {
                Some(Next::Pass) => return true,
                Some(Next::Done) => {
                    self.solutions[self.done] = self.solver.solution();
                    self.done += 1;
                    finished.fetch_add(1, Ordering::Relaxed);
                }
                None => {}
            }
            if self.done == self.solutions.len() {
                return false;
            }
            next = Some(self.solver.begin(self.rows, self.first + self.done));
        }
    }

    fn after_pass(&mut self, finished: &AtomicUsize) -> bool {
        let next = self.solver.after_pass(&self.scores);
        self.advance(Some(next), finished)
    }
}

/// Solves the rows of all chains, a pass for several at a time.
pub fn solve_together(
    dictionary: &Dictionary,
    mut chains: Vec<Chain>,
    cancelled: &AtomicBool,
    finished: &AtomicUsize,
) {
    let mut scratch = Scratch::default();
    chains.retain_mut(|chain| chain.advance(None, finished));
    while !chains.is_empty() && !cancelled.load(Ordering::Relaxed) {
        for batch in chains.chunks_mut(BATCH) {
            let (residuals, mut scores): (Vec<&[f64]>, Vec<&mut Scores>) = batch
                .iter_mut()
                .map(|chain| (chain.solver.dual(), &mut chain.scores))
                .unzip();
            dictionary
                .correlator
                .run(&dictionary.columns, &residuals, &mut scores, &mut scratch);
        }
        chains.retain_mut(|chain| chain.after_pass(finished));
    }
}
