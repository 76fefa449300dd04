//! Drives the whole window without a window: events in, counters and camera out.
//!
//! Protects that a still view draws nothing, that mouse, keys and dropped files do what they say,
//! and that bad files and odd window sizes end in a line, never in a crash. The CPU draws, so no
//! adapter is needed; `tools/view-check` does the same with a real window on a virtual display.
#![cfg(feature = "viewer")]

#[path = "support/las_file.rs"]
mod las_file;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use egui::{Event, Key, Modifiers, MouseWheelUnit, PointerButton, Pos2, RawInput, Rect, Vec2};
use esker::build::{ConvertOptions, Silent, convert};
use esker::frame::Renderer;
use esker::geometry::ViewPreset;
use esker::viewer::{Canvas, KeptIn, Statistics, Viewer, ViewerOptions, first_settings};
use glam::DVec3;
use las_file::{LasPoint, write_las};

/// A hand at mouse and keyboard.
struct Hand {
    ctx: egui::Context,
    viewer: Viewer,
    size: Vec2,
    seconds: f64,
}

impl Hand {
    fn new() -> Self {
        let mut frame = first_settings();
        frame.cut.point_budget = 200_000;
        let options = ViewerOptions { frame, ..ViewerOptions::default() };
        Hand {
            ctx: egui::Context::default(),
            viewer: Viewer::new(Renderer::on_cpu(1 << 28), Canvas::default(), options),
            size: Vec2::new(900.0, 600.0),
            seconds: 0.0,
        }
    }

    fn looking_at(path: &Path) -> Self {
        let mut hand = Hand::new();
        hand.viewer.open(&hand.ctx.clone(), vec![path.to_owned()]);
        hand.settle();
        hand
    }

    fn paint(&mut self, input: RawInput) {
        self.seconds += 0.02;
        let input = RawInput {
            screen_rect: Some(Rect::from_min_size(Pos2::ZERO, self.size)),
            time: Some(self.seconds),
            focused: true,
            ..input
        };
        let viewer = &mut self.viewer;
        let mut output = self.ctx.run_ui(input, |ui| {
            viewer.logic(&ui.ctx().clone());
            viewer.ui(ui);
        });
        output.textures_delta.clear();
    }

    fn send(&mut self, event: Event) {
        self.paint(RawInput { events: vec![event], ..RawInput::default() });
    }

    fn press(&mut self, key: Key) {
        for pressed in [true, false] {
            let (physical_key, repeat) = (None, false);
            let modifiers = Modifiers::NONE;
            self.send(Event::Key { key, physical_key, pressed, repeat, modifiers });
        }
    }

    fn button(&mut self, button: PointerButton, pos: Pos2, pressed: bool) {
        let modifiers = Modifiers::NONE;
        self.send(Event::PointerButton { pos, button, pressed, modifiers });
    }

    fn drag(&mut self, button: PointerButton, from: Pos2, to: Pos2) {
        self.send(Event::PointerMoved(from));
        self.button(button, from, true);
        for step in 1..=4 {
            self.send(Event::PointerMoved(from + (to - from) * (step as f32 / 4.0)));
        }
        self.button(button, to, false);
    }

    fn wheel(&mut self, at: Pos2, notches: f32) {
        self.send(Event::PointerMoved(at));
        self.send(Event::MouseWheel {
            unit: MouseWheelUnit::Line,
            delta: Vec2::new(0.0, notches),
            phase: egui::TouchPhase::Move,
            source: egui::MouseWheelSource::Unknown,
            modifiers: Modifiers::NONE,
        });
    }

    fn drop_file(&mut self, path: &Path) {
        let file: egui::DroppedFileHandle = Arc::new(Dropped(path.to_owned()));
        self.paint(RawInput { dropped_files: vec![file], ..RawInput::default() });
    }

    fn statistics(&self) -> Statistics {
        self.viewer.statistics()
    }

    /// Paints until nothing is opened or loaded any more.
    fn settle(&mut self) {
        for _ in 0..6000 {
            self.paint(RawInput::default());
            let now = self.statistics();
            if !now.is_opening && (now.files.is_empty() || now.frame.complete) {
                self.paint(RawInput::default());
                return;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        panic!("it never settles: {:?}", self.statistics());
    }

    /// Frames drawn by what `act` does.
    fn frames_of(&mut self, act: impl FnOnce(&mut Hand)) -> u64 {
        let before = self.statistics().frames_drawn;
        act(self);
        self.statistics().frames_drawn - before
    }

    fn eye(&self) -> DVec3 {
        DVec3::from(self.statistics().eye)
    }
}

#[derive(Debug)]
struct Dropped(PathBuf);

impl egui::DroppedFile for Dropped {
    fn path(&self) -> &Path {
        &self.0
    }

    fn bytes(&self) -> Result<Vec<u8>, String> {
        fs::read(&self.0).map_err(|error| error.to_string())
    }
}

/// A wavy field of points, 100 m by 100 m, at UTM coordinates.
fn scan(path: &Path, side: i32) {
    let points: Vec<_> = (0..side * side)
        .map(|i| {
            let (x, y) = (i % side, i / side);
            let wave = (f64::from(x) * 0.1).sin() * 3000.0;
            LasPoint {
                position: [x * 100_000 / side, y * 100_000 / side, wave as i32],
                color: [(x % 256) as u16 * 256, (y % 256) as u16 * 256, 40_000],
                intensity: (i % 1000) as u16,
            }
        })
        .collect();
    write_las(path, &points);
}

fn store(folder: &Path) -> PathBuf {
    let (input, output) = (folder.join("field.las"), folder.join("field.esker"));
    scan(&input, 250);
    let cancelled = false.into();
    convert(&[input], &output, &ConvertOptions::default(), &Silent, &cancelled).expect("converts");
    output
}

/// The middle of the picture, right of the panel.
const MIDDLE: Pos2 = Pos2::new(600.0, 300.0);

#[test]
fn a_still_view_draws_no_frames() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut hand = Hand::looking_at(&store(folder.path()));
    assert!(hand.statistics().frame.points_drawn > 10_000);
    let skipped = hand.statistics().frames_skipped;
    let drawn = hand.frames_of(|hand| {
        for i in 0..25 {
            // Over the panel and over the picture: the window is painted, the points are not.
            hand.send(Event::PointerMoved(Pos2::new(20.0 * i as f32, 100.0)));
        }
        hand.press(Key::F1);
        hand.press(Key::F2);
    });
    assert_eq!(drawn, 0);
    assert_eq!(hand.statistics().frames_skipped - skipped, 29);
}

#[test]
fn every_button_moves_the_camera_and_draws() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut hand = Hand::looking_at(&store(folder.path()));
    let to = MIDDLE + Vec2::new(60.0, 35.0);
    for button in [PointerButton::Primary, PointerButton::Middle, PointerButton::Secondary] {
        let before = hand.statistics();
        let drawn = hand.frames_of(|hand| hand.drag(button, MIDDLE, to));
        let after = hand.statistics();
        assert!(drawn >= 4, "{button:?}: {drawn} frames");
        let is_look = button == PointerButton::Secondary;
        assert_eq!(before.eye == after.eye, is_look, "{button:?}");
        let is_pan = button == PointerButton::Middle;
        assert_eq!(before.forward == after.forward, is_pan, "{button:?}");
        assert_eq!(hand.frames_of(Hand::settle), 0, "{button:?}");
        hand.press(Key::Home);
    }
    // A drag that begins on the panel is none of the picture's.
    let from = Pos2::new(150.0, 500.0);
    assert_eq!(hand.frames_of(|hand| hand.drag(PointerButton::Primary, from, to)), 0);
}

#[test]
fn the_wheel_goes_to_the_ground_under_the_cursor() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut hand = Hand::looking_at(&store(folder.path()));
    hand.press(Key::Num1);
    let high = hand.eye();
    for _ in 0..12 {
        hand.wheel(MIDDLE, 1.0);
    }
    let low = hand.eye();
    // The field is 500 m up, 3 m high; twelve notches leave less than a tenth of the height.
    assert!(low.z > 497.0 && low.z - 500.0 < 0.1 * (high.z - 500.0) + 3.0, "{low}");
    for _ in 0..12 {
        hand.wheel(MIDDLE, -1.0);
    }
    assert!((hand.eye() - high).length() < 1e-6, "and back: {}", hand.eye() - high);
}

#[test]
fn keys_fly_and_show_views() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut hand = Hand::looking_at(&store(folder.path()));
    for (key, preset) in [Key::Num1, Key::Num2, Key::Num3, Key::Num4].iter().zip(ViewPreset::ALL) {
        hand.press(*key);
        let forward = DVec3::from(hand.statistics().forward);
        assert!((forward - preset.directions().0).length() < 1e-9, "{preset}");
    }
    let (start, forward) = (hand.eye(), DVec3::from(hand.statistics().forward));
    hand.press(Key::W);
    let flown = hand.eye() - start;
    assert!(flown.length() > 0.0 && flown.normalize().dot(forward) > 1.0 - 1e-9);
    assert_eq!(hand.frames_of(Hand::settle), 0, "it ends with the key");
    let width_px = hand.statistics().width_px;
    hand.press(Key::F3);
    (0..20).for_each(|_| hand.paint(RawInput::default()));
    assert!(hand.statistics().width_px > width_px, "without the panel there is more room");
}

#[test]
fn a_dropped_scan_is_converted_beside_itself_once() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, beside) = (folder.path().join("field.las"), folder.path().join("field.esker"));
    scan(&path, 150);
    let mut hand = Hand::new();
    hand.settle();
    assert_eq!(hand.statistics().frames_drawn, 0, "nothing to draw, no frame");
    hand.drop_file(&path);
    hand.settle();
    let shown = hand.statistics();
    assert_eq!((shown.points, shown.notices.len()), (22_500, 0), "{:?}", shown.notices);
    assert_eq!(shown.stores, [KeptIn::Made(beside.clone())]);
    let made = fs::read(&beside).expect("the store is beside the scan");
    let changed = fs::metadata(&beside).and_then(|facts| facts.modified()).expect("has a time");
    hand.drop_file(&path);
    hand.settle();
    assert_eq!(hand.statistics().points, 22_500, "the new scene takes the place of the old one");
    assert_eq!(hand.statistics().stores, [KeptIn::Found(beside.clone())]);
    let again = fs::metadata(&beside).and_then(|facts| facts.modified()).expect("has a time");
    assert_eq!((changed, made), (again, fs::read(&beside).expect("still there")));
}

#[test]
fn a_store_of_another_scan_is_left_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    let store = store(folder.path());
    let other = folder.path().join("elsewhere");
    fs::create_dir(&other).expect("a folder");
    let path = other.join("hill.las");
    scan(&path, 100);
    fs::copy(&store, other.join("hill.esker")).expect("copies");
    let hand = Hand::looking_at(&path);
    assert_eq!(hand.statistics().stores, [KeptIn::Temporary]);
    assert_eq!(hand.statistics().points, 10_000);
    assert_eq!(fs::read(other.join("hill.esker")).ok(), fs::read(&store).ok());
}

#[test]
fn what_cannot_be_opened_is_a_line_and_the_scene_stays() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut hand = Hand::looking_at(&store(folder.path()));
    let bad = folder.path().join("bad.laz");
    fs::write(&bad, b"LASF but nothing else").expect("writes");
    let damaged = folder.path().join("damaged.esker");
    let mut bytes = fs::read(folder.path().join("field.esker")).expect("reads");
    bytes.truncate(bytes.len() / 2);
    fs::write(&damaged, bytes).expect("writes");
    let absent = folder.path().join("absent.las");
    for (count, path) in [bad, damaged, absent].iter().enumerate() {
        hand.drop_file(path);
        hand.settle();
        let now = hand.statistics();
        assert_eq!(now.notices.len(), count + 1, "{:?}", now.notices);
        let name = path.file_name().and_then(|name| name.to_str()).expect("has a name");
        assert!(now.notices[count].contains(name), "{:?}", now.notices);
        assert_eq!(now.points, 62_500, "the field is still there");
    }
    assert!(!folder.path().join("bad.esker").exists());
}

#[test]
fn closing_during_a_conversion_leaves_nothing_behind() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("large.las");
    scan(&path, 700);
    let mut hand = Hand::new();
    hand.drop_file(&path);
    while hand.viewer.conversion().is_none() && hand.statistics().is_opening {
        hand.paint(RawInput::default());
    }
    hand.viewer.finish().expect("nothing to write");
    let left: Vec<_> = fs::read_dir(folder.path()).expect("lists").flatten().collect();
    assert!(left.iter().all(|entry| entry.path() == path), "{left:?}");
}

#[test]
fn windows_of_any_size_are_survived() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut hand = Hand::looking_at(&store(folder.path()));
    for size in [[1.0, 1.0], [0.0, 0.0], [3.0, 900.0], [310.0, 2.0], [4000.0, 5.0], [900.0, 600.0]]
    {
        hand.size = Vec2::from(size);
        hand.wheel(Pos2::new(size[0] * 0.9, size[1] * 0.5), 1.0);
        hand.press(Key::F1);
        hand.press(Key::Num1);
        hand.drag(PointerButton::Primary, Pos2::ZERO, Pos2::new(size[0], size[1]));
        assert_eq!(hand.statistics().notices, Vec::<String>::new(), "{size:?}");
    }
    hand.settle();
    assert!(hand.statistics().frame.points_drawn > 0);
}

#[test]
fn statistics_are_written_on_demand_and_at_the_end() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("statistics.json");
    let mut hand = Hand::new();
    hand.press(Key::F5);
    assert_eq!(hand.statistics().notices.len(), 1, "there is no file to write");
    let options = ViewerOptions {
        frame: first_settings(),
        stats: Some(path.clone()),
        ..ViewerOptions::default()
    };
    hand.viewer = Viewer::new(Renderer::on_cpu(1 << 28), Canvas::default(), options);
    for write in [
        |hand: &mut Hand| hand.press(Key::F5),
        |hand: &mut Hand| {
            hand.viewer.finish().expect("writes");
        },
    ] {
        write(&mut hand);
        let text = fs::read_to_string(&path).expect("it is there");
        let value: serde_json::Value = serde_json::from_str(&text).expect("it is JSON");
        assert_eq!(value["frames_drawn"], 0);
        fs::remove_file(&path).expect("removes");
    }
}

#[test]
fn models_are_opened_dropped_shown_and_closed_beside_points() {
    let folder = tempfile::tempdir().expect("a folder");
    let field = store(folder.path());
    let ahead = {
        let mut hand = Hand::looking_at(&field);
        hand.settle();
        hand.statistics()
    };
    // A pyramid over the field, which lies at (0, 0) to (100, 100) m from this place on.
    let metadata = esker::store::Store::open(&field).expect("opens").metadata().bounds();
    let [x, y, z] = metadata.center().to_array();
    let path = folder.path().join("pyramid.obj");
    let mut text = String::new();
    for (dx, dy, dz) in
        [(-9.0, -9.0, 4.0), (9.0, -9.0, 4.0), (9.0, 9.0, 4.0), (-9.0, 9.0, 4.0), (0.0, 0.0, 30.0)]
    {
        text += &format!("v {} {} {}\n", x + dx, y + dy, z + dz);
    }
    text += "f 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\nf 1 2 77\n";
    fs::write(&path, text).expect("writes");
    let mut hand = Hand::new();
    hand.drop_file(&path);
    hand.settle();
    let now = hand.statistics();
    assert_eq!((now.models.len(), now.files.len(), now.triangles), (1, 0, 4));
    assert_eq!((now.frame.triangles_drawn, now.frame.points_drawn), (4, 0));
    assert_eq!(now.notices.len(), 1, "the triangle that is not there: {:?}", now.notices);
    assert!(hand.viewer.title().starts_with("pyramid.obj"));
    // Both of one request stay together, whichever comes first.
    hand.viewer.open(&hand.ctx.clone(), vec![path.clone(), field.clone()]);
    hand.settle();
    let now = hand.statistics();
    assert_eq!((now.models.len(), now.files.len()), (1, 1));
    assert!(now.frame.triangles_drawn == 4 && now.frame.points_drawn > 1000);
    // Another file takes the place of both.
    hand.drop_file(&field);
    hand.settle();
    let now = hand.statistics();
    assert_eq!((now.models.len(), now.files.len(), now.frame.triangles_drawn), (0, 1, 0));
    assert_eq!(now.eye, ahead.eye, "framed as if there had been no model");
    fs::write(folder.path().join("bad.glb"), b"glTF\x07\0\0\0").expect("writes");
    hand.drop_file(&folder.path().join("bad.glb"));
    hand.settle();
    let now = hand.statistics();
    assert!(now.notices.iter().any(|n| n.contains("glTF version 7")), "{:?}", now.notices);
    assert_eq!(now.files.len(), 1, "what was on view stays");
}

/// A street of blocks, one behind the other, as a model.
fn street(folder: &Path) -> PathBuf {
    let path = folder.join("street.obj");
    let (mut text, mut first) = (String::new(), 1);
    for i in 0..40 {
        let (x, y) = (f64::from(i % 4) * 9.0, f64::from(i / 4) * 7.0);
        text += &format!("o block{i}\n");
        for corner in 0..8 {
            let side = |bit: i32| f64::from(corner >> bit & 1) * 5.0;
            text += &format!("v {} {} {}\n", x + side(0), y + side(1), side(2));
        }
        for [a, b, c, d] in [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3]] {
            text += &format!("f {} {} {} {}\n", first + a, first + b, first + c, first + d);
        }
        first += 8;
    }
    fs::write(&path, text).expect("writes");
    path
}

#[test]
fn what_is_culled_is_shown_on_demand_and_costs_nothing_off() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut hand = Hand::new();
    hand.press(Key::F7);
    assert_eq!(hand.statistics().culling_view, None, "there is nothing to look at");
    let path = street(folder.path());
    hand.drop_file(&path);
    hand.settle();
    assert_eq!(hand.statistics().frame.objects_drawn, 40);
    // Fly in between, so that some blocks are behind.
    (0..6).for_each(|_| hand.wheel(MIDDLE, 2.0));
    hand.settle();
    let before = hand.statistics();
    assert_eq!(before.culling_view, None, "off, nothing is worked out");
    assert!(before.frame.objects_drawn < 40 && before.frame.objects_drawn > 0);
    let drawn = hand.frames_of(|hand| {
        hand.press(Key::F6);
        hand.settle();
    });
    assert_eq!(drawn, 0, "boxes are painted over the picture that is there");
    let boxes = hand.statistics().culling_view.expect("it is on");
    assert!(boxes.lines > 0 && !boxes.is_second_camera, "{boxes:?}");
    assert_eq!(boxes.drawn, before.frame.objects_drawn as usize);
    assert!(boxes.outside > 0 && boxes.hidden == 0, "{boxes:?}");
    hand.press(Key::F7);
    hand.settle();
    let above = hand.statistics();
    let shown = above.culling_view.expect("it is on");
    assert!(shown.is_second_camera && shown.drawn == boxes.drawn, "{shown:?}");
    assert_eq!(above.frame.objects_drawn, before.frame.objects_drawn, "as the first camera chose");
    assert!(above.eye[2] > before.eye[2], "from above");
    // Moving the second camera leaves the choice alone.
    hand.drag(PointerButton::Primary, MIDDLE, MIDDLE + Vec2::new(90.0, 20.0));
    hand.settle();
    let turned = hand.statistics();
    assert_ne!(turned.eye, above.eye);
    assert_eq!(turned.frame.objects_drawn, before.frame.objects_drawn);
    hand.press(Key::F7);
    hand.press(Key::F6);
    hand.settle();
    let after = hand.statistics();
    assert_eq!((after.culling_view, after.eye, after.forward), (None, before.eye, before.forward));
    assert_eq!(after.frame.objects_drawn, before.frame.objects_drawn);
    // A file that comes while the second camera is at work ends that.
    hand.press(Key::F7);
    hand.drop_file(&path);
    hand.settle();
    let now = hand.statistics();
    assert_eq!((now.culling_view, now.frame.objects_drawn), (None, 40));
}

#[test]
fn a_folder_of_models_opens_them_all() {
    let folder = tempfile::tempdir().expect("a folder");
    let inside = folder.path().join("site");
    fs::create_dir(&inside).expect("a folder");
    street(&inside);
    fs::copy(inside.join("street.obj"), inside.join("other.obj")).expect("copies");
    fn list(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
        let entries = fs::read_dir(folder)?;
        let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
        files.sort();
        Ok(files)
    }
    let mut options = ViewerOptions { frame: first_settings(), ..ViewerOptions::default() };
    options.opening.list_folder = Some(list);
    let mut hand = Hand::new();
    hand.viewer = Viewer::new(Renderer::on_cpu(1 << 28), Canvas::default(), options);
    hand.drop_file(&inside);
    hand.settle();
    let now = hand.statistics();
    assert_eq!((now.models.len(), now.objects, now.frame.objects_drawn), (2, 80, 80));
    assert!(now.notices.is_empty(), "{:?}", now.notices);
    assert!(!folder.path().join("site.esker").exists(), "there are no scans to keep");
}
