//! The prediction turned around: how many points and bytes fit a given time.

use crate::budget::{CostModel, Workload};

/// How a frame's time is to be used, milliseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimePlan {
    /// What the frame may take.
    pub target_ms: f64,
    /// What the system may take beside it.
    pub system_ms: f64,
    /// What fixed passes take: clearing, resolving, panels, shadows.
    pub reserved_ms: f64,
    /// Share by which predictions of drawing may be exceeded.
    pub guard_share: f64,
}

/// Share of the target time that is spent on uploads, unless asked otherwise.
pub const UPLOAD_SHARE: f64 = 0.1;

impl TimePlan {
    /// Predicted drawing time that fits; 0 if nothing does or the target is no number, infinite if
    /// the target is.
    pub fn free_ms(&self) -> f64 {
        let left = self.target_ms - self.system_ms - self.reserved_ms;
        let free = left / (1.0 + self.guard_share);
        if free > 0.0 { free } else { 0.0 }
    }

    /// The most points whose predicted time fits, if each comes with that many nodes and pixels.
    pub fn points(&self, model: &CostModel, nodes_each: f64, pixels_each: f64) -> u64 {
        let free_ms = self.free_ms();
        let time_ms = |points: f64| {
            model.predict(&Workload::points(nodes_each * points, points, pixels_each * points))
        };
        // All formulas grow in proportion.
        let each_ms = time_ms(1.0);
        if free_ms == 0.0 || each_ms.is_nan() || each_ms == f64::INFINITY {
            return 0;
        }
        let points = (free_ms / each_ms).floor();
        if points.is_nan() || points >= u64::MAX as f64 {
            return u64::MAX;
        }
        // The product may round to just above.
        let is_over = time_ms(points) > free_ms;
        (points as u64).saturating_sub(u64::from(is_over) * (1 + (points * 1e-15) as u64))
    }

    /// Bytes that may be uploaded, `share` of the target time at `byte_ms` each.
    pub fn upload_bytes(&self, byte_ms: f64, share: f64) -> u64 {
        let bytes = (self.target_ms * share / byte_ms).floor();
        if bytes > 0.0 { bytes as u64 } else { 0 }
    }
}

/// How many leading costs fit together. A cost that is no number fits nowhere.
pub fn fitting_prefix(costs_ms: impl IntoIterator<Item = f64>, free_ms: f64) -> usize {
    let mut sum_ms = 0.0;
    let fits = |cost_ms: &f64| {
        sum_ms += cost_ms;
        sum_ms <= free_ms
    };
    costs_ms.into_iter().take_while(fits).count()
}

/// Whether a scene fits whole, whatever the view: all points at the largest splats take a share of
/// the time that leaves room for wrong prices.
pub fn sure_points(plan: &TimePlan, model: &CostModel, scene: &Workload) -> bool {
    const ROOM: f64 = 0.5;
    model.predict(scene) <= ROOM * plan.free_ms()
}

/// Uploads of one frame after the other, on the average within a quota per frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Uploads {
    quota: u64,
    used: u64,
    debt: u64,
}

impl Uploads {
    /// Begins a frame with a quota of bytes.
    pub fn begin_frame(&mut self, quota: u64) {
        self.debt = self.debt.saturating_sub(self.quota);
        (self.quota, self.used) = (quota, 0);
    }

    /// Whether that many bytes may be sent now. What is larger than a whole quota goes alone, and
    /// later frames send nothing until it is paid for.
    pub fn admit(&mut self, bytes: u64) -> bool {
        let fits = self.used.saturating_add(bytes) <= self.quota;
        let alone = self.used == 0 && self.quota > 0;
        if self.debt > 0 || !(fits || alone) {
            return false;
        }
        self.used += bytes;
        // This frame's own quota pays for its part when the next frame begins.
        self.debt = if fits { 0 } else { bytes };
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::budget::{BudgetSearch, Heuristic, OnlineModel};
    use crate::sampling::Random;

    fn random_model(random: &mut Random) -> CostModel {
        let price = |random: &mut Random| 10f64.powf(random.between(-8.0, -2.0));
        CostModel {
            heuristic: Heuristic::ALL[random.below(5) as usize],
            draw_ms: price(random),
            vertex_ms: price(random),
            corner_ms: 0.0,
            pixel_ms: price(random),
            switch_ms: 0.0,
            exponent: random.between(1.0, 8.0),
        }
    }

    #[test]
    fn a_budget_fits_and_one_more_does_not_for_any_prices() {
        for index in 0..10_000 {
            let mut random = Random::new(21, index);
            let model = random_model(&mut random);
            let plan = TimePlan {
                target_ms: random.between(0.5, 100.0),
                system_ms: random.between(0.0, 2.0),
                reserved_ms: random.between(0.0, 2.0),
                guard_share: random.between(0.0, 0.5),
            };
            let (nodes_each, pixels_each) = (random.between(0.0, 1e-3), random.between(1.0, 50.0));
            let points = plan.points(&model, nodes_each, pixels_each);
            let time_ms = |points: f64| {
                model.predict(&Workload::points(nodes_each * points, points, pixels_each * points))
            };
            assert!(time_ms(points as f64) <= plan.free_ms(), "{index}: {model:?} {plan:?}");
            if plan.free_ms() > 0.0 {
                assert!(time_ms(points as f64 + 2.0) > plan.free_ms(), "{index}: {model:?}");
            }
            // Nodes of their own sizes, in order.
            let costs: Vec<f64> = (0..50).map(|_| random.between(0.0, 1.0)).collect();
            let fitting = fitting_prefix(costs.iter().copied(), plan.free_ms());
            assert!(costs[..fitting].iter().sum::<f64>() <= plan.free_ms());
            if fitting < costs.len() {
                assert!(costs[..=fitting].iter().sum::<f64>() > plan.free_ms());
            }
        }
    }

    #[test]
    fn targets_of_zero_and_targets_that_are_no_numbers_draw_nothing() {
        let model = CostModel { vertex_ms: 1e-5, ..CostModel::free(Heuristic::Sum) };
        let plan =
            |target_ms| TimePlan { target_ms, system_ms: 0.5, reserved_ms: 0.0, guard_share: 0.1 };
        for target_ms in [0.0, 0.4, -1.0, f64::NAN, f64::NEG_INFINITY] {
            assert_eq!(plan(target_ms).points(&model, 0.0, 1.0), 0, "{target_ms}");
        }
        for target_ms in [0.0, -1.0, f64::NAN] {
            assert_eq!(plan(target_ms).upload_bytes(1e-6, UPLOAD_SHARE), 0);
        }
        assert_eq!(plan(f64::INFINITY).points(&model, 0.0, 1.0), u64::MAX);
        assert_eq!(plan(10.0).points(&CostModel::free(Heuristic::Sum), 0.0, 1.0), u64::MAX);
        assert_eq!(plan(10.0).points(&model, 0.0, f64::NAN), 0);
        assert_eq!(plan(10.0).upload_bytes(1e-6, UPLOAD_SHARE), 1_000_000);
        assert_eq!(plan(10.0).upload_bytes(0.0, UPLOAD_SHARE), u64::MAX);
        assert_eq!(fitting_prefix([1.0, f64::NAN, 1.0], 10.0), 1);
        assert_eq!(fitting_prefix([], 10.0), 0);
    }

    #[test]
    fn uploads_larger_than_the_quota_go_alone_and_are_paid_off() {
        let mut uploads = Uploads::default();
        let mut sent = 0;
        let mut frames_with_any = 0;
        for _ in 0..1000 {
            uploads.begin_frame(1000);
            let before = sent;
            // Endless requests of 3500 bytes.
            while uploads.admit(3500) {
                sent += 3500;
            }
            frames_with_any += u32::from(sent > before);
        }
        // One every four frames: the fourth frame's quota is not used up, and not saved.
        assert_eq!((sent, frames_with_any), (875_000, 250));
        uploads = Uploads::default();
        uploads.begin_frame(0);
        assert!(!uploads.admit(1), "no quota, no upload");
        uploads.begin_frame(10);
        assert!(uploads.admit(4) && uploads.admit(6) && !uploads.admit(1));
    }

    /// Every second frame is a quarter slower: the budget does not follow each of them.
    #[test]
    fn alternating_frames_do_not_make_the_budget_swing() {
        let truth = CostModel { vertex_ms: 2e-5, ..CostModel::free(Heuristic::Sum) };
        let mut model = OnlineModel::new(truth);
        let (mut last, mut changes) = (0, 0);
        for frame in 0..600 {
            let plan = TimePlan {
                target_ms: 20.0,
                system_ms: 0.0,
                reserved_ms: 0.0,
                guard_share: model.guard_share(),
            };
            let first = if last > 0 { last } else { plan.points(model.model(), 0.0, 1.0) };
            let mut search = BudgetSearch::new(first, 5_000_000, plan.free_ms());
            while let Some(budget) = search.next_trial() {
                let work = Workload::points(1.0, budget as f64, budget as f64);
                search.note(budget, budget, model.predict(&work), true);
            }
            let budget = search.budget();
            changes += u32::from(frame >= 300 && budget != last);
            last = budget;
            let work = Workload::points(1.0, budget as f64, budget as f64);
            let swing = if frame % 2 == 0 { 1.25 } else { 1.0 };
            model.observe(&work, swing * truth.predict(&work)).expect("a sound frame");
        }
        assert!(changes <= 6, "{changes} changes in 300 frames");
        assert!(truth.scaled(1.25).vertex_ms * last as f64 <= 20.0, "and slow frames fit");
    }
}
