//! Scenes under culling on the exact software device, frame by frame.

use esker::geometry::{Camera, View};
use esker::hierarchy::{BoundingHierarchy, Bvh};
use esker::ids::TreeNodeId;
use esker::mesh::Model;
use esker::mesh::scenes::{CameraPath, ModelScene, SceneKind, camera_path};
use esker::visibility::{
    Algorithm, CullCounters, Culler, Drawables, ItemBuffer, Latency, ModelLeaves, SoftwareDevice,
};

pub const WIDTH: u32 = 160;
pub const HEIGHT: u32 = 120;

/// A scene with its tree.
pub struct Stage {
    pub scene: ModelScene,
    pub tree: Bvh,
}

impl Stage {
    pub fn new(kind: SceneKind, size: u32) -> Self {
        let scene = kind.make(size, 1);
        let tree = tree_over(&scene.model);
        Stage { scene, tree }
    }

    pub fn leaves(&self) -> ModelLeaves<'_> {
        ModelLeaves { model: &self.scene.model, tree: &self.tree }
    }

    pub fn views(&self, path: CameraPath, frames: u32) -> Vec<View> {
        camera_path(&self.scene, path, frames).into_iter().map(view).collect()
    }

    /// Runs an algorithm along views; `each` sees every frame's counters, leaves and picture.
    pub fn run(
        &self,
        algorithm: Algorithm,
        latency: Latency,
        views: &[View],
        each: impl FnMut(usize, &CullCounters, &[TreeNodeId], &ItemBuffer),
    ) -> Vec<CullCounters> {
        run(&self.tree, self.leaves(), algorithm, latency, views, each)
    }

    /// Runs an algorithm and demands the picture of everything in every frame.
    pub fn run_exact(
        &self,
        algorithm: Algorithm,
        latency: Latency,
        views: &[View],
    ) -> Vec<CullCounters> {
        let mut truth = Truth::default();
        self.run(algorithm, latency, views, |frame, _, _, picture| {
            let wrong = truth.wrong_pixels(self, &views[frame], picture);
            assert_eq!(wrong, 0, "{}: frame {frame}: {algorithm:?}, {latency:?}", self.name());
        })
    }

    fn name(&self) -> String {
        format!("{} objects", self.scene.model.objects.len())
    }
}

pub fn tree_over(model: &Model) -> Bvh {
    let costs: Vec<u64> =
        model.objects.iter().map(|object| model.mesh(object).triangles.len() as u64).collect();
    Bvh::build(&model.object_bounds(), &costs, 1)
}

pub fn view(camera: Camera) -> View {
    View { camera, width_px: WIDTH, height_px: HEIGHT }
}

/// Runs an algorithm over any tree.
pub fn run<H: BoundingHierarchy, D: Drawables>(
    tree: &H,
    drawables: D,
    algorithm: Algorithm,
    latency: Latency,
    views: &[View],
    mut each: impl FnMut(usize, &CullCounters, &[TreeNodeId], &ItemBuffer),
) -> Vec<CullCounters> {
    let mut device = SoftwareDevice::new(drawables, &views[0], latency);
    let mut culler = Culler::new(algorithm);
    let mut all = Vec::new();
    for (frame, view) in views.iter().enumerate() {
        let counters = culler.frame(tree, view, &mut device);
        each(frame, &counters, culler.drawn(), device.picture());
        all.push(counters);
    }
    all
}

/// Pictures of everything, kept while the view stays.
#[derive(Default)]
pub struct Truth {
    last: Option<(View, ItemBuffer)>,
}

impl Truth {
    pub fn picture(&mut self, stage: &Stage, view: &View) -> &ItemBuffer {
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

    pub fn wrong_pixels(&mut self, stage: &Stage, view: &View, picture: &ItemBuffer) -> u64 {
        self.picture(stage, view).differing_pixels(picture)
    }
}

/// Leaves that own what they draw, so that it may change between frames.
pub struct OwnedLeaves {
    model: Model,
    tree: Bvh,
}

impl OwnedLeaves {
    pub fn of(stage: &Stage) -> Self {
        OwnedLeaves { model: stage.scene.model.clone(), tree: stage.tree.clone() }
    }
}

impl Drawables for OwnedLeaves {
    fn draw(&self, node: TreeNodeId, target: &mut ItemBuffer) -> u64 {
        ModelLeaves { model: &self.model, tree: &self.tree }.draw(node, target)
    }
}

/// Sums of counters.
pub fn sum(counters: &[CullCounters]) -> CullCounters {
    let mut all = CullCounters::default();
    counters.iter().for_each(|counters| all.add(counters));
    all
}
