//! Protects the first look: scans are shown by some of their points before they are converted.
//!
//! Previews come before the store, are made of the scan's points and cover what it covers; nothing
//! but detail changes when the store takes over; nothing stays behind, whatever ends the work. The
//! thread that opens files is held at each of its signs of life, so the order is certain.
#![cfg(feature = "viewer")]

#[path = "support/las_file.rs"]
mod las_file;
#[path = "support/shared_data.rs"]
mod shared_data;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};

use egui::{Event, Key, Modifiers, Pos2, RawInput, Rect, Vec2};
use esker::frame::{ColorMode, FrameSettings, Renderer};
use esker::geometry::ViewPreset;
use esker::ids::NodeId;
use esker::store::{Store, check};
use esker::viewer::{
    CameraControl, Canvas, KeptIn, Opened, OpenedFile, Opening, OpeningOptions, Statistics, Viewer,
    ViewerOptions, first_settings,
};
use glam::DVec3;
use las_file::{LasPoint, write_las};

/// A wavy field of points, 100 m wide and deep, point after point in rows.
fn scan(path: &Path, side: i32) {
    let point = |i: i32| {
        let (x, y) = (i % side, i / side);
        let wave = (f64::from(x) * 0.1).sin() * 3000.0;
        LasPoint {
            position: [x * 100_000 / side, y * 100_000 / side, wave as i32],
            color: [(x % 256) as u16 * 256, (y % 256) as u16 * 256, 40_000],
            intensity: (i % 1000) as u16,
        }
    };
    write_las(path, &(0..side * side).map(point).collect::<Vec<_>>());
}

/// A folder with scans, and one for previews.
struct Place {
    folder: tempfile::TempDir,
    previews: tempfile::TempDir,
}

impl Place {
    fn new() -> Self {
        let folder = || tempfile::tempdir().expect("a folder");
        Place { folder: folder(), previews: folder() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn options(&self) -> OpeningOptions {
        OpeningOptions {
            preview_points: Some(1000),
            preview_folder: Some(self.previews.path().to_owned()),
            list_folder: Some(|folder| {
                let entries = fs::read_dir(folder)?.map(|entry| Ok(entry?.path()));
                let mut paths = entries.collect::<std::io::Result<Vec<_>>>()?;
                paths.sort();
                Ok(paths)
            }),
            ..OpeningOptions::default()
        }
    }

    /// Names in the folder of scans; that of previews must be empty.
    fn left(&self) -> Vec<String> {
        let names = |folder: &Path| -> Vec<String> {
            let entries = fs::read_dir(folder).expect("lists").flatten();
            let mut names: Vec<_> =
                entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
            names.sort();
            names
        };
        assert_eq!(names(self.previews.path()), [""; 0], "previews stay behind");
        names(self.folder.path())
    }
}

/// A request whose thread stops at each sign of life until it is let on; dropping the sender lets
/// it run.
fn held(paths: Vec<PathBuf>, options: OpeningOptions) -> (SyncSender<()>, Opening) {
    let (go, wait) = sync_channel::<()>(0);
    let wait = Mutex::new(wait);
    let wake = Arc::new(move |_| {
        let _ = wait.lock().expect("nobody panics with it").recv();
    });
    (go, Opening::start(paths, options, wake).expect("a thread starts"))
}

/// All news of a request.
fn news(paths: Vec<PathBuf>, options: OpeningOptions) -> Vec<Opened> {
    let opening = Opening::start(paths, options, Arc::new(|_| {})).expect("a thread starts");
    while !opening.is_finished() {
        std::thread::yield_now();
    }
    std::iter::from_fn(|| opening.next()).collect()
}

/// Previews, stores and lines, in order of kind; panics if a preview comes late.
fn sorted(news: Vec<Opened>) -> (Vec<OpenedFile>, Vec<OpenedFile>, Vec<String>) {
    let (mut previews, mut stores, mut lines) = (Vec::new(), Vec::new(), Vec::new());
    for item in news {
        match item {
            Opened::Preview(file) => {
                assert!(stores.is_empty() && lines.is_empty(), "a preview after the rest");
                assert_eq!(file.kept_in, KeptIn::Preview);
                previews.push(file);
            }
            Opened::Files(files) => stores.extend(files),
            Opened::Model(model) => panic!("no scan is a model: {}", model.path.display()),
            Opened::Warning(line) | Opened::Failed(line) => lines.push(line),
        }
    }
    (previews, stores, lines)
}

/// Numbers of all points, which stand in their GPS times.
fn numbers(store: &Store) -> Vec<u64> {
    let (time, _) = store.metadata().schema.find("gps_time").expect("format 3 has a GPS time");
    let mut numbers = Vec::new();
    let mut bytes = Vec::new();
    for node in 0..store.octree().nodes().len() {
        store.read_attribute(NodeId(node as u32), time, &mut bytes).expect("the column reads");
        let values = bytes.chunks_exact(8).map(|b| b.try_into().expect("8 bytes"));
        numbers.extend(values.map(|b| f64::from_le_bytes(b) as u64));
    }
    numbers.sort_unstable();
    numbers
}

/// Which pixels show a point.
fn covered(store: &Arc<Store>, view: &esker::geometry::View) -> Vec<bool> {
    let mut renderer = Renderer::on_cpu(1 << 28);
    renderer.set_scene(vec![store.clone()]);
    let picture = renderer.render_picture(view, &FrameSettings::default()).expect("it draws");
    picture.distances.iter().map(|distance| distance.is_finite()).collect()
}

#[test]
fn previews_are_points_of_the_scan_and_cover_what_it_covers() {
    let place = Place::new();
    scan(&place.path("field.las"), 400);
    let (previews, stores, lines) = sorted(news(vec![place.path("field.las")], place.options()));
    assert_eq!(lines, [""; 0]);
    let [store] = stores.as_slice() else { panic!("one store: {stores:?}") };
    assert_eq!(store.kept_in, KeptIn::Made(place.path("field.esker")));
    assert_eq!(store.store.metadata().points, 160_000);
    assert_eq!(check(&place.path("field.esker")).expect("opens").findings, []);
    assert!(previews.len() > 1, "the scan is large enough to be refined");
    assert_eq!(place.left(), ["field.esker", "field.las"]);

    let view = CameraControl::new(&store.store.metadata().bounds(), ViewPreset::Top, 1.0);
    let view = view.view(100, 100);
    let whole = covered(&store.store, &view);
    let count = |pixels: &[bool]| pixels.iter().filter(|covered| **covered).count();
    let extent = store.store.metadata().bounds().size();
    let (mut last, mut seen) = (0, 0);
    for preview in previews {
        let (points, numbers) = (preview.store.metadata().points, numbers(&preview.store));
        assert!(points > last, "each preview has more points: {points}");
        last = points;
        assert_eq!(numbers.len() as u64, points);
        assert!(numbers.is_sorted_by(|a, b| a < b), "no point twice");
        assert!(numbers.last() < Some(&160_000));
        let pixels = covered(&preview.store, &view);
        let beyond = pixels.iter().zip(&whole).filter(|(here, there)| **here && !**there).count();
        assert!(beyond * 50 < count(&whole), "{points}: {beyond} pixels where nothing is");
        assert!(count(&pixels) > seen.max(count(&whole) / 20), "{points}: {}", count(&pixels));
        seen = count(&pixels);
        let size = preview.store.metadata().bounds().size();
        assert!((size / extent).cmpgt(DVec3::splat(0.95)).all(), "{points}: {size} of {extent}");
    }
}

/// A window without a window.
struct Hand {
    ctx: egui::Context,
    viewer: Viewer,
}

impl Hand {
    fn new(color: ColorMode) -> Self {
        let frame = FrameSettings { color, ..first_settings() };
        let options = ViewerOptions { frame, ..ViewerOptions::default() };
        let viewer = Viewer::new(Renderer::on_cpu(1 << 28), Canvas::default(), options);
        Hand { ctx: egui::Context::default(), viewer }
    }

    fn paint(&mut self, events: Vec<Event>) -> Statistics {
        let screen = Rect::from_min_size(Pos2::ZERO, Vec2::new(900.0, 600.0));
        let input =
            RawInput { screen_rect: Some(screen), focused: true, events, ..RawInput::default() };
        let viewer = &mut self.viewer;
        let mut output = self.ctx.run_ui(input, |ui| {
            viewer.logic(&ui.ctx().clone());
            viewer.ui(ui);
        });
        output.textures_delta.clear();
        self.viewer.statistics()
    }
}

#[test]
fn the_store_takes_over_and_the_camera_stays() {
    let place = Place::new();
    scan(&place.path("field.las"), 200);
    let (go, opening) = held(vec![place.path("field.las")], place.options());
    let mut hand = Hand::new(ColorMode::Elevation);
    hand.viewer.follow(opening);
    while hand.paint(Vec::new()).stores != [KeptIn::Preview] {
        go.send(()).expect("the thread goes on");
    }
    let framed = hand.paint(Vec::new());
    assert!(framed.points < 10_000 && framed.frame.points_drawn > 0);
    let key = Event::Key {
        key: Key::W,
        physical_key: None,
        pressed: true,
        repeat: false,
        modifiers: Modifiers::NONE,
    };
    let moved = hand.paint(vec![key.clone()]);
    let Event::Key { key, physical_key, repeat, modifiers, .. } = key else { unreachable!() };
    hand.paint(vec![Event::Key { key, physical_key, pressed: false, repeat, modifiers }]);
    let before = hand.paint(Vec::new());
    assert!(framed.eye != moved.eye, "somebody looks around");
    drop(go);
    let mut drawn = before.frame.points_drawn;
    let after = loop {
        let now = hand.paint(Vec::new());
        assert_eq!((now.eye, now.forward), (before.eye, before.forward));
        assert!(now.frame.points_drawn >= drawn, "no frame is coarser than one before");
        drawn = now.frame.points_drawn;
        if !now.is_opening {
            break now;
        }
    };
    assert_eq!(after.stores, [KeptIn::Made(place.path("field.esker"))]);
    assert_eq!((after.points, after.notices.len()), (40_000, 0), "{:?}", after.notices);
    assert_eq!(after.color, before.color);
    assert_eq!(place.left(), ["field.esker", "field.las"]);
}

#[test]
fn a_request_that_ends_early_leaves_nothing() {
    let place = Place::new();
    scan(&place.path("field.las"), 300);
    // From the first sign of life on, up to some in the conversion.
    for signs in 0..10 {
        let (go, opening) = held(vec![place.path("field.las")], place.options());
        for _ in 0..signs {
            go.send(()).expect("the thread goes on");
        }
        let closing = std::thread::spawn(move || drop(opening));
        // The thread is let on only after it was told to stop.
        std::thread::yield_now();
        drop(go);
        closing.join().expect("it ends");
        let _ = fs::remove_file(place.path("field.esker"));
        assert_eq!(place.left(), ["field.las"], "after {signs} signs");
    }
}

/// Lets the listing of a folder end; until then the request is at its very beginning.
static LISTED: Mutex<Option<Receiver<()>>> = Mutex::new(None);

#[test]
fn a_request_that_ends_while_texts_are_read_tells_nothing_and_leaves_nothing() {
    // Text is read as a whole when it is opened, before there is a preview or a sign of life.
    let place = Place::new();
    let folder = place.path("texts");
    fs::create_dir(&folder).expect("a folder");
    for name in ["a.xyz", "b.xyz"] {
        let rows: String = (0..20_000).map(|i| format!("{} {} 0.5\n", i % 200, i / 200)).collect();
        fs::write(folder.join(name), rows).expect("a text");
    }
    let options = OpeningOptions {
        list_folder: Some(|folder| {
            let held = LISTED.lock().expect("nobody panics with it").take();
            let _ = held.expect("one request at a time").recv();
            let entries = fs::read_dir(folder)?.map(|entry| Ok(entry?.path()));
            entries.collect()
        }),
        ..place.options()
    };
    for is_cancelled in [true, false] {
        let (go, wait) = sync_channel::<()>(0);
        *LISTED.lock().expect("nobody panics with it") = Some(wait);
        let wake = Arc::new(|_| {});
        let opening = Opening::start(vec![folder.clone()], options.clone(), wake);
        let opening = opening.expect("a thread starts");
        if is_cancelled {
            opening.cancel();
        }
        drop(go);
        while !opening.is_finished() {
            std::thread::yield_now();
        }
        let news: Vec<Opened> = std::iter::from_fn(|| opening.next()).collect();
        if is_cancelled {
            assert!(news.is_empty(), "whoever cancelled needs no message: {news:?}");
            assert!(opening.advance().is_none(), "nothing is being converted");
            assert_eq!(place.left(), ["texts"]);
        } else {
            let (_, stores, lines) = sorted(news);
            assert_eq!((stores.len(), lines.len()), (1, 0), "{lines:?}");
            drop((stores, opening));
            assert_eq!(place.left(), ["texts", "texts.esker"]);
        }
    }
}

#[test]
fn a_folder_is_one_preview_and_one_store_beside_it() {
    let place = Place::new();
    let folder = place.path("tiles");
    fs::create_dir(&folder).expect("a folder");
    for i in 0..8 {
        scan(&folder.join(format!("{i}.las")), 100 + i);
    }
    let points: u64 = (0..8u64).map(|i| (100 + i).pow(2)).sum();
    let (previews, stores, lines) = sorted(news(vec![folder.clone()], place.options()));
    assert_eq!(lines, [""; 0]);
    assert!(!previews.is_empty() && previews.iter().all(|preview| preview.path == folder));
    let sources = &previews[0].store.metadata().sources;
    assert!(sources.len() == 8 && sources.iter().all(|source| source.points > 0));
    let [store] = stores.as_slice() else { panic!("one store: {stores:?}") };
    assert_eq!(store.store.metadata().points, points);
    assert_eq!(place.left(), ["tiles", "tiles.esker"]);
    let (previews, stores, lines) = sorted(news(vec![folder.clone()], place.options()));
    assert_eq!((previews.len(), lines.len()), (0, 0));
    let beside = fs::canonicalize(place.path("tiles.esker")).expect("it is there");
    assert_eq!(stores[0].kept_in, KeptIn::Found(beside));
    // One more scan, and the store is not of these any more.
    scan(&folder.join("9.las"), 50);
    let (_, stores, _) = sorted(news(vec![folder], place.options()));
    assert_eq!(stores[0].kept_in, KeptIn::Temporary);
    assert_eq!(stores[0].store.metadata().points, points + 2500);
}

#[test]
fn several_scans_share_a_preview_and_have_stores_of_their_own() {
    let place = Place::new();
    let paths: Vec<_> = (0..3).map(|i| place.path(&format!("{i}.las"))).collect();
    paths.iter().for_each(|path| scan(path, 100));
    let (previews, stores, lines) = sorted(news(paths.clone(), place.options()));
    assert_eq!(lines, [""; 0]);
    assert!(!previews.is_empty());
    assert_eq!(previews[0].store.metadata().sources.len(), 3);
    let kept: Vec<_> = stores.iter().map(|file| (file.path.clone(), &file.kept_in)).collect();
    let made: Vec<_> =
        paths.iter().map(|path| KeptIn::Made(path.with_extension("esker"))).collect();
    assert_eq!(kept, paths.into_iter().zip(&made).collect::<Vec<_>>());
}

#[test]
fn small_scans_and_unwanted_previews_are_left_out() {
    let place = Place::new();
    scan(&place.path("small.las"), 40);
    scan(&place.path("large.las"), 100);
    let unwanted = OpeningOptions { preview_points: Some(0), ..place.options() };
    for (name, options) in [("small.las", place.options()), ("large.las", unwanted)] {
        let (previews, stores, _) = sorted(news(vec![place.path(name)], options));
        assert_eq!((previews.len(), stores.len()), (0, 1), "{name}");
    }
}

#[test]
fn a_damaged_scan_shows_what_it_can_and_why_that_is_all() {
    let Some(whole) = shared_data::file("ign-1km-pf6.laz") else { return };
    let place = Place::new();
    let path = place.path("damaged.laz");
    let mut bytes = fs::read(whole).expect("reads");
    let middle = bytes.len() / 2;
    bytes[middle..middle + 2000].fill(0xff);
    fs::write(&path, bytes).expect("writes");
    let (go, opening) = held(vec![path], place.options());
    drop(go);
    let mut hand = Hand::new(ColorMode::Auto);
    hand.viewer.follow(opening);
    while hand.paint(Vec::new()).is_opening {}
    let end = hand.paint(Vec::new());
    assert_eq!(end.stores, [KeptIn::Preview]);
    assert!(end.points > 0 && end.frame.points_drawn > 0);
    assert!(end.notices.len() == 1 && end.notices[0].contains("damaged.laz"), "{:?}", end.notices);
    assert_eq!(place.left(), ["damaged.laz"]);
}
