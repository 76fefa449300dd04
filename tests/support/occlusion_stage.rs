//! A device over a model, as culling sees it, without a renderer around it.

use std::sync::Arc;

use esker::geometry::{Aabb, View};
use esker::gpu::Gpu;
use esker::gpu::layout::GpuFrame;
use esker::hierarchy::{BoundingHierarchy, Bvh, Forest};
use esker::ids::TreeNodeId;
use esker::mesh::Model;
use esker::mesh::scenes::{CameraPath, ModelScene, camera_path};
use esker::passes::{
    CulledOutput, CulledRecording, CulledScene, Meshes, OcclusionQueries, SceneTree, Targets, Tile,
};
use esker::select::SplatSettings;
use esker::visibility::{Answer, OcclusionDevice, QueryId};

pub fn tree_over(model: &Model) -> Bvh {
    let costs: Vec<u64> =
        model.objects.iter().map(|object| model.mesh(object).triangles.len() as u64).collect();
    Bvh::build(&model.object_bounds(), &costs, 1)
}

pub fn leaves_of(tree: &Bvh) -> Vec<TreeNodeId> {
    (0..tree.node_count() as u32).map(TreeNodeId).filter(|&node| tree.is_leaf(node)).collect()
}

pub fn views(scene: &ModelScene, path: CameraPath, frames: u32, size: (u32, u32)) -> Vec<View> {
    let view = |camera| View { camera, width_px: size.0, height_px: size.1 };
    camera_path(scene, path, frames).into_iter().map(view).collect()
}

pub fn frame_of(view: &View) -> GpuFrame {
    Tile::whole(view).gpu_frame(view, &SplatSettings::default(), 0)
}

/// A device over a model, as culling sees it.
pub struct Stage {
    pub gpu: Arc<Gpu>,
    pub tree: Bvh,
    pub meshes: Meshes,
    pub targets: Targets,
    pub view: View,
    pub frame: GpuFrame,
}

impl Stage {
    pub fn new(gpu: &Arc<Gpu>, scene: &ModelScene, view: View) -> Stage {
        let model = &scene.model;
        let targets = Targets::new(gpu, view.width_px, view.height_px).unwrap();
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        targets.clear(&mut encoder, 0);
        gpu.queue().submit([encoder.finish()]);
        Stage {
            gpu: gpu.clone(),
            tree: tree_over(model),
            meshes: Meshes::new(gpu, model).unwrap(),
            targets,
            view,
            frame: frame_of(&view),
        }
    }

    /// The stage as culling draws on it, in a frame that was begun.
    pub fn device<'a>(&'a mut self, queries: &'a mut OcclusionQueries) -> CulledScene<'a> {
        self.meshes.begin(&self.gpu, &self.view, &self.frame).unwrap();
        let (colors, depths) = (&self.targets, &self.targets);
        let mut device = CulledScene {
            gpu: &self.gpu,
            queries,
            tree: SceneTree { first: &self.tree, second: Forest::default() },
            meshes: Some(&mut self.meshes),
            points: None,
            frame: &self.frame,
            output: CulledOutput::Over { colors, depths, shades_after: false },
            recording: CulledRecording::default(),
        };
        device.begin_frame(&self.view);
        device
    }

    /// Draws some leaves, asks about others in one round; `true` for what shows.
    pub fn ask(
        &mut self,
        queries: &mut OcclusionQueries,
        drawn: &[TreeNodeId],
        asked: &[Vec<Aabb>],
    ) -> Vec<bool> {
        let mut device = self.device(queries);
        drawn.iter().for_each(|&leaf| device.draw(device.tree.of_first(leaf)));
        let ids: Vec<QueryId> = asked.iter().map(|boxes| device.query(boxes)).collect();
        assert!(ids.iter().all(|&id| device.answer(id) == Answer::Unknown));
        if let Some(&last) = ids.last() {
            device.wait(last);
        }
        let shows = |&id: &QueryId| match device.answer(id) {
            Answer::Samples(samples) => samples > 0,
            Answer::Unknown => panic!("it was waited for"),
        };
        let answers = ids.iter().map(shows).collect();
        device.end_frame();
        assert_eq!(device.rounds(), 1);
        device.finish().unwrap();
        answers
    }
}
