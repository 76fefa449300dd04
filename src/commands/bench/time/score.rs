//! How well predictions agree with measurements.

use std::fmt::Write;

use crate::budget::quantile;

/// One estimator on one path.
#[derive(Clone, Debug)]
pub struct Score {
    /// `objects`, `counted` or `timed`.
    pub study: &'static str,
    /// The scene and what was varied.
    pub scene: String,
    /// The estimator.
    pub estimator: String,
    /// Frames.
    pub frames: usize,
    /// Mean squared error, square milliseconds (of counted frames: of millions of units).
    pub mse: f64,
    /// Root of the mean squared relative error.
    pub relative_rms: f64,
    /// Quantiles of the relative error's size: half, 95 %, 99 % of the frames.
    pub relative: [f64; 3],
    /// Share of frames that are off by more than 15 %.
    pub outside_15: f64,
    /// Share of frames that took longer than predicted.
    pub under: f64,
    /// The largest share by which one did.
    pub worst_under: f64,
    /// Time that one prediction took.
    pub estimate_us: f64,
}

impl Score {
    /// Heads a table of [`line`](Self::line)s.
    pub const HEADER: &str = "study    scene                       estimator         frames        \
        MSE   rel.RMS     q50     q95     q99   >15 %   under  worst under  predict us";
    /// Heads the CSV file.
    pub const CSV_HEADER: &str = "study,scene,estimator,frames,mse,relative_rms,q50,q95,q99,\
        outside_15,under,worst_under,estimate_us";

    /// From pairs of a prediction and a measurement.
    pub fn of(
        (study, scene, estimator): (&'static str, &str, &str),
        pairs: &[(f64, f64)],
        estimate_us: f64,
    ) -> Score {
        let count = pairs.len().max(1) as f64;
        let relative: Vec<f64> = pairs.iter().map(|(p, m)| p / m - 1.0).collect();
        let sizes: Vec<f64> = relative.iter().map(|r| r.abs()).collect();
        let at = |q| quantile(&sizes, q).unwrap_or(0.0);
        let share =
            |is: &dyn Fn(&f64) -> bool| relative.iter().filter(|r| is(r)).count() as f64 / count;
        Score {
            study,
            scene: scene.to_owned(),
            estimator: estimator.to_owned(),
            frames: pairs.len(),
            mse: pairs.iter().map(|(p, m)| (p - m).powi(2)).sum::<f64>() / count,
            relative_rms: (relative.iter().map(|r| r * r).sum::<f64>() / count).sqrt(),
            relative: [at(0.5), at(0.95), at(0.99)],
            outside_15: share(&|r| r.abs() > 0.15),
            under: share(&|r| *r < -1e-9),
            worst_under: relative.iter().fold(0.0f64, |worst, r| worst.max(-r)),
            estimate_us,
        }
    }

    /// A line of the table.
    pub fn line(&self) -> String {
        let percent = |share: f64| format!("{:.1} %", 100.0 * share);
        let [q50, q95, q99] = self.relative.map(percent);
        format!(
            "{:<8} {:<27} {:<17} {:>6} {:>10.4} {:>9} {:>7} {:>7} {:>7} {:>7} {:>7} {:>12} {:>11.2}",
            self.study,
            self.scene,
            self.estimator,
            self.frames,
            self.mse,
            percent(self.relative_rms),
            q50,
            q95,
            q99,
            percent(self.outside_15),
            percent(self.under),
            percent(self.worst_under),
            self.estimate_us,
        )
    }

    /// Adds a row to the CSV file.
    pub fn write_csv(&self, csv: &mut String) {
        let [q50, q95, q99] = self.relative;
        writeln!(
            csv,
            "{},{},{},{},{},{},{q50},{q95},{q99},{},{},{},{}",
            self.study,
            self.scene,
            self.estimator,
            self.frames,
            self.mse,
            self.relative_rms,
            self.outside_15,
            self.under,
            self.worst_under,
            self.estimate_us
        )
        .expect("a string takes all text");
    }
}

/// Rank correlation of two lists (Spearman); ties share their mean rank.
pub fn spearman(a: &[f64], b: &[f64]) -> f64 {
    let ranks = |values: &[f64]| -> Vec<f64> {
        let rank = |v: &f64| {
            let below = values.iter().filter(|w| *w < v).count() as f64;
            let equal = values.iter().filter(|w| *w == v).count() as f64;
            below + 0.5 * (equal - 1.0)
        };
        values.iter().map(rank).collect()
    };
    correlation(&ranks(a), &ranks(b))
}

/// Share of the variance of `measured` that `predicted` explains.
pub fn r_squared(predicted: &[f64], measured: &[f64]) -> f64 {
    let mean = measured.iter().sum::<f64>() / measured.len().max(1) as f64;
    let rest: f64 = predicted.iter().zip(measured).map(|(p, m)| (p - m).powi(2)).sum();
    1.0 - rest / measured.iter().map(|m| (m - mean).powi(2)).sum::<f64>().max(1e-300)
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let dot = |x: &[f64], mx: f64, y: &[f64], my: f64| -> f64 {
        x.iter().zip(y).map(|(x, y)| (x - mx) * (y - my)).sum()
    };
    dot(a, mean_a, b, mean_b)
        / (dot(a, mean_a, a, mean_a) * dot(b, mean_b, b, mean_b)).sqrt().max(1e-300)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scores_count_what_they_say() {
        let pairs = [(10.0, 10.0), (9.0, 10.0), (12.0, 10.0), (5.0, 10.0)];
        let score = Score::of(("timed", "s", "e"), &pairs, 0.1);
        assert_eq!(score.mse, (1.0 + 4.0 + 25.0) / 4.0);
        assert_eq!((score.outside_15, score.under, score.worst_under), (0.5, 0.5, 0.5));
        assert!((score.relative_rms - (0.3f64 / 4.0).sqrt()).abs() < 1e-12);
        let header = Score::CSV_HEADER.split(',').count();
        let mut csv = String::new();
        score.write_csv(&mut csv);
        assert_eq!(csv.trim().split(',').count(), header);
    }

    #[test]
    fn ranks_correlate_whatever_the_scale() {
        assert_eq!(spearman(&[1.0, 2.0, 3.0, 4.0], &[1.0, 10.0, 100.0, 1e9]), 1.0);
        assert_eq!(spearman(&[1.0, 2.0, 3.0], &[3.0, 2.0, 1.0]), -1.0);
        assert!((spearman(&[1.0, 1.0, 2.0], &[1.0, 1.0, 2.0]) - 1.0).abs() < 1e-12);
        assert_eq!(r_squared(&[1.0, 2.0, 3.0], &[1.0, 2.0, 3.0]), 1.0);
    }
}
