//! Protects the estimators of `budget` as a whole: which formula predicts a pipeline best, which
//! exponent is chosen, and what is learned from a path that was never seen.
//!
//! Truth is the simulated pipeline, so every figure repeats. One test per claim of the note; the
//! table in `docs/rendering-time.md` names them.

use esker::budget::procedural::{Facet, ProceduralObject};
use esker::budget::{CostModel, Heuristic, Sample, TwoStagePipeline};
use esker::sampling::Random;
use glam::DVec3;

/// Objects of 50 to 1500 triangles of widely different sizes, from near and far.
fn timed_objects(queue: Option<u32>) -> Vec<Sample> {
    let object = |index: u64| {
        let mut random = Random::new(30, index);
        let count = random.between(50.0, 1500.0) as u64;
        let shared = random.between(0.6, 2.4);
        let facet = |_| Facet {
            transformed: shared * random.between(0.5, 1.5),
            area: (1.5 * random.bell()).exp(),
            normal: DVec3::Z,
        };
        let facets = (0..count).map(facet).collect();
        let object = ProceduralObject::new(DVec3::ZERO, 1.0, facets);
        let px_m2 = 60.0 * (1.3 * random.bell()).exp();
        object.exact_sample(DVec3::Z, px_m2, TwoStagePipeline { queue })
    };
    (0..300).map(object).collect()
}

/// Mean squared relative error on every fifth object, fitted to the others.
fn test_error(heuristic: Heuristic, samples: &[Sample]) -> (f64, CostModel) {
    let part = |is_test: bool| -> Vec<Sample> {
        let chosen = samples.iter().enumerate().filter(|(i, _)| (i % 5 == 4) == is_test);
        chosen.map(|(_, sample)| *sample).collect()
    };
    let model = CostModel::fit(heuristic, &part(false)).expect("the objects differ");
    let tests = part(true);
    let error = |s: &Sample| (model.predict(&s.work) / s.time_ms - 1.0).powi(2);
    (tests.iter().map(error).sum::<f64>() / tests.len() as f64, model)
}

#[test]
fn with_short_queues_the_sum_predicts_better_than_the_maximum_and_both_than_counting() {
    for depth in 1..=4 {
        let samples = timed_objects(Some(depth));
        let [h1, h2, h3, h4, _] = Heuristic::ALL.map(|h| test_error(h, &samples).0);
        println!("depth {depth}: H1 {h1:.4} H2 {h2:.4} H3 {h3:.4} H4 {h4:.4}");
        assert!(h4 < h3 && h3 < h1 && h4 < h2, "depth {depth}: {h1} {h2} {h3} {h4}");
    }
}

#[test]
fn the_exponent_follows_the_depth_of_the_queue() {
    for (queue, range) in [(Some(1), 1.0..=2.0), (None, 4.0..=8.0)] {
        let samples = timed_objects(queue);
        let (h3, h4) =
            (test_error(Heuristic::Bottleneck, &samples).0, test_error(Heuristic::Sum, &samples).0);
        let (h5, model) = test_error(Heuristic::Blend, &samples);
        println!("{queue:?}: H3 {h3:.5} H4 {h4:.5} H5 {h5:.6} at p = {}", model.exponent);
        assert!(range.contains(&model.exponent), "{queue:?}: {model:?}");
        assert!(h5 <= 0.5 * h3.min(h4), "{queue:?}: {h3} {h4} {h5}");
    }
}
