//! The four ways to draw points give the same picture, on seeded clouds of ragged sizes, for
//! every splat policy, for narrow and wide nodes, and for scans with several points at one place.
#![cfg(feature = "gpu")]

#[path = "support/device.rs"]
mod device;
#[path = "support/memory_cloud.rs"]
mod memory_cloud;

use std::sync::Arc;

use device::gpu;
use esker::frame::{FrameSettings, NodeSource, RasterPath, Renderer};
use esker::geometry::{Camera, View};
use esker::passes::{EarlyOut, EyeDome, FinishSettings, Picture};
use esker::points::Lattice;
use esker::select::{SplatDrawing, SplatPolicy, SplatShape, SplatSize};
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
    cloud_of(count, bits, depth, seed, 0)
}

/// The same with the bits of `flip` turned over in each colour.
fn cloud_of(count: usize, bits: u32, depth: u32, seed: u64, flip: u32) -> MemoryCloud {
    // The cloud is about 10 m wide whatever its lattice.
    let scale = DVec3::splat(10.0 / (1u64 << bits) as f64);
    let offset = DVec3::new(5e5, 5e6, 500.0);
    let points = points_of(count, bits, seed, flip);
    MemoryCloud::new(Lattice { scale, offset }, bits, depth, &points)
}

/// Cells and colours of a cloud.
fn points_of(count: usize, bits: u32, seed: u64, flip: u32) -> Vec<(UVec3, u32)> {
    let mut random = Random(seed);
    let edge = (1u64 << bits) as f64;
    let mut point = || {
        let (x, y) =
            (f64::from(random.next()) / 2f64.powi(32), f64::from(random.next()) / 2f64.powi(32));
        let sheet = f64::from(random.next() % 2);
        let z = 0.2 + 0.5 * sheet + 0.1 * (9.0 * x).sin() * (7.0 * y).cos();
        let cell = [x, y, z].map(|v| (v * edge) as u32);
        (UVec3::from(cell), 0xff00_0000 | (random.next() ^ flip) & 0xff_ffff)
    };
    (0..count).map(|_| point()).collect()
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

/// On a software adapter, whose arithmetic is that of the CPU, no pixel may differ; elsewhere at
/// most one in a thousand, because fused multiplication may move a point over an edge.
fn assert_same_picture(expected: &Picture, picture: &Picture, what: &str) {
    let (differing, ties) = differences(expected, picture);
    let share = differing as f64 / expected.colors.len() as f64;
    assert!(share <= 0.001, "{what}: {differing} pixels differ, {ties} of them ties");
    if gpu().is_some_and(|gpu| gpu.is_software()) {
        assert_eq!(differing, 0, "{what}: pixels that differ, {ties} of them ties");
    }
}

const PATHS: [RasterPath; 3] = [RasterPath::Compute, RasterPath::Compute32, RasterPath::Raster];

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

/// A cloud on screen as few pixels and many, from near, far and inside.
const EYES: [[f64; 3]; 3] = [[0.0, -14.0, 3.0], [0.3, 0.2, 0.4], [30.0, 20.0, 90.0]];

#[test]
fn all_sizes_and_shapes_are_the_same_on_all_paths() {
    if gpu().is_none() {
        return;
    }
    let cloud = Arc::new(cloud(6_000, 18, 5, 11));
    let sizes = [
        SplatSize::Adaptive,
        SplatSize::Fixed { px: 2.0 },
        SplatSize::Fixed { px: 7.0 },
        SplatSize::Attenuated { length: 0.12 },
    ];
    for eye in EYES {
        let view = view(201, 133, eye);
        for size in sizes {
            for shape in SplatShape::ALL {
                let mut settings = settings(SplatPolicy::PerPoint, 3.0);
                (settings.cut.splat.size, settings.cut.splat.shape) = (size, shape);
                settings.cut.splat.max_px = 11.0;
                let expected = draw(RasterPath::Cpu, &cloud, &view, &settings);
                assert!(expected.covered() > 100, "{eye:?}: something is seen");
                for path in PATHS {
                    for drawing in [SplatDrawing::OneByOne, SplatDrawing::Grown] {
                        settings.cut.splat.drawing = drawing;
                        let picture = draw(path, &cloud, &view, &settings);
                        let what = format!("{size:?}, {shape:?}, {drawing:?}, {path:?}, {eye:?}");
                        assert_same_picture(&expected, &picture, &what);
                    }
                }
            }
        }
    }
}

/// Scans on a coarse lattice have several points at one place. Which of them a pixel shows must not
/// depend on the path: a plain point list shows the first that it draws, and so another picture.
#[test]
fn points_at_one_place_are_the_same_on_all_paths() {
    let Some(gpu) = gpu() else { return };
    for (bits, px) in [(6, 1.0), (6, 3.0), (30, 1.0)] {
        // Thirty bits are the wide form; the points still share places.
        let cloud = Arc::new(match bits {
            6 => cloud(20_000, 6, 3, 21),
            _ => spread(20_000, 6, bits, 21),
        });
        let view = view(320, 240, EYES[0]);
        let mut settings = settings(SplatPolicy::PerPoint, 0.01);
        settings.cut.splat.size = SplatSize::Fixed { px };
        let expected = draw(RasterPath::Cpu, &cloud, &view, &settings);
        for path in PATHS {
            let picture = draw(path, &cloud, &view, &settings);
            assert_same_picture(&expected, &picture, &format!("{bits} bits, {px} px, {path:?}"));
        }
        if gpu.draws_by_raster() {
            let mut renderer = Renderer::with_point_list(gpu.clone(), 1 << 30).expect("a device");
            renderer.set_scene(vec![cloud.clone() as Arc<dyn NodeSource>]);
            renderer.render(&view, &settings).unwrap();
            let picture = renderer.read_picture().unwrap().expect("drawn");
            let (differing, ties) = differences(&expected, &picture);
            assert!(10 * differing > expected.covered(), "{differing} of {}", expected.covered());
            assert_eq!(differing, ties, "of the same distance all");
        }
    }
}

/// Shares of nodes are the same points on all paths, and fewer than all.
#[test]
fn shares_of_nodes_are_the_same_on_all_paths() {
    if gpu().is_none() {
        return;
    }
    let cloud = Arc::new(cloud(20_000, 18, 5, 11));
    for (i, eye) in EYES.into_iter().enumerate() {
        let view = view(201, 133, eye);
        for max_px in [1.0, 9.0] {
            let mut settings = settings(SplatPolicy::PerPoint, 2.0);
            settings.cut.splat.max_px = max_px;
            let whole = draw(RasterPath::Cpu, &cloud, &view, &settings);
            settings.cut.continuous = true;
            let expected = draw(RasterPath::Cpu, &cloud, &view, &settings);
            assert!(i != 0 || whole.colors != expected.colors, "shares are drawn");
            for path in PATHS {
                let picture = draw(path, &cloud, &view, &settings);
                assert_same_picture(&expected, &picture, &format!("{path:?} {max_px} {eye:?}"));
            }
        }
    }
}

/// Looking first what a pixel holds saves work and changes no pixel; neither does the second
/// dispatch that nodes of larger splats need, which limiting them to a pixel saves.
#[test]
fn looking_first_changes_no_pixel() {
    let Some(gpu) = gpu() else { return };
    let cloud = Arc::new(cloud(20_000, 18, 5, 11));
    for eye in EYES {
        let view = view(201, 133, eye);
        for (max_px, shape) in
            [(1.0, SplatShape::Square), (9.0, SplatShape::Square), (9.0, SplatShape::Sphere)]
        {
            let mut settings = settings(SplatPolicy::PerPoint, 2.0);
            (settings.cut.splat.max_px, settings.cut.splat.shape) = (max_px, shape);
            let expected = draw(RasterPath::Cpu, &cloud, &view, &settings);
            for early_out in [EarlyOut::Always, EarlyOut::Never] {
                let mut renderer =
                    Renderer::with_early_out(gpu.clone(), early_out, 1 << 30).expect("a device");
                renderer.set_scene(vec![cloud.clone() as Arc<dyn NodeSource>]);
                let stats = renderer.render(&view, &settings).unwrap();
                assert!(max_px > 1.0 || stats.dispatches == 1, "{stats:?}");
                let picture = renderer.read_picture().unwrap().expect("drawn");
                assert_same_picture(
                    &expected,
                    &picture,
                    &format!("{early_out:?} {max_px} {eye:?}"),
                );
            }
        }
    }
}

/// Growing is taken where it was asked for and possible, and only there.
#[test]
fn growing_runs_where_it_can() {
    let Some(gpu) = gpu() else { return };
    let cloud = Arc::new(cloud(2_000, 18, 5, 11));
    let view = view(200, 130, EYES[0]);
    let dispatches = |size, shape, drawing| {
        let mut renderer =
            Renderer::on_gpu(gpu.clone(), RasterPath::Compute, 1 << 30).expect("a device");
        renderer.set_scene(vec![cloud.clone() as Arc<dyn NodeSource>]);
        let mut settings = settings(SplatPolicy::PerPoint, 3.0);
        let splat = &mut settings.cut.splat;
        (splat.size, splat.shape, splat.drawing) = (size, shape, drawing);
        renderer.render(&view, &settings).unwrap().dispatches
    };
    let (five, one) = (SplatSize::Fixed { px: 5.0 }, SplatSize::Fixed { px: 1.0 });
    let (square, round, sphere) = (SplatShape::Square, SplatShape::Round, SplatShape::Sphere);
    assert_eq!(dispatches(five, square, SplatDrawing::OneByOne), 1);
    assert_eq!(dispatches(five, square, SplatDrawing::Grown), 3, "rows and columns");
    assert_eq!(dispatches(five, round, SplatDrawing::Grown), 2, "one pass over squares");
    assert_eq!(dispatches(five, sphere, SplatDrawing::Grown), 1, "depth differs within a ball");
    assert_eq!(dispatches(one, square, SplatDrawing::Grown), 1, "single pixels are done");
    let adaptive = dispatches(SplatSize::Adaptive, square, SplatDrawing::Grown);
    assert!(adaptive <= 2, "sizes differ from node to node");
    assert_eq!(dispatches(five, square, SplatDrawing::Auto), 1, "few points do not pay");
}

/// Finished pictures are the same; a pass runs only for what is switched on.
#[test]
fn finishing_is_the_same_on_all_paths_and_nothing_when_off() {
    let Some(gpu) = gpu() else { return };
    let cloud = Arc::new(cloud(4_000, 18, 5, 12));
    let eye_dome = Some(EyeDome { strength: 1.5, radius_px: 2 });
    let cases = [
        (FinishSettings { gap_radius_px: 0, eye_dome: None }, 0),
        (FinishSettings { gap_radius_px: 2, eye_dome: None }, 1),
        (FinishSettings { gap_radius_px: 0, eye_dome }, 1),
        (FinishSettings { gap_radius_px: 3, eye_dome }, 2),
    ];
    for eye in EYES {
        let view = view(201, 133, eye);
        let mut pictures = Vec::new();
        for (finish, passes) in cases {
            let mut settings = settings(SplatPolicy::PerPoint, 3.0);
            settings.cut.splat.max_px = 1.0;
            settings.finish = finish;
            let expected = draw(RasterPath::Cpu, &cloud, &view, &settings);
            for path in PATHS {
                let mut renderer = Renderer::on_gpu(gpu.clone(), path, 1 << 30).expect("a device");
                renderer.set_scene(vec![cloud.clone() as Arc<dyn NodeSource>]);
                let draw_calls = renderer.render(&view, &settings).unwrap().draw_calls;
                let nodes = renderer.stats().nodes_drawn;
                // The rasterizer draws twice, and then depth.
                let points = if path == RasterPath::Raster { 2 * nodes + 1 } else { 1 };
                assert_eq!(draw_calls, points + passes, "{path:?} {finish:?}");
                let picture = renderer.read_picture().unwrap().expect("drawn");
                assert_finished(&expected, &picture, &format!("{path:?} {finish:?} {eye:?}"));
            }
            pictures.push(expected);
        }
        assert!(pictures[1].covered() > pictures[0].covered(), "gaps were filled");
        assert!(pictures[2].colors != pictures[0].colors, "edges were shaded");
    }
}

/// Like [`assert_same_picture`], where a tie in depth may change the colours around it.
fn assert_finished(expected: &Picture, picture: &Picture, what: &str) {
    let differs = |&i: &usize| {
        let (a, b) = (expected.colors[i].to_le_bytes(), picture.colors[i].to_le_bytes());
        (0..4).any(|c| a[c].abs_diff(b[c]) > 1)
    };
    let differing = (0..expected.colors.len()).filter(differs).count();
    let share = differing as f64 / expected.colors.len() as f64;
    assert!(share <= 0.001, "{what}: {differing} pixels differ");
}

/// The nearest point wins, of equal ones the smallest colour: so the order in which clouds, and
/// with them nodes, are drawn has no say.
#[test]
fn the_order_of_nodes_does_not_matter() {
    if gpu().is_none() {
        return;
    }
    // The second cloud has the places of the first in other colours: all depths are tied.
    let first = Arc::new(cloud(5_000, 12, 4, 3));
    let second = Arc::new(recolored(5_000, 12, 4, 3));
    let view = view(160, 120, EYES[0]);
    let settings = settings(SplatPolicy::PerPoint, 2.0);
    for path in [RasterPath::Cpu, RasterPath::Compute, RasterPath::Compute32, RasterPath::Raster] {
        let picture = |order: [&Arc<MemoryCloud>; 2]| {
            let mut renderer = match path {
                RasterPath::Cpu => Renderer::on_cpu(1 << 30),
                path => Renderer::on_gpu(gpu().expect("asked before"), path, 1 << 30).unwrap(),
            };
            let source = |cloud: &Arc<MemoryCloud>| cloud.clone() as Arc<dyn NodeSource>;
            renderer.set_scene(order.map(source).into());
            renderer.render(&view, &settings).unwrap();
            renderer.read_picture().unwrap().expect("drawn")
        };
        let (forwards, backwards) = (picture([&first, &second]), picture([&second, &first]));
        assert!(forwards == backwards, "{path:?}");
        let alone = draw(path, &first, &view, &settings);
        assert!(alone.colors != forwards.colors, "{path:?}: the second cloud is seen too");
    }
}

/// White is a colour like others, although its inverted bits are all zero.
#[test]
fn white_points_are_seen_on_all_paths() {
    let white: Vec<_> =
        points_of(3_000, 12, 3, 0).into_iter().map(|(cell, _)| (cell, u32::MAX)).collect();
    let lattice =
        Lattice { scale: DVec3::splat(10.0 / 4096.0), offset: DVec3::new(5e5, 5e6, 500.0) };
    let cloud = Arc::new(MemoryCloud::new(lattice, 12, 3, &white));
    let view = view(160, 120, EYES[0]);
    let mut settings = settings(SplatPolicy::PerPoint, 1.0);
    settings.background = 0xff00_0000;
    // Depth is written by another pipeline.
    for depth in [false, true] {
        settings.depth = depth;
        let expected = draw(RasterPath::Cpu, &cloud, &view, &settings);
        let whites = expected.colors.iter().filter(|&&color| color == u32::MAX).count();
        assert_eq!(whites, expected.covered());
        assert!(whites > 500, "{whites}");
        for path in gpu().map_or(&[][..], |_| &PATHS) {
            let picture = draw(*path, &cloud, &view, &settings);
            assert!(picture.colors == expected.colors, "{path:?}, depth {depth}");
        }
    }
}

/// The points of a cloud of `bits` bits in a lattice that is finer, and no larger.
fn spread(count: usize, bits: u32, finer_bits: u32, seed: u64) -> MemoryCloud {
    let points: Vec<_> = points_of(count, bits, seed, 0)
        .into_iter()
        .map(|(cell, color)| (cell * (1 << (finer_bits - bits)), color))
        .collect();
    let scale = DVec3::splat(10.0 / (1u64 << finer_bits) as f64);
    let offset = DVec3::new(5e5, 5e6, 500.0);
    MemoryCloud::new(Lattice { scale, offset }, finer_bits, 3, &points)
}

/// The points of [`cloud`] in other colours.
fn recolored(count: usize, bits: u32, depth: u32, seed: u64) -> MemoryCloud {
    cloud_of(count, bits, depth, seed, 0x5a_a55a)
}
