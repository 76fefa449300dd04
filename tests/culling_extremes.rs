//! Scenes at the edge of what there is: a million boxes in one place, a hundred thousand leaves under
//! one node, an object around the camera, one object, none. Every algorithm ends, draws what is
//! seen, and asks no more than the scene is worth.

#[path = "support/culling.rs"]
mod support;

use esker::geometry::{Aabb, View};
use esker::hierarchy::{BoundingHierarchy, Bvh};
use esker::ids::TreeNodeId;
use esker::mesh::scenes::{CameraPath, SceneKind};
use esker::visibility::{
    Algorithm, Culler, Drawables, ItemBuffer, Latency, NodeState, SoftwareDevice,
};
use glam::DVec3;
use support::{Stage, run, view};

/// Draws a box.
fn draw_box(item: u32, bounds: &Aabb, target: &mut ItemBuffer) -> u64 {
    let corner = |i: usize| {
        let pick = |axis: usize| [bounds.min, bounds.max][i >> axis & 1][axis];
        DVec3::new(pick(0), pick(1), pick(2))
    };
    const FACES: [[u32; 3]; 12] = [
        [0, 1, 3],
        [0, 3, 2],
        [4, 5, 7],
        [4, 7, 6],
        [0, 1, 5],
        [0, 5, 4],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 3, 7],
        [1, 7, 5],
    ];
    target.triangles(item, (0..8).map(corner), &FACES)
}

fn looking(eye: DVec3, target: DVec3) -> View {
    view(esker::geometry::Camera::looking_at(eye, target, DVec3::Z, 1.0, 0.05))
}

const MILLION: usize = 1_000_000;

/// A million boxes in one place, with a plate before them that has the last number. Only the first
/// box is really drawn: the others would add nothing to the picture.
struct Coincident {
    tree: Bvh,
    plate: Aabb,
    cube: Aabb,
}

impl Coincident {
    fn new() -> Self {
        let cube = Aabb::new(DVec3::splat(-0.5), DVec3::splat(0.5));
        let plate = Aabb::new(DVec3::new(-3.0, -2.0, -3.0), DVec3::new(3.0, -1.9, 3.0));
        let mut bounds = vec![cube; MILLION];
        bounds.push(plate);
        let tree = Bvh::build(&bounds, &vec![12; bounds.len()], 1);
        Coincident { tree, plate, cube }
    }
}

impl Drawables for &Coincident {
    fn draw(&self, node: TreeNodeId, target: &mut ItemBuffer) -> u64 {
        let mut passed = 0;
        for object in self.tree.objects_of(node) {
            passed += match object.index() {
                0 => draw_box(0, &self.cube, target),
                MILLION => draw_box(1, &self.plate, target),
                _ => 0,
            };
        }
        passed
    }
}

#[test]
fn a_million_boxes_in_one_place_are_one_question_behind_a_plate() {
    let scene = Coincident::new();
    assert!(scene.tree.depth() <= 24, "{}", scene.tree.depth());
    let [_, _, frustum, _, _, chc, plus, ..] = Algorithm::usual();
    let before = looking(DVec3::new(0.3, -9.0, 0.2), DVec3::ZERO);
    // In the middle of them; and on a face of theirs, looking along it.
    let inside = looking(DVec3::new(0.1, 0.0, 0.0), DVec3::Y);
    let on_face = looking(DVec3::new(0.5, -0.2, 0.0), DVec3::new(0.5, 9.0, 0.0));
    let picture = |algorithm, views: &[View]| {
        let mut last = None;
        let counters =
            run(&scene.tree, &scene, algorithm, Latency::Batches, views, |_, _, _, picture| {
                last = Some(picture.clone());
            });
        (counters[counters.len() - 1], last.expect("there were frames"))
    };
    let (all, expected) = picture(frustum, &[before]);
    assert_eq!(all.leaves_drawn, 1 + MILLION as u64);
    for algorithm in [chc, plus] {
        let (counters, found) = picture(algorithm, &[before; 3]);
        assert_eq!(expected.differing_pixels(&found), 0);
        assert_eq!(counters.leaves_drawn, 1, "{algorithm:?}");
        assert!(counters.queries_issued <= 64, "{algorithm:?}: {counters:?}");
        assert!(counters.nodes_visited <= 200, "{algorithm:?}: {counters:?}");
    }
    for odd in [inside, on_face] {
        let (all, expected) = picture(frustum, &[odd]);
        let (counters, found) = picture(plus, &[odd]);
        assert_eq!(expected.differing_pixels(&found), 0);
        assert_eq!(counters.leaves_drawn, all.leaves_drawn, "none can be asked about");
        assert_eq!(counters.queries_issued, 0);
    }
}

/// A root with leaves, and nothing between.
struct Flat(Vec<Aabb>);

impl BoundingHierarchy for Flat {
    fn root(&self) -> Option<TreeNodeId> {
        Some(TreeNodeId(0))
    }

    fn node_limit(&self) -> usize {
        self.0.len() + 1
    }

    fn parent(&self, node: TreeNodeId) -> Option<TreeNodeId> {
        (node.0 > 0).then_some(TreeNodeId(0))
    }

    fn children(&self, node: TreeNodeId) -> impl Iterator<Item = TreeNodeId> {
        let count = if node.0 == 0 { self.0.len() as u32 } else { 0 };
        (1..=count).map(TreeNodeId)
    }

    fn is_leaf(&self, node: TreeNodeId) -> bool {
        node.0 > 0
    }

    fn bounds(&self, node: TreeNodeId) -> Aabb {
        match node.index() {
            0 => self.0.iter().fold(Aabb::EMPTY, |all, one| all.union(one)),
            leaf => self.0[leaf - 1],
        }
    }

    fn cost(&self, node: TreeNodeId) -> u64 {
        if node.0 == 0 { 12 * self.0.len() as u64 } else { 12 }
    }
}

impl Drawables for &Flat {
    fn draw(&self, node: TreeNodeId, target: &mut ItemBuffer) -> u64 {
        match node.index() {
            0 => (1..=self.0.len() as u32).map(|leaf| self.draw(TreeNodeId(leaf), target)).sum(),
            leaf => draw_box(leaf as u32, &self.0[leaf - 1], target),
        }
    }
}

#[test]
fn a_hundred_thousand_leaves_under_one_node_are_culled_one_by_one() {
    let mut boxes = vec![Aabb::new(DVec3::new(-40.0, 0.0, -40.0), DVec3::new(40.0, 0.2, 40.0))];
    let mut random = esker::sampling::Random::new(11, 0);
    while boxes.len() < 100_000 {
        let at = DVec3::new(
            random.between(-20.0, 20.0),
            random.between(2.0, 40.0),
            random.between(-20.0, 20.0),
        );
        boxes.push(Aabb::new(at, at + 0.1));
    }
    let tree = Flat(boxes);
    let eye = DVec3::new(0.0, -20.0, 0.0);
    let views = vec![looking(eye, DVec3::ZERO); 5];
    let mut expected = ItemBuffer::new(&views[0]);
    (&tree).draw(TreeNodeId(0), &mut expected);
    let plus = Algorithm::usual()[6];
    for algorithm in [Algorithm::usual()[5], plus] {
        let counters =
            run(&tree, &tree, algorithm, Latency::Batches, &views, |frame, _, _, picture| {
                assert_eq!(expected.differing_pixels(picture), 0, "frame {frame}: {algorithm:?}");
            });
        let last = counters[4];
        assert_eq!(last.leaves_drawn, 1, "{algorithm:?}: {last:?}");
        assert!(last.hidden_nodes_decided > 10_000, "{last:?}");
        if algorithm == plus {
            let asked = last.queries_issued;
            assert!(20 * asked < last.hidden_nodes_decided, "{last:?}");
        }
    }
}

#[test]
fn an_object_around_the_camera_hides_what_is_outside_of_it() {
    let mut stage = Stage::new(SceneKind::Shells, 1);
    // The shell of radius 1 about the eye, and a city around it.
    let city = Stage::new(SceneKind::City, 2);
    let middle = city.scene.walk[1];
    let shell = &mut stage.scene.model.objects[0];
    shell.world_from_mesh.translation = middle;
    let mut model = city.scene.model.clone();
    model.append(stage.scene.model.clone());
    let scene = esker::mesh::scenes::ModelScene { model, ..city.scene.clone() };
    let stage = Stage { tree: support::tree_over(&scene.model), scene };
    let around = stage.scene.model.objects.len() as u32 - 1;
    let views = vec![looking(middle, middle + DVec3::new(1.0, 0.4, 0.1)); 12];
    for algorithm in Algorithm::usual() {
        let mut culler = Culler::new(algorithm);
        let mut device = SoftwareDevice::new(stage.leaves(), &views[0], Latency::Rounds);
        for view in &views {
            culler.frame(&stage.tree, view, &mut device);
            assert_eq!(device.picture().visible_items(), [around], "{algorithm:?}");
        }
        let drawn = culler.drawn().len();
        // So few leaves in view are not worth an attempt of `auto`.
        let culls = matches!(algorithm.name(), "naive" | "stop-and-wait" | "chc" | "chc++");
        // What meets the near plane is drawn besides: the box of the ground.
        assert_eq!(drawn <= 6, culls, "{}: {drawn} drawn", algorithm.name());
    }
}

#[test]
fn one_object_and_none() {
    let one = Stage::new(SceneKind::Boxes, 1);
    let views = one.views(CameraPath::Walk, 6);
    for algorithm in Algorithm::usual() {
        let mut culler = Culler::new(algorithm);
        let mut device = SoftwareDevice::new(one.leaves(), &views[0], Latency::Rounds);
        for view in &views {
            culler.frame(&one.tree, view, &mut device);
            assert_eq!(culler.states(&one.tree).len(), 1, "{algorithm:?}");
        }
        let nothing = Bvh::default();
        let mut culler = Culler::new(algorithm);
        let counters = culler.frame(&nothing, &views[0], &mut device);
        assert_eq!((counters.leaves_drawn, counters.queries_issued), (0, 0));
        assert!(culler.states(&nothing).is_empty());
    }
    // An object without a box is drawn always, and no box is told of it.
    let bounds = [Aabb::new(DVec3::NAN, DVec3::NAN)];
    let tree = Bvh::build(&bounds, &[12], 1);
    for algorithm in Algorithm::usual() {
        let mut culler = Culler::new(algorithm);
        let mut device = SoftwareDevice::new(
            esker::visibility::ModelLeaves { model: &one.scene.model, tree: &tree },
            &views[0],
            Latency::Rounds,
        );
        culler.frame(&tree, &views[0], &mut device);
        assert_eq!(culler.drawn().len(), 1, "{algorithm:?}");
        let states = culler.states(&tree);
        assert!(states.iter().all(|status| status.state != NodeState::Hidden));
    }
}
