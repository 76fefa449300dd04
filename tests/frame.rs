//! Frames do no more than the view asks for, and points land where they belong.
//!
//! Row numbers are those of the acceptance table of the Instant Points note: 24 precision at large
//! coordinates, 26 draw economy, 27 skips. What a frame did is read from its counters; where a
//! point landed from its colour, which is its number.
#![cfg(feature = "gpu")]

#[path = "support/device.rs"]
mod device;
#[path = "support/memory_cloud.rs"]
mod memory_cloud;

use std::sync::Arc;
use std::time::Duration;

use device::gpu;
use esker::frame::{ColorMode, FrameSettings, Loading, NodeSource, RasterPath, Renderer};
use esker::geometry::{Camera, View};
use esker::points::Lattice;
use esker::stream::StreamSettings;
use glam::{DVec3, UVec3};
use memory_cloud::MemoryCloud;

const UTM: DVec3 = DVec3::new(5e5, 5e6, 500.0);

/// Every path that this machine has.
fn paths() -> Vec<RasterPath> {
    match gpu() {
        Some(_) => {
            vec![RasterPath::Cpu, RasterPath::Compute, RasterPath::Compute32, RasterPath::Raster]
        }
        None => vec![RasterPath::Cpu],
    }
}

fn renderer(path: RasterPath, cloud: &Arc<MemoryCloud>, limit_bytes: u64) -> Renderer {
    let mut renderer = match path {
        RasterPath::Cpu => Renderer::on_cpu(limit_bytes),
        path => Renderer::on_gpu(gpu().expect("asked before"), path, limit_bytes).unwrap(),
    };
    renderer.set_scene(vec![cloud.clone() as Arc<dyn NodeSource>]);
    renderer
}

/// `count` points on a wavy sheet of 2^17 steps of 1 mm; the colour of a point is its number + 1.
fn cloud(count: u32, offset: DVec3, depth: u32) -> Arc<MemoryCloud> {
    let mut state = 0x2545_f491_4f6c_dd1du64;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as u32 & 0x1_ffff
    };
    let points: Vec<(UVec3, u32)> = (0..count)
        .map(|number| {
            let (x, y) = (next(), next());
            let height = (f64::from(x) * 1e-4).sin() * (f64::from(y) * 7e-5).cos();
            let z = (65_536.0 + 30_000.0 * height) as u32;
            (UVec3::new(x, y, z), 0xff00_0000 | (number + 1))
        })
        .collect();
    let lattice = Lattice { scale: DVec3::splat(1e-3), offset };
    Arc::new(MemoryCloud::new(lattice, 17, depth, &points))
}

/// The places of the points of [`cloud`], by number.
fn places(count: u32, offset: DVec3) -> Vec<DVec3> {
    let cloud = cloud(count, offset, 4);
    let (octree, mut places) = (cloud.octree(), vec![DVec3::NAN; count as usize]);
    let (mut words, mut colors) = (Vec::new(), Vec::new());
    for (i, node) in octree.nodes().iter().enumerate() {
        let id = esker::ids::NodeId(i as u32);
        cloud.read_positions(id, &mut words).unwrap();
        cloud.read_colors(id, &mut colors).unwrap();
        for point in 0..node.point_count() as usize {
            let cell = esker::passes::splat::cell_of_code(words[2 * point], words[2 * point + 1]);
            let steps = octree.cell_min(id) + UVec3::from(cell).as_i64vec3();
            let number = (colors[point] & 0xff_ffff) - 1;
            places[number as usize] = octree.lattice().world(steps);
        }
    }
    places
}

/// A view of a cloud whose lattice starts at `offset`.
fn view(offset: DVec3, eye: [f64; 3], target: [f64; 3], fov_degrees: f64) -> View {
    let camera = Camera::looking_at(
        offset + DVec3::from(eye),
        offset + DVec3::from(target),
        DVec3::Z,
        fov_degrees.to_radians(),
        1e-3,
    );
    View { camera, width_px: 640, height_px: 360 }
}

/// All points, one pixel each, coloured as stored.
fn all_points() -> FrameSettings {
    let mut settings = FrameSettings { color: ColorMode::Rgb, ..FrameSettings::default() };
    settings.cut.error_px = 1e-3;
    settings.cut.splat.max_px = 1.0;
    settings.background = 0;
    settings
}

const VIEWS: [([f64; 3], [f64; 3], f64); 5] = [
    ([65.0, -90.0, 150.0], [65.0, 65.0, 65.0], 60.0),
    ([65.0123, 65.0456, 66.2], [70.0, 80.0, 64.0], 90.0),
    ([3000.0, -9000.0, 4000.0], [65.0, 65.0, 65.0], 1.0),
    ([20.0, 20.0, 70.0], [120.0, 110.0, 60.0], 150.0),
    ([65.0, 65.0, 400.0], [65.0, 65.0, 65.0], 30.0),
];

/// Row 24: no point lands farther than 0.05 px from its f64 place.
#[test]
fn points_land_where_f64_says() {
    let count = 20_000;
    let (cloud, places) = (cloud(count, UTM, 4), places(count, UTM));
    for path in paths() {
        let mut renderer = renderer(path, &cloud, 1 << 30);
        for (eye, target, fov) in VIEWS {
            let view = view(UTM, eye, target, fov);
            renderer.render(&view, &all_points()).unwrap();
            let picture = renderer.read_picture().unwrap().expect("drawn");
            let mut seen = 0;
            for (i, &color) in picture.colors.iter().enumerate().filter(|(_, color)| **color != 0) {
                let place = places[(color & 0xff_ffff) as usize - 1];
                let (x, y, _) = view.project(place).expect("it was drawn");
                let (column, row) = ((i % 640) as f64, (i / 640) as f64);
                let off = (column - x).max(x - column - 1.0).max(row - y).max(y - row - 1.0);
                assert!(off < 0.05, "{path:?} {eye:?}: {off} px off at {x} {y}");
                seen += 1;
            }
            assert!(seen > 100, "{path:?} {eye:?}: only {seen} points seen");
        }
    }
}

/// Row 24: the picture at large coordinates is the picture at the origin.
#[test]
fn large_coordinates_change_nothing() {
    let (near, far) = (cloud(20_000, DVec3::ZERO, 4), cloud(20_000, UTM, 4));
    for path in paths() {
        let mut at_origin = renderer(path, &near, 1 << 30);
        let mut at_utm = renderer(path, &far, 1 << 30);
        for (eye, target, fov) in VIEWS {
            at_origin.render(&view(DVec3::ZERO, eye, target, fov), &all_points()).unwrap();
            at_utm.render(&view(UTM, eye, target, fov), &all_points()).unwrap();
            let a = at_origin.read_picture().unwrap().expect("drawn");
            let b = at_utm.read_picture().unwrap().expect("drawn");
            let differing = a.colors.iter().zip(&b.colors).filter(|(a, b)| a != b).count();
            // Only a point within a hair of a pixel's edge may change sides.
            assert!(differing <= 4, "{path:?} {eye:?}: {differing} pixels differ");
        }
    }
}

/// Row 26: draws do not grow with points, dispatches not even with nodes.
#[test]
fn draws_are_few() {
    let cloud = cloud(150_000, UTM, 5);
    for path in paths() {
        let mut renderer = renderer(path, &cloud, 1 << 30);
        let mut settings = all_points();
        settings.cut.error_px = 1.0;
        for step in 0..12 {
            let angle = f64::from(step) * 0.5;
            let eye = [65.0 + 150.0 * angle.cos(), 65.0 + 150.0 * angle.sin(), 100.0];
            let view = view(UTM, eye, [65.0, 65.0, 65.0], 60.0);
            let stats = renderer.render(&view, &settings).unwrap().clone();
            assert!(stats.nodes_drawn > 8 && stats.nodes_drawn < 1000, "{stats:?}");
            match path {
                RasterPath::Cpu => assert_eq!((stats.draw_calls, stats.dispatches), (0, 0)),
                // One shard of narrow nodes: those of single pixels, and the others.
                RasterPath::Compute => {
                    assert!(stats.dispatches <= 2 && stats.draw_calls == 1, "{stats:?}");
                }
                RasterPath::Compute32 => {
                    assert!(stats.dispatches <= 4 && stats.draw_calls == 1, "{stats:?}");
                }
                // Each node for depth and for colour, then the depth that others read.
                RasterPath::Raster => assert_eq!(stats.draw_calls, 2 * stats.nodes_drawn + 1),
            }
        }
    }
}

/// Row 27: a cloud within the budget needs no queue; a view of nothing reads and draws nothing; a
/// still view does nothing at all.
#[test]
fn what_a_view_does_not_need_is_skipped() {
    let cloud = cloud(30_000, UTM, 4);
    let (eye, target, fov) = VIEWS[0];
    let seen = view(UTM, eye, target, fov);
    let away = view(UTM, eye, [65.0, -900.0, 900.0], 30.0);
    let settings = FrameSettings::default();
    for path in paths() {
        let mut renderer = renderer(path, &cloud, 1 << 30);
        let before = cloud.bytes_read();
        let nothing = renderer.render(&away, &settings).unwrap().clone();
        assert_eq!((nothing.points_drawn, nothing.nodes_drawn), (0, 0), "{path:?}");
        assert_eq!((nothing.draw_calls, nothing.dispatches), (0, 0), "{path:?}");
        assert_eq!((nothing.bytes_read, nothing.bytes_uploaded), (0, 0), "{path:?}");
        assert_eq!(cloud.bytes_read(), before);

        let first = renderer.render(&seen, &settings).unwrap().clone();
        assert!(first.points_drawn > 1000 && first.bytes_read > 0 && first.complete);
        assert_eq!(first.queue_pops, 0, "the cloud fits the budget");

        let still = renderer.render(&seen, &settings).unwrap().clone();
        assert!(still.unchanged && still.complete);
        assert_eq!((still.points_drawn, still.draw_calls, still.dispatches), (0, 0, 0));
        assert_eq!((still.bytes_read, still.bytes_uploaded), (0, 0));

        let mut turned = seen;
        turned.camera.eye.z += 0.01;
        let again = renderer.render(&turned, &settings).unwrap().clone();
        assert!(!again.unchanged);
        assert_eq!((again.bytes_read, again.nodes_loaded), (0, 0), "all of it was there");
    }
}

/// What comes in by a quota per frame ends as the picture that waits for everything, and nothing
/// is read twice on the way.
#[test]
fn a_quota_ends_with_the_same_picture() {
    let cloud = cloud(60_000, UTM, 4);
    let (eye, target, fov) = VIEWS[0];
    let view = view(UTM, eye, target, fov);
    for path in paths() {
        let mut waiting = renderer(path, &cloud, 1 << 30);
        let whole = waiting.render(&view, &FrameSettings::default()).unwrap().clone();
        let expected = waiting.read_picture().unwrap().expect("drawn");

        let loading = Loading::Quota { bytes: 50_000 };
        let settings = FrameSettings { loading, ..FrameSettings::default() };
        let mut streaming = renderer(path, &cloud, 1 << 30);
        let (mut frames, mut loaded, mut read, mut drawn) = (0, 0, 0, 0);
        loop {
            let stats = streaming.render(&view, &settings).unwrap();
            assert!(stats.points_drawn >= drawn, "a still view only gains points");
            (loaded, read, drawn) =
                (loaded + stats.nodes_loaded, read + stats.bytes_read, stats.points_drawn);
            frames += 1;
            assert!(frames < 1000, "it never ends");
            if stats.complete {
                break;
            }
        }
        assert!(frames > 3, "a quota spreads loading over frames, not {frames}");
        assert_eq!((loaded, read), (whole.nodes_loaded, whole.bytes_read), "{path:?}");
        assert!(streaming.read_picture().unwrap().expect("drawn") == expected, "{path:?}");
    }
}

/// With room for less than the view wants, what fits is drawn, and frames do not load in circles.
#[test]
fn a_full_cache_settles() {
    let cloud = cloud(60_000, UTM, 4);
    let (eye, target, fov) = VIEWS[0];
    let view = view(UTM, eye, target, fov);
    for path in paths() {
        let mut small = renderer(path, &cloud, 300_000);
        // What is read ahead of the camera is another matter.
        let look_ahead = std::time::Duration::ZERO;
        small.set_streaming(StreamSettings { look_ahead, ..StreamSettings::default() });
        let mut settings = FrameSettings::default();
        for loading in [Loading::All, Loading::Quota { bytes: 100_000 }] {
            settings.loading = loading;
            let mut frames = 0;
            while !small.render(&view, &settings).unwrap().complete {
                frames += 1;
                assert!(frames < 2000, "it never settles");
                std::thread::sleep(std::time::Duration::from_millis(1));
            }
            let mut moved = view;
            moved.camera.eye.x += 1e-3;
            let stats = small.render(&moved, &settings).unwrap();
            assert!(stats.points_drawn > 0 && stats.nodes_without_room > 0, "{path:?} {stats:?}");
            assert!(stats.node_bytes <= 300_000, "{path:?} {stats:?}");
            // Room on a device may be in pieces that are too short: a node or two is read in vain.
            assert!(stats.bytes_read < 3000 && stats.nodes_evicted == 0, "{path:?} {stats:?}");
        }
    }
}

/// When the device turns out to have less memory than it was asked for, caches become smaller, step
/// by step, and frames go on.
#[test]
fn caches_shrink_and_frames_go_on() {
    let cloud = cloud(60_000, UTM, 4);
    let (eye, target, fov) = VIEWS[0];
    let view = view(UTM, eye, target, fov);
    for path in paths() {
        let mut shrinking = renderer(path, &cloud, 64 << 20);
        let whole = shrinking.render(&view, &FrameSettings::default()).unwrap().clone();
        let (mut steps, mut limit_bytes) = (0, 64 << 20);
        while shrinking.shrink_caches() {
            steps += 1;
            assert!(steps < 40, "{path:?}: it never ends");
            let stats = shrinking.render(&view, &FrameSettings::default()).unwrap().clone();
            assert!(stats.points_drawn > 0 && stats.node_bytes <= limit_bytes, "{path:?}");
            assert!(stats.problems.iter().any(|problem| problem.contains("memory ran out")));
            let fits = stats.nodes_without_room == 0;
            assert_eq!(fits, stats.points_drawn == whole.points_drawn, "{path:?} {stats:?}");
            limit_bytes = limit_bytes.min(64 << 20) / 2 + (1 << 20);
        }
        assert!(steps > 1, "{path:?}");
    }
}

/// A picked pixel gives the world position of the point that it shows.
#[test]
fn picking_gives_the_place_of_the_point() {
    let count = 20_000;
    let (cloud, places) = (cloud(count, UTM, 4), places(count, UTM));
    let (eye, target, fov) = VIEWS[0];
    let view = view(UTM, eye, target, fov);
    for path in paths() {
        let mut renderer = renderer(path, &cloud, 1 << 30);
        renderer.render(&view, &all_points()).unwrap();
        let picture = renderer.read_picture().unwrap().expect("drawn");
        let at = picture.colors.iter().position(|&color| color != 0).expect("a point is seen");
        let (x, y) = ((at % 640) as u32, (at / 640) as u32);
        let place = places[(picture.colors[at] & 0xff_ffff) as usize - 1];
        let picked = renderer.pick(x, y, 0).unwrap().expect("there is a point");
        // Half a pixel's diagonal at that distance.
        let pixel = (place - view.camera.eye).length() / view.focal_px();
        assert!((picked - place).length() < 0.8 * pixel, "{path:?}: {picked} for {place}");
        assert_eq!(renderer.pick(0, 0, 0).unwrap(), None, "{path:?}: the corner is empty");
        assert_eq!(renderer.pick(9999, 0, 5).unwrap(), None);
    }
}

/// Nodes that arrive after the first picture come with a rising share of their points, and the
/// frame is drawn again until all are there; the last picture is that without the option.
#[test]
fn nodes_that_arrive_appear_little_by_little() {
    let cloud = cloud(60_000, UTM, 4);
    let (eye, target, fov) = VIEWS[0];
    let view = view(UTM, eye, target, fov);
    for path in paths() {
        let mut plain = renderer(path, &cloud, 1 << 30);
        plain.render(&view, &all_points()).unwrap();
        let expected = plain.read_picture().unwrap().expect("drawn");
        let mut slow = renderer(path, &cloud, 1 << 30);
        let mut settings = all_points();
        settings.appear = Duration::from_millis(100);
        settings.loading = Loading::Quota { bytes: 100_000 };
        let (mut at_ms, mut most_appearing, mut before) = (0, 0, 0);
        loop {
            slow.pin_time(Duration::from_millis(at_ms));
            let stats = slow.render(&view, &settings).unwrap();
            if stats.unchanged {
                break;
            }
            most_appearing = most_appearing.max(stats.nodes_appearing);
            assert!(stats.points_drawn >= before, "{path:?}: {stats:?}");
            (before, at_ms) = (stats.points_drawn, at_ms + 10);
            assert!(at_ms < 100_000, "{path:?}: it never ends");
            std::thread::sleep(Duration::from_millis(1));
        }
        assert!(most_appearing > 3, "{path:?}: {most_appearing}");
        assert!(slow.read_picture().unwrap().expect("drawn") == expected, "{path:?}");
    }
}

/// Levels that pass continuously: points come by shares while the camera nears, never in jumps as
/// large as those of whole nodes, and all of them in the end.
#[test]
fn continuous_levels_have_no_steps() {
    let cloud = cloud(60_000, UTM, 4);
    let mut renderer = renderer(RasterPath::Cpu, &cloud, 1 << 30);
    let mut largest = [0.0f64; 2];
    for (way, continuous) in [false, true].into_iter().enumerate() {
        let mut settings = all_points();
        settings.cut.error_px = 1.0;
        settings.cut.continuous = continuous;
        let mut before = 0.0;
        for step in 0..120 {
            let eye = 2000.0 * 0.97f64.powi(step);
            let view = view(UTM, [65.0, 65.0 - eye, 80.0], [65.0, 65.0, 65.0], 60.0);
            let points = renderer.render(&view, &settings).unwrap().points_drawn as f64;
            if step > 0 {
                largest[way] = largest[way].max(points / before - 1.0);
            }
            before = points;
        }
    }
    assert!(largest[1] < 0.6 * largest[0], "plain and continuous: {largest:?}");
}
