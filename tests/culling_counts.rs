//! Protects the second promise of occlusion culling: few questions, and no more than what is seen
//! asks for. Counters only; they repeat on any machine.

#[path = "support/culling.rs"]
mod support;

use esker::geometry::{Aabb, Containment, Frustum, View};
use esker::hierarchy::{BoundingHierarchy, Bvh, TightCut};
use esker::ids::{ObjectId, TreeNodeId};
use esker::mesh::scenes::{CameraPath, SceneKind};
use esker::visibility::{
    Algorithm, Answer, ChcOptions, ChcPlusOptions, CullCounters, Culler, CullingCosts, Drawables,
    ItemBuffer, KeepRule, Latency, OcclusionDevice, Proxies, QueryId, SoftwareDevice,
    hidden_frontier, meets_near_plane,
};
use support::{Stage, run, sum};

const CHC: ChcOptions = ChcOptions {
    threshold: 0,
    assume_visible_frames: 1,
    geometry_queries: false,
    order: esker::visibility::Order::Nearest,
    leaf_cost: 0,
    late: esker::visibility::LateAnswers::Rounds(64),
    defer_verification: true,
    seed_first_frame: false,
};

fn plus() -> ChcPlusOptions {
    ChcPlusOptions { late: CHC.late, seed_first_frame: false, ..ChcPlusOptions::default() }
}

/// The leaves that an exact walk sees, and those it draws because of the near plane.
fn visible_leaves(stage: &Stage, view: &View) -> Vec<TreeNodeId> {
    let mut leaves = Vec::new();
    stage.run(Algorithm::StopAndWait, Latency::Commands(0), &[*view], |_, _, drawn, _| {
        leaves = drawn.to_vec();
    });
    leaves
}

/// What the next frame has to ask about, from nothing but this frame's flags.
struct Expected {
    visible_leaves: u64,
    hidden: u64,
}

fn expected_questions(stage: &Stage, view: &View, culler: &Culler) -> Expected {
    let (frustum, proxies) = (Frustum::new(view), Proxies::new(view));
    let mut expected = Expected { visible_leaves: 0, hidden: 0 };
    let mut open: Vec<TreeNodeId> = stage.tree.root().into_iter().collect();
    while let Some(node) = open.pop() {
        let bounds = proxies.of(&stage.tree, node);
        if frustum.test_box(&bounds) == Containment::Outside {
            continue;
        }
        let leaf = stage.tree.is_leaf(node);
        match (meets_near_plane(view, &bounds), culler.history().is_visible(node)) {
            (false, false) => expected.hidden += 1,
            (false, true) if leaf => expected.visible_leaves += 1,
            _ => open.extend(stage.tree.children(node)),
        }
    }
    expected
}

/// A still view in which every block of the plates scene lies behind its plate by a pixel or more.
fn plates(size: u32, frames: usize) -> (Stage, Vec<View>) {
    let stage = Stage::new(SceneKind::Plates, size);
    let view = stage.views(CameraPath::Still, 1)[0];
    (stage, vec![View { width_px: 480, height_px: 360, ..view }; frames])
}

/// Row A3: in a still view the questions are the visible leaves and the largest hidden nodes, and
/// no inner node that was visible is asked about. Row A8: two rounds, one wait.
#[test]
fn a_still_view_asks_about_visible_leaves_and_the_hidden_frontier() {
    for (kind, size) in [(SceneKind::City, 3), (SceneKind::Rooms, 3), (SceneKind::Plates, 12)] {
        let stage = Stage::new(kind, size);
        let view = stage.views(CameraPath::Still, 1)[0];
        let options = ChcOptions { defer_verification: false, ..CHC };
        let mut culler = Culler::new(Algorithm::Chc(options));
        let mut device = SoftwareDevice::new(stage.leaves(), &view, Latency::Rounds);
        let mut still = 0;
        for frame in 0..24 {
            let expected = (frame > 0).then(|| expected_questions(&stage, &view, &culler));
            let counters = culler.frame(&stage.tree, &view, &mut device);
            // An inner box may show where none of its content's boxes does; it then turns visible
            // and hidden in turns.
            if frame < 5 || counters.pulled_down > 0 {
                continue;
            }
            still += 1;
            let expected = expected.expect("it is not the first frame");
            assert_eq!(counters.queries_hidden, expected.hidden, "{}", kind.name());
            assert_eq!(counters.queries_visible_leaf, expected.visible_leaves, "{}", kind.name());
            assert!(counters.rounds <= 1 && counters.blocking_waits <= 1, "{counters:?}");
        }
        assert!(still >= 2, "{}: {still} still frames", kind.name());
        let naive = stage.run(Algorithm::Naive, Latency::Rounds, &[view], |_, _, _, _| {});
        assert_eq!(naive[0].blocking_waits, naive[0].queries_issued);
    }
}

/// Row A4: questions follow what is seen, not what there is.
#[test]
fn questions_do_not_grow_with_what_is_hidden() {
    // Boxes behind a wall, more and more of them.
    let questions = |size: u32, algorithm: Algorithm| {
        let mut stage = Stage::new(SceneKind::Window, size);
        // Close the window.
        let pane = stage.scene.model.objects[1];
        let closed = glam::DAffine3::from_scale(glam::DVec3::new(60.0, 0.1, 30.0));
        stage.scene.model.objects.push(esker::mesh::Object { world_from_mesh: closed, ..pane });
        stage.tree = support::tree_over(&stage.scene.model);
        let views = stage.views(CameraPath::Still, 12);
        let counters = stage.run(algorithm, Latency::Rounds, &views, |_, _, _, _| {});
        counters[11].queries_issued
    };
    let small = questions(500, Algorithm::Chc(CHC));
    let large = questions(16_000, Algorithm::Chc(CHC));
    assert!(large < 3 * small, "{large} against {small}");
    let (small, large) = (questions(250, Algorithm::Naive), questions(4000, Algorithm::Naive));
    assert!(large > 10 * small, "{large} against {small}");
}

/// A tree with single-child levels above every leaf.
struct Chained<'a> {
    tree: &'a Bvh,
    levels: u32,
}

impl Chained<'_> {
    fn split(&self, node: TreeNodeId) -> (TreeNodeId, u32) {
        let per_node = self.levels + 1;
        (TreeNodeId(node.0 / per_node), node.0 % per_node)
    }

    fn join(&self, node: TreeNodeId, level: u32) -> TreeNodeId {
        TreeNodeId(node.0 * (self.levels + 1) + level)
    }
}

impl BoundingHierarchy for Chained<'_> {
    fn root(&self) -> Option<TreeNodeId> {
        self.tree.root()
    }

    fn node_limit(&self) -> usize {
        self.tree.node_limit() * (self.levels as usize + 1)
    }

    fn parent(&self, node: TreeNodeId) -> Option<TreeNodeId> {
        match self.split(node) {
            (node, 0) => self.tree.parent(node).map(|parent| self.join(parent, 0)),
            (node, level) => Some(self.join(node, level - 1)),
        }
    }

    fn children(&self, node: TreeNodeId) -> impl Iterator<Item = TreeNodeId> {
        let (inner, level) = self.split(node);
        let below = self.tree.is_leaf(inner) && level < self.levels;
        let single = below.then(|| self.join(inner, level + 1));
        single.into_iter().chain(self.tree.children(inner).map(|child| self.join(child, 0)))
    }

    fn is_leaf(&self, node: TreeNodeId) -> bool {
        let (inner, level) = self.split(node);
        self.tree.is_leaf(inner) && level == self.levels
    }

    fn bounds(&self, node: TreeNodeId) -> Aabb {
        self.tree.bounds(self.split(node).0)
    }

    fn cost(&self, node: TreeNodeId) -> u64 {
        self.tree.cost(self.split(node).0)
    }
}

struct ChainedLeaves<'a>(esker::visibility::ModelLeaves<'a>, u32);

impl Drawables for ChainedLeaves<'_> {
    fn draw(&self, node: TreeNodeId, target: &mut ItemBuffer) -> u64 {
        self.0.draw(TreeNodeId(node.0 / (self.1 + 1)), target)
    }
}

/// Row A5: levels without a choice cost CHC nothing, and stop-and-wait a question each.
#[test]
fn questions_do_not_depend_on_the_depth_of_the_tree() {
    let stage = Stage::new(SceneKind::City, 2);
    let views = stage.views(CameraPath::Still, 16);
    let questions = |levels, algorithm| {
        let tree = Chained { tree: &stage.tree, levels };
        let leaves = ChainedLeaves(stage.leaves(), levels);
        run(&tree, leaves, algorithm, Latency::Rounds, &views, |_, _, _, _| {})[15].queries_issued
    };
    let chc = [0, 4, 8].map(|levels| questions(levels, Algorithm::Chc(CHC)));
    assert_eq!((chc[0], chc[1]), (chc[1], chc[2]));
    let [none, four, eight] = [0, 4, 8].map(|levels| questions(levels, Algorithm::StopAndWait));
    assert_eq!(eight - four, four - none);
    assert!(four > none);
}

/// Row A6: on a walk CHC asks less than stop-and-wait, which asks less than asking every leaf; from
/// above, where all is seen, CHC asks about each leaf once.
#[test]
fn coherence_and_hierarchy_each_save_questions() {
    let stage = Stage::new(SceneKind::City, 6);
    let views = stage.steady_walk(80, 0.1);
    let asked = |algorithm, views: &[View]| {
        sum(&stage.run(algorithm, Latency::Rounds, views, |_, _, _, _| {})[20..])
    };
    let naive = asked(Algorithm::Naive, &views);
    let wait = asked(Algorithm::StopAndWait, &views);
    let chc = asked(Algorithm::Chc(CHC), &views);
    let plus = asked(Algorithm::ChcPlus(plus()), &views);
    let order = [chc, wait, naive].map(|counters| counters.queries_issued);
    assert!(order.is_sorted(), "{order:?}");
    assert!(plus.queries_issued < chc.queries_issued);
    // Rows A7 and B5, the counters of them.
    let frustum = asked(Algorithm::Frustum, &views);
    assert!(4 * chc.triangles_drawn <= frustum.triangles_drawn);
    assert!(chc.blocking_waits <= 3 * 60, "{chc:?}");
    // Row B5 is about the published period; to draw less in vain costs some questions.
    let published = ChcPlusOptions { in_vain: None, ..self::plus() };
    let published = asked(Algorithm::ChcPlus(published), &views);
    assert!(5 * published.queries_issued <= chc.queries_issued, "{published:?}");
    assert!(4 * plus.queries_issued <= chc.queries_issued, "{plus:?}");
}

/// Row A9: a leaf assumed visible for three frames is asked about in one of them.
#[test]
fn assumed_leaves_are_asked_about_once_a_period() {
    let stage = Stage::new(SceneKind::City, 3);
    let views = stage.views(CameraPath::Still, 40);
    let leaf_questions = |assume_visible_frames| {
        let options = ChcOptions { assume_visible_frames, ..CHC };
        let counters = stage.run(Algorithm::Chc(options), Latency::Rounds, &views, |_, _, _, _| {});
        sum(&counters[10..]).queries_visible_leaf
    };
    let ratio = leaf_questions(3) as f64 / leaf_questions(1) as f64;
    assert!((ratio - 1.0 / 3.0).abs() < 0.034, "{ratio}");
}

/// What a device was told, in order.
struct Recorder<'a> {
    device: SoftwareDevice<esker::visibility::ModelLeaves<'a>>,
    log: Vec<String>,
}

impl OcclusionDevice for Recorder<'_> {
    fn begin_frame(&mut self, view: &View) {
        self.log.push("frame".into());
        self.device.begin_frame(view);
    }
    fn draw(&mut self, node: TreeNodeId) {
        self.log.push(format!("draw {node}"));
        self.device.draw(node);
    }
    fn query(&mut self, boxes: &[Aabb]) -> QueryId {
        self.log.push(format!("ask {boxes:?}"));
        self.device.query(boxes)
    }
    fn draw_and_query(&mut self, node: TreeNodeId) -> QueryId {
        self.device.draw_and_query(node)
    }
    fn answer(&mut self, query: QueryId) -> Answer {
        self.device.answer(query)
    }
    fn wait(&mut self, query: QueryId) {
        self.device.wait(query);
    }
    fn end_frame(&mut self) {
        self.device.end_frame();
    }
    fn state_switches(&self) -> u64 {
        self.device.state_switches()
    }
    fn rounds(&self) -> u64 {
        self.device.rounds()
    }
}

/// Row B2: with every part off CHC++ is CHC, command for command.
#[test]
fn plain_chc_plus_is_chc() {
    let stage = Stage::new(SceneKind::City, 3);
    let views = stage.views(CameraPath::Rotate, 20);
    let log = |algorithm| {
        let device = SoftwareDevice::new(stage.leaves(), &views[0], Latency::Commands(5));
        let mut recorder = Recorder { device, log: Vec::new() };
        let mut culler = Culler::new(algorithm);
        for view in &views {
            culler.frame(&stage.tree, view, &mut recorder);
        }
        recorder.log
    };
    let chc = log(Algorithm::Chc(CHC));
    let plain = ChcPlusOptions { late: CHC.late, seed_first_frame: false, ..ChcPlusOptions::PLAIN };
    let plain = log(Algorithm::ChcPlus(plain));
    assert!(chc.len() > 1000);
    assert_eq!(chc, plain);
}

/// Row B3: batches change state seldom, and the number of changes falls with their size.
#[test]
fn larger_batches_change_state_less() {
    let (stage, views) = plates(40, 12);
    let switches = |algorithm| {
        let counters = stage.run(algorithm, Latency::Commands(3), &views, |_, _, _, _| {});
        assert!(counters[11].hidden_nodes_decided >= 500, "{:?}", counters[11]);
        counters[11].state_switches as f64
    };
    let chc = switches(Algorithm::Chc(CHC));
    let at = |batch_size| {
        switches(Algorithm::ChcPlus(ChcPlusOptions { batch_size, multiqueries: false, ..plus() }))
    };
    let curve = [20, 50, 80].map(at);
    assert!(chc / curve[1] >= 10.0, "{chc} against {}", curve[1]);
    assert!(curve[1] <= 200.0);
    for (pair, sizes) in curve.windows(2).zip([20.0, 50.0, 80.0].windows(2)) {
        let expected = sizes[1] / sizes[0];
        let found = pair[0] / pair[1];
        assert!((found / expected - 1.0).abs() < 0.25, "{curve:?}");
    }
}

/// Row B4: many hidden nodes next to visible ones need few questions once they are known.
#[test]
fn stable_hidden_nodes_are_decided_many_at_a_time() {
    let (stage, views) = plates(40, 120);
    let last = |keep| {
        let options = ChcPlusOptions { keep, ..plus() };
        stage.run(Algorithm::ChcPlus(options), Latency::Batches, &views, |_, _, _, _| {})[119]
    };
    let measured = last(KeepRule::Measured);
    let frontier = measured.hidden_nodes_decided;
    assert!(frontier >= 500, "{measured:?}");
    let asked = |counters: &CullCounters| counters.multiqueries + counters.queries_hidden;
    assert!(asked(&measured) <= frontier / 50 + 1, "{measured:?}");
    let analytic = last(KeepRule::Analytic);
    assert!(asked(&analytic) <= frontier / 10 + 1, "{analytic:?}");
}

/// The extreme scene: more than 50,000 hidden objects between visible ones, so that more than 5,000
/// hidden nodes are left; still they need few questions.
#[test]
fn thousands_of_hidden_nodes_are_decided_by_few_questions() {
    let stage = Stage::new(SceneKind::Field, 76);
    // Plates of about five pixels.
    let view = View { width_px: 640, height_px: 480, ..stage.views(CameraPath::Still, 1)[0] };
    let views = vec![view; 50];
    let options = ChcPlusOptions::default();
    let ran = stage.run(Algorithm::ChcPlus(options), Latency::Batches, &views, |_, _, _, _| {});
    let last = ran[49];
    assert!(last.hidden_nodes_decided >= 5000, "{last:?}");
    // Each plate, and hardly a block: boxes are widened less than the blocks stand behind.
    assert!(last.leaves_drawn >= 76 * 76 && last.leaves_drawn <= 76 * 76 + 10, "{last:?}");
    let asked = last.multiqueries + last.queries_hidden;
    assert!(asked <= last.hidden_nodes_decided / 50 + 1, "{last:?}");
    assert!(last.blocking_waits <= 1, "{last:?}");
}

/// Boxes that show where nothing in them does are drawn, and switch questions off.
#[test]
fn boxes_that_show_in_vain_switch_questions_off() {
    let stage = Stage::new(SceneKind::Slit, 300);
    let views = stage.views(CameraPath::Still, 400);
    let seen = visible_leaves(&stage, &views[0]);
    let shown = {
        let mut picture = ItemBuffer::new(&views[0]);
        stage.leaves().draw(stage.tree.root().expect("a tree"), &mut picture);
        picture.visible_items()
    };
    assert!(seen.len() > 200, "every box shows: {}", seen.len());
    assert!(
        shown.iter().all(|item| [0, esker::visibility::NO_ITEM].contains(item)),
        "only the wall"
    );
    let (ratio, asked) = course_of_auto(&stage, &views, CullingCosts::default());
    assert!(ratio <= 1.1, "{ratio}");
    assert!(!asked[399] && asked.iter().any(|asked| *asked));
}

/// Row B8: leaves that appear together do not stay in step.
#[test]
fn jittered_tests_spread() {
    let stage = Stage::new(SceneKind::Plates, 30);
    let away = {
        let mut view = stage.views(CameraPath::Still, 1)[0];
        view.camera.forward = -view.camera.forward;
        view
    };
    let mut views = vec![away; 2];
    views.extend(stage.views(CameraPath::Still, 80));
    let spread = |jitter| {
        let options = ChcPlusOptions { jitter, in_vain: None, optimized: false, ..plus() };
        let counters =
            stage.run(Algorithm::ChcPlus(options), Latency::Rounds, &views, |_, _, _, _| {});
        let after = &counters[32..72];
        let most = after.iter().map(|counters| counters.queries_visible_leaf).max().unwrap_or(0);
        let mean = sum(after).queries_visible_leaf as f64 / after.len() as f64;
        (most as f64 / mean, mean, counters[70].leaves_drawn)
    };
    let (ratio, mean, leaves) = spread(true);
    assert!(leaves >= 500);
    assert!(ratio <= 2.0, "{ratio}");
    assert!((mean / (leaves as f64 / 10.0) - 1.0).abs() < 0.05, "{mean} of {leaves}");
    let (ratio, _, _) = spread(false);
    assert!(ratio >= 8.0, "{ratio}");
}

/// Row B9: tight boxes never draw more, and draw less where the boxes are loose.
#[test]
fn tight_boxes_draw_less() {
    let mut less = 0;
    for (kind, size) in [(SceneKind::City, 4), (SceneKind::Pipes, 12), (SceneKind::Terrain, 3)] {
        let stage = Stage::new(kind, size);
        let views = stage.steady_walk(30, 0.5);
        let with = |tight| {
            let options = ChcPlusOptions { tight, leaf_cost: 3000, multiqueries: false, ..plus() };
            sum(&stage.run(Algorithm::ChcPlus(options), Latency::Rounds, &views, |_, _, _, _| {}))
        };
        let (loose, tight) = (with(None), with(Some(TightCut::default())));
        assert!(tight.triangles_drawn <= loose.triangles_drawn, "{}", kind.name());
        less += u32::from(tight.triangles_drawn < loose.triangles_drawn);
    }
    assert!(less >= 2, "no scene gained");
}

/// Rows B11 and B12: near the triangles of the optimum, with fewer questions than one for each
/// hidden node.
#[test]
fn triangles_are_near_the_optimum_and_questions_below_one_a_node() {
    let courses =
        [(SceneKind::City, 6, 0.1), (SceneKind::Pipes, 40, 0.1), (SceneKind::Pipes, 40, 0.02)];
    for (kind, size, step) in courses {
        let stage = Stage::new(kind, size);
        let views = stage.steady_walk(70, step);
        let (mut ratios, mut below, mut frames) = (Vec::new(), 0, 0);
        stage.run(Algorithm::ChcPlus(plus()), Latency::Batches, &views, |frame, counters, _, _| {
            if frame < 20 {
                return;
            }
            let visible = visible_leaves(&stage, &views[frame]);
            let optimum: u64 = visible.iter().map(|&leaf| stage.tree.cost(leaf)).sum();
            ratios.push(counters.triangles_drawn as f64 / optimum as f64);
            let frontier =
                hidden_frontier(&stage.tree, &views[frame], &visible, 0, &CullingCosts::default());
            frames += 1;
            below += u32::from(counters.queries_issued < frontier.feasible);
        });
        ratios.sort_by(f64::total_cmp);
        let median = ratios[ratios.len() / 2];
        assert!(median <= 1.15, "{}: {median}", kind.name());
        // Row B12 is about coherent frames.
        if step <= 0.02 || kind == SceneKind::City {
            assert!(f64::from(below) >= 0.9 * f64::from(frames), "{}: {below}", kind.name());
        }
    }
}

/// Row B15: the optimized form waits less, and asks less where nodes come back into the frustum.
#[test]
fn the_optimized_form_waits_less_and_remembers_what_left_the_frustum() {
    let stage = Stage::new(SceneKind::City, 5);
    let mut waits = (0, 0);
    for path in [CameraPath::Walk, CameraPath::Rotate, CameraPath::Rise] {
        let all = stage.views(path, 360);
        let views = all[120..180].to_vec();
        let with = |optimized| {
            // Which leaves are tested when is not left to chance.
            let options = ChcPlusOptions { optimized, jitter: false, in_vain: None, ..plus() };
            sum(&stage.run(Algorithm::ChcPlus(options), Latency::Rounds, &views, |_, _, _, _| {}))
        };
        let (classic, optimized) = (with(false), with(true));
        waits = (waits.0 + optimized.blocking_waits, waits.1 + classic.blocking_waits);
        if path == CameraPath::Rotate {
            let asked = |counters: &CullCounters| counters.queries_hidden + counters.multiqueries;
            assert!(asked(&optimized) < asked(&classic));
        }
    }
    assert!(waits.0 <= waits.1, "{waits:?}");
}

/// Boxes that show where nothing in them does are not asked about again and again.
#[test]
fn split_nodes_come_to_rest() {
    let stage = Stage::new(SceneKind::Rooms, 3);
    let views = stage.views(CameraPath::Still, 60);
    let with = |remember_splits| {
        let options = ChcPlusOptions { remember_splits, ..plus() };
        let counters =
            stage.run(Algorithm::ChcPlus(options), Latency::Rounds, &views, |_, _, _, _| {});
        sum(&counters[40..])
    };
    let (forgetful, remembering) = (with(false), with(true));
    assert!(4 * remembering.pulled_down < forgetful.pulled_down);
    assert!(remembering.blocking_waits <= forgetful.blocking_waits);
}

/// A course of `auto`: its counted cost beside that of the frustum alone, and the frames that asked.
fn course_of_auto(stage: &Stage, views: &[View], costs: CullingCosts) -> (f64, Vec<bool>) {
    let auto = Algorithm::Auto(ChcPlusOptions::default(), costs);
    let ran = stage.run(auto, Latency::Rounds, views, |_, _, _, _| {});
    let all = stage.run(Algorithm::Frustum, Latency::Rounds, views, |_, _, _, _| {});
    let cost = |counters: &[CullCounters]| counters.iter().map(|c| costs.of_frame(c)).sum::<f64>();
    (cost(&ran) / cost(&all), ran.iter().map(|counters| counters.queries_issued > 0).collect())
}

fn plates_alone(size: u32) -> Stage {
    let mut stage = Stage::new(SceneKind::Plates, size);
    let plates = stage.scene.model.objects.chunks(2).map(|pair| pair[0]).collect();
    stage.scene.model.objects = plates;
    stage.tree = support::tree_over(&stage.scene.model);
    stage
}

/// Row A11: where everything is seen questions switch themselves off, at a tenth of the counted
/// cost at most, and stay on where they pay.
#[test]
fn questions_that_do_not_pay_switch_off() {
    let plates = plates_alone(24);
    let dear = CullingCosts { query: 20_000.0, ..CullingCosts::default() };
    for costs in [CullingCosts::default(), dear] {
        let views = plates.views(CameraPath::Still, 600);
        let (ratio, asked) = course_of_auto(&plates, &views, costs);
        assert!(ratio <= 1.1, "{ratio} of the frustum's cost");
        let on = asked[10..210].iter().filter(|asked| **asked).count();
        assert!(on <= 16, "{on} of 200 frames asked");
        assert!(asked.iter().any(|asked| *asked), "never tried");
    }
    let city = Stage::new(SceneKind::City, 4);
    let views = city.views(CameraPath::Still, 60);
    let (ratio, asked) = course_of_auto(&city, &views, CullingCosts::default());
    assert!(asked[1..].iter().all(|asked| *asked) && ratio < 0.5, "{ratio}");
}

/// The same with cameras that move: over the roofs, where little is hidden, and from place to place,
/// where no answer is of use.
#[test]
fn moving_cameras_cost_no_more_than_a_tenth_beyond_the_frustum() {
    let city = Stage::new(SceneKind::City, 3);
    for path in [CameraPath::Fly, CameraPath::Teleport, CameraPath::Rotate, CameraPath::Rise] {
        let views = city.views(path, 240);
        let (ratio, asked) = course_of_auto(&city, &views, CullingCosts::default());
        assert!(ratio <= 1.1, "{}: {ratio}", path.name());
        assert!(!asked[0], "a first frame asks for nobody");
        if path == CameraPath::Teleport {
            let on = asked.iter().filter(|asked| **asked).count();
            assert!(on < 40, "{on} frames asked");
        }
    }
    let (ratio, _) = course_of_auto(
        &city,
        &city.views(CameraPath::Walk, 240),
        CullingCosts { query: 1e9, ..CullingCosts::default() },
    );
    // One frame that asked about a thousand leaves at a second each is all that can be lost.
    let once = 1e9 * city.scene.model.objects.len() as f64 / 240.0;
    let frame = 60.0 * city.scene.model.triangle_count() as f64 / 50.0;
    assert!(ratio <= 1.1 + once / frame, "{ratio}");
}

/// Occlusion that goes and comes back: a wall of plates that is taken away and put up again.
#[test]
fn questions_come_back_with_what_hides() {
    let full = Stage::new(SceneKind::Plates, 24);
    // Each block before its plate instead of behind it.
    let mut open = Stage { scene: full.scene.clone(), tree: full.tree.clone() };
    for pair in open.scene.model.objects.chunks_mut(2) {
        pair[1].world_from_mesh.translation.y -= 0.4;
    }
    let bounds = open.scene.model.object_bounds();
    open.tree.refit(&(0u32..).map(ObjectId).zip(bounds).collect::<Vec<_>>());
    let view = full.views(CameraPath::Still, 1)[0];
    let costs = CullingCosts { query: 300.0, ..CullingCosts::default() };
    let mut culler = Culler::new(Algorithm::Auto(ChcPlusOptions::default(), costs));
    let mut device = SoftwareDevice::new(full.leaves(), &view, Latency::Rounds);
    let mut asking = |stage, frames: u32| -> Vec<bool> {
        let stage: &Stage = stage;
        *device.drawables_mut() = stage.leaves();
        let mut frame = || culler.frame(&stage.tree, &view, &mut device).queries_issued > 0;
        (0..frames).map(|_| frame()).collect()
    };
    let count = |asked: &[bool]| asked.iter().filter(|asked| **asked).count();
    let on = asking(&full, 60);
    assert!(count(&on) >= 55, "{} of 60", count(&on));
    let off = asking(&open, 400);
    assert!(count(&off) <= 90 && !off[399], "{} of 400", count(&off));
    let back = asking(&full, 1200);
    assert!(back[1000..].iter().all(|asked| *asked), "{} of 1200", count(&back));
}

/// A leaf that hangs under two nodes.
struct Shared(Aabb);

impl BoundingHierarchy for Shared {
    fn root(&self) -> Option<TreeNodeId> {
        Some(TreeNodeId(0))
    }

    fn node_limit(&self) -> usize {
        4
    }

    fn parent(&self, node: TreeNodeId) -> Option<TreeNodeId> {
        [None, Some(0), Some(0), Some(1)][node.index()].map(TreeNodeId)
    }

    fn children(&self, node: TreeNodeId) -> impl Iterator<Item = TreeNodeId> {
        [&[1u32, 2][..], &[3], &[3], &[]][node.index()].iter().map(|&child| TreeNodeId(child))
    }

    fn is_leaf(&self, node: TreeNodeId) -> bool {
        node.0 == 3
    }

    fn bounds(&self, _: TreeNodeId) -> Aabb {
        self.0
    }

    fn cost(&self, _: TreeNodeId) -> u64 {
        1
    }
}

struct Nothing;

impl Drawables for Nothing {
    fn draw(&self, _: TreeNodeId, _: &mut ItemBuffer) -> u64 {
        0
    }
}

/// What hangs under several nodes is drawn once a frame.
#[test]
fn shared_leaves_are_drawn_once() {
    let stage = Stage::new(SceneKind::Boxes, 1);
    let views = stage.views(CameraPath::Still, 2);
    let ahead = views[0].camera.eye + 5.0 * views[0].camera.forward;
    let tree = Shared(Aabb::new(ahead - 0.5, ahead + 0.5));
    for algorithm in [Algorithm::None, Algorithm::Frustum, Algorithm::Naive] {
        let counters = run(&tree, Nothing, algorithm, Latency::Rounds, &views, |_, _, drawn, _| {
            assert_eq!(drawn, [TreeNodeId(3)], "{algorithm:?}");
        });
        assert!(counters.iter().all(|counters| counters.leaves_drawn == 1));
    }
}

/// A tree that is built anew gives its ids to other nodes: nothing that was learned, and no answer
/// that is still on its way, is taken for one of theirs.
#[test]
fn a_rebuilt_tree_is_a_new_one() {
    let stage = Stage::new(SceneKind::City, 3);
    let model = &stage.scene.model;
    let views = stage.steady_walk(12, 0.1);
    // As many nodes, with other ids: the objects come in another order.
    let mirrored: Vec<Aabb> = model.object_bounds().into_iter().rev().collect();
    let costs: Vec<u64> = model
        .objects
        .iter()
        .rev()
        .map(|object| model.mesh(object).triangles.len() as u64)
        .collect();
    let other = esker::mesh::Model {
        objects: model.objects.iter().rev().copied().collect(),
        ..model.clone()
    };
    let tree = Bvh::build(&mirrored, &costs, 1);
    assert_eq!(tree.node_limit(), stage.tree.node_limit());
    let leaves = esker::visibility::ModelLeaves { model: &other, tree: &tree };
    // Without tests at random frames, which depend on the number of the frame.
    let plus = ChcPlusOptions { jitter: false, in_vain: None, ..plus() };
    let chc = ChcOptions { assume_visible_frames: 3, ..CHC };
    for algorithm in [Algorithm::Chc(chc), Algorithm::ChcPlus(plus)] {
        let walk = |culler: &mut Culler, device: &mut dyn OcclusionDevice| -> Vec<CullCounters> {
            views[6..].iter().map(|view| culler.frame(&tree, view, device)).collect()
        };
        let mut device = SoftwareDevice::new(leaves, &views[0], Latency::Batches);
        let expected = walk(&mut Culler::new(algorithm), &mut device);
        let mut culler = Culler::new(algorithm);
        let mut before = SoftwareDevice::new(stage.leaves(), &views[0], Latency::Batches);
        for view in &views[..6] {
            culler.frame(&stage.tree, view, &mut before);
        }
        let mut device = SoftwareDevice::new(leaves, &views[0], Latency::Batches);
        assert_eq!(walk(&mut culler, &mut device), expected, "{}", algorithm.name());
    }
}
