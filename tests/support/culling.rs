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

    /// Frames in a row from the middle of a walk, `step` metres apart. 0.1 m is 6 m/s at 60 frames a
    /// second.
    #[allow(dead_code)] // Not all test files that share this need it.
    pub fn steady_walk(&self, frames: u32, step: f64) -> Vec<View> {
        let length: f64 = self.scene.walk.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
        let all = ((length / step) as u32).max(frames);
        let first = (all - frames) as usize / 2;
        self.views(CameraPath::Walk, all)[first..first + frames as usize].to_vec()
    }

    /// Runs an algorithm along views; `each` sees every frame's counters, leaves and picture.
    #[allow(dead_code)] // As above.
    pub fn run(
        &self,
        algorithm: Algorithm,
        latency: Latency,
        views: &[View],
        each: impl FnMut(usize, &CullCounters, &[TreeNodeId], &ItemBuffer),
    ) -> Vec<CullCounters> {
        run(&self.tree, self.leaves(), algorithm, latency, views, each)
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
#[allow(dead_code)] // As above.
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

/// Sums of counters.
#[allow(dead_code)] // As above.
pub fn sum(counters: &[CullCounters]) -> CullCounters {
    let mut all = CullCounters::default();
    counters.iter().for_each(|counters| all.add(counters));
    all
}
