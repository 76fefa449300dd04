//! Protects frames with a target time: the points drawn are those that are expected to fit, odd
//! targets are harmless, nothing is done without need, and no frame waits for the GPU.
//!
//! Predictions and counters are asserted, never the clock.

#[cfg(feature = "gpu")]
#[path = "support/device.rs"]
mod device;
#[path = "support/memory_cloud.rs"]
mod memory_cloud;

use std::sync::Arc;

use esker::budget::{CostModel, FrameModel, Heuristic, MOST_TRIALS};
use esker::frame::{Calibration, FrameSettings, PacingStats, Renderer};
use esker::geometry::{Camera, View};
use esker::points::Lattice;
use esker::sampling::Random;
use glam::{DVec3, UVec3};
use memory_cloud::MemoryCloud;

const BITS: u32 = 12;

/// A wavy sheet of 60,000 points, 41 m wide.
fn cloud() -> MemoryCloud {
    let point = |index: u64| {
        let mut random = Random::new(5, index);
        let (x, y) = (random.below(1 << BITS) as u32, random.below(1 << BITS) as u32);
        let height = (f64::from(x) * 0.004).sin() * (f64::from(y) * 0.003).cos();
        (UVec3::new(x, y, (2048.0 + 600.0 * height) as u32), 0xff00_0000 | x << 4)
    };
    let points: Vec<_> = (0..60_000).map(point).collect();
    let lattice = Lattice { scale: DVec3::splat(0.01), offset: DVec3::ZERO };
    MemoryCloud::new(lattice, BITS, 4, &points)
}

fn view(step: u32) -> View {
    let angle = f64::from(step) * 0.05;
    let middle = DVec3::new(20.0, 20.0, 20.0);
    let eye = middle + DVec3::new(angle.cos(), angle.sin(), 0.7) * (12.0 + f64::from(step % 20));
    let camera = Camera::looking_at(eye, middle, DVec3::Z, 1.0, 0.1);
    View { camera, width_px: 320, height_px: 200 }
}

/// Prices as if measured; 2 us a point, so that all of the cloud would take 120 ms.
fn known_prices() -> Calibration {
    Calibration {
        model: CostModel {
            vertex_ms: 1e-3,
            pixel_ms: 5e-4,
            draw_ms: 1e-3,
            ..CostModel::free(Heuristic::Sum)
        },
        base_px_ms: 0.0,
        setup_px_ms: 0.0,
        cpu_ms: 0.1,
        byte_ms: 1e-6,
        frame: FrameModel::PARALLEL,
        views: 0,
        refused: false,
        calibration_ms: 0.0,
    }
}

fn settings(target_ms: Option<f64>) -> FrameSettings {
    let mut settings = FrameSettings { target_ms, ..FrameSettings::default() };
    settings.cut.error_px = 0.01;
    settings
}

fn renderer() -> Renderer {
    let mut renderer = Renderer::on_cpu(1 << 28);
    renderer.set_scene(vec![Arc::new(cloud())]);
    renderer.set_calibration(known_prices());
    renderer
}

fn paced(renderer: &mut Renderer, view: &View, target_ms: f64) -> (PacingStats, u64) {
    let stats = renderer.render(view, &settings(Some(target_ms))).expect("it draws");
    (stats.pacing.expect("there is a target"), stats.points_drawn)
}

#[test]
fn what_is_drawn_is_expected_to_fit() {
    let mut renderer = renderer();
    let mut most = 0;
    for step in 0..60 {
        let (pacing, points) = paced(&mut renderer, &view(step), 20.0);
        let predicted_ms = pacing.predicted_ms.expect("not all of it fits for sure");
        assert!(predicted_ms <= pacing.free_ms, "frame {step}: {pacing:?}");
        assert!((1..=MOST_TRIALS).contains(&pacing.cuts_tried), "{pacing:?}");
        assert!(points <= pacing.point_budget.max(1), "frame {step}: {points} {pacing:?}");
        most = most.max(points);
    }
    assert!(most > 1000, "and something is drawn: {most}");
}

#[test]
fn more_time_draws_more_points() {
    let mut last = 0;
    for target_ms in [1.0, 4.0, 16.0, 64.0] {
        let points = paced(&mut renderer(), &view(3), target_ms).1;
        assert!(points > last, "{target_ms} ms: {points} after {last}");
        last = points;
    }
}

#[test]
fn odd_targets_draw_the_least_or_all() {
    for target_ms in [0.0, -5.0, f64::NAN, 1e-300, f64::NEG_INFINITY] {
        let (pacing, points) = paced(&mut renderer(), &view(3), target_ms);
        assert_eq!(points, 1, "{target_ms}: the root never vanishes; {pacing:?}");
    }
    let (_, points) = paced(&mut renderer(), &view(3), f64::INFINITY);
    let mut free = Renderer::on_cpu(1 << 28);
    free.set_scene(vec![Arc::new(cloud())]);
    let stats = free.render(&view(3), &settings(None)).expect("it draws");
    assert_eq!(points, stats.points_drawn);
}

#[test]
fn empty_scenes_have_nothing_to_predict() {
    let mut renderer = Renderer::on_cpu(1 << 28);
    renderer.set_calibration(known_prices());
    for target_ms in [0.0, 10.0] {
        let (pacing, points) = paced(&mut renderer, &view(0), target_ms);
        assert_eq!((points, pacing.predicted_ms.unwrap_or(0.0)), (0, 0.0));
    }
    renderer.set_scene(vec![Arc::new(MemoryCloud::new(
        Lattice { scale: DVec3::ONE, offset: DVec3::ZERO },
        4,
        2,
        &[],
    ))]);
    assert_eq!(paced(&mut renderer, &view(1), 10.0).1, 0);
}

#[test]
fn without_a_target_nothing_is_held_and_with_much_room_nothing_is_tried() {
    let mut renderer = renderer();
    let stats = renderer.render(&view(0), &settings(None)).expect("it draws");
    assert_eq!(stats.pacing, None);
    assert!(renderer.calibration().is_none());
    renderer.set_calibration(known_prices());
    let mut predicted = 0;
    for step in 0..40 {
        let (pacing, points) = paced(&mut renderer, &view(step), 50_000.0);
        assert!(points > 0);
        assert_eq!(pacing.cuts_tried, u32::from(step == 0), "frame {step}: {pacing:?}");
        predicted += u32::from(pacing.predicted_ms.is_some());
    }
    assert_eq!(predicted, 5, "one in eight");
}

/// The picture under a target is that of its budget.
#[test]
fn a_target_changes_the_budget_and_nothing_else() {
    let mut timed = renderer();
    let (pacing, _) = paced(&mut timed, &view(7), 10.0);
    let mut counted = Renderer::on_cpu(1 << 28);
    counted.set_scene(vec![Arc::new(cloud())]);
    let mut same = settings(None);
    same.cut.point_budget = pacing.point_budget;
    counted.render(&view(7), &same).expect("it draws");
    assert_eq!(timed.picture(), counted.picture());
}

/// A target is for views that move: one that rests comes to all it may show, in few frames, then
/// nothing is drawn any more; as soon as it moves, frames fit again.
#[test]
fn a_view_at_rest_comes_to_all_its_points() {
    let mut free = Renderer::on_cpu(1 << 28);
    free.set_scene(vec![Arc::new(cloud())]);
    let all = free.render(&view(3), &settings(None)).expect("it draws").points_drawn;
    for target_ms in [0.0, 1.0, 5.0] {
        let mut renderer = renderer();
        let (first, few) = paced(&mut renderer, &view(3), target_ms);
        assert!(!renderer.stats().complete && !first.rests, "{target_ms} ms hold something back");
        assert!(few < all / 4, "{target_ms} ms: {few} of {all}");
        let (mut drawn, mut last) = (0, few);
        while !renderer.render(&view(3), &settings(Some(target_ms))).expect("it draws").unchanged {
            let stats = renderer.stats();
            let pacing = stats.pacing.expect("there is a target");
            assert!(pacing.rests && pacing.cuts_tried == 0, "{pacing:?}");
            assert!(stats.points_drawn > last, "every frame shows more: {last} {stats:?}");
            last = stats.points_drawn;
            drawn += 1;
            assert!(drawn <= 8, "{target_ms} ms: {last} of {all} after {drawn} frames at rest");
        }
        assert_eq!(last, all, "{target_ms} ms");
        assert_eq!(renderer.picture(), free.picture());
        let (moved, points) = paced(&mut renderer, &view(4), target_ms);
        assert!(!moved.rests && points < all / 4, "{target_ms} ms: {points} {moved:?}");
    }
}

/// The budget that was asked for ends it, not that of the time; other settings are another view.
#[test]
fn a_view_at_rest_keeps_to_the_budget_that_was_asked_for() {
    let mut renderer = renderer();
    let mut asked = settings(Some(1.0));
    asked.cut.point_budget = 20_000;
    for _ in 0..10 {
        renderer.render(&view(3), &asked).expect("it draws");
    }
    assert!(renderer.stats().unchanged);
    asked.background ^= 0xff;
    let stats = renderer.render(&view(3), &asked).expect("it draws").clone();
    assert!(stats.points_drawn < 5_000 && !stats.complete, "{stats:?}");
    let stats = renderer.render(&view(3), &asked).expect("it draws");
    assert!((5_000..=20_000).contains(&stats.points_drawn), "{stats:?}");
    assert!(stats.complete, "{stats:?}");
}

#[test]
fn measuring_gives_prices_that_tell_points_from_pixels() {
    let mut renderer = Renderer::on_cpu(1 << 28);
    renderer.set_scene(vec![Arc::new(cloud())]);
    let (_, points) = paced(&mut renderer, &view(0), 5.0);
    assert!(points >= 1);
    let calibration = renderer.calibration().expect("it was measured");
    println!("{calibration:?}");
    assert!(calibration.views >= 10 && !calibration.refused, "{calibration:?}");
    let prices = calibration.model;
    assert!(prices.vertex_ms > 0.0 && prices.vertex_ms < 1.0, "{prices:?}");
    assert!(calibration.byte_ms > 0.0 && calibration.frame.system_ms >= 0.0);
}

#[cfg(feature = "gpu")]
#[test]
fn frames_are_measured_without_waiting_for_them() {
    let Some(gpu) = device::gpu() else { return };
    let path = match gpu.draws_by_compute() {
        true => esker::frame::RasterPath::Compute,
        false => esker::frame::RasterPath::Raster,
    };
    let mut renderer = Renderer::on_gpu(gpu.clone(), path, 1 << 28).expect("a renderer");
    renderer.set_scene(vec![Arc::new(cloud())]);
    renderer.set_calibration(known_prices());
    let mut waits = 0;
    let mut last = PacingStats::default();
    for step in 0..60 {
        last = paced(&mut renderer, &view(step), 20.0).0;
        waits += u64::from(step >= 10) * last.blocking_waits;
    }
    // Software drivers do not survive the end of a process that they still draw in.
    gpu.wait().expect("it ends");
    // Without a clock that can be trusted, one frame in eight is waited for, and the one before
    // it.
    let allowed = if gpu.has_timestamps() && !gpu.is_software() { 0 } else { 2 * (50 / 8 + 1) };
    assert!(waits <= allowed, "{waits} waits in 50 frames");
    assert!(last.frames_learned + last.frames_together > 0, "{last:?}");
    assert!(last.checked_measured_ms.is_some_and(|ms| ms > 0.0), "{last:?}");
}

/// Pixels known before drawing against those that are tested, over distances, budgets, sizes.
#[test]
fn estimated_pixels_are_near_the_counted_ones() {
    let mut renderer = renderer();
    let (mut squares, mut frames, mut ratios) = (0.0f64, 0.0, 0.0);
    for step in 0..60 {
        let mut settings = settings(None);
        settings.cut.point_budget = 2_000 << (step % 5);
        settings.cut.splat.multiplier = [1.0, 1.5, 2.5][step as usize % 3];
        let work = renderer.time_frame(&view(step), &settings).expect("it draws").work;
        let counted = renderer.count_work(&view(step), &settings).expect("the CPU has the points");
        assert_eq!(work.transformed, counted.points as f64);
        let ratio = work.pixels / counted.pixels.max(1) as f64;
        println!("{step}: {:.0} estimated, {} counted, {ratio:.2}", work.pixels, counted.pixels);
        squares += (ratio - 1.0).powi(2);
        ratios += ratio;
        frames += 1.0;
    }
    let (rms, mean) = ((squares / frames).sqrt(), ratios / frames);
    assert!(rms < 0.25 && (0.8..1.25).contains(&mean), "{rms} {mean}");
}
