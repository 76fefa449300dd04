//! A device whose memory is small, in pieces, or runs out: all that fits is drawn whatever was there
//! before, and when there is less than was asked for, caches shrink and frames go on.
//!
//! The device is one of this file's own, since its memory is limited here.
#![cfg(feature = "gpu")]

#[path = "support/memory_cloud.rs"]
mod memory_cloud;

use std::sync::Arc;

use esker::frame::{FrameError, FrameSettings, NodeSource, RasterPath, Renderer};
use esker::geometry::{Camera, View};
use esker::gpu::{Gpu, GpuError};
use esker::passes::Picture;
use esker::points::Lattice;
use glam::{DVec3, UVec3};
use memory_cloud::MemoryCloud;

fn gpu() -> Option<Arc<Gpu>> {
    match Gpu::open() {
        Ok(gpu) => Some(Arc::new(gpu)),
        Err(GpuError::NoAdapter) if std::env::var_os("CI").is_none() => {
            eprintln!("skipped: no graphics adapter");
            None
        }
        Err(error) => panic!("{error}"),
    }
}

/// `count` points on a sheet of 2^17 steps of 1 mm, denser towards one corner, so that nodes have
/// many sizes.
fn cloud(count: u32) -> Arc<MemoryCloud> {
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        f64::from((state >> 40) as u32 & 0xff_ffff) / f64::from(1 << 24)
    };
    let points: Vec<(UVec3, u32)> = (0..count)
        .map(|number| {
            let (x, y) = (next().powi(2), next().powi(2));
            let height = 0.5 + 0.2 * (13.0 * x).sin() * (9.0 * y).cos();
            let cell = DVec3::new(x, y, height) * 131_071.0;
            (cell.as_uvec3(), 0xff00_0000 | number)
        })
        .collect();
    let lattice = Lattice { scale: DVec3::splat(1e-3), offset: DVec3::ZERO };
    Arc::new(MemoryCloud::new(lattice, 17, 4, &points))
}

fn view(eye: [f64; 3], target: [f64; 3], side_px: u32) -> View {
    let camera = Camera::looking_at(eye.into(), target.into(), DVec3::Z, 1.0, 0.01);
    View { camera, width_px: side_px, height_px: side_px }
}

/// Places over the sheet, near and far, here and there.
fn views() -> Vec<View> {
    (0..40u32)
        .map(|step| {
            let (x, y) = (f64::from(step * 37 % 120), f64::from(step * 53 % 120));
            let height = 75.0 + f64::from(step * 29 % 50);
            view([x, y, height], [x + 20.0, y + 15.0, 60.0], 160)
        })
        .collect()
}

fn renderer(gpu: &Arc<Gpu>, cloud: &Arc<MemoryCloud>, limit_bytes: u64) -> Renderer {
    let path = RasterPath::offered_by(gpu)[0];
    let mut renderer = Renderer::on_gpu(gpu.clone(), path, limit_bytes).expect("a device");
    renderer.set_scene(vec![cloud.clone() as Arc<dyn NodeSource>]);
    renderer
}

/// Nearly all points of a view.
fn fine() -> FrameSettings {
    let mut settings = FrameSettings::default();
    settings.cut.error_px = 0.2;
    settings
}

fn picture(renderer: &mut Renderer, view: &View) -> Result<Picture, FrameError> {
    renderer.render(view, &fine())?;
    Ok(renderer.read_picture()?.expect("drawn"))
}

/// With room for the largest view and not a node more, every view finds room for all it wants,
/// however the views before it left the free room in pieces; and what was moved is still right.
#[test]
fn what_fits_in_bytes_fits() {
    let Some(gpu) = gpu() else { return };
    let cloud = cloud(60_000);
    let mut largest_bytes = 0;
    let mut expected = Vec::new();
    for view in views() {
        let mut whole = renderer(&gpu, &cloud, 1 << 30);
        expected.push(picture(&mut whole, &view).expect("a picture"));
        largest_bytes = largest_bytes.max(whole.stats().node_bytes);
    }
    let mut small = renderer(&gpu, &cloud, largest_bytes.next_multiple_of(256));
    let (mut moved, mut evicted) = (0, 0);
    for round in 0..3 {
        for (number, (view, expected)) in views().iter().zip(&expected).enumerate() {
            let found = picture(&mut small, view).expect("a picture");
            let stats = small.stats();
            assert_eq!(stats.nodes_without_room, 0, "view {number} of round {round}: {stats:?}");
            assert!(stats.complete && found == *expected, "view {number} of round {round}");
            moved += stats.bytes_moved;
            evicted += stats.nodes_evicted;
        }
    }
    assert!(evicted > 100, "{evicted} nodes had to go");
    assert!(moved > 0, "nothing was ever moved: the test shows nothing");
}

/// The device has less memory than the cache was promised: the cache gets what there is.
#[test]
fn a_cache_takes_what_the_device_has() {
    let Some(gpu) = gpu() else { return };
    let cloud = cloud(60_000);
    let view = view([60.0, -60.0, 120.0], [60.0, 60.0, 60.0], 160);
    let mut whole = renderer(&gpu, &cloud, 1 << 30);
    picture(&mut whole, &view).expect("a picture");
    let points = whole.stats().points_drawn;
    drop(whole);
    // Pixels, tables and the read-back of so small a picture take about 1 MB, the points 0.6 MB.
    let mut small = renderer(&gpu, &cloud, 1 << 30);
    let limit_bytes = gpu.held_bytes() + 1_300_000;
    gpu.limit_memory(limit_bytes);
    let stats = small.render(&view, &fine()).expect("a frame, if a coarser one").clone();
    assert!(stats.points_drawn > 0 && stats.points_drawn < points, "{points}: {stats:?}");
    assert!(stats.nodes_without_room > 0 && stats.complete, "{stats:?}");
    assert!(gpu.held_bytes() <= limit_bytes, "{}", gpu.held_bytes());
    gpu.limit_memory(u64::MAX);
    assert!(small.read_picture().expect("it reads").expect("drawn").covered() > 0);
}

/// Memory runs out for drawing itself: points give theirs up, the frame is drawn and says so; with
/// nothing left to give it is an error that says what for, and more memory ends it.
#[test]
fn points_give_way_to_the_picture() {
    let Some(gpu) = gpu() else { return };
    let cloud = cloud(60_000);
    let small_view = view([60.0, -60.0, 120.0], [60.0, 60.0, 60.0], 64);
    let mut renderer = renderer(&gpu, &cloud, 1 << 30);
    picture(&mut renderer, &small_view).expect("a picture");
    // A larger picture needs 16 bytes a pixel and more; there is less than that beside the points.
    let large_view = View { width_px: 700, height_px: 700, ..small_view };
    gpu.limit_memory(gpu.held_bytes() + (2 << 20));
    let stats = renderer.render(&large_view, &FrameSettings::default()).expect("a frame").clone();
    assert!(stats.points_drawn > 0, "{stats:?}");
    let said = stats.problems.iter().any(|problem| problem.contains("memory ran out"));
    assert!(said, "{:?}", stats.problems);

    gpu.limit_memory(1 << 10);
    let error = renderer.render(&View { width_px: 1500, ..large_view }, &FrameSettings::default());
    assert!(error.as_ref().is_err_and(FrameError::is_out_of_memory), "{error:?}");
    assert!(error.expect_err("just seen").to_string().contains("no memory left to"));
    gpu.limit_memory(u64::MAX);
    let stats = renderer.render(&large_view, &FrameSettings::default()).expect("a frame again");
    assert!(stats.points_drawn > 0, "{stats:?}");
}
