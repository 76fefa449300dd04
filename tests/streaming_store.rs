//! Streaming from real stores: how little a first picture reads, and files that go bad while open.

#[path = "support/las_file.rs"]
mod las_file;

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use esker::build::{ConvertOptions, Silent, convert};
use esker::frame::{FIRST_PICTURE_BYTES, FrameSettings, FrameStats, Loading, Renderer};
use esker::geometry::{Camera, View};
use esker::ids::NodeId;
use esker::store::{SectionContent, Store, StoreBytes};
use esker::stream::{StreamSettings, StreamWhen};
use glam::DVec3;
use las_file::{LasPoint, write_las};

/// A store of a wavy square of 100 m, points in no order.
fn store_of(folder: &Path, count: u32) -> PathBuf {
    let mut state = 1u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as i32 % 100_000
    };
    let points: Vec<LasPoint> = (0..count)
        .map(|_| {
            let (x, y) = (next(), next());
            let z = ((f64::from(x) * 2e-4).sin() * (f64::from(y) * 3e-4).cos() * 4_000.0) as i32;
            let color = [(x / 2) as u16, (y / 2) as u16, 30_000];
            LasPoint { position: [x, y, z], color, intensity: 7 }
        })
        .collect();
    let (input, output) = (folder.join("wavy.las"), folder.join("wavy.esker"));
    write_las(&input, &points);
    let options = ConvertOptions::default();
    convert(&[input], &output, &options, &Silent, &AtomicBool::new(false)).expect("it converts");
    output
}

/// From above, so that the square fills the picture.
fn from_above(renderer: &Renderer) -> View {
    let target = renderer.bounds().center();
    let eye = target + DVec3::Z * (0.6 * renderer.bounds().size().x);
    let camera = Camera::looking_at(eye, target, DVec3::Y, 1.0, 0.05);
    View { camera, width_px: 400, height_px: 300 }
}

fn by_hand(when: StreamWhen) -> StreamSettings {
    let look_ahead = Duration::ZERO;
    StreamSettings { when, in_flight_nodes: 0, look_ahead, ..StreamSettings::default() }
}

fn quota() -> FrameSettings {
    FrameSettings { loading: Loading::Quota { bytes: 8 << 20 }, ..FrameSettings::default() }
}

fn renderer(store: &Arc<Store>, streaming: StreamSettings) -> Renderer {
    let mut renderer = Renderer::on_cpu(1 << 30);
    renderer.set_scene(vec![store.clone()]);
    renderer.set_streaming(streaming);
    renderer
}

/// Frames until nothing is left to load.
fn settle(renderer: &mut Renderer) -> FrameStats {
    let view = from_above(renderer);
    for _ in 0..2_000 {
        let stats = renderer.render(&view, &quota()).expect("a frame").clone();
        if stats.complete {
            return stats;
        }
        if let Some(loader) = renderer.loader() {
            while loader.work() {}
        }
    }
    panic!("it never ends");
}

/// A file that counts its reads, and can be told to fail from some offset on.
#[derive(Debug)]
struct Watched {
    file: std::fs::File,
    reads: Arc<AtomicU64>,
    bytes: Arc<AtomicU64>,
    fails: Arc<AtomicBool>,
}

impl StoreBytes for Watched {
    fn byte_count(&self) -> io::Result<u64> {
        self.file.byte_count()
    }
    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        self.reads.fetch_add(1, Ordering::Relaxed);
        self.bytes.fetch_add(buffer.len() as u64, Ordering::Relaxed);
        if self.fails.load(Ordering::Relaxed) {
            return Err(io::Error::new(io::ErrorKind::NotFound, "the server is gone"));
        }
        self.file.read_exact_at(buffer, offset)
    }
}

struct Open {
    store: Arc<Store>,
    reads: Arc<AtomicU64>,
    bytes: Arc<AtomicU64>,
    fails: Arc<AtomicBool>,
}

fn open_watched(path: &Path) -> Open {
    let (reads, bytes) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
    let fails = Arc::new(AtomicBool::new(false));
    let file = std::fs::File::open(path).expect("it opens");
    let watched =
        Watched { file, reads: reads.clone(), bytes: bytes.clone(), fails: fails.clone() };
    let store = Store::open_bytes(Box::new(watched), path, FIRST_PICTURE_BYTES).expect("a store");
    Open { store: Arc::new(store), reads, bytes, fails }
}

/// A store opens and fills the picture with at most 3 reads and 4 MB, with a loader and without.
#[test]
fn a_first_picture_takes_three_reads_and_four_megabytes() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = store_of(folder.path(), 600_000);
    for when in [StreamWhen::Never, StreamWhen::Always] {
        let Open { store, reads, bytes, .. } = open_watched(&path);
        let mut renderer = renderer(&store, by_hand(when));
        let view = from_above(&renderer);
        let first = loop {
            let stats = renderer.render(&view, &quota()).expect("a frame").clone();
            if stats.points_drawn > 0 {
                break stats;
            }
            // One node: read, then unpacked.
            let loader = renderer.loader().expect("nothing was drawn in the call itself");
            assert!(loader.work() && loader.work());
        };
        assert!(!first.complete, "this is not all of it");
        let picture = renderer.read_picture().expect("it reads").expect("it is drawn");
        let covered = picture.distances.iter().filter(|distance| distance.is_finite()).count();
        assert!(covered * 100 > picture.distances.len() * 90, "{when:?}: {covered} pixels");
        let (reads, bytes) = (reads.load(Ordering::Relaxed), bytes.load(Ordering::Relaxed));
        assert!(reads <= 3 && bytes <= 4_000_000, "{when:?}: {reads} reads, {bytes} bytes");
        assert_eq!((store.reads(), store.bytes_read()), (reads, bytes));
        assert!(settle(&mut renderer).points_drawn > first.points_drawn);
    }
}

/// Where the coarse nodes are too many for the first picture, the coarsest come alone, in a third
/// read, and no more bytes than were allowed.
#[test]
fn of_many_coarse_nodes_the_coarsest_come_first() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = store_of(folder.path(), 200_000);
    let columns = [SectionContent::Positions, SectionContent::Color];
    let is_at_hand = |store: &Store, node| store.fetches_from_memory(NodeId(node), &columns);
    let all = Store::open_with_coarse(&path, FIRST_PICTURE_BYTES).expect("a store");
    assert!(is_at_hand(&all, 0) && all.reads() == 2);
    let none = Store::open(&path).expect("a store");
    assert!(!is_at_hand(&none, 0) && none.reads() == 2);
    let allowed = none.bytes_read() + none.fetch_bytes(NodeId::ROOT, &columns) * 2;
    let some = Store::open_with_coarse(&path, allowed).expect("a store");
    assert!(is_at_hand(&some, 0), "the root");
    let nodes = some.octree().nodes().len() as u32;
    assert!((1..nodes).any(|node| is_at_hand(&all, node) && !is_at_hand(&some, node)));
    assert!(some.reads() == 3 && some.bytes_read() <= allowed + 4_096, "{}", some.bytes_read());
    let (mut expected, mut words) = (Vec::new(), Vec::new());
    none.read_positions(NodeId::ROOT, &mut expected).expect("it reads");
    some.read_positions(NodeId::ROOT, &mut words).expect("it reads");
    assert!(words == expected && some.reads() == 3, "from memory, the same");
}

/// Columns that stand side by side come in one read, and unpacking reads nothing.
#[test]
fn a_node_is_one_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = store_of(folder.path(), 200_000);
    let store = Store::open(&path).expect("it opens");
    let columns = [SectionContent::Positions, SectionContent::Color];
    for id in 0..store.octree().nodes().len() as u32 {
        let node = NodeId(id);
        let (reads, bytes) = (store.reads(), store.bytes_read());
        let fetched = store.fetch(node, &columns).expect("it reads");
        assert_eq!(store.reads() - reads, 1);
        assert_eq!(store.bytes_read() - bytes, store.fetch_bytes(node, &columns));
        let (mut positions, mut colors) = (Vec::new(), Vec::new());
        store.unpack_positions(&fetched, &mut positions).expect("it unpacks");
        store.unpack_colors(&fetched, &mut colors).expect("it unpacks");
        assert_eq!(store.reads() - reads, 1, "unpacking reads nothing");
        let (mut expected, mut expected_colors) = (Vec::new(), Vec::new());
        store.read_positions(node, &mut expected).expect("it reads");
        store.read_colors(node, &mut expected_colors).expect("it reads");
        assert!(positions == expected && colors == expected_colors);
        // Any other column, 16-bit colours put together included.
        for attribute in 0..store.metadata().schema.attributes.len() {
            let column = [SectionContent::Attribute(attribute as u32)];
            let fetched = store.fetch(node, &column).expect("it reads");
            let reads = store.reads();
            let (mut bytes, mut expected) = (Vec::new(), Vec::new());
            store.unpack_attribute(&fetched, attribute, &mut bytes).expect("it unpacks");
            assert_eq!(store.reads(), reads);
            store.read_attribute(node, attribute, &mut expected).expect("it reads");
            assert!(bytes == expected, "attribute {attribute}");
        }
    }
}

/// A file that becomes shorter while it is open: what is gone is an error that names its place,
/// what was there before stays on view.
#[test]
fn a_file_that_shrinks_is_an_error_value() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = store_of(folder.path(), 600_000);
    for when in [StreamWhen::Never, StreamWhen::Always] {
        let cut = folder.path().join("cut.esker");
        std::fs::copy(&path, &cut).expect("a copy");
        let store = Arc::new(Store::open_with_coarse(&cut, FIRST_PICTURE_BYTES).expect("a store"));
        let mut renderer = renderer(&store, by_hand(when));
        let view = from_above(&renderer);
        renderer.render(&view, &quota()).expect("a frame");
        std::fs::File::options().write(true).open(&cut).unwrap().set_len(1_000).unwrap();
        let stats = settle(&mut renderer);
        assert!(stats.nodes_failed > 0 && stats.points_drawn > 0, "{stats:?}");
        let problem = &stats.problems[0];
        assert!(problem.starts_with("node ") && problem.contains("bytes "), "{problem}");
        assert!(problem.ends_with("coarser points stand in"), "{problem}");
    }
}

/// A store that is no longer to be reached: the same, and a file that is only unlinked reads on.
#[test]
fn a_store_that_vanishes_is_an_error_value() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = store_of(folder.path(), 600_000);
    let Open { store, fails, .. } = open_watched(&path);
    let mut gone = renderer(&store, by_hand(StreamWhen::Always));
    let view = from_above(&gone);
    gone.render(&view, &quota()).expect("a frame");
    fails.store(true, Ordering::Relaxed);
    let stats = settle(&mut gone);
    assert!(stats.nodes_failed > 0 && stats.points_drawn > 0, "{stats:?}");
    assert!(stats.problems[0].contains("the server is gone"), "{:?}", stats.problems);

    let store = Arc::new(Store::open_with_coarse(&path, FIRST_PICTURE_BYTES).expect("a store"));
    if std::fs::remove_file(&path).is_ok() && cfg!(unix) {
        let stats = settle(&mut renderer(&store, by_hand(StreamWhen::Always)));
        assert!(stats.nodes_failed == 0 && stats.complete, "{stats:?}");
    }
}
