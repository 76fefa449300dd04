//! The search for a budget whose cut is expected to fit.
//!
//! Time does not grow in proportion to points: with fewer points splats are larger, and the pixels
//! stay. So budgets are tried, and the next try lies between what fitted and what did not.

/// Trials for one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BudgetSearch {
    next: Option<u64>,
    most: u64,
    free_ms: f64,
    fits: Option<Trial>,
    over: Option<Trial>,
    /// The two last trials, the later one second.
    last: [Option<Trial>; 2],
    tries: u32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Trial {
    budget: u64,
    expected_ms: f64,
}

/// Most trials per frame.
pub const MOST_TRIALS: u32 = 6;
/// Share of the free time that is used well enough.
const WELL_USED: f64 = 0.85;
/// Share of the free time that a trial aims at.
const AIM: f64 = 0.95;
/// Factor between a budget that fits and one that does not, below which nothing more is tried.
const NEAR: f64 = 1.05;

impl BudgetSearch {
    /// Begins with a budget, of at most `most` points.
    pub fn new(first: u64, most: u64, free_ms: f64) -> Self {
        let free_ms = if free_ms > 0.0 { free_ms } else { 0.0 };
        let next = (free_ms > 0.0).then_some(first.clamp(1, most.max(1)));
        BudgetSearch { next, most, free_ms, fits: None, over: None, last: [None; 2], tries: 0 }
    }

    /// The next budget to try; `None` if the search is over.
    pub fn next_trial(&self) -> Option<u64> {
        self.next.filter(|_| self.tries < MOST_TRIALS)
    }

    /// Budgets tried.
    pub fn tries(&self) -> u32 {
        self.tries
    }

    /// The largest budget that was found to fit; 0 if none did.
    pub fn budget(&self) -> u64 {
        self.fits.map_or(0, |fits| fits.budget.min(self.most))
    }

    /// Notes what the trial of `budget` found: the points of its cut, their expected time, and
    /// whether the budget bound the cut.
    pub fn note(&mut self, budget: u64, points: u64, expected_ms: f64, is_bound: bool) {
        self.tries += 1;
        self.last = [self.last[1], Some(Trial { budget, expected_ms })];
        if expected_ms <= self.free_ms {
            self.fits = Some(Trial { budget, expected_ms });
            let is_full = expected_ms >= WELL_USED * self.free_ms;
            if !is_bound || is_full || budget >= self.most {
                self.next = None;
                return;
            }
        } else {
            // A budget that binds nothing is as good as the points that were chosen.
            let budget = budget.min(points.max(1));
            self.over = Some(Trial { budget, expected_ms });
            if points <= 1 {
                self.next = None;
                return;
            }
        }
        self.next = self.between().filter(|&next| next >= 1);
    }

    fn between(&self) -> Option<u64> {
        let aim_ms = AIM * self.free_ms;
        let next = match (self.fits, self.over) {
            (Some(fits), None) => {
                let in_proportion = fits.budget as f64 * aim_ms / fits.expected_ms;
                let low = NEAR * fits.budget as f64;
                let next = self.along_the_last(aim_ms).unwrap_or(in_proportion);
                next.clamp(low, (64.0 * low).max(low)).ceil().min(self.most as f64)
            }
            (None, Some(over)) => {
                let in_proportion = over.budget as f64 * aim_ms / over.expected_ms;
                let next = self.along_the_last(aim_ms).unwrap_or(in_proportion);
                next.clamp(0.02 * over.budget as f64, 0.7 * over.budget as f64).floor()
            }
            (Some(fits), Some(over)) => {
                let (low, high) = (fits.budget as f64, over.budget as f64);
                if high <= NEAR * low {
                    return None;
                }
                let share = (aim_ms - fits.expected_ms) / (over.expected_ms - fits.expected_ms);
                low + (high - low) * share.clamp(0.1, 0.9)
            }
            (None, None) => return None,
        };
        Some(next as u64)
    }

    /// Where the line through the last two trials reaches a time, if it rises.
    fn along_the_last(&self, aim_ms: f64) -> Option<f64> {
        let [Some(a), Some(b)] = self.last else { return None };
        let slope = (b.expected_ms - a.expected_ms) / (b.budget as f64 - a.budget as f64);
        let next = b.budget as f64 + (aim_ms - b.expected_ms) / slope;
        (slope > 0.0 && next.is_finite()).then_some(next)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Random;

    /// Points at a price, and pixels that stay the same until splats are single pixels.
    fn expected_ms(points: u64, point_ms: f64, covered_ms: f64, single_ms: f64) -> f64 {
        point_ms * points as f64 + covered_ms.max(single_ms * points as f64)
    }

    fn search(first: u64, most: u64, free_ms: f64, cost: impl Fn(u64) -> f64) -> BudgetSearch {
        let mut search = BudgetSearch::new(first, most, free_ms);
        while let Some(budget) = search.next_trial() {
            // The scene has ten million points.
            let points = budget.min(10_000_000);
            search.note(budget, points, cost(points), points == budget);
        }
        search
    }

    /// The hysteresis: what takes nearly all of the time is kept without another trial.
    #[test]
    fn a_budget_that_uses_the_time_well_stays() {
        let tried = |expected_ms: f64| {
            let mut search = BudgetSearch::new(1_000, 1_000_000, 10.0);
            search.note(1_000, 1_000, expected_ms, true);
            (search.next_trial().is_none(), search.budget())
        };
        assert_eq!(tried(9.0), (true, 1_000));
        assert_eq!(tried(8.0), (false, 1_000), "more may fit");
        assert_eq!(tried(11.0), (false, 0), "less has to");
    }

    #[test]
    fn what_is_found_fits_and_uses_the_time() {
        let (mut well_used, mut all) = (0, 0);
        for index in 0..2000 {
            let mut random = Random::new(23, index);
            let point_ms = 10f64.powf(random.between(-6.0, -4.0));
            let covered_ms = random.between(0.0, 12.0);
            let cost = |points| expected_ms(points, point_ms, covered_ms, 0.5 * point_ms);
            let first = 10f64.powf(random.between(4.0, 7.0)) as u64;
            let found = search(first, 5_000_000, 16.0, cost);
            assert!(found.budget() == 0 || cost(found.budget()) <= 16.0, "{index}: {found:?}");
            assert!(found.tries() <= MOST_TRIALS && found.budget() <= 5_000_000);
            all += 1;
            let is_full = found.budget() >= 5_000_000 || cost(found.budget()) >= 0.8 * 16.0;
            well_used += u32::from(is_full);
        }
        assert!(100 * well_used >= 95 * all, "{well_used} of {all}");
    }

    #[test]
    fn a_good_guess_is_tried_once() {
        let cost = |points: u64| 1e-5 * points as f64;
        assert_eq!(search(1_500_000, 5_000_000, 16.0, cost).tries(), 1);
        assert_eq!(search(u64::MAX, 1_000_000, 16.0, cost).tries(), 1, "the user's budget binds");
    }

    #[test]
    fn no_time_and_no_prices_end_at_once() {
        for free_ms in [0.0, -1.0, f64::NAN] {
            let found = search(1000, 5000, free_ms, |_| 0.0);
            assert_eq!((found.tries(), found.budget()), (0, 0), "{free_ms}");
        }
        assert_eq!(search(1000, 5000, 16.0, |_| f64::NAN).budget(), 0);
        assert_eq!(search(1000, 5000, 16.0, |_| f64::INFINITY).budget(), 0);
        assert_eq!(search(1000, 0, 16.0, |_| 0.0).budget(), 0);
    }

    #[test]
    fn scenes_whose_pixels_alone_take_too_long_end_at_the_least() {
        let found = search(1_000_000, 5_000_000, 16.0, |points| 20.0 + 1e-6 * points as f64);
        assert_eq!(found.budget(), 0);
    }
}
