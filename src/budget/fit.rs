//! The prices of each formula from timed samples.
//!
//! Errors count in proportion to the time, so that small objects matter as much as large ones.
//! H1, H2 and H4 are linear. H3 is fitted by turns: samples are given to the stage that is slower
//! under the present prices, each stage is fitted to its samples, until nothing changes sides. H5
//! is fitted for each exponent of a grid by damped Gauss-Newton steps from H4's prices; the
//! exponent with the least error stays, and the smaller of equals, which predicts more.

use crate::budget::heuristic::norm;
use crate::budget::least_squares::{Triangle, non_negative};
use crate::budget::{CostModel, Design, FitError, Heuristic, Sample, Workload};

/// Exponents that H5 may take.
const EXPONENTS: [f64; 12] = [1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0];
/// Most turns of the fit of H3.
const MAX_TURNS: usize = 50;
/// Shares of the samples that H3's first turn gives to the vertex stage, by pixels per polygon.
const FIRST_SHARES: [f64; 5] = [0.1, 0.3, 0.5, 0.7, 0.9];

pub(super) fn fit(heuristic: Heuristic, samples: &[Sample]) -> Result<CostModel, FitError> {
    let is_usable = |sample: &&Sample| {
        sample.work.is_sound() && sample.time_ms > 0.0 && sample.time_ms.is_finite()
    };
    let samples: Vec<Sample> = samples.iter().filter(is_usable).copied().collect();
    match heuristic {
        Heuristic::Triangles => linear(heuristic, &samples, &[Price::Vertex]),
        Heuristic::Transformed => linear(heuristic, &samples, &[Price::Vertex]),
        Heuristic::Sum => linear(heuristic, &samples, &[Price::Vertex, Price::Pixel]),
        Heuristic::Bottleneck => by_turns(&samples),
        Heuristic::Blend => with_exponent(&samples),
    }
}

/// One of a model's prices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Price {
    Draw,
    Vertex,
    Corner,
    Pixel,
    Switch,
}

impl Price {
    fn count(self, heuristic: Heuristic, work: &Workload) -> f64 {
        match self {
            Price::Draw => work.draws,
            Price::Vertex if heuristic == Heuristic::Triangles => work.triangles,
            Price::Vertex if heuristic == Heuristic::Bottleneck => work.polygons,
            Price::Vertex => work.transformed,
            Price::Corner => work.vertices,
            Price::Pixel => work.pixels,
            Price::Switch => work.switches,
        }
    }

    fn of(self, model: &mut CostModel) -> &mut f64 {
        match self {
            Price::Draw => &mut model.draw_ms,
            Price::Vertex => &mut model.vertex_ms,
            Price::Corner => &mut model.corner_ms,
            Price::Pixel => &mut model.pixel_ms,
            Price::Switch => &mut model.switch_ms,
        }
    }
}

/// The stages' prices, and those of draws and changes of state where the samples have any that tell
/// them apart.
fn linear(
    heuristic: Heuristic,
    samples: &[Sample],
    stages: &[Price],
) -> Result<CostModel, FitError> {
    let has_any = |price: &Price| samples.iter().any(|s| price.count(heuristic, &s.work) > 0.0);
    let extras: Vec<Price> = [Price::Draw, Price::Switch].into_iter().filter(has_any).collect();
    // From all extras to none, until the samples tell the columns apart.
    let mut refusal = None;
    for kept in (0..=extras.len()).rev() {
        let prices: Vec<Price> = stages.iter().chain(&extras[..kept]).copied().collect();
        match solve(heuristic, samples, &prices) {
            Ok(model) => return Ok(model),
            Err(error) => refusal = Some(error),
        }
    }
    Err(refusal.expect("no extras is one of the attempts"))
}

fn solve(
    heuristic: Heuristic,
    samples: &[Sample],
    prices: &[Price],
) -> Result<CostModel, FitError> {
    let mut design = Design::new(prices.len());
    for sample in samples {
        let counts: Vec<f64> = prices.iter().map(|p| p.count(heuristic, &sample.work)).collect();
        design.push(&counts, sample.time_ms, 1.0 / sample.time_ms);
    }
    let solution = design.solve_robust()?;
    let mut model = CostModel::free(heuristic);
    for (price, &value) in prices.iter().zip(&solution.prices) {
        *price.of(&mut model) = value;
    }
    Ok(model)
}

/// H3. Several first divisions are tried, because turns end in the nearest resting place.
fn by_turns(samples: &[Sample]) -> Result<CostModel, FitError> {
    if samples.len() < 2 {
        return Err(FitError::TooFew { samples: samples.len(), unknowns: 2 });
    }
    let mut ordered = samples.to_vec();
    let pixels_each = |s: &Sample| s.work.pixels / s.work.polygons.max(1e-300);
    ordered.sort_by(|a, b| pixels_each(a).total_cmp(&pixels_each(b)));
    let mut best: Option<(f64, CostModel)> = None;
    for share in FIRST_SHARES {
        let split = (share * ordered.len() as f64) as usize;
        let is_vertex_bound: Vec<bool> = (0..ordered.len()).map(|i| i < split).collect();
        if let Some((model, _)) = turns(&ordered, is_vertex_bound) {
            let error = relative_error(&model, &ordered);
            if best.as_ref().is_none_or(|(least, _)| error < *least) {
                best = Some((error, model));
            }
        }
    }
    best.map(|(_, model)| model).ok_or(FitError::Singular { condition: f64::INFINITY })
}

/// Turns from a first division; the model and the number of turns, or `None` if no stage can be
/// fitted.
fn turns(samples: &[Sample], mut is_vertex_bound: Vec<bool>) -> Option<(CostModel, usize)> {
    let mut model = CostModel::free(Heuristic::Bottleneck);
    for turn in 1..=MAX_TURNS {
        let side = |wanted: bool| -> Vec<Sample> {
            let chosen = samples.iter().zip(&is_vertex_bound).filter(|(_, is)| **is == wanted);
            chosen.map(|(sample, _)| *sample).collect()
        };
        let both = [Price::Vertex, Price::Corner];
        let (bound, unbound) = (side(true), side(false));
        // Of lists without shared vertices polygons and vertices say the same.
        let vertices = solve(Heuristic::Bottleneck, &bound, &both)
            .or_else(|_| solve(Heuristic::Bottleneck, &bound, &both[..1]));
        let pixels = solve(Heuristic::Bottleneck, &unbound, &[Price::Pixel]);
        if vertices.is_err() && pixels.is_err() {
            return None;
        }
        // A side without samples keeps its prices.
        if let Ok(fitted) = vertices {
            (model.vertex_ms, model.corner_ms) = (fitted.vertex_ms, fitted.corner_ms);
        }
        if let Ok(fitted) = pixels {
            model.pixel_ms = fitted.pixel_ms;
        }
        let divided: Vec<bool> = samples
            .iter()
            .map(|sample| {
                let (vertices, pixels) = model.stages(&sample.work);
                vertices >= pixels
            })
            .collect();
        if divided == is_vertex_bound {
            return Some((model, turn));
        }
        is_vertex_bound = divided;
    }
    Some((model, MAX_TURNS))
}

fn with_exponent(samples: &[Sample]) -> Result<CostModel, FitError> {
    let start = CostModel { heuristic: Heuristic::Blend, ..fit(Heuristic::Sum, samples)? };
    let mut best = (relative_error(&start, samples), start);
    for exponent in EXPONENTS {
        // The next exponent starts where the last one ended.
        let model = descend(CostModel { exponent, ..best.1 }, samples);
        let error = relative_error(&model, samples);
        if error < 0.99 * best.0 {
            best = (error, model);
        }
    }
    Ok(best.1)
}

/// Prices of least squared relative error at the model's exponent, by damped Gauss-Newton steps on
/// the prices, none below zero.
fn descend(mut model: CostModel, samples: &[Sample]) -> CostModel {
    const PRICES: [Price; 4] = [Price::Vertex, Price::Pixel, Price::Draw, Price::Switch];
    // A stage that H4 found to be free gets a chance: a hundredth of the other's price.
    let work = samples.iter().fold(Workload::default(), |sum, s| sum.with(&s.work));
    let (vertices, pixels) = model.stages(&work);
    if vertices == 0.0 && work.transformed > 0.0 {
        model.vertex_ms = 0.01 * pixels / work.transformed;
    }
    if pixels == 0.0 && work.pixels > 0.0 {
        model.pixel_ms = 0.01 * vertices / work.pixels;
    }
    let mut damping = 1e-3;
    let mut error = relative_error(&model, samples);
    for _ in 0..40 {
        // In units of each price's share of the whole time, so that the damping means the same.
        let unit = PRICES.map(|price| {
            let count = price.count(model.heuristic, &work);
            if count > 0.0 { samples.iter().map(|s| s.time_ms).sum::<f64>() / count } else { 0.0 }
        });
        let mut system = Triangle::new(PRICES.len());
        for sample in samples {
            let slopes = slopes(&model, &sample.work);
            let row = (0..4).map(|i| slopes[i] * unit[i] / sample.time_ms).collect();
            // Solved for the new prices themselves, so that none can be negative.
            let linear: f64 = (0..4).map(|i| slopes[i] * *PRICES[i].of(&mut model.clone())).sum();
            let rest = sample.time_ms - model.predict(&sample.work) + linear;
            system.absorb(row, rest / sample.time_ms);
        }
        let weight = (damping * samples.len() as f64).sqrt();
        for i in 0..4 {
            let mut row = vec![0.0; 4];
            row[i] = weight.max(1e-9);
            let price = *PRICES[i].of(&mut model.clone());
            let now = if unit[i] > 0.0 { price / unit[i] } else { 0.0 };
            system.absorb(row, weight * now);
        }
        let mut next = model;
        for ((price, value), unit) in PRICES.iter().zip(non_negative(&system)).zip(unit) {
            *price.of(&mut next) = value * unit;
        }
        let next_error = relative_error(&next, samples);
        if next_error < error {
            let gain = (error - next_error) / error;
            (model, error) = (next, next_error);
            damping *= 0.2;
            if gain < 1e-9 {
                break;
            }
        } else {
            damping *= 8.0;
            if damping > 1e6 {
                break;
            }
        }
    }
    model
}

/// Change of the prediction per change of the prices of vertices, pixels, draws and switches.
fn slopes(model: &CostModel, work: &Workload) -> [f64; 4] {
    let (vertices, pixels) = model.stages(work);
    let whole = norm(vertices, pixels, model.exponent);
    let share = |part: f64| {
        if whole > 0.0 { (part / whole).powf(model.exponent - 1.0) } else { 1.0 }
    };
    [share(vertices) * work.transformed, share(pixels) * work.pixels, work.draws, work.switches]
}

/// Mean squared relative error.
pub(super) fn relative_error(model: &CostModel, samples: &[Sample]) -> f64 {
    let error = |s: &Sample| (model.predict(&s.work) / s.time_ms - 1.0).powi(2);
    samples.iter().map(error).sum::<f64>() / samples.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Random;

    fn random_work(seed: u64, index: u64) -> Workload {
        let mut random = Random::new(seed, index);
        let polygons = random.between(50.0, 1500.0);
        Workload {
            draws: 1.0,
            triangles: polygons,
            polygons,
            vertices: polygons * random.between(0.6, 3.0),
            transformed: polygons * random.between(0.6, 2.0),
            pixels: polygons * (1.5 * random.bell()).exp() * 20.0,
            switches: random.below(4) as f64,
        }
    }

    #[test]
    fn the_turns_find_a_bottleneck_without_noise() {
        let truth = CostModel {
            vertex_ms: 2e-3,
            corner_ms: 5e-4,
            pixel_ms: 1.2e-4,
            ..CostModel::free(Heuristic::Bottleneck)
        };
        let sample = |index| {
            let work = random_work(6, index);
            Sample { work, time_ms: truth.predict(&work) }
        };
        let samples: Vec<Sample> = (0..500).map(sample).collect();
        let model = CostModel::fit(Heuristic::Bottleneck, &samples).expect("well posed");
        for (found, known) in [
            (model.vertex_ms, truth.vertex_ms),
            (model.corner_ms, truth.corner_ms),
            (model.pixel_ms, truth.pixel_ms),
        ] {
            assert!((found / known - 1.0).abs() < 1e-3, "{model:?}");
        }
        for share in FIRST_SHARES {
            let split = (share * 500.0) as usize;
            let (_, turns) = turns(&samples, (0..500).map(|i| i < split).collect()).expect("fits");
            assert!(turns < MAX_TURNS, "{share}: {turns} turns");
        }
    }

    #[test]
    fn the_blend_finds_its_own_exponent_and_prices() {
        let truth = CostModel {
            draw_ms: 0.02,
            vertex_ms: 1e-3,
            pixel_ms: 5e-5,
            switch_ms: 0.05,
            exponent: 3.0,
            ..CostModel::free(Heuristic::Blend)
        };
        let sample = |index| {
            let work = random_work(7, index);
            Sample { work, time_ms: truth.predict(&work) }
        };
        let samples: Vec<Sample> = (0..800).map(sample).collect();
        let model = CostModel::fit(Heuristic::Blend, &samples).expect("well posed");
        assert_eq!(model.exponent, 3.0, "{model:?}");
        assert!((model.vertex_ms / 1e-3 - 1.0).abs() < 0.01, "{model:?}");
        assert!((model.pixel_ms / 5e-5 - 1.0).abs() < 0.01, "{model:?}");
    }

    #[test]
    fn polygons_and_vertices_that_say_the_same_are_one_price() {
        let sample = |index| {
            let work = random_work(8, index);
            let work = Workload { vertices: 3.0 * work.polygons, ..work };
            Sample { work, time_ms: (4e-3 * work.polygons).max(1e-4 * work.pixels) }
        };
        let samples: Vec<Sample> = (0..300).map(sample).collect();
        let model = CostModel::fit(Heuristic::Bottleneck, &samples).expect("fits");
        assert_eq!(model.corner_ms, 0.0);
        assert!((model.vertex_ms / 4e-3 - 1.0).abs() < 1e-3, "{model:?}");
    }

    #[test]
    fn bad_samples_are_left_out_and_too_few_are_refused() {
        let work = random_work(9, 0);
        for time_ms in [0.0, f64::NAN, -1.0, f64::INFINITY] {
            let samples = vec![Sample { work, time_ms }; 50];
            for heuristic in Heuristic::ALL {
                assert!(CostModel::fit(heuristic, &samples).is_err(), "{heuristic:?} {time_ms}");
            }
        }
        let same = vec![Sample { work, time_ms: 1.0 }; 50];
        let refused = CostModel::fit(Heuristic::Sum, &same);
        assert!(matches!(refused, Err(FitError::Singular { .. })), "{refused:?}");
        assert!(CostModel::fit(Heuristic::Transformed, &same).is_ok(), "one price is enough there");
    }
}
