//! Protects what is told and shown of culling: every leaf is in exactly one box, boxes say what
//! happened, frozen culling draws the same from anywhere, and a frame that nobody looks into does
//! nothing for it.

#[path = "support/culling.rs"]
mod support;

use std::collections::HashSet;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use esker::frame::{
    FrameSettings, Renderer, box_lines, camera_above, count_states, frustum_lines, frustum_reach,
    state_color,
};
use esker::geometry::{Containment, Frustum, View};
use esker::hierarchy::{Joined, Side};
use esker::ids::{ObjectId, TreeNodeId};
use esker::mesh::scenes::{CameraPath, SceneKind};
use esker::passes::{Picture, draw_line};
use esker::visibility::{
    Algorithm, Culler, Drawables, ItemBuffer, LateAnswers, Latency, ModelLeaves, NO_ITEM,
    NodeState, NodeStatus, Proxies, SoftwareDevice, meets_near_plane,
};
use support::Stage;

/// The objects in the boxes of some states.
fn objects(stage: &Stage, states: &[NodeStatus], of: &[NodeState]) -> Vec<ObjectId> {
    let chosen = states.iter().filter(|status| of.contains(&status.state));
    chosen.flat_map(|status| stage.tree.objects_of(status.node)).copied().collect()
}

#[test]
fn every_object_is_in_one_box_and_boxes_say_what_happened() {
    let [auto, none, frustum, naive, stop_and_wait, chc, plus, _] = Algorithm::usual();
    let Algorithm::ChcPlus(options) = plus else { panic!("{plus:?}") };
    let late = LateAnswers::Rounds(0);
    let seed_first_frame = false;
    let hasty = esker::visibility::ChcPlusOptions { late, seed_first_frame, ..options };
    let coarse = esker::visibility::ChcPlusOptions { leaf_cost: 500, ..options };
    let methods = [auto, none, frustum, naive, stop_and_wait, chc, plus];
    let methods = methods.into_iter().chain([hasty, coarse].map(Algorithm::ChcPlus));
    for (kind, size) in [(SceneKind::City, 3), (SceneKind::Rooms, 3), (SceneKind::Boxes, 60)] {
        let stage = Stage::new(kind, size);
        let views = stage.views(CameraPath::Walk, 16);
        for algorithm in methods.clone() {
            let mut device = SoftwareDevice::new(stage.leaves(), &views[0], Latency::Rounds);
            let mut culler = Culler::new(algorithm);
            assert!(culler.states(&stage.tree).is_empty(), "no frame, no boxes");
            let (mut forced, mut exhausted) = (0, 0);
            for view in &views {
                let counters = culler.frame(&stage.tree, view, &mut device);
                let states = culler.states(&stage.tree);
                let what = format!("{} {algorithm:?}", kind.name());
                let all = objects(&stage, &states, &NodeState::ALL);
                let distinct: HashSet<_> = all.iter().collect();
                let count = stage.scene.model.objects.len();
                assert_eq!((all.len(), distinct.len()), (count, count), "{what}");
                let drawn = objects(&stage, &states, &[NodeState::Drawn, NodeState::Forced]);
                let told: HashSet<_> = drawn.into_iter().collect();
                let leaves = culler.drawn().iter();
                let really: HashSet<_> =
                    leaves.flat_map(|&leaf| stage.tree.objects_of(leaf)).copied().collect();
                assert_eq!(told, really, "{what}");
                let seen: HashSet<u32> = device.picture().visible_items().into_iter().collect();
                assert!(!seen.contains(&NO_ITEM));
                for hidden in objects(&stage, &states, &[NodeState::Hidden, NodeState::Outside]) {
                    assert!(!seen.contains(&hidden.0), "{what}: {hidden} is seen");
                }
                let outside = states.iter().filter(|s| s.state == NodeState::Outside);
                for status in outside {
                    let test = Frustum::new(view).test_box(&status.bounds);
                    assert_eq!(test, Containment::Outside, "{what}");
                }
                let [_, unasked, hidden, _] = count_states(&states);
                let proxies = Proxies::new(view);
                let is_near = |s: &&NodeStatus| {
                    s.state == NodeState::Forced
                        && meets_near_plane(view, &proxies.of(&stage.tree, s.node))
                };
                // The others found no round left.
                forced += unasked - states.iter().filter(is_near).count();
                let culls_nothing = matches!(algorithm, Algorithm::None | Algorithm::Frustum);
                assert!(!culls_nothing || hidden + unasked == 0, "{what}");
                exhausted += counters.forced_subtrees;
            }
            assert!(exhausted > 0 || forced == 0, "{}: {algorithm:?}", kind.name());
            assert!(forced > 0 || algorithm != Algorithm::ChcPlus(hasty), "rounds were enough");
        }
    }
}

/// Two scenes under one root, as models and points are.
struct Both<'a>(&'a Joined<esker::hierarchy::Bvh, esker::hierarchy::Bvh>, [&'a Stage; 2]);

impl Drawables for Both<'_> {
    fn draw(&self, node: TreeNodeId, target: &mut ItemBuffer) -> u64 {
        let draw = |stage: &Stage, tree, node| {
            ModelLeaves { model: &stage.scene.model, tree }.draw(node, target)
        };
        let mut draw = draw;
        match self.0.side(node) {
            Side::Root => 0,
            Side::First(node) => draw(self.1[0], &self.0.first, node),
            Side::Second(node) => draw(self.1[1], &self.0.second, node),
        }
    }
}

#[test]
fn two_trees_under_one_root_are_told_together() {
    let (city, boxes) = (Stage::new(SceneKind::City, 3), Stage::new(SceneKind::Boxes, 40));
    let tree = Joined { first: city.tree.clone(), second: boxes.tree.clone() };
    let views = city.views(CameraPath::Walk, 8);
    let device = &mut SoftwareDevice::new(Both(&tree, [&city, &boxes]), &views[0], Latency::Rounds);
    let mut culler = Culler::new(Algorithm::usual()[6]);
    for view in &views {
        culler.frame(&tree, view, device);
    }
    let mut counts = [0, 0];
    for status in culler.states(&tree) {
        match tree.side(status.node) {
            Side::Root => panic!("the root was opened"),
            Side::First(node) => counts[0] += city.tree.objects_of(node).len(),
            Side::Second(node) => counts[1] += boxes.tree.objects_of(node).len(),
        }
    }
    assert_eq!(counts, [city.scene.model.objects.len(), 40]);
}

fn renderer(stage: &Stage) -> Renderer {
    let mut renderer = Renderer::on_cpu(1 << 20);
    renderer.set_model(Arc::new(stage.scene.model.clone()));
    renderer
}

#[test]
fn frozen_culling_draws_the_same_from_above() {
    let stage = Stage::new(SceneKind::City, 3);
    let view = stage.views(CameraPath::Still, 1)[0];
    let mut renderer = renderer(&stage);
    let settings = FrameSettings::default();
    let first = renderer.render_picture(&view, &settings).expect("draws");
    let drawn = renderer.stats().objects_drawn;
    let states = renderer.culling_states();
    assert!(drawn > 10 && (drawn as usize) < stage.scene.model.objects.len());
    let above = View { camera: camera_above(&view.camera, &renderer.bounds()).0, ..view };
    let everything = renderer.render_picture(&above, &settings).expect("draws");
    assert_ne!(renderer.stats().objects_drawn, drawn, "the view from above sees others");
    renderer.render_picture(&view, &settings).expect("draws");
    renderer.freeze_culling(&view);
    let frozen = renderer.render_picture(&above, &settings).expect("draws");
    assert_eq!(renderer.stats().objects_drawn, drawn);
    assert_eq!(renderer.culling_states(), states);
    assert_eq!(renderer.frozen_view(), Some(&view));
    assert_ne!(frozen, everything, "what the first camera does not draw is missing");
    renderer.thaw_culling();
    assert_eq!(renderer.render_picture(&above, &settings).expect("draws"), everything);
    assert_eq!(renderer.render_picture(&view, &settings).expect("draws"), first);
    // Another scene is seen by its own culling.
    renderer.freeze_culling(&view);
    renderer.set_model(Arc::new(Stage::new(SceneKind::Boxes, 9).scene.model));
    assert_eq!(renderer.frozen_view(), None);
    assert!(renderer.culling_states().is_empty(), "nothing was drawn of it yet");
}

#[test]
fn boxes_are_lines_over_the_picture_and_nothing_else() {
    let stage = Stage::new(SceneKind::City, 3);
    let view = stage.views(CameraPath::Still, 1)[0];
    let mut renderer = renderer(&stage);
    let settings = FrameSettings::default();
    let plain = renderer.render_picture(&view, &settings).expect("draws");
    let states = renderer.culling_states();
    let again = renderer.render_picture(&view, &settings).expect("draws");
    assert_eq!(plain, again, "to look into a frame changes none");
    let (lines, left_out) = box_lines(&view, &states, 25);
    let frustum = Frustum::new(&view);
    let in_view = |s: &&NodeStatus| frustum.test_box(&s.bounds) != Containment::Outside;
    let in_view = states.iter().filter(in_view).count();
    assert_eq!(left_out, in_view - 25);
    let mut marked = again.clone();
    lines.iter().for_each(|line| draw_line(&mut marked, line));
    let [r, g, b] = state_color(NodeState::Drawn);
    let green = u32::from_le_bytes([r, g, b, 255]);
    let changed: Vec<u32> = differing(&plain, &marked);
    assert!(changed.len() > 200 && changed.iter().all(|&color| color == green));
    assert_eq!(box_lines(&view, &[], 25), (Vec::new(), 0));
    // From its own eye a frustum is the edge of the picture, and no line through it.
    let reach = frustum_reach(&renderer.bounds());
    for line in frustum_lines(&view, &view, reach) {
        let is_rim = |[x, y]: [f32; 2]| {
            let on = |v: f32, size: u32| v.abs() < 0.01 || (v - size as f32).abs() < 0.01;
            on(x, view.width_px) || on(y, view.height_px)
        };
        assert!(line.ends.into_iter().all(is_rim), "{line:?}");
    }
}

fn differing(plain: &Picture, marked: &Picture) -> Vec<u32> {
    let pairs = plain.colors.iter().zip(&marked.colors);
    pairs.filter(|(a, b)| a != b).map(|(_, b)| *b).collect()
}

fn esker(folder: &Path, arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_esker"))
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("the program starts");
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{message}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn the_command_line_shows_boxes_pixel_by_pixel() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path();
    // Two triangles beside each other, and one behind the camera.
    let text = "o a\nv 0 5 0\nv 1 5 0\nv 0 5 1\nf 1 2 3\no b\nv -2 5 0\nv -1 5 0\nv -2 5 1\nf 4 5 6\n\
        o c\nv 0 -9 0\nv 1 -9 0\nv 0 -9 1\nf 7 8 9\n";
    std::fs::write(path.join("m.obj"), text).expect("writes");
    std::fs::write(path.join("c.json"), r#"{"eye": [0, 0, 0.3], "target": [0, 1, 0.3]}"#)
        .expect("writes");
    let render = |output: &str, more: &[&str]| {
        let usual =
            ["render", "m.obj", "--view", "c.json", "--size", "200x120", "--renderer", "cpu", "-o"];
        let text = esker(path, &[&usual[..], &[output], more].concat());
        (image::open(path.join(output)).expect("a picture").into_rgba8(), text)
    };
    let (plain, text) = render("plain.png", &[]);
    assert!(!text.contains("boxes"));
    let (boxes, text) = render("boxes.png", &["--show-culling"]);
    assert!(text.contains("2 drawn, 0 forced, 0 hidden, 1 outside"), "{text}");
    let [r, g, b] = state_color(NodeState::Drawn);
    let mut green = 0;
    for (before, after) in plain.pixels().zip(boxes.pixels()) {
        let is_green = after.0 == [r, g, b, 255];
        assert!(before == after || is_green);
        green += u32::from(is_green);
    }
    // Two flat boxes of 1 m at 5 m: four sides of 20.8 pixels each, which meet in corners.
    assert!((150..=190).contains(&green), "{green} pixels");
    let (above, _) = render("above.png", &["--show-culling", "above"]);
    let white = above.pixels().filter(|pixel| pixel.0 == [255; 4]).count();
    assert!(white > 50, "the frustum is drawn: {white} pixels");
}
