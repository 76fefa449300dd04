//! The three ways to draw points give the same picture, on seeded clouds of ragged sizes, for
//! every splat policy, for narrow and wide nodes. What may differ is which of several points at
//! the same depth wins, and then only between the rasterizer and the others.
#![cfg(feature = "gpu")]

#[path = "support/device.rs"]
mod device;
#[path = "support/memory_cloud.rs"]
mod memory_cloud;

use std::sync::Arc;

use device::gpu;
use esker::frame::{FrameSettings, NodeSource, RasterPath, Renderer};
use esker::geometry::{Camera, View};
use esker::passes::Picture;
use esker::points::Lattice;
use esker::select::SplatPolicy;
use glam::{DVec3, UVec3};
use memory_cloud::MemoryCloud;

/// A small generator of repeatable numbers (xorshift64*).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u32 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 32) as u32
    }
}

/// `count` points on two bumpy sheets within a cube of `bits` bits.
fn cloud(count: usize, bits: u32, depth: u32, seed: u64) -> MemoryCloud {
    let mut random = Random(seed);
    let edge = (1u64 << bits) as f64;
    let mut point = || {
        let (x, y) =
            (f64::from(random.next()) / 2f64.powi(32), f64::from(random.next()) / 2f64.powi(32));
        let sheet = f64::from(random.next() % 2);
        let z = 0.2 + 0.5 * sheet + 0.1 * (9.0 * x).sin() * (7.0 * y).cos();
        let cell = [x, y, z].map(|v| (v * edge) as u32);
        (UVec3::from(cell), 0xff00_0000 | random.next() & 0xff_ffff)
    };
    let points: Vec<_> = (0..count).map(|_| point()).collect();
    // The cloud is about 10 m wide whatever its lattice.
    let scale = DVec3::splat(10.0 / edge);
    MemoryCloud::new(Lattice { scale, offset: DVec3::new(5e5, 5e6, 500.0) }, bits, depth, &points)
}

fn view(width_px: u32, height_px: u32, eye: [f64; 3]) -> View {
    let middle = DVec3::new(5e5 + 5.0, 5e6 + 5.0, 505.0);
    let camera =
        Camera::looking_at(middle + DVec3::from(eye), middle, DVec3::Z, 55f64.to_radians(), 0.05);
    View { camera, width_px, height_px }
}

fn draw(
    path: RasterPath,
    cloud: &Arc<MemoryCloud>,
    view: &View,
    settings: &FrameSettings,
) -> Picture {
    let mut renderer = match path {
        RasterPath::Cpu => Renderer::on_cpu(1 << 30),
        path => Renderer::on_gpu(gpu().expect("asked before"), path, 1 << 30).unwrap(),
    };
    renderer.set_scene(vec![cloud.clone() as Arc<dyn NodeSource>]);
    renderer.render(view, settings).unwrap();
    renderer.read_picture().unwrap().expect("a frame was drawn")
}

fn settings(policy: SplatPolicy, error_px: f64) -> FrameSettings {
    let mut settings = FrameSettings::default();
    settings.cut.splat.policy = policy;
    settings.cut.error_px = error_px;
    settings
}

/// Pixels whose colours differ, and how many of them are ties in depth.
fn differences(a: &Picture, b: &Picture) -> (usize, usize) {
    assert_eq!(a.colors.len(), b.colors.len());
    let is_tie = |&i: &usize| {
        let (a, b) = (a.distances[i], b.distances[i]);
        a == b || (a / b - 1.0).abs() < 1e-6
    };
    let differing: Vec<usize> =
        (0..a.colors.len()).filter(|&i| a.colors[i] != b.colors[i]).collect();
    (differing.len(), differing.iter().filter(|i| is_tie(i)).count())
}

/// At most a pixel in a thousand may differ. On a software adapter, whose arithmetic is that of
/// the CPU, the rest must be ties; elsewhere fused multiplication may move a point over an edge.
fn assert_same_picture(expected: &Picture, picture: &Picture, what: &str) {
    let (differing, ties) = differences(expected, picture);
    let share = differing as f64 / expected.colors.len() as f64;
    assert!(share <= 0.001, "{what}: {differing} pixels differ, {ties} of them ties");
    if gpu().is_some_and(|gpu| gpu.is_software()) {
        assert_eq!(differing, ties, "{what}: pixels that differ, and those that are ties");
    }
}

const PATHS: [RasterPath; 2] = [RasterPath::Compute, RasterPath::Raster];

#[test]
fn all_paths_draw_the_same_picture() {
    if gpu().is_none() {
        return;
    }
    for (count, bits, depth, size) in [
        (0, 8, 3, (20, 10)),
        (1, 4, 2, (33, 17)),
        (2, 10, 3, (64, 64)),
        (777, 12, 4, (101, 67)),
        (20_000, 21, 5, (320, 240)),
        (20_000, 24, 5, (320, 240)),
        (5_000, 32, 6, (160, 120)),
    ] {
        let cloud = Arc::new(cloud(count, bits, depth, 7 + count as u64));
        for eye in [[0.0, -14.0, 3.0], [0.3, 0.2, 0.4], [300.0, 200.0, 900.0]] {
            let view = view(size.0, size.1, eye);
            for policy in SplatPolicy::ALL {
                let settings = settings(policy, 3.0);
                let expected = draw(RasterPath::Cpu, &cloud, &view, &settings);
                for path in PATHS {
                    let what =
                        format!("{count} points, {bits} bits, {policy:?}, {path:?}, {eye:?}");
                    let picture = draw(path, &cloud, &view, &settings);
                    assert_same_picture(&expected, &picture, &what);
                }
            }
        }
    }
}
