//! Frames of scenes that do not fit the room for them: drawn, requested, evicted, frame by frame.
//!
//! Row numbers are those of the acceptance table of the Instant Points note: 19 convergence, 20 no
//! blocking, 22 no thrash, 23 refinement order, 27 skips. The CPU draws, so no device is needed;
//! the loader has no threads unless a test is about them, and reads as many nodes between two
//! frames as the test says.

#[path = "support/memory_cloud.rs"]
mod memory_cloud;
#[path = "support/slow_cloud.rs"]
mod slow_cloud;

use std::collections::HashSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use esker::frame::{ColorMode, FrameSettings, FrameStats, Loading, NodeSource, Renderer};
use esker::geometry::{Camera, View};
use esker::ids::NodeId;
use esker::passes::Picture;
use esker::points::Lattice;
use esker::stream::{Residency, StreamSettings, StreamWhen};
use glam::{DVec3, UVec3};
use memory_cloud::MemoryCloud;
use slow_cloud::SlowCloud;

/// Bytes of a point's words.
const POINT_BYTES: u64 = 12;

/// `count` points on a wavy sheet of 2^17 steps of 1 mm.
fn cloud(count: u32) -> Arc<MemoryCloud> {
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
            (UVec3::new(x, y, (65_536.0 + 30_000.0 * height) as u32), 0xff00_0000 | number)
        })
        .collect();
    let lattice = Lattice { scale: DVec3::splat(1e-3), offset: DVec3::ZERO };
    Arc::new(MemoryCloud::new(lattice, 17, 4, &points))
}

fn view(eye: [f64; 3], target: [f64; 3]) -> View {
    let camera = Camera::looking_at(eye.into(), target.into(), DVec3::Z, 1.0, 0.01);
    View { camera, width_px: 320, height_px: 240 }
}

/// A flight low over the sheet.
fn flight(step: u32) -> View {
    let x = 10.0 + 2.0 * f64::from(step);
    view([x, 60.0, 110.0], [x + 30.0, 70.0, 60.0])
}

fn settings(upload_bytes: u64) -> FrameSettings {
    FrameSettings { loading: Loading::Quota { bytes: upload_bytes }, ..FrameSettings::default() }
}

/// No threads, and nothing ahead: tests turn the crank.
fn by_hand() -> StreamSettings {
    StreamSettings {
        in_flight_nodes: 0,
        look_ahead: Duration::ZERO,
        frame_time: Some(Duration::from_millis(40)),
        ..StreamSettings::default()
    }
}

fn renderer(source: Arc<dyn NodeSource>, limit_bytes: u64, streaming: StreamSettings) -> Renderer {
    let mut renderer = Renderer::on_cpu(limit_bytes);
    renderer.set_scene(vec![source]);
    renderer.set_streaming(streaming);
    renderer
}

/// Does up to `jobs` steps of the loader.
fn work(renderer: &Renderer, jobs: usize) {
    if let Some(loader) = renderer.loader() {
        let _ = (0..jobs).take_while(|_| loader.work()).count();
    }
}

fn all(source: &dyn NodeSource) -> impl Iterator<Item = NodeId> + use<> {
    (0..source.octree().nodes().len() as u32).map(NodeId)
}

fn resident(renderer: &Renderer, source: &dyn NodeSource) -> HashSet<NodeId> {
    all(source).filter(|&id| renderer.residency((0, id)) == Residency::Resident).collect()
}

fn bytes_of(source: &dyn NodeSource, node: NodeId) -> u64 {
    POINT_BYTES * u64::from(source.octree().node(node).point_count())
}

/// The picture of a view with everything loaded.
fn whole_picture(source: Arc<dyn NodeSource>, view: &View) -> (Picture, FrameStats) {
    let mut renderer = Renderer::on_cpu(1 << 30);
    renderer.set_scene(vec![source]);
    let stats = renderer.render(view, &FrameSettings::default()).unwrap().clone();
    (renderer.read_picture().unwrap().expect("drawn"), stats)
}

/// Frames until nothing is left to load; the loader does `jobs` steps between them.
fn settle(
    renderer: &mut Renderer,
    view: &View,
    settings: &FrameSettings,
    jobs: usize,
) -> Vec<FrameStats> {
    let mut frames = Vec::new();
    loop {
        frames.push(renderer.render(view, settings).unwrap().clone());
        assert!(frames.len() < 5_000, "it never ends");
        if frames.last().expect("one").complete {
            return frames;
        }
        work(renderer, jobs);
    }
}

/// Row 19: a still camera ends with the picture of everything loaded if that has room, whatever
/// the room is beyond that, and with nothing requested.
#[test]
fn a_still_camera_comes_to_the_whole_picture() {
    let cloud = cloud(30_000);
    let view = flight(8);
    let (expected, whole) = whole_picture(cloud.clone(), &view);
    let scene_bytes = POINT_BYTES * cloud.octree().point_count();
    for room in [whole.node_bytes, whole.node_bytes + 100_000, scene_bytes - 1] {
        for jobs in [3, 1_000] {
            let mut streamed = renderer(cloud.clone(), room, by_hand());
            let frames = settle(&mut streamed, &view, &settings(30_000), jobs);
            let last = frames.last().expect("one");
            assert_eq!((last.nodes_requested, last.nodes_without_room), (0, 0), "{room}");
            assert!(streamed.read_picture().unwrap().expect("drawn") == expected, "{room} {jobs}");
            let loaded: u32 = frames.iter().map(|frame| frame.nodes_loaded).sum();
            assert_eq!(loaded, whole.nodes_loaded, "each once");
            // A still view only gains points, and no frame takes in more than the quota and one
            // node.
            let drawn = frames.iter().filter(|f| !f.unchanged).map(|f| f.points_drawn);
            assert!(drawn.clone().zip(drawn.skip(1)).all(|(a, b)| a <= b));
            assert!(frames.iter().all(|frame| frame.nodes_waited_for == 0));
        }
    }
}

/// Rows 19 and 22 with too little room: what is wanted most is there, the rest is not asked for,
/// and nothing is loaded or dropped any more, even as the camera trembles.
#[test]
fn too_little_room_clips_and_does_not_thrash() {
    let source = SlowCloud::new(cloud(60_000), Duration::ZERO, &[]);
    let view = flight(8);
    let (_, whole) = whole_picture(source.clone(), &view);
    let room = whole.node_bytes / 3;
    let mut small = renderer(source.clone(), room, by_hand());
    settle(&mut small, &view, &settings(20_000), 5);
    let first = resident(&small, &*source);
    let read = source.read_nodes().len();
    for tremble in 1..30 {
        let mut moved = view;
        moved.camera.eye.x += 1e-7 * f64::from(tremble % 3);
        let stats = small.render(&moved, &settings(20_000)).unwrap().clone();
        work(&small, 1_000);
        assert!(stats.nodes_without_room > 0 && stats.complete, "{stats:?}");
        assert_eq!((stats.nodes_loaded, stats.nodes_evicted), (0, 0), "frame {tremble}");
        assert!(stats.node_bytes <= room && stats.node_bytes > room - 10_000, "{stats:?}");
    }
    assert_eq!(source.read_nodes().len(), read, "nothing is read in vain");

    // What is there is the same whatever was there before.
    settle(&mut small, &flight(30), &settings(20_000), 5);
    settle(&mut small, &view, &settings(20_000), 5);
    assert!(first.is_subset(&resident(&small, &*source)));
}

/// Row 23, over a flight with a slow store: at each frame every loaded node has its parent, limits
/// hold, and nothing that the frame draws is dropped by it.
#[test]
fn a_flight_keeps_order_and_limits() {
    let cloud = cloud(60_000);
    let room = 200_000;
    let memory_bytes = 150_000;
    let streaming = StreamSettings { memory_bytes, ..by_hand() };
    let mut flying = renderer(cloud.clone(), room, streaming);
    let upload = 40_000;
    let largest = all(&*cloud).map(|id| bytes_of(&*cloud, id)).max().expect("nodes");
    let (mut evicted, mut requested) = (0, 0);
    let mut before: HashSet<NodeId> = HashSet::new();
    for step in 0..40 {
        let stats = flying.render(&flight(step), &settings(upload)).unwrap().clone();
        let now = resident(&flying, &*cloud);
        for &id in &now {
            let parent = cloud.octree().node(id).parent;
            assert!(parent.is_none_or(|parent| now.contains(&parent)), "frame {step}: node {id}");
        }
        let came: u64 = now.difference(&before).map(|&id| bytes_of(&*cloud, id)).sum();
        assert!(came <= upload.max(largest), "frame {step}: {came} bytes");
        assert_eq!(now.difference(&before).count(), stats.nodes_loaded as usize);
        assert!(stats.node_bytes <= room, "frame {step}: {stats:?}");
        let stream = stats.stream.expect("it streams");
        assert!(stream.ram_peak_bytes <= memory_bytes, "frame {step}: {stream:?}");
        assert_eq!(stats.nodes_waited_for, 0);
        evicted += stats.nodes_evicted;
        requested += stats.nodes_requested;
        before = now;
        work(&flying, 12);
    }
    assert!(evicted > 50 && requested > 0, "the flight was too short: {evicted} {requested}");
}

/// Row 23: within a frame the best go first; nodes become ready in the order of their size on
/// screen, as far as their parents let them.
#[test]
fn the_largest_on_screen_are_read_first() {
    let source = SlowCloud::new(cloud(30_000), Duration::ZERO, &[]);
    let view = flight(8);
    let mut streamed = renderer(source.clone(), 250_000, by_hand());
    settle(&mut streamed, &view, &settings(1 << 20), 3);
    let octree = source.octree();
    // Nearest corner of the cell, as the cut takes it.
    let size_px = |id: NodeId| {
        let cell = octree.cell_box(id);
        let distance = cell.distance(view.camera.eye);
        let edge = octree.cell_size(octree.node(id).depth).max_element();
        if distance > 0.0 { edge / distance.max(view.camera.near) } else { f64::INFINITY }
    };
    let sizes: Vec<f64> = source.read_nodes().into_iter().map(size_px).collect();
    assert!(sizes.len() > 50);
    // Cells are closed by a lattice step less than their edge: a hair of slack.
    assert!(sizes.windows(2).all(|pair| pair[1] <= pair[0] * (1.0 + 1e-3)), "{sizes:?}");
}

/// Row 20: with 50 ms for every read, no frame waits for one: nothing is read on the thread that
/// draws, and frames go on meanwhile.
#[test]
fn frames_do_not_wait_for_a_slow_disk() {
    let source = SlowCloud::new(cloud(20_000), Duration::from_millis(50), &[]);
    let streaming = StreamSettings { look_ahead: Duration::ZERO, ..StreamSettings::default() };
    let mut streamed = renderer(source.clone(), 230_000, streaming);
    let woken = Arc::new(AtomicU64::new(0));
    let counter = woken.clone();
    streamed.set_wake(Arc::new(move || {
        counter.fetch_add(1, Ordering::Relaxed);
    }));
    let view = flight(8);
    let (mut frames, mut idle_frames) = (0, 0);
    loop {
        let stats = streamed.render(&view, &settings(1 << 20)).unwrap();
        assert_eq!(stats.nodes_waited_for, 0);
        frames += 1;
        idle_frames += u32::from(stats.unchanged);
        let stream = stats.stream.expect("it streams");
        assert!(stream.loader_threads > 0 && stream.nodes_in_flight <= 8, "{stream:?}");
        if stats.complete {
            break;
        }
        assert!(frames < 100_000, "it never ends");
        std::thread::sleep(Duration::from_millis(1));
    }
    let me = std::thread::current().id();
    let reads = source.reads.lock().unwrap();
    assert!(reads.len() > 8 && reads.iter().all(|&(_, thread)| thread != me));
    assert!(idle_frames > 0, "frames went on while nothing came");
    // One for each node that was wanted.
    assert_eq!(woken.load(Ordering::Relaxed), reads.len() as u64);
}

/// The same without the loader: the counter tells that frames waited.
#[test]
fn waiting_is_counted() {
    let source = SlowCloud::new(cloud(20_000), Duration::ZERO, &[]);
    let never = StreamSettings { when: StreamWhen::Never, ..by_hand() };
    let mut waiting = renderer(source.clone(), 230_000, never);
    let frames = settle(&mut waiting, &flight(8), &settings(50_000), 0);
    let waited: u32 = frames.iter().map(|frame| frame.nodes_waited_for).sum();
    assert_eq!(waited as usize, source.read_nodes().len());
    assert!(waited > 8 && waiting.loader().is_none());
}

/// Row 27: a scene that fits the room for it starts no loader; one that does not, does.
#[test]
fn what_fits_starts_no_loader() {
    let cloud = cloud(20_000);
    let scene_bytes = POINT_BYTES * cloud.octree().point_count();
    for (room, expected) in [(scene_bytes, false), (scene_bytes - 1, true)] {
        let streaming = StreamSettings::default();
        let mut some = renderer(cloud.clone(), room, streaming);
        for step in 0..10 {
            let stats = some.render(&flight(step), &settings(1 << 20)).unwrap();
            assert_eq!(stats.stream.is_some(), expected, "{room}");
            assert_eq!(stats.stream.map_or(0, |s| s.loader_threads), 8 * u32::from(expected));
        }
        // A picture that still holds tells it too.
        while !some.render(&flight(9), &settings(1 << 20)).unwrap().complete {
            std::thread::sleep(Duration::from_millis(1));
        }
        let still = some.render(&flight(9), &settings(1 << 20)).unwrap();
        assert!(still.unchanged);
        assert_eq!(still.stream.is_some(), expected);
        assert_eq!(some.loader().is_some(), expected);
        // A picture on its own needs none either: it waits.
        let mut alone = renderer(cloud.clone(), room, streaming);
        alone.render_picture(&flight(0), &FrameSettings::default()).unwrap();
        assert!(alone.loader().is_none());
    }
}

/// A node that cannot be read is told, its parent and its children are drawn, and all else comes.
#[test]
fn unreadable_nodes_are_stood_in_for() {
    let cloud = cloud(60_000);
    let view = flight(8);
    let broken = [1, 7, 8, 40];
    let source = SlowCloud::new(cloud.clone(), Duration::ZERO, &broken);
    let (expected, whole) = whole_picture(source.clone(), &view);
    assert!(whole.nodes_failed > 0 && !whole.problems.is_empty());
    let room = POINT_BYTES * cloud.octree().point_count() - 1;
    let mut streamed = renderer(source.clone(), room, by_hand());
    let frames = settle(&mut streamed, &view, &settings(50_000), 9);
    let last = frames.last().expect("one");
    assert_eq!((last.nodes_failed, last.complete), (whole.nodes_failed, true));
    assert!(last.problems.iter().any(|problem| problem.contains("checksum")), "{last:?}");
    assert!(streamed.read_picture().unwrap().expect("drawn") == expected);
    let shown = resident(&streamed, &*source);
    let failed = |id: &NodeId| streamed.residency((0, *id)) == Residency::Failed;
    let below = |id: NodeId| cloud.octree().node(id).children().any(|child| shown.contains(&child));
    assert!(all(&*cloud).filter(failed).any(below), "children of a failed node are drawn");

    // With all of it unreadable there is an empty picture and a reason.
    let nodes: Vec<u32> = all(&*cloud).map(|id| id.0).collect();
    let nothing = SlowCloud::new(cloud.clone(), Duration::ZERO, &nodes);
    let mut streamed = renderer(nothing, room, by_hand());
    let frames = settle(&mut streamed, &view, &settings(50_000), 9);
    let last = frames.last().expect("one");
    assert_eq!((last.points_drawn, last.problems.is_empty()), (0, false));
}

/// A line that hesitates is asked again: with the loader, whose threads wait meanwhile and not the
/// frames, and without it. What never answers is given up after a few tries.
#[test]
fn what_times_out_is_read_again() {
    let cloud = cloud(30_000);
    let view = flight(8);
    let (expected, _) = whole_picture(cloud.clone(), &view);
    let room = POINT_BYTES * cloud.octree().point_count() - 1;
    for when in [StreamWhen::Always, StreamWhen::Never] {
        let source = SlowCloud::new(cloud.clone(), Duration::ZERO, &[]);
        source.hesitates.lock().unwrap().extend([(NodeId(0), 1), (NodeId(2), 2)]);
        let look_ahead = Duration::ZERO;
        let streaming = StreamSettings { when, look_ahead, ..StreamSettings::default() };
        let mut streamed = renderer(source.clone(), room, streaming);
        let (mut frames, mut retried) = (0, 0);
        let last = loop {
            let stats = streamed.render(&view, &settings(1 << 20)).unwrap().clone();
            retried += u64::from(stats.reads_retried);
            frames += 1;
            assert!(frames < 100_000, "it never ends");
            if stats.complete {
                break stats;
            }
            std::thread::sleep(Duration::from_millis(1));
        };
        retried += last.stream.map_or(0, |stream| stream.reads_retried);
        assert_eq!((retried, last.nodes_failed), (3, 0), "{when:?}");
        assert!(last.problems.is_empty(), "{:?}", last.problems);
        assert!(streamed.read_picture().unwrap().expect("drawn") == expected, "{when:?}");
    }

    let source = SlowCloud::new(cloud.clone(), Duration::ZERO, &[]);
    source.hesitates.lock().unwrap().insert(NodeId(2), u32::MAX);
    let never = StreamSettings { when: StreamWhen::Never, ..by_hand() };
    let mut waiting = renderer(source.clone(), room, never);
    let stats = waiting.render(&view, &FrameSettings::default()).unwrap().clone();
    assert_eq!((stats.nodes_failed, stats.reads_retried), (1, 4), "{stats:?}");
    assert!(stats.problems[0].contains("timed out"), "{:?}", stats.problems);
    let tries = source.read_nodes().iter().filter(|&&node| node == NodeId(2)).count();
    assert_eq!(tries, 5, "the first and four more");
}

/// Reading ahead of a steady camera: more of what comes into view is there when it does.
#[test]
fn a_steady_flight_is_foreseen() {
    let cloud = cloud(120_000);
    let fly = |look_ahead| {
        let streaming = StreamSettings { look_ahead, memory_bytes: 4 << 20, ..by_hand() };
        let mut flying = renderer(cloud.clone(), 500_000, streaming);
        let mut missing = 0;
        for step in 0..60 {
            let view = flight(step);
            let stats = flying.render(&view, &settings(1 << 20)).unwrap();
            missing += stats.nodes_requested;
            work(&flying, 400);
        }
        let stream = flying.stats().stream.expect("it streams");
        (missing, stream.ram_hits, stream.nodes_read_ahead)
    };
    let (missing_without, _, none_ahead) = fly(Duration::ZERO);
    let (missing_with, hits, ahead) = fly(Duration::from_millis(250));
    assert_eq!(none_ahead, 0);
    assert!(ahead > 50 && hits > 50, "{ahead} ahead, {hits} hits");
    assert!(2 * missing_with < missing_without, "{missing_with} of {missing_without}");
}

/// Another colour while nodes are under way: the old colours never show up in the new picture.
#[test]
fn colors_may_change_on_the_way() {
    let cloud = cloud(40_000);
    let view = flight(8);
    let room = POINT_BYTES * cloud.octree().point_count() - 1;
    let mut streamed = renderer(cloud.clone(), room, by_hand());
    let mut elevation = settings(50_000);
    elevation.color = ColorMode::Elevation;
    for step in 0..4 {
        streamed.render(&view, &settings(50_000)).unwrap();
        work(&streamed, 10 + step);
        streamed.render(&view, &elevation).unwrap();
        work(&streamed, 3);
    }
    settle(&mut streamed, &view, &elevation, 20);
    let mut whole = Renderer::on_cpu(1 << 30);
    whole.set_scene(vec![cloud]);
    let color = ColorMode::Elevation;
    whole.render(&view, &FrameSettings { color, ..FrameSettings::default() }).unwrap();
    let expected = whole.read_picture().unwrap().expect("drawn");
    assert!(streamed.read_picture().unwrap().expect("drawn") == expected);
}

/// Settings that make no sense end in a frame, not in a panic or a standstill.
#[test]
fn extreme_settings_are_survived() {
    let cloud = cloud(20_000);
    let scene_bytes = POINT_BYTES * cloud.octree().point_count();
    let root_bytes = bytes_of(&*cloud, NodeId::ROOT);
    for (room, memory_bytes) in [(0, 0), (root_bytes - 1, 1), (root_bytes, 0), (scene_bytes / 2, 0)]
    {
        let streaming = StreamSettings { memory_bytes, ..by_hand() };
        let mut odd = renderer(cloud.clone(), room, streaming);
        for budget in [0, 1, 1_000, 1 << 40] {
            let mut settings = settings(0);
            settings.cut.point_budget = budget;
            for step in 0..8 {
                // A camera that jumps about, budgets that change each frame.
                let view = flight(step * 37 % 50);
                odd.render(&view, &settings).unwrap();
                settings.cut.point_budget = budget + u64::from(step);
                work(&odd, 3);
            }
            let frames = settle(&mut odd, &flight(3), &settings, 50);
            let last = frames.last().expect("one");
            assert!(last.node_bytes <= room, "{last:?}");
            let shows = odd.read_picture().unwrap().expect("drawn");
            let is_empty = shows.distances.iter().all(|distance| !distance.is_finite());
            // One point alone may be out of sight.
            assert!(budget < 1_000 || is_empty == (room < root_bytes), "{room} {budget}");
        }
    }
}

/// Threads, a small memory and a camera that leaps: limits hold, and it ends well.
#[test]
fn many_threads_keep_the_limits() {
    let cloud = cloud(60_000);
    let source = SlowCloud::new(cloud.clone(), Duration::from_micros(200), &[5]);
    let memory_bytes = 120_000;
    let streaming = StreamSettings { memory_bytes, ..StreamSettings::default() };
    let mut flying = renderer(source, 150_000, streaming);
    let mut state = 1u32;
    for _ in 0..150 {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let stats = flying.render(&flight(state >> 27), &settings(60_000)).unwrap();
        let stream = stats.stream.expect("it streams");
        assert!(stream.ram_peak_bytes <= memory_bytes, "{stream:?}");
        assert!(stream.nodes_in_flight <= 8 && stats.node_bytes <= 150_000, "{stats:?}");
        let now = resident(&flying, &*cloud);
        let has_parent = |&id: &NodeId| {
            let parent = cloud.octree().node(id).parent;
            parent.is_none_or(|parent| now.contains(&parent) || parent == NodeId(5))
        };
        assert!(now.iter().all(has_parent), "a node without its parent");
    }
    let mut frames = 0;
    while !flying.render(&flight(8), &settings(60_000)).unwrap().complete {
        frames += 1;
        assert!(frames < 20_000, "it never ends");
        std::thread::sleep(Duration::from_millis(1));
    }
}
