//! Models in the scene: what is in sight of them, drawn into the picture of the points.
//!
//! Models are drawn when the points are done and finished, against their depth: whatever is nearer
//! shows. So eye-dome lighting and the filling of gaps see points alone. Without models nothing is
//! kept, tested or drawn.

use std::sync::Arc;

use glam::DAffine3;

use crate::frame::culling_view::Explained;
use crate::frame::device::Device;
use crate::frame::{FrameSettings, Renderer};
use crate::geometry::{Aabb, Containment, Frustum, View};
use crate::hierarchy::Bvh;
use crate::ids::ObjectId;
use crate::mesh::Model;
use crate::visibility::Algorithm;

/// The models of a scene.
pub(super) struct Models {
    pub(super) model: Arc<Model>,
    pub(super) bounds: Vec<Aabb>,
    all: Aabb,
    /// Objects of this frame that are in sight, hidden or not.
    pub(super) visible: Vec<ObjectId>,
    /// What these were chosen for: a view, and whether all of them were to be drawn.
    pub(super) chosen_for: Option<(View, bool)>,
    /// Made when somebody looks at what the frustum alone culls.
    pub(super) explained: Option<Box<Explained>>,
}

impl Models {
    fn new(model: Arc<Model>) -> Self {
        let bounds = model.object_bounds();
        let all = bounds.iter().fold(Aabb::EMPTY, |all, one| all.union(one));
        Models { model, bounds, all, visible: Vec::new(), chosen_for: None, explained: None }
    }

    /// Chooses what is in sight; everything, if that is how it is to be.
    fn choose(&mut self, view: &View, culling: &Algorithm) {
        let everything = matches!(culling, Algorithm::None);
        self.chosen_for = Some((*view, everything));
        if everything {
            self.visible.clear();
            self.visible.extend(self.model.object_ids());
            return;
        }
        let frustum = Frustum::new(view);
        let in_sight = |bounds: &Aabb| frustum.test_box(bounds) != Containment::Outside;
        let bounds = self.bounds.iter().zip(0u32..);
        self.visible.clear();
        self.visible.extend(bounds.filter(|(b, _)| in_sight(b)).map(|(_, id)| ObjectId(id)));
    }

    /// A tree over the objects.
    pub(super) fn tree(&self) -> Bvh {
        let triangles = |object| self.model.mesh(object).triangles.len() as u64;
        let costs: Vec<u64> = self.model.objects.iter().map(triangles).collect();
        Bvh::build(&self.bounds, &costs, 1)
    }
}

impl Renderer {
    /// Replaces the models of the scene; one without objects is none. The model must be sound by
    /// [`Model::check`].
    pub fn set_model(&mut self, model: Arc<Model>) {
        self.thaw_culling();
        self.models = (!model.is_empty()).then(|| Box::new(Models::new(model)));
        self.drop_drawn_model();
        #[cfg(feature = "gpu")]
        {
            self.culling = None;
        }
        self.last = None;
    }

    /// The models of the scene.
    pub fn model(&self) -> Option<&Arc<Model>> {
        self.models.as_ref().map(|models| &models.model)
    }

    /// Bytes of models held on the device; 0 on the CPU, where they are read as they are.
    pub fn mesh_bytes(&self) -> u64 {
        match &self.device {
            Device::Cpu { .. } => 0,
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => on_gpu.meshes.as_ref().map_or(0, |meshes| meshes.held_bytes()),
        }
    }

    /// Moves an object of the models; nothing else is done anew. Ignored if there is no such object
    /// or the place is not finite.
    pub fn place_object(&mut self, object: ObjectId, world_from_mesh: DAffine3) {
        let Some(models) = &mut self.models else { return };
        if object.index() >= models.model.objects.len() || !world_from_mesh.is_finite() {
            return;
        }
        let model = Arc::make_mut(&mut models.model);
        model.objects[object.index()].world_from_mesh = world_from_mesh;
        models.bounds[object.index()] = model.bounds_of(object);
        models.explained = None;
        #[cfg(feature = "gpu")]
        if let Some(culling) = &mut self.culling {
            culling.objects.refit(&[(object, models.bounds[object.index()])]);
        }
        models.all = models.bounds.iter().fold(Aabb::EMPTY, |all, one| all.union(one));
        match &mut self.device {
            Device::Cpu { meshes, .. } => {
                if let Some(meshes) = meshes {
                    meshes.place(object, world_from_mesh);
                }
            }
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => {
                if let Some(meshes) = &mut on_gpu.meshes {
                    meshes.place(object, world_from_mesh);
                }
            }
        }
        self.last = None;
    }

    /// Shades each pixel of models so many times, with the same picture; to measure what dear
    /// shading changes. On the CPU nothing changes.
    #[cfg(feature = "gpu")]
    pub fn repeat_shading(&mut self, times: u32) {
        match &mut self.device {
            Device::Cpu { .. } => {}
            Device::Gpu(on_gpu) => on_gpu.shading_repeats = times.max(1),
        }
    }

    /// The box of all objects; empty without models.
    pub(super) fn model_bounds(&self) -> Aabb {
        self.models.as_ref().map_or(Aabb::EMPTY, |models| models.all)
    }

    /// Chooses the objects of a frame.
    pub(super) fn choose_objects(&mut self, view: &View, settings: &FrameSettings) {
        let Some(models) = &mut self.models else { return };
        match &self.frozen {
            Some(frozen) => models.visible.clone_from(&frozen.objects),
            None => models.choose(view, &settings.culling),
        }
        self.stats.objects_culled = (models.model.objects.len() - models.visible.len()) as u32;
    }

    fn drop_drawn_model(&mut self) {
        match &mut self.device {
            Device::Cpu { meshes, .. } => *meshes = None,
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => {
                on_gpu.meshes = None;
                on_gpu.two_pass = None;
            }
        }
    }
}
