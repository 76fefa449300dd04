//! What drawing and asking cost where they are done: prices learned from the times of frames.
//!
//! Four prices: a triangle, a leaf, a question, a wait for answers. Frames of one place look much
//! alike and do not tell all four apart; then fewer numbers are fitted: what drawing costs and what
//! asking costs, each in the proportions known so far, or one factor for all. Samples that tell
//! nothing change nothing. The latest samples count, so prices follow the machine.

use std::collections::VecDeque;

use crate::budget::least_squares::Design;

/// Samples that count.
const REMEMBERED: usize = 64;
/// Samples before the first fit.
const FEWEST: usize = 6;
/// Most that a fit changes a price at once: the first fits see few samples.
const LARGEST_STEP: f64 = 8.0;
/// A fit whose residuals are larger than this share of the times is not taken.
const LARGEST_RESIDUAL: f64 = 0.35;

/// Triangles, leaves, questions, waits: of one frame, or the price of one each.
pub type CullingWork = [f64; 4];

/// How a fit came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FittedPrices {
    /// Each of those that the samples have by itself.
    Each,
    /// Drawing and asking, by a factor each.
    DrawingAndAsking,
    /// All by one factor.
    Together,
    /// None: too few samples, or samples that contradict each other.
    Refused,
}

/// Prices that follow the frames.
#[derive(Clone, Debug)]
pub struct CullingPrices {
    prices: CullingWork,
    samples: VecDeque<(CullingWork, f64)>,
    last: FittedPrices,
    fits: u64,
}

impl CullingPrices {
    /// Starts from guessed prices, all above zero; their proportions hold until samples tell more.
    pub fn new(prices: CullingWork) -> Self {
        CullingPrices {
            prices,
            samples: VecDeque::with_capacity(REMEMBERED),
            last: FittedPrices::Refused,
            fits: 0,
        }
    }

    /// The prices as they are now, in the unit of the times.
    pub fn prices(&self) -> CullingWork {
        self.prices
    }

    /// How the last sample changed them.
    pub fn last(&self) -> FittedPrices {
        self.last
    }

    /// How often they were fitted.
    pub fn fits(&self) -> u64 {
        self.fits
    }

    /// Takes in a frame. What is no number, or not above zero, is left out.
    pub fn observe(&mut self, work: CullingWork, time: f64) -> FittedPrices {
        let sound = work.iter().all(|count| count.is_finite() && *count >= 0.0);
        let expected = dot(&work, &self.prices);
        if !(sound && time.is_finite() && time > 0.0 && expected > 0.0) {
            self.last = FittedPrices::Refused;
            return self.last;
        }
        if self.samples.len() == REMEMBERED {
            self.samples.pop_front();
        }
        self.samples.push_back((work, time));
        self.last = match self.samples.len() < FEWEST {
            true => FittedPrices::Refused,
            false => self.fit(),
        };
        self.fits += u64::from(self.last != FittedPrices::Refused);
        self.last
    }

    fn fit(&mut self) -> FittedPrices {
        // Counts that no sample has say nothing about their price.
        let known: Vec<usize> =
            (0..4).filter(|&i| self.samples.iter().any(|(work, _)| work[i] > 0.0)).collect();
        let each: Vec<Vec<usize>> = known.iter().map(|&i| vec![i]).collect();
        let side = |range: [usize; 2]| -> Vec<usize> {
            range.into_iter().filter(|i| known.contains(i)).collect()
        };
        let sides: Vec<Vec<usize>> =
            [side([0, 1]), side([2, 3])].into_iter().filter(|side| !side.is_empty()).collect();
        for (groups, kind) in [
            (each, FittedPrices::Each),
            (sides, FittedPrices::DrawingAndAsking),
            (vec![known.clone()], FittedPrices::Together),
        ] {
            if let Some(factors) = self.factors(&groups) {
                for (group, factor) in groups.iter().zip(factors) {
                    let factor = factor.clamp(1.0 / LARGEST_STEP, LARGEST_STEP);
                    group.iter().for_each(|&i| self.prices[i] *= factor);
                }
                return kind;
            }
        }
        FittedPrices::Refused
    }

    /// A factor for each group of prices, if the samples tell them apart and bear them out.
    fn factors(&self, groups: &[Vec<usize>]) -> Option<Vec<f64>> {
        let mut design = Design::new(groups.len());
        for (work, time) in &self.samples {
            let part = |group: &Vec<usize>| -> f64 {
                group.iter().map(|&i| work[i] * self.prices[i]).sum()
            };
            let row: Vec<f64> = groups.iter().map(part).collect();
            design.push(&row, *time, 1.0 / time);
        }
        let solution = design.solve_robust().ok()?;
        // A price of nothing is what a fit gives to counts that it cannot tell from others.
        let told = solution.prices.iter().all(|factor| factor.is_finite() && *factor > 0.0);
        (told && solution.median_residual <= LARGEST_RESIDUAL).then_some(solution.prices)
    }
}

fn dot(a: &CullingWork, b: &CullingWork) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Random;

    const GUESS: CullingWork = [60.0, 400.0, 2000.0, 150_000.0];

    /// Frames of an attempt: everything drawn with many questions, then little with few, and
    /// frames without any.
    fn work(index: u64) -> CullingWork {
        let mut random = Random::new(5, index);
        let all = random.between(2e5, 2e6);
        let triangles_a_leaf = random.between(50.0, 2000.0);
        let (triangles, questions, waits) = match index % 3 {
            0 => (all, all / triangles_a_leaf, 0.0),
            1 => (0.1 * all, random.between(20.0, 200.0), (1 + index % 4) as f64),
            _ => (all, 0.0, 0.0),
        };
        [triangles, triangles / triangles_a_leaf, questions, waits]
    }

    #[test]
    fn prices_far_from_the_guess_are_found() {
        // A device that draws a thousand times as fast and answers ten times as slowly.
        let truth = [0.06, 2.0, 900.0, 1_500_000.0];
        let mut prices = CullingPrices::new(GUESS);
        for index in 0..120 {
            let noise = 1.0 + 0.02 * Random::new(6, index).bell();
            prices.observe(work(index), dot(&work(index), &truth) * noise);
        }
        for (found, true_price) in prices.prices().iter().zip(truth) {
            assert!((found / true_price - 1.0).abs() < 0.3, "{:?}", prices.prices());
        }
        assert_eq!(prices.last(), FittedPrices::Each);
    }

    #[test]
    fn frames_that_look_alike_keep_proportions() {
        let mut prices = CullingPrices::new(GUESS);
        let alike = [1e6, 1000.0, 0.0, 0.0];
        for _ in 0..40 {
            prices.observe(alike, 0.5 * dot(&alike, &GUESS));
        }
        let [triangle, leaf, question, wait] = prices.prices();
        assert!((triangle / 30.0 - 1.0).abs() < 0.01 && (leaf / 200.0 - 1.0).abs() < 0.01);
        assert_eq!((question, wait), (2000.0, 150_000.0), "nothing is known of them");
        // Two kinds of frames tell drawing from asking, and no more.
        let asking = [1e5, 100.0, 300.0, 0.0];
        let truth = [30.0, 200.0, 8000.0, 150_000.0];
        for _ in 0..40 {
            prices.observe(alike, dot(&alike, &truth));
            prices.observe(asking, dot(&asking, &truth));
        }
        let [triangle, leaf, question, _] = prices.prices();
        assert!((triangle / 30.0 - 1.0).abs() < 0.05 && (leaf / 200.0 - 1.0).abs() < 0.05);
        assert!((question / 8000.0 - 1.0).abs() < 0.05, "{question}");
        assert_eq!(prices.last(), FittedPrices::DrawingAndAsking);
    }

    #[test]
    fn what_tells_nothing_changes_nothing() {
        let mut prices = CullingPrices::new(GUESS);
        for (work, time) in [
            ([0.0; 4], 1.0),
            ([1.0, 1.0, 1.0, f64::NAN], 1.0),
            ([1.0, 1.0, 1.0, -1.0], 1.0),
            ([1e6, 1.0, 1.0, 1.0], 0.0),
            ([1e6, 1.0, 1.0, 1.0], f64::INFINITY),
        ] {
            assert_eq!(prices.observe(work, time), FittedPrices::Refused);
        }
        // Times that have nothing to do with the counts.
        for index in 0..100u64 {
            let time = 10f64.powf(Random::new(9, index).between(0.0, 9.0));
            prices.observe(work(index), time);
        }
        assert!(prices.prices().iter().all(|price| price.is_finite() && *price > 0.0));
        let before = prices.fits();
        assert!(before < 30, "{before} fits to noise");
    }
}
