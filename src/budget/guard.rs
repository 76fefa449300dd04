//! What is added to a prediction so that hardly any frame takes longer, and when to measure anew.

use std::collections::VecDeque;

/// Frames that are remembered.
const FRAMES: usize = 256;
/// Frames after which an excess counts half.
const HALF_LIFE: f64 = 120.0;
/// Largest excess that counts: beyond, a frame was interrupted and says nothing about the next.
const MOST: f64 = 2.0;
/// Frames in a row whose signs tell a drift.
const DRIFT_FRAMES: usize = 120;

/// The share by which frames exceed their predictions: raised at once by a frame that does, lowered
/// slowly, and never below the worst of the last frames (their 99.9 % quantile).
#[derive(Clone, Debug, Default)]
pub struct Guard {
    excesses: VecDeque<f64>,
    faded: f64,
}

impl Guard {
    /// Takes in a frame. Numbers that are not finite, or a prediction of zero, are ignored.
    pub fn observe(&mut self, predicted_ms: f64, measured_ms: f64) {
        let excess = measured_ms / predicted_ms - 1.0;
        if !excess.is_finite() || predicted_ms <= 0.0 {
            return;
        }
        let excess = excess.clamp(0.0, MOST);
        self.faded = (self.faded * (-1.0 / HALF_LIFE).exp2()).max(excess);
        if self.excesses.len() == FRAMES {
            self.excesses.pop_front();
        }
        self.excesses.push_back(excess);
    }

    /// The share to add to predictions: 0.1 means ten per cent.
    pub fn share(&self) -> f64 {
        // The 99.9 % quantile of 256 frames is the largest of them.
        self.excesses.iter().copied().fold(self.faded, f64::max)
    }
}

/// Whether predictions have begun to miss to one side.
#[derive(Clone, Debug, Default)]
pub struct Drift {
    signs: VecDeque<bool>,
}

impl Drift {
    /// Takes in a frame.
    pub fn observe(&mut self, predicted_ms: f64, measured_ms: f64) {
        if !(predicted_ms.is_finite() && measured_ms.is_finite()) {
            return;
        }
        if self.signs.len() == DRIFT_FRAMES {
            self.signs.pop_front();
        }
        self.signs.push_back(measured_ms > predicted_ms);
    }

    /// Whether 95 % of the last 120 residuals have one sign: time to calibrate anew.
    pub fn is_one_sided(&self) -> bool {
        let above = self.signs.iter().filter(|&&above| above).count();
        let most = above.max(self.signs.len() - above);
        self.signs.len() == DRIFT_FRAMES && 100 * most >= 95 * DRIFT_FRAMES
    }

    /// Begins anew.
    pub fn clear(&mut self) {
        self.signs.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Random;

    #[test]
    fn an_excess_counts_at_once_and_fades_slowly() {
        let mut guard = Guard::default();
        guard.observe(10.0, 10.0);
        assert_eq!(guard.share(), 0.0);
        guard.observe(10.0, 14.0);
        assert!((guard.share() - 0.4).abs() < 1e-12);
        (0..240).for_each(|_| guard.observe(10.0, 9.0));
        assert!((guard.share() - 0.4).abs() < 1e-12, "it is among the last frames");
        (0..60).for_each(|_| guard.observe(10.0, 9.0));
        assert!((0.05..0.08).contains(&guard.share()), "{}", guard.share());
    }

    /// Even noise, with a tail: after the guard fewer than one frame in a hundred takes longer.
    #[test]
    fn under_one_frame_in_a_hundred_exceeds_the_guard() {
        let (mut guard, mut over) = (Guard::default(), 0);
        let mut random = Random::new(18, 0);
        for frame in 0..20_000 {
            let tail = if random.below(50) == 0 { 0.3 * random.unit() } else { 0.0 };
            let measured = 10.0 * (1.0 + 0.05 * random.bell() + tail);
            over += u32::from(frame >= 100 && measured > 10.0 * (1.0 + guard.share()));
            guard.observe(10.0, measured);
        }
        assert!(over < 200, "{over} of 20,000");
    }

    #[test]
    fn numbers_that_are_none_are_ignored() {
        let mut guard = Guard::default();
        for (predicted, measured) in [(f64::NAN, 1.0), (0.0, 1.0), (1.0, f64::NAN), (0.0, 0.0)] {
            guard.observe(predicted, measured);
        }
        assert_eq!(guard.share(), 0.0);
        guard.observe(1.0, f64::MAX);
        assert_eq!(guard.share(), MOST);
    }

    #[test]
    fn residuals_of_one_sign_are_a_drift() {
        let mut drift = Drift::default();
        (0..119).for_each(|_| drift.observe(1.0, 2.0));
        assert!(!drift.is_one_sided(), "too few");
        drift.observe(1.0, 2.0);
        assert!(drift.is_one_sided());
        (0..7).for_each(|_| drift.observe(2.0, 1.0));
        assert!(!drift.is_one_sided());
        drift.clear();
        assert!(!drift.is_one_sided());
    }
}
