//! Protects the decision in the middle of a frame: the device chooses what the rule says for any
//! clock, and whatever it chooses, the picture is exactly that of the full or of the coarser cut.
#![cfg(feature = "gpu")]

#[path = "support/device.rs"]
mod device;
#[path = "support/memory_cloud.rs"]
mod memory_cloud;

use std::sync::Arc;

use esker::budget::{CostModel, FrameModel, Heuristic, choose_alternative, ticks_left};
use esker::frame::{
    Calibration, FrameSettings, InFrameCheckpoint, PacingStats, RasterPath, Renderer,
};
use esker::geometry::{Camera, View};
use esker::gpu::layout::GpuDispatch;
use esker::gpu::{Gpu, read_buffer};
use esker::passes::{Checkpoint, Decision, Picture};
use esker::points::Lattice;
use esker::sampling::Random;
use glam::{DVec3, UVec3};
use memory_cloud::MemoryCloud;

/// What the device decides at a given time: the alternative, and the arguments it wrote.
fn decided(
    gpu: &Gpu,
    checkpoint: &mut Checkpoint,
    [begin, now]: [u64; 2],
    decision: &Decision,
) -> (u32, Vec<u32>) {
    let stamps = [7, begin, 9, now];
    gpu.queue().write_buffer(checkpoint.stamps(), 0, bytemuck::cast_slice(&stamps));
    let mut encoder = gpu.device().create_command_encoder(&Default::default());
    let arguments = checkpoint.decide(gpu, &mut encoder, decision).expect("it decides").clone();
    gpu.queue().submit([encoder.finish()]);
    let words = 3 * decision.dispatches.len() as u64 + 1;
    let bytes = read_buffer(gpu, &arguments, 0, 4 * words).expect("it reads back");
    let mut words: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes);
    let chosen = words.pop().expect("the choice stands last");
    (chosen, words)
}

#[test]
fn the_device_chooses_what_the_rule_says_for_any_clock() {
    let Some(gpu) = device::gpu() else { return };
    let mut checkpoint = Checkpoint::new(&gpu).expect("it compiles");
    let large = 1u64 << 33;
    let orders: [&[u64]; 9] = [
        &[10, 5, 2],
        &[2, 5, 10],
        &[5, 5, 5],
        &[10, 2, 5],
        &[0, 0],
        &[u64::MAX, 1],
        &[7],
        &[large, large - 1, 3],
        &[large + 5, large + 4, large + 3, large + 2],
    ];
    let clocks = [
        [0, 0],
        [100, 105],
        [u64::MAX - 1, 3],
        [large, large + large],
        [u64::MAX - large, large],
        [50, 49],
    ];
    let mut chosen_counts = [0; 4];
    for needs in orders {
        for [begin, now] in clocks {
            for allowed in [0, 1, 5, 6, 10, 11, 16, large + 4, 2 * large, u64::MAX] {
                let dispatch = |i: u32| GpuDispatch { alternative: i % 3, x: 10 + i, y: i, z: 1 };
                let dispatches: Vec<GpuDispatch> = (0..5).map(dispatch).collect();
                let decision = Decision { stamps: (1, 3), allowed, needs, dispatches: &dispatches };
                let (chosen, words) = decided(&gpu, &mut checkpoint, [begin, now], &decision);
                let left = ticks_left(begin, allowed, now);
                let rule = choose_alternative(needs, left);
                assert_eq!(chosen as usize, rule, "{needs:?} {allowed} {begin} {now}");
                chosen_counts[rule] += 1;
                for (words, dispatch) in words.chunks(3).zip(&dispatches) {
                    let is_on = dispatch.alternative == chosen;
                    let expected =
                        [dispatch.x, dispatch.y, dispatch.z].map(|n| n * u32::from(is_on));
                    assert_eq!(words, expected);
                }
            }
        }
    }
    assert!(chosen_counts.iter().all(|&count| count > 0), "{chosen_counts:?}");
}

/// A wavy sheet of 120,000 points.
fn cloud() -> MemoryCloud {
    let point = |index: u64| {
        let mut random = Random::new(6, index);
        let (x, y) = (random.below(4096) as u32, random.below(4096) as u32);
        let height = (f64::from(x) * 0.004).sin() * (f64::from(y) * 0.003).cos();
        let color = 0xff00_0000 | random.below(1 << 24) as u32;
        (UVec3::new(x, y, (2048.0 + 600.0 * height) as u32), color)
    };
    let points: Vec<_> = (0..120_000).map(point).collect();
    let lattice = Lattice { scale: DVec3::splat(0.01), offset: DVec3::ZERO };
    MemoryCloud::new(lattice, 12, 5, &points)
}

fn view() -> View {
    let middle = DVec3::new(20.0, 20.0, 20.0);
    let camera =
        Camera::looking_at(middle + DVec3::new(9.0, 14.0, 10.0), middle, DVec3::Z, 1.0, 0.1);
    View { camera, width_px: 320, height_px: 200 }
}

/// Prices next to nothing, so that the plan never draws less.
fn cheap() -> Calibration {
    Calibration {
        model: CostModel { vertex_ms: 1e-12, ..CostModel::free(Heuristic::Sum) },
        base_px_ms: 0.0,
        setup_px_ms: 0.0,
        cpu_ms: 0.0,
        byte_ms: 1e-6,
        frame: FrameModel::PARALLEL,
        views: 0,
        refused: false,
        calibration_ms: 0.0,
    }
}

fn drawn(
    gpu: &Arc<Gpu>,
    path: RasterPath,
    budget: u64,
    target_ms: Option<f64>,
) -> (Picture, u64, Option<PacingStats>) {
    let mut renderer = Renderer::on_gpu(gpu.clone(), path, 1 << 28).expect("a renderer");
    renderer.set_scene(vec![Arc::new(cloud())]);
    let mut settings = FrameSettings { target_ms, ..FrameSettings::default() };
    settings.checkpoint = InFrameCheckpoint::On;
    settings.cut.error_px = 0.01;
    settings.cut.point_budget = budget;
    if target_ms.is_some() {
        renderer.set_calibration(cheap());
    }
    let stats = renderer.render(&view(), &settings).expect("it draws").clone();
    let picture = renderer.read_picture().expect("it reads").expect("there is one");
    let again = renderer.render(&view(), &FrameSettings { background: 1, ..settings });
    let pacing = again.expect("it draws").pacing;
    // Software drivers do not survive the end of a process that they still draw in.
    gpu.wait().expect("it ends");
    (picture, stats.points_drawn, pacing)
}

#[test]
fn either_way_the_picture_is_that_of_its_cut() {
    let Some(gpu) = device::gpu() else { return };
    if !gpu.has_timestamps() {
        return;
    }
    for path in RasterPath::offered_by(&gpu) {
        if path == RasterPath::Raster {
            continue;
        }
        let (full, points, _) = drawn(&gpu, path, 60_000, None);
        assert!(points > 40_000, "{points}");
        // All the time in the world: the full cut.
        let (in_time, in_time_points, _) = drawn(&gpu, path, 60_000, Some(1e6));
        assert_eq!(in_time_points, points);
        assert!(in_time == full, "{}: the full cut", path.name());
        // A millionth of a second: the coarser one, found out half-way.
        let (late, late_points, pacing) = drawn(&gpu, path, 60_000, Some(1e-3));
        assert_eq!(late_points, points, "the plan was to draw all");
        let (coarse, coarse_points, _) = drawn(&gpu, path, points / 2, None);
        assert!(coarse_points < points);
        assert!(late == coarse, "{}: the coarser cut", path.name());
        assert!(late != full, "which is another picture");
        let pacing = pacing.expect("there is a target");
        assert!(pacing.frames_cut_short >= 1, "and the CPU hears of it: {pacing:?}");
    }
}

/// What the device left out half-way comes once the view rests, and then nothing more.
#[test]
fn a_view_at_rest_shows_what_was_cut_short() {
    let Some(gpu) = device::gpu() else { return };
    if !gpu.has_timestamps() || !gpu.draws_by_compute() {
        return;
    }
    let (full, ..) = drawn(&gpu, RasterPath::Compute, 60_000, None);
    let mut renderer =
        Renderer::on_gpu(gpu.clone(), RasterPath::Compute, 1 << 28).expect("a renderer");
    renderer.set_scene(vec![Arc::new(cloud())]);
    renderer.set_calibration(cheap());
    let mut settings = FrameSettings { target_ms: Some(1e-3), ..FrameSettings::default() };
    settings.checkpoint = InFrameCheckpoint::On;
    settings.cut.error_px = 0.01;
    settings.cut.point_budget = 60_000;
    let picture =
        |renderer: &mut Renderer| renderer.read_picture().expect("it reads").expect("there is one");
    assert!(!renderer.render(&view(), &settings).expect("it draws").complete);
    assert!(picture(&mut renderer) != full, "cut short");
    assert!(renderer.render(&view(), &settings).expect("it draws").complete);
    assert!(picture(&mut renderer) == full, "at rest");
    assert!(renderer.render(&view(), &settings).expect("it draws").unchanged);
    gpu.wait().expect("it ends");
}
