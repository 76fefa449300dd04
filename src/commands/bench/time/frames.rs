//! Frames of points: counted and timed, each path fitted on one set of views and judged on another.

use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;

use crate::budget::{CostModel, Heuristic, OnlineModel, Sample, SystemNoise, Workload};
use crate::commands::bench::plot::{Panel, Scale, Series};
use crate::commands::bench::time::score::{Score, r_squared, spearman};
use crate::commands::bench::time::{Study, kept};
use crate::commands::bench::{BenchArgs, cameras, open_files};
use crate::commands::generate::{self, GenerateArgs, Subject};
use crate::commands::render::{RendererChoice, open_renderer};
use crate::frame::{FrameSettings, NodeSource, Renderer};
use crate::geometry::{Camera, View};
use crate::sampling::Random;

/// All that comes out.
pub struct Outcome {
    /// One row per estimator.
    pub scores: Vec<Score>,
    /// What is no table.
    pub text: String,
    /// One row per frame.
    pub csv: String,
    /// Plots.
    pub panels: Vec<Panel>,
}

/// How much is measured.
#[derive(Clone, Copy)]
pub(super) struct Plan {
    pub(super) size: (u32, u32),
    training: u32,
    pub(super) tests: u32,
    pub(super) flight: u32,
    pub(super) curve: &'static [u64],
    repeats: usize,
    noise: u32,
    points: u64,
}

impl Plan {
    fn new(args: &BenchArgs) -> Self {
        if args.quick {
            Plan {
                size: args.size.unwrap_or((640, 360)),
                training: 40,
                tests: 40,
                flight: 40,
                curve: &[25_000, 50_000, 100_000, 200_000],
                repeats: 3,
                noise: 200,
                points: 300_000,
            }
        } else {
            Plan {
                size: args.size.unwrap_or((1280, 720)),
                training: 200,
                tests: 300,
                flight: 1200,
                curve: &[25_000, 50_000, 100_000, 200_000, 400_000, 800_000],
                repeats: 4,
                noise: 10_000,
                points: 2_000_000,
            }
        }
    }
}

/// A frame and what it took, in milliseconds or millions of counted units.
#[derive(Clone, Copy)]
struct Measured {
    work: Workload,
    time: f64,
}

const CSV_HEADER: &str = "scan,study,frame,nodes,points,pixels,predicted,measured";

/// Runs all of it.
pub fn run(args: &BenchArgs) -> anyhow::Result<Outcome> {
    let plan = Plan::new(args);
    let folder = tempfile::tempdir()?;
    let mut outcome = Outcome {
        scores: Vec::new(),
        text: String::new(),
        csv: format!("{CSV_HEADER}\n"),
        panels: Vec::new(),
    };
    for (name, source) in sources(args, &plan, folder.path())? {
        let points = source.octree().point_count();
        writeln!(outcome.text, "{name}: {points} points")?;
        if args.wants_time(Study::Counted) {
            counted(&name, &source, &plan, &mut outcome)?;
        }
        if args.wants_time(Study::Timed) {
            timed(&name, &source, &plan, &mut outcome)?;
        }
    }
    Ok(outcome)
}

type Named = (String, Arc<dyn NodeSource>);

fn sources(args: &BenchArgs, plan: &Plan, folder: &Path) -> anyhow::Result<Vec<Named>> {
    let mut files = args.files.clone();
    if files.is_empty() {
        let scan = folder.join("generated.las");
        generate::run(GenerateArgs {
            size: None,
            output: scan.clone(),
            points: plan.points,
            subject: Subject::Scene,
            seed: 1,
            origin: DVec3::ZERO,
            step: 0.001,
            overwrite: false,
        })?;
        files.push(scan);
    }
    let stores = open_files(&files, folder)?;
    Ok(stores.into_iter().map(|(name, store)| (name, Arc::new(store) as _)).collect())
}

/// The same frames with their work counted: what the formulas miss when no clock is in the way.
fn counted(
    name: &str,
    source: &Arc<dyn NodeSource>,
    plan: &Plan,
    outcome: &mut Outcome,
) -> anyhow::Result<()> {
    let mut renderer = Renderer::on_cpu(1 << 34);
    renderer.set_scene(vec![Arc::clone(source)]);
    let mut count = |(view, settings): (View, FrameSettings)| -> anyhow::Result<Measured> {
        let work = renderer.time_frame(&view, &settings)?.work;
        let counted = renderer.count_work(&view, &settings).unwrap_or_default();
        Ok(Measured { work, time: 1e-6 * counted.units() })
    };
    let training = training(source.as_ref(), plan)?;
    let training = training.into_iter().map(&mut count).collect::<Result<Vec<_>, _>>()?;
    let tests = (0..plan.tests).map(|frame| count(test_frame(source.as_ref(), plan, frame)));
    let tests = tests.collect::<Result<Vec<_>, _>>()?;
    judge(("counted", name), &training, &tests, outcome);
    let steady = (0..plan.flight).map(|frame| {
        let (view, _) = test_frame(source.as_ref(), plan, frame * plan.tests / plan.flight);
        count((view, settings(plan.curve[plan.curve.len() - 2], 1.0)))
    });
    let steady = steady.collect::<Result<Vec<_>, _>>()?;
    judge(("counted", &format!("{name}, steady flight")), &training, &steady, outcome);
    curve(("counted", name), source, plan, &mut count, outcome)
}

/// The frames by the clock of what draws here.
fn timed(
    name: &str,
    source: &Arc<dyn NodeSource>,
    plan: &Plan,
    outcome: &mut Outcome,
) -> anyhow::Result<()> {
    let (mut renderer, adapter) = open_renderer(RendererChoice::Auto, 1 << 32)?;
    renderer.set_scene(vec![Arc::clone(source)]);
    let calibration = renderer.calibrate(plan.size.0, plan.size.1)?;
    writeln!(
        outcome.text,
        "timed on {} ({})\ncalibrated in {:.0} ms: {calibration:?}",
        adapter.as_deref().unwrap_or("the CPU"),
        renderer.path().name(),
        calibration.calibration_ms,
    )?;
    noise(&mut renderer, source.as_ref(), plan, outcome)?;
    let base_ms = calibration.base_px_ms * f64::from(plan.size.0) * f64::from(plan.size.1);
    let mut time = |(view, settings): (View, FrameSettings)| -> anyhow::Result<Measured> {
        // Once to load and to compile; then the least of some, because what else the machine does
        // only ever adds.
        let mut frame = renderer.time_frame(&view, &settings)?;
        frame.points_ms = f64::INFINITY;
        for _ in 0..plan.repeats {
            let points_ms = renderer.time_frame(&view, &settings)?.points_ms;
            frame.points_ms = frame.points_ms.min(points_ms);
        }
        let time = (frame.points_ms - base_ms).max(0.25 * frame.points_ms);
        Ok(Measured { work: frame.work, time })
    };
    let training = training(source.as_ref(), plan)?;
    let training = training.into_iter().map(&mut time).collect::<Result<Vec<_>, _>>()?;
    let test_of = |frame| test_frame(source.as_ref(), plan, frame);
    let tests = (0..plan.tests).map(|frame| time(test_of(frame)));
    let tests = tests.collect::<Result<Vec<_>, _>>()?;
    judge(("timed", name), &training, &tests, outcome);
    // What no estimator can know: the same frames by the same clock once more.
    let again = (0..plan.tests).map(|frame| time(test_of(frame)));
    let again = again.collect::<Result<Vec<_>, _>>()?;
    note_repeat(("timed", name), &tests, &again, outcome);
    curve(("timed", name), source, plan, &mut time, outcome)?;
    renderer.set_calibration(calibration);
    kept::flight(name, &mut renderer, source.as_ref(), plan, outcome)
}

/// One timing of frames as the prediction of another: the noise below which nothing can be told.
fn note_repeat(
    (study, scene): (&'static str, &str),
    first: &[Measured],
    second: &[Measured],
    outcome: &mut Outcome,
) {
    let pairs: Vec<_> = first.iter().zip(second).map(|(a, b)| (a.time, b.time)).collect();
    outcome.scores.push(Score::of((study, scene, "the same again"), &pairs, 0.0));
}

/// Fits every estimator to some frames and judges it on others.
fn judge(
    (study, name): (&'static str, &str),
    training: &[Measured],
    tests: &[Measured],
    outcome: &mut Outcome,
) {
    let samples: Vec<Sample> =
        training.iter().map(|m| Sample { work: m.work, time_ms: m.time }).collect();
    let mut note = |estimator: &str, predicted: Vec<f64>, us: f64| {
        let pairs: Vec<_> = predicted.into_iter().zip(tests.iter().map(|m| m.time)).collect();
        outcome.scores.push(Score::of((study, name, estimator), &pairs, us));
        pairs
    };
    // Points at one price: least squares of the relative error.
    let each = |s: &Sample| s.work.transformed / s.time_ms;
    let price = samples.iter().map(each).sum::<f64>()
        / samples.iter().map(|s| each(s).powi(2)).sum::<f64>().max(1e-300);
    note("c x points", tests.iter().map(|m| price * m.work.transformed).collect(), 0.0);
    let mut best = None;
    for heuristic in [Heuristic::Bottleneck, Heuristic::Sum, Heuristic::Blend] {
        let Ok(model) = CostModel::fit(heuristic, &samples) else { continue };
        let start = Instant::now();
        let predicted: Vec<f64> = tests.iter().map(|m| model.predict(&m.work)).collect();
        let us = start.elapsed().as_secs_f64() * 1e6 / tests.len().max(1) as f64;
        let pairs = note(heuristic.name(), predicted, us);
        best = Some((model, pairs));
    }
    let last = |i: usize| match i {
        0 => tests[0].time,
        _ => tests[i - 1].time * tests[i].work.transformed / tests[i - 1].work.transformed.max(1.0),
    };
    note("last frame", (0..tests.len()).map(last).collect(), 0.0);
    let Some((model, pairs)) = best else { return };
    let mut online = OnlineModel::new(model);
    let start = Instant::now();
    let (mut expected, mut safe) = (Vec::new(), Vec::new());
    for test in tests {
        expected.push(online.predict(&test.work));
        safe.push(online.predict_safely(&test.work));
        // Rejected frames are counted there, and change nothing.
        let _ = online.observe(&test.work, test.time);
    }
    let us = start.elapsed().as_secs_f64() * 1e6 / tests.len().max(1) as f64;
    // The first frames only warm up.
    let warm = tests.len() / 10;
    let skip = |values: Vec<f64>| -> Vec<f64> {
        let warmed = values.into_iter().enumerate();
        warmed.map(|(i, v)| if i < warm { tests[i].time } else { v }).collect()
    };
    let learned = note("H5 on-line", skip(expected), us);
    note("H5 on-line, guarded", skip(safe), us);
    for (frame, (test, (predicted, measured))) in tests.iter().zip(&learned).enumerate() {
        let Workload { draws, transformed, pixels, .. } = test.work;
        writeln!(
            outcome.csv,
            "{name},{study},{frame},{draws},{transformed},{pixels},{predicted},{measured}"
        )
        .expect("a string takes all text");
    }
    let mut places: Vec<(f64, f64)> = pairs.iter().map(|(p, m)| (*m, *p)).collect();
    places.sort_by(|a, b| a.0.total_cmp(&b.0));
    let ideal = places.iter().map(|&(m, _)| (m, m)).collect();
    let unit = if study == "timed" { "ms" } else { "million units" };
    outcome.panels.push(Panel {
        title: format!("{name}, {study}: H5 on a path it was not fitted to"),
        x_label: format!("measured, {unit}"),
        y_label: format!("predicted, {unit}"),
        x_scale: Scale::Log,
        y_scale: Scale::Log,
        series: vec![
            Series { name: "predicted".into(), points: places },
            Series { name: "measured".into(), points: ideal },
        ],
    });
}

/// Time over budget, in two views.
fn curve(
    (study, name): (&'static str, &str),
    source: &Arc<dyn NodeSource>,
    plan: &Plan,
    measure: &mut dyn FnMut((View, FrameSettings)) -> anyhow::Result<Measured>,
    outcome: &mut Outcome,
) -> anyhow::Result<()> {
    let views = cameras::views_of(source.as_ref(), plan.size)?;
    let mut all = Vec::new();
    let mut series = Vec::new();
    let mut ranks = Vec::new();
    let mut again = Vec::new();
    for (view_name, view) in
        views.iter().filter(|(name, _)| name == "outside" || name == "inside high")
    {
        for multiplier in [1.0, 2.5] {
            let mut line: Vec<Measured> = Vec::new();
            for &budget in plan.curve {
                line.push(measure((*view, settings(budget, multiplier)))?);
                again.push(measure((*view, settings(budget, multiplier)))?.time);
            }
            let points: Vec<f64> = line.iter().map(|m| m.work.transformed).collect();
            let times: Vec<f64> = line.iter().map(|m| m.time).collect();
            ranks.push(spearman(&points, &times));
            series.push(Series {
                name: format!("{view_name}, x{multiplier}"),
                points: points.iter().copied().zip(times).collect(),
            });
            all.extend(line);
        }
    }
    let samples: Vec<Sample> =
        all.iter().map(|m| Sample { work: m.work, time_ms: m.time }).collect();
    let times: Vec<f64> = all.iter().map(|m| m.time).collect();
    if let Ok(model) = CostModel::fit(Heuristic::Sum, &samples) {
        let predicted: Vec<f64> = all.iter().map(|m| model.predict(&m.work)).collect();
        let alone: Vec<f64> = all.iter().map(|m| m.work.transformed).collect();
        let price = alone.iter().zip(&times).map(|(x, t)| x * t).sum::<f64>()
            / alone.iter().map(|x| x * x).sum::<f64>().max(1e-300);
        let by_points: Vec<f64> = alone.iter().map(|x| price * x).collect();
        writeln!(
            outcome.text,
            "{study}: time over points at {} budgets, two views, two splat sizes: rank correlation \
             {:.3} at least, H4 explains R2 = {:.3}, points alone {:.3}, the same frames once more \
             {:.3}",
            plan.curve.len(),
            ranks.iter().copied().fold(1.0, f64::min),
            r_squared(&predicted, &times),
            r_squared(&by_points, &times),
            r_squared(&again, &times),
        )?;
    }
    outcome.panels.push(Panel {
        title: format!("{name}, {study}: time over points"),
        x_label: "points drawn".into(),
        y_label: if study == "timed" { "point pass, ms" } else { "million units" }.into(),
        x_scale: Scale::Log,
        y_scale: Scale::Log,
        series,
    });
    Ok(())
}

/// One frame over and over: what the system takes beside it.
fn noise(
    renderer: &mut Renderer,
    source: &dyn NodeSource,
    plan: &Plan,
    outcome: &mut Outcome,
) -> anyhow::Result<()> {
    let small = Plan { size: (320, 180), ..*plan };
    let (view, _) = test_frame(source, &small, 0);
    let settings = settings(10_000, 1.0);
    let mut times = Vec::new();
    for _ in 0..plan.noise {
        times.push(renderer.time_frame(&view, &settings)?.total_ms);
    }
    if let Some(noise) = SystemNoise::of(&times, 0.99) {
        writeln!(
            outcome.text,
            "system: {} renderings of one frame, shortest {:.2} ms, 99 % within {:.2} ms above it, \
             the middle 99 % within {:.2} ms",
            noise.samples, noise.least_ms, noise.constant_ms, noise.spread_ms
        )?;
    }
    Ok(())
}

pub(super) fn settings(point_budget: u64, multiplier: f64) -> FrameSettings {
    let mut settings = FrameSettings::default();
    settings.cut.point_budget = point_budget;
    settings.cut.error_px = 0.5;
    settings.cut.splat.multiplier = multiplier;
    settings
}

/// Budgets and splat sizes that vary from frame to frame.
fn varied(seed: u64, frame: u32, plan: &Plan) -> FrameSettings {
    let mut random = Random::new(seed, u64::from(frame));
    let [low, .., high] = *plan.curve else { unreachable!("a curve has several budgets") };
    let share = random.unit();
    let budget = (low as f64) * (high as f64 / low as f64).powf(share);
    settings(budget as u64, [1.0, 1.0, 1.5, 2.5][random.below(4) as usize])
}

/// Fixed views and approaches, with varied settings.
fn training(source: &dyn NodeSource, plan: &Plan) -> anyhow::Result<Vec<(View, FrameSettings)>> {
    let mut views = cameras::views_of(source, plan.size)?;
    views.extend(cameras::approach(source, plan.size, 6));
    anyhow::ensure!(!views.is_empty(), "the scan has no points");
    let frame = |i: u32| (views[i as usize % views.len()].1, varied(50, i, plan));
    Ok((0..plan.training).map(frame).collect())
}

/// A spiral towards the middle, with varied settings.
pub(super) fn test_frame(
    source: &dyn NodeSource,
    plan: &Plan,
    frame: u32,
) -> (View, FrameSettings) {
    let share = f64::from(frame) / f64::from(plan.tests.max(1));
    (on_path(source, plan, share), varied(51, frame, plan))
}

/// A place on that spiral, from 0 at its start to 1.
pub(super) fn on_path(source: &dyn NodeSource, plan: &Plan, share: f64) -> View {
    let bounds = source.bounds();
    let radius = (0.5 * bounds.diagonal()).max(1e-3);
    let turn = 4.0 * share;
    let away = DVec3::new(turn.cos(), turn.sin(), 0.25 + 0.3 * (1.0 - share));
    let eye = bounds.center() + away * radius * (1.7 * (1.0 - share) + 0.08);
    let target =
        bounds.center() + DVec3::new(-turn.sin(), turn.cos(), 0.0) * (0.2 * radius * share);
    let camera = Camera::looking_at(eye, target, DVec3::Z, 60f64.to_radians(), 1e-4 * radius);
    View { camera, width_px: plan.size.0, height_px: plan.size.1 }
}
