//! Protects the first promise of occlusion culling: the picture is that of drawing everything.
//!
//! Every algorithm runs over every made scene and camera path on the exact software device, with
//! answers that come at once, late, and by submissions, and each frame's picture (item and depth of
//! every pixel) is compared with the picture of everything.

#[path = "support/culling.rs"]
mod support;

use esker::geometry::View;
use esker::hierarchy::{BoundingHierarchy, Bvh, TightCut};
use esker::ids::{ObjectId, TreeNodeId};
use esker::mesh::Model;
use esker::mesh::scenes::{CameraPath, SceneKind};
use esker::sampling::Random;
use esker::visibility::{
    Algorithm, ChcOptions, ChcPlusOptions, CullCounters, Culler, CullingCosts, Drawables,
    ItemBuffer, KeepRule, LateAnswers, Latency, ModelLeaves, Order, SoftwareDevice,
};
use glam::DVec3;
use support::{Stage, sum};

/// Runs an algorithm and demands the picture of everything in every frame.
fn run_exact(
    stage: &Stage,
    algorithm: Algorithm,
    latency: Latency,
    views: &[View],
) -> Vec<CullCounters> {
    let mut truth = Truth::default();
    stage.run(algorithm, latency, views, |frame, _, _, picture| {
        let wrong = truth.wrong_pixels(stage, &views[frame], picture);
        let objects = stage.scene.model.objects.len();
        assert_eq!(wrong, 0, "{objects} objects: frame {frame}: {algorithm:?}, {latency:?}");
    })
}

/// Pictures of everything, kept while the view stays.
#[derive(Default)]
struct Truth {
    last: Option<(View, ItemBuffer)>,
}

impl Truth {
    fn picture(&mut self, stage: &Stage, view: &View) -> &ItemBuffer {
        if self.last.as_ref().is_none_or(|(last, _)| last != view) {
            let mut picture = ItemBuffer::new(view);
            let root = stage.tree.root().into_iter().chain(stage.tree.always_drawn());
            for node in root {
                stage.leaves().draw(node, &mut picture);
            }
            self.last = Some((*view, picture));
        }
        &self.last.as_ref().expect("it was just drawn").1
    }

    fn wrong_pixels(&mut self, stage: &Stage, view: &View, picture: &ItemBuffer) -> u64 {
        self.picture(stage, view).differing_pixels(picture)
    }
}

/// Leaves that own what they draw, so that it may change between frames.
struct OwnedLeaves {
    model: Model,
    tree: Bvh,
}

impl OwnedLeaves {
    fn of(stage: &Stage) -> Self {
        OwnedLeaves { model: stage.scene.model.clone(), tree: stage.tree.clone() }
    }
}

impl Drawables for OwnedLeaves {
    fn draw(&self, node: TreeNodeId, target: &mut ItemBuffer) -> u64 {
        ModelLeaves { model: &self.model, tree: &self.tree }.draw(node, target)
    }
}

const SCENES: [(SceneKind, u32); 10] = [
    (SceneKind::City, 2),
    (SceneKind::Rooms, 3),
    (SceneKind::Terrain, 2),
    (SceneKind::Pipes, 2),
    (SceneKind::Boxes, 150),
    (SceneKind::Shells, 5),
    (SceneKind::Window, 80),
    (SceneKind::Plates, 8),
    (SceneKind::Field, 5),
    (SceneKind::Slit, 30),
];

const LATENCIES: [Latency; 4] =
    [Latency::Commands(0), Latency::Commands(9), Latency::Rounds, Latency::Batches];

fn algorithms() -> Vec<Algorithm> {
    let chc = ChcOptions::default();
    let plus = ChcPlusOptions::default();
    let costs = CullingCosts::default();
    vec![
        Algorithm::Frustum,
        Algorithm::Naive,
        Algorithm::StopAndWait,
        Algorithm::Chc(chc),
        Algorithm::Chc(ChcOptions { seed_first_frame: false, ..chc }),
        Algorithm::Chc(ChcOptions { geometry_queries: true, defer_verification: false, ..chc }),
        Algorithm::Chc(ChcOptions { assume_visible_frames: 3, order: Order::DepthFirst, ..chc }),
        Algorithm::Chc(ChcOptions { late: LateAnswers::Rounds(0), leaf_cost: 400, ..chc }),
        Algorithm::ChcPlus(ChcPlusOptions { optimized: false, ..plus }),
        Algorithm::ChcPlus(ChcPlusOptions { batch_size: 3, seed_first_frame: false, ..plus }),
        Algorithm::ChcPlus(ChcPlusOptions { leaf_cost: 500, late: LateAnswers::Rounds(1), ..plus }),
        Algorithm::NearOptimal(chc, costs),
        Algorithm::Auto(plus, costs),
    ]
}

#[test]
fn every_algorithm_shows_what_is_there_on_every_scene_and_path() {
    for (kind, size) in SCENES {
        let stage = Stage::new(kind, size);
        for path in CameraPath::ALL {
            let views = stage.views(path, 6);
            for (at, algorithm) in algorithms().into_iter().enumerate() {
                // Each pair is tried with one latency; all meet over the scenes and paths.
                let latency = LATENCIES[(at + path as usize + kind as usize) % 4];
                run_exact(&stage, algorithm, latency, &views);
            }
        }
    }
}

/// All 32 combinations of the parts of CHC++.
#[test]
fn every_combination_of_parts_is_exact() {
    for (kind, size) in [(SceneKind::City, 2), (SceneKind::Pipes, 2), (SceneKind::Window, 60)] {
        let stage = Stage::new(kind, size);
        for path in [CameraPath::Walk, CameraPath::Teleport] {
            let views = stage.views(path, 5);
            for parts in 0..32u32 {
                let on = |part: u32| parts >> part & 1 == 1;
                let options = ChcPlusOptions {
                    batching: on(0),
                    jitter: on(1),
                    assumed_visible_frames: if on(1) { 3 } else { 1 },
                    tight: on(2).then(TightCut::default),
                    multiqueries: on(3),
                    optimized: on(4),
                    batch_size: 8,
                    ..ChcPlusOptions::default()
                };
                let latency = LATENCIES[(parts as usize / 2 + parts as usize) % 4];
                run_exact(&stage, Algorithm::ChcPlus(options), latency, &views);
            }
        }
    }
}

/// Answers that are left to the next frame lose what comes into sight: the counter-example.
#[test]
fn answers_a_frame_late_lose_pixels_on_a_turn() {
    let stage = Stage::new(SceneKind::City, 3);
    let views = stage.views(CameraPath::Rotate, 24);
    let late = LateAnswers::NextFrame;
    let chc = ChcOptions { late, seed_first_frame: false, ..ChcOptions::default() };
    let plus = ChcPlusOptions { late, seed_first_frame: false, ..ChcPlusOptions::default() };
    for algorithm in [Algorithm::Chc(chc), Algorithm::ChcPlus(plus)] {
        let mut truth = Truth::default();
        let (mut wrong_late, mut waits) = (0, 0);
        stage.run(algorithm, Latency::Rounds, &views, |frame, counters, _, picture| {
            if frame > 8 {
                wrong_late += truth.wrong_pixels(&stage, &views[frame], picture);
            }
            waits += counters.blocking_waits;
        });
        assert!(wrong_late > 0, "nothing was lost");
        assert_eq!(waits, 0);
    }
}

/// Fewer rounds draw more and lose nothing.
#[test]
fn fewer_rounds_draw_more_and_lose_nothing() {
    let stage = Stage::new(SceneKind::City, 3);
    let views = stage.views(CameraPath::Rotate, 16);
    let triangles = |rounds| {
        let late = LateAnswers::Rounds(rounds);
        let options = ChcOptions { late, seed_first_frame: false, ..ChcOptions::default() };
        sum(&run_exact(&stage, Algorithm::Chc(options), Latency::Rounds, &views)).triangles_drawn
    };
    let drawn: Vec<u64> = (0..=6).map(triangles).collect();
    for pair in drawn.windows(2) {
        assert!(pair[1] as f64 <= 1.02 * pair[0] as f64, "{drawn:?}");
    }
    assert!(drawn[6] < drawn[0], "{drawn:?}");
}

/// Eyes inside boxes and near planes through them, at any place and angle (row A12). In turns of
/// 400 poses, so that hints from one pose to the next are old as well as new.
#[test]
fn eyes_inside_and_beside_boxes_lose_nothing() {
    for first in (0..10_000).step_by(400) {
        try_poses(first..first + 400);
    }
}

fn try_poses(poses: std::ops::Range<u64>) {
    let stage = Stage::new(SceneKind::Boxes, 60);
    let bounds = stage.scene.model.bounds();
    let mut views = Vec::new();
    for pose in poses {
        let mut random = Random::new(4, pose);
        let unit = DVec3::new(random.unit(), random.unit(), random.unit());
        let mut view = stage.views(CameraPath::Still, 1)[0];
        view.camera.eye = bounds.min + unit * bounds.size();
        let angle = random.between(0.0, 6.3);
        let forward = DVec3::new(angle.cos(), angle.sin(), random.between(-1.0, 1.0)).normalize();
        let near = 10f64.powf(random.between(-3.0, 0.5));
        view.camera = esker::geometry::Camera::looking_at(
            view.camera.eye,
            view.camera.eye + forward,
            DVec3::Z,
            random.between(0.3, 2.6),
            near,
        );
        views.push(view);
    }
    for algorithm in [
        Algorithm::StopAndWait,
        Algorithm::Chc(ChcOptions { seed_first_frame: false, ..ChcOptions::default() }),
        Algorithm::ChcPlus(ChcPlusOptions { seed_first_frame: false, ..Default::default() }),
    ] {
        run_exact(&stage, algorithm, Latency::Rounds, &views);
    }
}

/// Eyes on the faces, edges and corners of boxes, exactly, and near planes that lie in a face.
#[test]
fn eyes_on_faces_of_boxes_lose_nothing() {
    let stage = Stage::new(SceneKind::Boxes, 40);
    let mut views = Vec::new();
    for (at, bounds) in stage.scene.model.object_bounds().iter().enumerate() {
        let (center, size) = (bounds.center(), bounds.size());
        for face in [DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::ONE] {
            let eye = center + 0.5 * size * face * if at % 2 == 0 { 1.0 } else { -1.0 };
            // Into the box, away from it, and along the face.
            let forward = [center - eye, eye - center, DVec3::new(0.0, 1.0, 0.2)][at % 3];
            let near = [0.01, size.x, 0.5 * size.x][at % 3];
            let mut view = stage.views(CameraPath::Still, 1)[0];
            let target = eye + forward;
            view.camera = esker::geometry::Camera::looking_at(eye, target, DVec3::Z, 1.2, near);
            views.push(view);
        }
    }
    for algorithm in [
        Algorithm::StopAndWait,
        Algorithm::Chc(ChcOptions { seed_first_frame: false, ..ChcOptions::default() }),
        Algorithm::ChcPlus(ChcPlusOptions { seed_first_frame: false, ..Default::default() }),
    ] {
        run_exact(&stage, algorithm, Latency::Rounds, &views);
    }
}

/// Odd sizes of the parts, and odd scenes.
#[test]
fn odd_settings_and_scenes_are_exact() {
    let plus = ChcPlusOptions { seed_first_frame: false, ..ChcPlusOptions::default() };
    let tight = TightCut::default();
    let odd = [
        ChcPlusOptions { batch_size: 1, ..plus },
        ChcPlusOptions { batch_size: u32::MAX, ..plus },
        ChcPlusOptions { batch_size: 0, assumed_visible_frames: 0, ..plus },
        ChcPlusOptions { assumed_visible_frames: 1, ..plus },
        ChcPlusOptions { tight: Some(TightCut { depth: 0, ..tight }), ..plus },
        ChcPlusOptions { tight: Some(TightCut { growth: 1.0, ..tight }), ..plus },
        ChcPlusOptions { tight: Some(TightCut { growth: f64::INFINITY, ..tight }), ..plus },
        ChcPlusOptions { keep: KeepRule::Analytic, leaf_cost: u64::MAX, ..plus },
    ];
    for (kind, size) in [(SceneKind::City, 1), (SceneKind::Boxes, 1), (SceneKind::Shells, 1)] {
        let stage = Stage::new(kind, size);
        for options in odd {
            for path in [CameraPath::Teleport, CameraPath::Walk] {
                let views = stage.views(path, 8);
                run_exact(&stage, Algorithm::ChcPlus(options), Latency::Rounds, &views);
            }
        }
    }
    // The camera looks away from everything, and then at it.
    let stage = Stage::new(SceneKind::Plates, 6);
    let mut views = stage.views(CameraPath::Still, 6);
    for view in &mut views[1..4] {
        view.camera.forward = -view.camera.forward;
    }
    for algorithm in algorithms() {
        let counters = run_exact(&stage, algorithm, Latency::Rounds, &views);
        assert_eq!(counters[2].leaves_drawn, 0);
    }
}

/// Boxes that are not numbers are drawn in every frame; an empty scene draws nothing.
#[test]
fn unbounded_objects_and_empty_scenes() {
    let mut stage = Stage::new(SceneKind::Boxes, 20);
    let mut bounds = stage.scene.model.object_bounds();
    bounds[3] = esker::geometry::Aabb::new(DVec3::NAN, DVec3::NAN);
    stage.tree = esker::hierarchy::Bvh::build(&bounds, &vec![12; bounds.len()], 1);
    let views = stage.views(CameraPath::Walk, 4);
    for algorithm in algorithms() {
        let leaf = stage.tree.always_drawn().next().expect("one object has no box");
        stage.run(algorithm, Latency::Rounds, &views, |_, _, drawn, _| {
            assert!(drawn.contains(&leaf), "{algorithm:?}");
        });
        run_exact(&stage, algorithm, Latency::Rounds, &views);
    }
    stage.tree = esker::hierarchy::Bvh::default();
    for algorithm in algorithms() {
        stage.run(algorithm, Latency::Rounds, &views, |_, counters, drawn: &[TreeNodeId], _| {
            assert!(drawn.is_empty() && counters.queries_issued == 0);
        });
    }
}

/// Objects that move: the tree is refitted before each frame.
#[test]
fn moving_objects_are_followed() {
    for algorithm in algorithms() {
        let mut stage = Stage::new(SceneKind::City, 2);
        let views = stage.views(CameraPath::Walk, 10);
        let mut culler = Culler::new(algorithm);
        let mut device = SoftwareDevice::new(OwnedLeaves::of(&stage), &views[0], Latency::Rounds);
        for (frame, view) in views.iter().enumerate() {
            move_objects(&mut stage, frame as u64);
            *device.drawables_mut() = OwnedLeaves::of(&stage);
            culler.frame(&stage.tree, view, &mut device);
            let wrong = Truth::default().wrong_pixels(&stage, view, device.picture());
            assert_eq!(wrong, 0, "frame {frame}: {algorithm:?}");
        }
    }
}

/// Moves a tenth of the objects and refits the tree.
fn move_objects(stage: &mut Stage, frame: u64) {
    let mut random = Random::new(8, frame);
    let objects = &mut stage.scene.model.objects;
    let count = objects.len() as u64;
    let mut moved = Vec::new();
    for _ in 0..count / 10 {
        let at = random.below(count) as usize;
        let step = DVec3::new(random.bell(), random.bell(), 0.0) * 2.0;
        objects[at].world_from_mesh.translation += step;
        moved.push(ObjectId(at as u32));
    }
    let bounds = stage.scene.model.object_bounds();
    let moved: Vec<_> = moved.into_iter().map(|id| (id, bounds[id.index()])).collect();
    stage.tree.refit(&moved);
}
