//! Prices that follow the machine, frame by frame.
//!
//! Recursive least squares that forgets two per cent per frame, in relative units, with steps of at
//! most five per cent. Frames of a path that all look alike do not tell prices apart (the condition
//! of what is remembered says so): then all prices move together, which one number can always tell.
//! What is left over, slowly, goes into a constant, and what neighbouring frames have in common that
//! no count tells into a factor that follows at once.

use std::collections::VecDeque;

use crate::budget::heuristic::norm;
use crate::budget::least_squares::{MAX_CONDITION, Triangle, condition, non_negative};
use crate::budget::{CostModel, Drift, Guard, Heuristic, Workload};

/// Share of what is remembered that is kept from frame to frame.
const FORGETTING: f64 = 0.98;
/// Largest relative change of a price per frame.
const STEP: f64 = 0.05;
/// Share of a residual that goes into the constant.
const BIAS_GAIN: f64 = 0.02;
/// Largest share of a frame that the constant may be.
const MOST_BIAS: f64 = 0.25;
/// Factor on the worst excess of the last frames, because the next may be worse.
const MARGIN: f64 = 1.25;
/// Residuals that say what an outlier is.
const RESIDUALS: usize = 15;
/// Relative residual that never counts as an outlier.
const USUAL: f64 = 0.05;
/// Frames in a row, far off to one side, after which the machine is another one.
const CHANGED: u32 = 6;
/// Relative residual that is far off.
const FAR: f64 = 0.2;
/// Share of the last frame's ratio that the next prediction takes over at once, and share of that
/// which stays from frame to frame: neighbouring frames are alike in what no count tells.
const TREND: f64 = 0.4;
const TREND_STAYS: f64 = 0.98;
/// Weight of the present prices against a remembered frame.
const PRIOR: f64 = 1e-3;

/// Why a frame was not learned from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rejected {
    /// Its time or its counts are no numbers, or the time is not above zero.
    NotFinite,
    /// Nothing was drawn that has a price.
    NoWork,
}

/// A model that learns.
#[derive(Clone, Debug)]
pub struct OnlineModel {
    model: CostModel,
    bias_ms: f64,
    /// Factor by which the last frames were off.
    trend: f64,
    /// Which of vertices, pixels, draws, switches have a price.
    active: Vec<usize>,
    memory: Triangle,
    residuals: VecDeque<f64>,
    guard: Guard,
    drift: Drift,
    /// Frames in a row that were far above (positive) or far below.
    far: i32,
    learned: u64,
    together: u64,
    rejected: u64,
}

impl OnlineModel {
    /// Starts from calibrated prices.
    pub fn new(model: CostModel) -> Self {
        let prices = [model.vertex_ms, model.pixel_ms, model.draw_ms, model.switch_ms];
        let active: Vec<usize> = (0..4).filter(|&i| prices[i] > 0.0).collect();
        OnlineModel {
            model,
            bias_ms: 0.0,
            trend: 1.0,
            memory: Triangle::new(active.len()),
            active,
            residuals: VecDeque::with_capacity(RESIDUALS),
            guard: Guard::default(),
            drift: Drift::default(),
            far: 0,
            learned: 0,
            together: 0,
            rejected: 0,
        }
    }

    /// The prices as they are now.
    pub fn model(&self) -> &CostModel {
        &self.model
    }

    /// Expected time of a workload, milliseconds.
    pub fn predict(&self, work: &Workload) -> f64 {
        self.by_prices(work) * self.trend
    }

    /// Without the trend of the last frames.
    fn by_prices(&self, work: &Workload) -> f64 {
        let bare = self.model.predict(work);
        (bare + self.bias_ms.clamp(-MOST_BIAS * bare, MOST_BIAS * bare)).max(0.0)
    }

    /// Time that hardly any frame exceeds.
    pub fn predict_safely(&self, work: &Workload) -> f64 {
        self.predict(work) * (1.0 + self.guard_share())
    }

    /// The share that is added for safety.
    pub fn guard_share(&self) -> f64 {
        MARGIN * self.guard.share()
    }

    /// Whether residuals have lain on one side for long: time to calibrate anew.
    pub fn is_drifting(&self) -> bool {
        self.drift.is_one_sided()
    }

    /// The constant beside the prices, milliseconds; it may be below zero.
    pub fn bias_ms(&self) -> f64 {
        self.bias_ms
    }

    /// Frames from which each price was learned by itself, from which all moved together, and
    /// which were rejected.
    pub fn counts(&self) -> (u64, u64, u64) {
        (self.learned, self.together, self.rejected)
    }

    /// Forgets what was learned of prices apart from what they are now; the guard stays.
    pub fn start_anew(&mut self) {
        self.memory.clear();
        self.drift.clear();
    }

    /// Learns from a frame.
    pub fn observe(&mut self, work: &Workload, time_ms: f64) -> Result<(), Rejected> {
        let expected_ms = self.predict(work);
        if !(time_ms > 0.0 && time_ms.is_finite() && expected_ms.is_finite()) {
            self.rejected += 1;
            return Err(Rejected::NotFinite);
        }
        if expected_ms <= 0.0 || self.active.is_empty() {
            self.rejected += 1;
            return Err(Rejected::NoWork);
        }
        self.guard.observe(expected_ms, time_ms);
        self.drift.observe(expected_ms, time_ms);

        let off = (time_ms / expected_ms).clamp(0.5, 2.0);
        self.trend = (self.trend * off.powf(TREND)).powf(TREND_STAYS);

        let residual = time_ms / self.by_prices(work) - 1.0;
        let weight = self.weight_of(residual);
        self.far = match residual {
            r if r > FAR => self.far.max(0) + 1,
            r if r < -FAR => self.far.min(0) - 1,
            _ => 0,
        };
        if self.far.unsigned_abs() == CHANGED {
            // What was learned is of another machine.
            self.memory.clear();
        }
        // In units of the present prices: all ones would predict the present model.
        let whole = self.parts(work);
        let row: Vec<f64> = self.active.iter().map(|&i| weight * whole[i] / time_ms).collect();
        let bias_ms = self.by_prices(work) - self.model.predict(work);
        let aim = weight * (time_ms - bias_ms) / time_ms;
        self.memory.fade(FORGETTING.sqrt());
        self.memory.absorb(row, aim);
        let factors = self.factors();
        for (index, factor) in factors.iter().enumerate() {
            *self.price(self.active[index]) *= factor;
        }
        self.memory.rescale(&factors);
        self.bias_ms += BIAS_GAIN * weight * weight * (time_ms - self.by_prices(work));
        Ok(())
    }

    /// Factors on the active prices for the next frame.
    fn factors(&mut self) -> Vec<f64> {
        let n = self.active.len();
        let step = |factor: f64| factor.clamp(1.0 - STEP, 1.0 + STEP);
        if condition(&self.memory) <= MAX_CONDITION {
            self.learned += 1;
            let mut system = self.memory.clone();
            for i in 0..n {
                let mut row = vec![0.0; n];
                row[i] = PRIOR;
                system.absorb(row, PRIOR);
            }
            return non_negative(&system).into_iter().map(step).collect();
        }
        self.together += 1;
        vec![step(self.memory.common_factor()); n]
    }

    /// Less for residuals far beyond what is usual.
    fn weight_of(&mut self, residual: f64) -> f64 {
        let mut sizes: Vec<f64> = self.residuals.iter().copied().collect();
        let middle = sizes.len() / 2;
        let median = match sizes.is_empty() {
            true => f64::INFINITY,
            false => *sizes.select_nth_unstable_by(middle, f64::total_cmp).1,
        };
        let delta = (2.0 * median).max(USUAL);
        if self.residuals.len() == RESIDUALS {
            self.residuals.pop_front();
        }
        self.residuals.push_back(residual.abs());
        (delta / residual.abs().max(delta)).sqrt().max(1e-3)
    }

    /// Milliseconds per price of a workload, so that they add up to the prediction.
    fn parts(&self, work: &Workload) -> [f64; 4] {
        let (vertices, pixels) = self.model.stages(work);
        let share = |part: f64| match self.model.heuristic {
            Heuristic::Blend => {
                let whole = norm(vertices, pixels, self.model.exponent);
                if whole > 0.0 {
                    (part / whole).powf(self.model.exponent - 1.0) * part
                } else {
                    0.0
                }
            }
            Heuristic::Bottleneck if part < vertices.max(pixels) => 0.0,
            _ => part,
        };
        [
            share(vertices),
            share(pixels),
            self.model.draw_ms * work.draws,
            self.model.switch_ms * work.switches,
        ]
    }

    fn price(&mut self, index: usize) -> &mut f64 {
        match index {
            0 => &mut self.model.vertex_ms,
            1 => &mut self.model.pixel_ms,
            2 => &mut self.model.draw_ms,
            _ => &mut self.model.switch_ms,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Random;

    fn truth() -> CostModel {
        CostModel {
            draw_ms: 5e-3,
            vertex_ms: 2e-5,
            pixel_ms: 4e-6,
            ..CostModel::free(Heuristic::Sum)
        }
    }

    /// Frames of a path: budgets and splat sizes vary.
    fn work(index: u64) -> Workload {
        let mut random = Random::new(19, index);
        let points = random.between(1e5, 1e6);
        Workload::points(random.between(5.0, 200.0), points, points * random.between(1.0, 12.0))
    }

    fn worst_error(model: &OnlineModel, truth: &CostModel) -> f64 {
        (0..200)
            .map(|i| (model.predict(&work(i)) / truth.predict(&work(i)) - 1.0).abs())
            .fold(0.0, f64::max)
    }

    #[test]
    fn wrong_prices_find_their_way() {
        let start = CostModel { vertex_ms: 4e-5, pixel_ms: 2e-6, ..truth() };
        let mut model = OnlineModel::new(start);
        for index in 0..300 {
            let noise = 1.0 + 0.01 * Random::new(20, index).bell();
            let time_ms = truth().predict(&work(index)) * noise;
            model.observe(&work(index), time_ms).expect("a sound frame");
        }
        assert!(worst_error(&model, &truth()) < 0.03, "{:?}", model.model());
        assert!(model.counts().0 > 250, "{:?}", model.counts());
    }

    #[test]
    fn frames_that_all_look_alike_move_all_prices_together() {
        let mut model = OnlineModel::new(truth());
        for _ in 0..400 {
            model.observe(&work(1), 2.0 * truth().predict(&work(1))).expect("sound");
        }
        assert!((model.predict(&work(1)) / truth().predict(&work(1)) - 2.0).abs() < 0.02);
        let (vertex, pixel) = (model.model().vertex_ms / 2e-5, model.model().pixel_ms / 4e-6);
        assert!((vertex / pixel - 1.0).abs() < 1e-9, "their ratio stays: {vertex} {pixel}");
        assert_eq!(model.counts().0, 0, "refused each time");
        assert!(worst_error(&model, &truth().scaled(2.0)) < 0.3, "and other frames stay sensible");
    }

    #[test]
    fn a_machine_that_becomes_three_times_slower_is_guarded_at_once_and_learned_soon() {
        let mut model = OnlineModel::new(truth());
        for index in 0..100 {
            model.observe(&work(index), truth().predict(&work(index))).expect("sound");
        }
        let slow = truth().scaled(3.0);
        model.observe(&work(100), slow.predict(&work(100))).expect("sound");
        for index in 101..161 {
            let safe_ms = model.predict_safely(&work(index));
            assert!(safe_ms >= 0.95 * slow.predict(&work(index)), "frame {index}: {safe_ms}");
            model.observe(&work(index), slow.predict(&work(index))).expect("sound");
        }
        assert!(worst_error(&model, &slow) < 0.15, "{:?}", model.model());
    }

    #[test]
    fn single_interrupted_frames_hardly_move_prices() {
        let mut model = OnlineModel::new(truth());
        for index in 0..600 {
            let fault = if index % 60 == 59 { 5.0 } else { 1.0 };
            let time_ms = fault * truth().predict(&work(index));
            model.observe(&work(index), time_ms).expect("sound");
        }
        (600..650).for_each(|i| {
            model.observe(&work(i), truth().predict(&work(i))).expect("sound");
        });
        assert!(worst_error(&model, &truth()) < 0.08, "{}", worst_error(&model, &truth()));
    }

    #[test]
    fn frames_that_are_no_samples_are_rejected_and_change_nothing() {
        let mut model = OnlineModel::new(truth());
        let before = *model.model();
        for time_ms in [f64::NAN, 0.0, -1.0, f64::INFINITY] {
            assert_eq!(model.observe(&work(1), time_ms), Err(Rejected::NotFinite));
        }
        assert_eq!(model.observe(&Workload::default(), 1.0), Err(Rejected::NoWork));
        let wrong = Workload { pixels: f64::NAN, ..work(1) };
        assert_eq!(model.observe(&wrong, 1.0), Err(Rejected::NotFinite));
        assert_eq!((*model.model(), model.counts()), (before, (0, 0, 6)));
        let mut free = OnlineModel::new(CostModel::free(Heuristic::Sum));
        assert_eq!(free.observe(&work(1), 1.0), Err(Rejected::NoWork));
    }

    #[test]
    fn a_slow_drift_is_told() {
        let mut model = OnlineModel::new(truth());
        for index in 0..200u64 {
            let slower = 1.1f64.powi(index as i32 / 2);
            model.observe(&work(index), slower * truth().predict(&work(index))).expect("sound");
        }
        assert!(model.is_drifting(), "five per cent a frame cannot follow");
    }
}
