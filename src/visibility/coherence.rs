//! How likely a node is to keep its classification, learned from the frames so far.
//!
//! For each number of tests in a row that kept the classification the table counts how many nodes
//! were tested and how many kept it once more. Old frames fade, so that the table follows the motion.
//!
//! After: Mattausch et al. 2008, section 5.1; smoothing, fading and the bound are ours.

use crate::visibility::history::LONGEST_PERSISTENCE;

/// Where the probability comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum KeepRule {
    /// Counted, with the analytic form where too little was seen.
    #[default]
    Measured,
    /// `0.99 - 0.7 exp(-i)` for a node that kept its classification `i` times.
    Analytic,
}

/// Tests below which a count says nothing.
const LEAST_TESTS: f64 = 16.0;
/// Weight of the last frame's counts in the next.
const FADING: f64 = 0.99;
/// No group may rest on certainty: one failure costs all its members.
const MOST: f64 = 1.0 - 1.0 / 4096.0;

/// Counts per persistence.
#[derive(Clone, Debug)]
pub struct CoherenceTable {
    tested: [f64; LENGTH],
    kept: [f64; LENGTH],
}

const LENGTH: usize = LONGEST_PERSISTENCE as usize + 1;

impl Default for CoherenceTable {
    fn default() -> Self {
        CoherenceTable { tested: [0.0; LENGTH], kept: [0.0; LENGTH] }
    }
}

impl CoherenceTable {
    /// Takes in the test of a node that had kept its classification `persistence` times.
    pub fn record(&mut self, persistence: u16, kept: bool) {
        let at = usize::from(persistence.min(LONGEST_PERSISTENCE));
        self.tested[at] += 1.0;
        self.kept[at] += f64::from(u8::from(kept));
    }

    /// Lets older frames count less.
    pub fn end_frame(&mut self) {
        self.tested.iter_mut().chain(&mut self.kept).for_each(|count| *count *= FADING);
    }

    /// Probability that a node keeps its classification once more.
    ///
    /// Where too little was seen the next smaller persistence with enough tests answers, and the
    /// analytic form where there is none.
    pub fn keep(&self, persistence: u16, rule: KeepRule) -> f64 {
        let at = usize::from(persistence.min(LONGEST_PERSISTENCE));
        let counted = (rule == KeepRule::Measured)
            .then(|| (0..=at).rev().find(|&at| self.tested[at] >= LEAST_TESTS))
            .flatten();
        match counted {
            Some(at) => ((self.kept[at] + 1.0) / (self.tested[at] + 2.0)).min(MOST),
            None => analytic(persistence),
        }
    }
}

fn analytic(persistence: u16) -> f64 {
    0.99 - 0.7 * (-f64::from(persistence)).exp()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Random;

    /// Nodes that flip with a known rate: the table finds the rate, and carries it on to longer
    /// times than any it saw.
    #[test]
    fn known_rates_are_found_and_carried_on() {
        for rate in [0.5, 0.9, 0.99] {
            let mut table = CoherenceTable::default();
            let mut random = Random::new(5, (rate * 100.0) as u64);
            let mut nodes = vec![0u16; 4000];
            let mut counts = [0u64; LENGTH];
            for _ in 0..40 {
                for persistence in &mut nodes {
                    let kept = random.unit() < rate;
                    counts[usize::from(*persistence)] += 1;
                    table.record(*persistence, kept);
                    *persistence = if kept { *persistence + 1 } else { 0 };
                }
                table.end_frame();
            }
            let mut seen = 0;
            for (at, count) in counts.iter().enumerate() {
                if *count >= 4000 {
                    let found = table.keep(at as u16, KeepRule::Measured);
                    assert!((found - rate).abs() < 0.02, "{found} for {rate} at {at}");
                    seen += 1;
                }
            }
            assert!(seen > 0);
            let beyond = table.keep(u16::MAX, KeepRule::Measured);
            assert!((beyond - rate).abs() < 0.2 && beyond < 1.0, "{beyond} for {rate}");
        }
    }

    #[test]
    fn the_analytic_form_answers_before_anything_was_seen() {
        let table = CoherenceTable::default();
        for (i, p) in [(0, 0.290), (1, 0.7325), (2, 0.8953), (3, 0.9551), (10, 0.990)] {
            assert!((table.keep(i, KeepRule::Measured) - p).abs() < 1e-3);
        }
    }

    #[test]
    fn certainty_is_never_reached() {
        let mut table = CoherenceTable::default();
        (0..1_000_000).for_each(|_| table.record(3, true));
        assert!(table.keep(3, KeepRule::Measured) <= MOST);
    }
}
