//! When a visible leaf is asked about again.
//!
//! A leaf that went out of sight is drawn in vain until its next test. If a share `h` of the leaves,
//! by what they cost, goes out of sight in a frame and each is tested every `n` frames, a share
//! `h n / 2` of the drawing is in vain. What just came into sight goes out of it far more often than
//! what has long been there, so `h` is counted for each number of tests passed in a row. Of all
//! periods that keep the share drawn in vain at a given bound, `n` in proportion to `1 / sqrt(c h)`
//! asks least, with `c` the mean cost of a leaf (Lagrange).

/// Numbers of passed tests that are told apart.
const CLASSES: usize = 8;
/// Weight of the last frame's counts in the next.
const FADING: f64 = 0.97;
/// Leaf frames that the first guess counts for.
const GUESSED_FRAMES: f64 = 16.0;

/// Counts of visible leaves and of those that went out of sight, per class.
#[derive(Clone, Debug, Default)]
pub(super) struct RetestTable {
    /// Frames of leaves.
    frames: [f64; CLASSES],
    /// The same, each leaf weighed by its cost.
    costs: [f64; CLASSES],
    /// Cost of the leaves that went out of sight.
    lost: [f64; CLASSES],
    /// Periods for a share of 1 drawn in vain.
    periods: [f64; CLASSES],
}

impl RetestTable {
    /// Takes in the test of a leaf of that cost that had passed `passed` tests, the last one `frames`
    /// ago.
    pub fn record(&mut self, passed: u16, frames: u32, cost: u64, lost: bool) {
        let class = class_of(passed);
        let (frames, cost) = (f64::from(frames.max(1)), cost.max(1) as f64);
        // It went at some time since the last test: in the middle, on average.
        let visible = if lost { 0.5 * (frames + 1.0) } else { frames };
        self.frames[class] += visible;
        self.costs[class] += cost * visible;
        self.lost[class] += if lost { cost } else { 0.0 };
    }

    /// Works the periods out; older frames count less from now on.
    pub fn begin_frame(&mut self) {
        let counts = self.frames.iter_mut().chain(&mut self.costs).chain(&mut self.lost);
        counts.for_each(|count| *count *= FADING);
        let [all, dear] = [self.frames, self.costs].map(|counts| counts.iter().sum::<f64>());
        let guessed = GUESSED_FRAMES * if all > 0.0 { dear / all } else { 1.0 };
        let classes: [(f64, f64, f64); CLASSES] = std::array::from_fn(|class| {
            let cost = self.costs[class] + guessed;
            let loss = (self.lost[class] + 0.05 * 0.5f64.powi(class as i32) * guessed) / cost;
            (self.frames[class] + GUESSED_FRAMES, cost, loss)
        });
        let drawn: f64 = classes.iter().map(|(_, cost, _)| cost).sum();
        let asked: f64 =
            classes.iter().map(|(frames, cost, loss)| (frames * cost * loss).sqrt()).sum();
        self.periods = classes
            .map(|(frames, cost, loss)| 2.0 * drawn / asked * (frames / (cost * loss)).sqrt());
    }

    /// Frames until the next test of a leaf, at least 1 and at most `most`, with a share `in_vain` of
    /// the drawing in vain.
    pub fn period(&self, passed: u16, in_vain: f64, most: u32) -> u32 {
        // Casts of what is no number give 0.
        ((in_vain * self.periods[class_of(passed)]).round() as u32).clamp(1, most.max(1))
    }
}

fn class_of(passed: u16) -> usize {
    usize::from(passed).min(CLASSES - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Random;

    /// Leaves that go out of sight the sooner the younger they are: (share drawn in vain, questions
    /// a frame and leaf).
    fn drawn_in_vain(mut period: impl FnMut(&RetestTable, u16) -> u32) -> (f64, f64) {
        struct Leaf {
            age: u32,
            gone: bool,
            passed: u16,
            tested: u32,
            next: u32,
        }
        let mut table = RetestTable::default();
        let mut random = Random::new(7, 0);
        let new = |frame| Leaf { age: 0, gone: false, passed: 0, tested: frame, next: frame + 1 };
        let mut leaves: Vec<Leaf> = (0..2000).map(|_| new(0)).collect();
        let (mut drawn, mut vain, mut questions) = (0u64, 0u64, 0u64);
        for frame in 1..300 {
            table.begin_frame();
            for leaf in &mut leaves {
                leaf.age += 1;
                leaf.gone |= random.unit() < 0.3 / f64::from(leaf.age);
                if frame > 100 {
                    drawn += 1;
                    vain += u64::from(leaf.gone);
                    questions += u64::from(leaf.next == frame);
                }
                if leaf.next == frame {
                    table.record(leaf.passed, frame - leaf.tested, 12, leaf.gone);
                    leaf.passed += 1;
                    if leaf.gone {
                        *leaf = new(frame);
                    }
                    leaf.tested = frame;
                    leaf.next = frame + period(&table, leaf.passed);
                }
            }
        }
        (vain as f64 / drawn as f64, questions as f64 / drawn as f64)
    }

    /// What a test finds gone was drawn in vain in the frame of the test too, whatever the period.
    #[test]
    fn the_bound_is_kept_with_fewer_questions_than_with_one_period_for_all() {
        let (least, _) = drawn_in_vain(|_, _| 1);
        for share in [0.05, 0.1, 0.2] {
            let (vain, questions) =
                drawn_in_vain(|table, passed| table.period(passed, share, u32::MAX));
            assert!(vain - least <= share && vain - least >= 0.3 * share, "{vain} for {share}");
            let uniform = (2..).map(|period| drawn_in_vain(move |_, _| period));
            let (_, same_waste) =
                uniform.take_while(|(wasted, _)| *wasted <= vain).last().unwrap_or((1.0, 1.0));
            assert!(questions < same_waste, "{questions} {same_waste} for {share}");
        }
    }

    #[test]
    fn periods_stay_between_one_and_the_most() {
        let mut table = RetestTable::default();
        assert_eq!(table.period(0, 0.1, 10), 1, "before anything was counted");
        (0..10_000).for_each(|_| table.record(3, 5, 80, false));
        table.begin_frame();
        assert_eq!(table.period(3, 0.1, 10), 10);
        assert_eq!(table.period(3, f64::NAN, 10), 1);
        assert_eq!(table.period(3, 0.1, 0), 1);
    }

    /// Cheap leaves that come and go are no reason to ask about everything.
    #[test]
    fn cheap_leaves_that_flicker_change_little() {
        let mut table = RetestTable::default();
        for _ in 0..100 {
            (0..50).for_each(|_| table.record(0, 1, 1, true));
            (0..50).for_each(|_| table.record(7, 10, 1000, false));
            table.begin_frame();
        }
        assert_eq!(table.period(0, 0.05, 10), 10);
        assert_eq!(table.period(7, 0.05, 10), 10);
    }
}
