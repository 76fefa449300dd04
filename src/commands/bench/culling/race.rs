//! Methods side by side along one course.

use std::time::{Duration, Instant};

use crate::geometry::{Camera, View};
use crate::hierarchy::{BoundingHierarchy, Bvh};
use crate::mesh::Model;
use crate::mesh::scenes::{CameraPath, ModelScene, SceneKind, camera_path};
use crate::visibility::{
    Algorithm, CullCounters, Culler, CullingCosts, Latency, ModelLeaves, SoftwareDevice,
    hidden_frontier,
};

use super::Extent;
use super::methods::Method;

/// Frames at the start that are left out of medians: methods learn in them.
const LEARNING: usize = 2;

/// What a method did along a course.
#[derive(Clone, Debug)]
pub(super) struct Result {
    pub name: String,
    pub frames: Vec<CullCounters>,
    pub times: Vec<Duration>,
    pub wrong_pixels: Vec<u64>,
    /// Per frame: triangles over those of frustum culling, and over those of the optimum.
    pub of_frustum: Vec<f64>,
    pub of_optimum: Vec<f64>,
    /// Frames with fewer questions than the optimum that asks one for each hidden node.
    pub below_frontier: usize,
    /// Sum of times over that of frustum culling.
    pub time_ratio: f64,
}

/// All methods on one course.
pub(super) struct Race {
    pub objects: usize,
    pub triangles: u64,
    results: Vec<Result>,
}

/// The tree over a model's objects.
pub(super) fn tree_over(model: &Model) -> Bvh {
    let costs: Vec<u64> =
        model.objects.iter().map(|object| model.mesh(object).triangles.len() as u64).collect();
    Bvh::build(&model.object_bounds(), &costs, 1)
}

/// Metres between two frames of a walk: 6 m/s at 60 frames a second.
const WALK_STEP: f64 = 0.1;

/// The cameras of a course. A walk is a steady piece from the middle of the scene's walk; the other
/// paths are whole.
pub(super) fn cameras(scene: &ModelScene, path: CameraPath, frames: u32) -> Vec<Camera> {
    if path != CameraPath::Walk {
        return camera_path(scene, path, frames);
    }
    let length: f64 = scene.walk.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
    let all = ((length / WALK_STEP) as u32).max(frames);
    let first = ((all - frames) / 2) as usize;
    camera_path(scene, path, all)[first..first + frames as usize].to_vec()
}

impl Race {
    /// Runs all methods, frame by frame beside each other. The first is taken as frustum culling.
    pub fn run(
        extent: &Extent,
        kind: SceneKind,
        path: CameraPath,
        latency: Latency,
        methods: &[Method],
    ) -> Race {
        let scene = kind.make(extent.scene_size(kind), 1);
        let tree = tree_over(&scene.model);
        let leaves = ModelLeaves { model: &scene.model, tree: &tree };
        let views: Vec<View> = cameras(&scene, path, extent.frames)
            .into_iter()
            .map(|camera| View { camera, width_px: extent.width, height_px: extent.height })
            .collect();
        let mut runners: Vec<_> = methods
            .iter()
            .map(|method| {
                let device = SoftwareDevice::new(leaves, &views[0], latency);
                (Culler::new(method.algorithm), device)
            })
            .collect();
        let mut oracle = Culler::new(Algorithm::StopAndWait);
        let mut oracle_device = SoftwareDevice::new(leaves, &views[0], Latency::Commands(0));
        let mut results: Vec<Result> = methods.iter().map(Result::new).collect();
        for view in &views {
            let optimum = oracle.frame(&tree, view, &mut oracle_device).triangles_drawn.max(1);
            let costs = CullingCosts::default();
            let frontier = hidden_frontier(&tree, view, oracle.drawn(), 0, &costs);
            for ((culler, device), result) in runners.iter_mut().zip(&mut results) {
                let start = Instant::now();
                let counters = culler.frame(&tree, view, device);
                result.times.push(start.elapsed());
                result.frames.push(counters);
                result.of_optimum.push(counters.triangles_drawn as f64 / optimum as f64);
                result.below_frontier += usize::from(counters.queries_issued < frontier.feasible);
            }
            let truth = runners[0].1.picture();
            for ((_, device), result) in runners.iter().zip(&mut results) {
                result.wrong_pixels.push(truth.differing_pixels(device.picture()));
            }
        }
        let frustum: Vec<u64> =
            results[0].frames.iter().map(|frame| frame.triangles_drawn.max(1)).collect();
        let frustum_time: Duration = results[0].times.iter().sum();
        for result in &mut results {
            let of =
                |(frame, all): (&CullCounters, &u64)| frame.triangles_drawn as f64 / *all as f64;
            result.of_frustum = result.frames.iter().zip(&frustum).map(of).collect();
            let time: Duration = result.times.iter().sum();
            result.time_ratio = time.as_secs_f64() / frustum_time.as_secs_f64();
        }
        Race {
            objects: scene.model.objects.len(),
            triangles: tree.root().map_or(0, |root| tree.cost(root)),
            results,
        }
    }

    pub fn results(&self) -> &[Result] {
        &self.results
    }
}

impl Result {
    pub const TABLE_HEAD: &'static str = "method               queries  hidden  leaves multi(failed)  switches \
        rounds waits   drawn/frustum  drawn/optimum  fewer q.  time/frustum  wrong px";
    pub const CSV_HEAD: &'static str = "course,method,frames,queries,queries_hidden,\
        queries_visible_leaf,multiqueries,multiqueries_failed,state_switches,rounds,blocking_waits,\
        leaves_drawn,triangles_drawn,of_frustum,of_optimum,below_frontier,time_ms,time_ratio,\
        wrong_pixels\n";

    fn new(method: &Method) -> Self {
        Result {
            name: method.name.clone(),
            frames: Vec::new(),
            times: Vec::new(),
            wrong_pixels: Vec::new(),
            of_frustum: Vec::new(),
            of_optimum: Vec::new(),
            below_frontier: 0,
            time_ratio: 0.0,
        }
    }

    /// Mean of a counter over the frames after the first ones.
    pub fn mean(&self, of: impl Fn(&CullCounters) -> u64) -> f64 {
        let frames = &self.frames[LEARNING.min(self.frames.len() - 1)..];
        frames.iter().map(|frame| of(frame) as f64).sum::<f64>() / frames.len() as f64
    }

    /// Middle of a ratio over the frames.
    pub fn median(values: &[f64]) -> f64 {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
    }

    pub fn median_ms(&self) -> f64 {
        let times: Vec<f64> = self.times.iter().map(|time| 1e3 * time.as_secs_f64()).collect();
        Result::median(&times)
    }

    pub fn all_wrong_pixels(&self) -> u64 {
        self.wrong_pixels.iter().sum()
    }

    pub fn table_line(&self) -> String {
        format!(
            "{:<20} {:>7.1} {:>7.1} {:>7.1} {:>6.1} {:>6.2} {:>9.1} {:>6.2} {:>6.1} {:>14.3} {:>14.3} \
             {:>8.0}% {:>13.3} {:>9}",
            self.name,
            self.mean(|c| c.queries_issued),
            self.mean(|c| c.queries_hidden),
            self.mean(|c| c.queries_visible_leaf),
            self.mean(|c| c.multiqueries),
            self.mean(|c| c.multiqueries_failed),
            self.mean(|c| c.state_switches),
            self.mean(|c| c.rounds),
            self.mean(|c| c.blocking_waits),
            Result::median(&self.of_frustum),
            Result::median(&self.of_optimum),
            100.0 * self.below_frontier as f64 / self.frames.len() as f64,
            self.time_ratio,
            self.all_wrong_pixels(),
        )
    }

    pub fn csv_line(&self, course: &str) -> String {
        let mut all = CullCounters::default();
        self.frames.iter().for_each(|frame| all.add(frame));
        format!(
            "{course},\"{}\",{},{},{},{},{},{},{},{},{},{},{},{:.5},{:.5},{},{:.4},{:.4},{}",
            self.name,
            self.frames.len(),
            all.queries_issued,
            all.queries_hidden,
            all.queries_visible_leaf,
            all.multiqueries,
            all.multiqueries_failed,
            all.state_switches,
            all.rounds,
            all.blocking_waits,
            all.leaves_drawn,
            all.triangles_drawn,
            Result::median(&self.of_frustum),
            Result::median(&self.of_optimum),
            self.below_frontier,
            self.median_ms(),
            self.time_ratio,
            self.all_wrong_pixels(),
        )
    }
}
