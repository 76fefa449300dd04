//! Quantiles of measured times, and the time that the system takes beside the frame.

/// The value below which a share `q` of the samples lies, between neighbours in proportion.
///
/// Samples that are not finite are left out; `None` if none is left. `q` is clamped to 0..=1.
pub fn quantile(samples: &[f64], q: f64) -> Option<f64> {
    let mut sorted: Vec<f64> = samples.iter().copied().filter(|s| s.is_finite()).collect();
    sorted.sort_unstable_by(f64::total_cmp);
    quantile_of_sorted(&sorted, q)
}

/// [`quantile`] of finite samples in rising order.
pub(super) fn quantile_of_sorted(sorted: &[f64], q: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    let q = if q.is_nan() { 1.0 } else { q.clamp(0.0, 1.0) };
    let at = q * last as f64;
    let (below, above) = (sorted[at.floor() as usize], sorted[at.ceil() as usize]);
    Some(below + (above - below) * at.fract())
}

/// Time taken by the operating system and the driver, a constant for a confidence.
///
/// Its distribution has no known form (it has a second hill where a regular task runs every few
/// frames), so only its quantiles are used.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SystemNoise {
    /// Quantile at the confidence minus the shortest time, milliseconds: what a frame may take
    /// longer than its own work.
    pub constant_ms: f64,
    /// Width of the interval that holds the confidence's share around the middle (the other
    /// reading of the paper), milliseconds.
    pub spread_ms: f64,
    /// The shortest time, milliseconds.
    pub least_ms: f64,
    /// Samples that counted.
    pub samples: usize,
}

impl SystemNoise {
    /// The noise in times of one and the same frame; `None` without a finite sample.
    pub fn of(times_ms: &[f64], confidence: f64) -> Option<SystemNoise> {
        let mut sorted: Vec<f64> = times_ms.iter().copied().filter(|t| t.is_finite()).collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let at = |q| quantile_of_sorted(&sorted, q);
        let tail = 0.5 * (1.0 - confidence);
        let least_ms = *sorted.first()?;
        Some(SystemNoise {
            constant_ms: at(confidence)? - least_ms,
            spread_ms: at(1.0 - tail)? - at(tail)?,
            least_ms,
            samples: sorted.len(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Random;

    /// A frame of 4 ms with an even jitter of 0.2 ms; in 40 % of the frames a task of 0.5 ms runs.
    /// The upper hill ends at 4.7 ms and holds 40 %, so 99 % lie below `4.7 - 0.2 * 0.01 / 0.4`.
    #[test]
    fn the_constant_is_the_known_quantile_of_a_distribution_with_two_hills() {
        let mut random = Random::new(10, 0);
        let mut frame = || {
            let task_ms = if random.unit() < 0.4 { 0.5 } else { 0.0 };
            4.0 + task_ms + random.between(0.0, 0.2)
        };
        let times: Vec<f64> = (0..10_000).map(|_| frame()).collect();
        let noise = SystemNoise::of(&times, 0.99).expect("there are samples");
        let known_ms = 0.7 - 0.2 * 0.01 / 0.4;
        assert!((noise.constant_ms / known_ms - 1.0).abs() < 0.02, "{noise:?}");
        let (low, high) = (0.2 * 0.005 / 0.6, 0.7 - 0.2 * 0.005 / 0.4);
        assert!((noise.spread_ms / (high - low) - 1.0).abs() < 0.02, "{noise:?}");
        assert_eq!(noise.samples, 10_000);
    }

    #[test]
    fn samples_that_are_no_times_are_left_out() {
        assert_eq!(SystemNoise::of(&[], 0.99), None);
        assert_eq!(SystemNoise::of(&[f64::NAN], 0.99), None);
        let noise = SystemNoise::of(&[2.0, f64::NAN, 2.0, f64::INFINITY], 0.99);
        assert_eq!(noise.map(|n| (n.constant_ms, n.samples)), Some((0.0, 2)));
        assert_eq!(quantile(&[3.0, 1.0, 2.0], 0.5), Some(2.0));
        assert_eq!(quantile(&[1.0, 2.0], 7.0), Some(2.0));
        assert_eq!(quantile(&[1.0, 2.0], f64::NAN), Some(2.0));
    }
}
