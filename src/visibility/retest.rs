//! When a visible leaf is asked about again.
//!
//! A leaf that went out of sight is drawn in vain until its next test. If a share `h` of the leaves
//! go out of sight in a frame and each is tested every `n` frames, a share `h n / 2` of what is drawn
//! is drawn in vain. What just came into sight goes out of it far more often than what has long been
//! there, so `h` is counted for each number of tests passed in a row. Of all periods that keep the
//! share drawn in vain at a given bound, `n` in proportion to `1 / sqrt(h)` asks least (Lagrange).

/// Numbers of passed tests that are told apart.
const CLASSES: usize = 8;
/// Weight of the last frame's counts in the next.
const FADING: f64 = 0.97;
/// Leaf frames that the first guess counts for.
const GUESSED_FRAMES: f64 = 16.0;

/// Counts of leaves that went out of sight, per class.
#[derive(Clone, Debug, Default)]
pub(super) struct RetestTable {
    frames: [f64; CLASSES],
    lost: [f64; CLASSES],
    /// Periods for a share of 1 drawn in vain.
    periods: [f64; CLASSES],
}

impl RetestTable {
    /// Takes in the test of a leaf that had passed `passed` tests, the last one `frames` ago.
    pub fn record(&mut self, passed: u16, frames: u32, lost: bool) {
        let class = class_of(passed);
        let frames = f64::from(frames.max(1));
        // It went at some time since the last test: in the middle, on average.
        self.frames[class] += if lost { 0.5 * (frames + 1.0) } else { frames };
        self.lost[class] += f64::from(u8::from(lost));
    }

    /// Works the periods out; older frames count less from now on.
    pub fn begin_frame(&mut self) {
        self.frames.iter_mut().chain(&mut self.lost).for_each(|count| *count *= FADING);
        let frames = self.frames.map(|frames| frames + GUESSED_FRAMES);
        let roots: [f64; CLASSES] = std::array::from_fn(|class| {
            let guess = 0.2 * 0.5f64.powi(class as i32);
            ((self.lost[class] + guess * GUESSED_FRAMES) / frames[class]).sqrt()
        });
        let all: f64 = frames.iter().sum();
        let weighted: f64 = frames.iter().zip(&roots).map(|(frames, root)| frames * root).sum();
        self.periods = roots.map(|root| 2.0 * all / (root * weighted));
    }

    /// Frames until the next test of a leaf, at least 1 and at most `most`, with a share `in_vain` of
    /// the drawn leaves drawn in vain.
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
                    table.record(leaf.passed, frame - leaf.tested, leaf.gone);
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
        (0..10_000).for_each(|_| table.record(3, 5, false));
        table.begin_frame();
        assert_eq!(table.period(3, 0.1, 10), 10);
        assert_eq!(table.period(3, f64::NAN, 10), 1);
        assert_eq!(table.period(3, 0.1, 0), 1);
    }
}
