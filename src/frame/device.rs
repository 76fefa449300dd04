//! What draws: the CPU, or a pass on a device with its targets and its clock.

#[cfg(feature = "gpu")]
use std::sync::Arc;

#[cfg(feature = "gpu")]
use crate::frame::culling::SceneCulling;
#[cfg(feature = "gpu")]
use crate::frame::{CullingAnswers, FrameSettings, NodeSource};
#[cfg(feature = "gpu")]
use crate::geometry::{Aabb, View};
#[cfg(feature = "gpu")]
use crate::gpu::layout::GpuFrame;
#[cfg(feature = "gpu")]
use crate::gpu::{Gpu, GpuError, PassTimer, WordArena};
#[cfg(feature = "gpu")]
use crate::ids::{NodeId, ObjectId};
#[cfg(feature = "gpu")]
use crate::mesh::Model;
#[cfg(feature = "gpu")]
use crate::passes::{
    CulledDraws, CulledOutput, CulledPoints, CulledRecording, CulledScene, DepthTarget, DrawCounts,
    DrawOrder, DrawTable, Finish, MeshCounts, MeshOutput, Meshes, OcclusionQueries, PointDrawing,
    PointsCompute, PointsRaster, SceneTree, Targets, TwoPass, TwoPassDrawing,
};
use crate::passes::{MeshesCpu, Picture, PointsCpu};
#[cfg(feature = "gpu")]
use crate::visibility::Algorithm;

/// Where points are drawn.
pub(super) enum Device {
    Cpu {
        pass: PointsCpu,
        /// Only while there are models.
        meshes: Option<Box<MeshesCpu>>,
        picture: Option<Picture>,
    },
    #[cfg(feature = "gpu")]
    Gpu(Box<OnGpu>),
}

/// All that draws on a device.
#[cfg(feature = "gpu")]
pub(super) struct OnGpu {
    pub(super) gpu: Arc<Gpu>,
    pub(super) pass: GpuPass,
    pub(super) timer: PassTimer,
    pub(super) targets: Option<Targets>,
    pub(super) finish: Finish,
    /// Only while there are models.
    pub(super) meshes: Option<Box<Meshes>>,
    /// Only once occlusion culling was asked for.
    pub(super) occlusion: Option<Box<OcclusionQueries>>,
    /// Only while culling without read-back is asked for.
    pub(super) two_pass: Option<Box<TwoPass>>,
    /// Depth of what rounds of culling drew; only while points take part in it.
    pub(super) culled_depth: Option<DepthTarget>,
    /// Whether the last frame wrote depth.
    pub(super) has_depth: bool,
    /// How often pixels of models are shaded; other than once to measure.
    pub(super) shading_repeats: u32,
}

/// The pass that draws points there.
#[cfg(feature = "gpu")]
pub(super) enum GpuPass {
    Compute(Box<PointsCompute>),
    Raster(Box<PointsRaster>),
}

/// The objects of models that a frame shows.
#[cfg(feature = "gpu")]
pub(super) struct ModelDrawing<'a> {
    pub(super) model: &'a Model,
    pub(super) visible: &'a [ObjectId],
    /// The boxes of all objects; none while what is drawn stays as another camera chose it.
    pub(super) bounds: Option<&'a [Aabb]>,
}

/// What is drawn in a frame.
#[cfg(feature = "gpu")]
pub(super) struct SceneDrawing<'a> {
    pub(super) view: &'a View,
    pub(super) frame: &'a GpuFrame,
    pub(super) table: &'a DrawTable,
    pub(super) arena: &'a WordArena,
    pub(super) settings: &'a FrameSettings,
    pub(super) models: Option<ModelDrawing<'a>>,
    pub(super) culling: Option<&'a mut SceneCulling>,
    pub(super) sources: &'a [Arc<dyn NodeSource>],
    /// Whether points are drawn as culling finds them.
    pub(super) culls_points: bool,
    /// The index of a node among the table's draws.
    pub(super) draw_of: &'a dyn Fn(usize, NodeId) -> Option<u32>,
    /// Whether each draw's points are there.
    pub(super) ready: &'a [bool],
}

#[cfg(feature = "gpu")]
impl OnGpu {
    /// Draws a frame. What culling drew of the points comes back if they took part in it.
    pub(super) fn draw(
        &mut self,
        mut scene: SceneDrawing,
    ) -> Result<(DrawCounts, MeshCounts, Option<CulledDraws>), GpuError> {
        let [width_px, height_px] = scene.frame.target_px;
        if !self.targets.as_ref().is_some_and(|targets| targets.fits(width_px, height_px)) {
            self.targets = None;
            self.targets = Some(Targets::new(&self.gpu, width_px, height_px)?);
        }
        self.timer.begin_frame();
        let gpu = self.gpu.clone();
        let mut culling = scene.culling.take();
        let has_points = scene.culls_points && !scene.table.draws.is_empty();
        // Points in the tree and no question: everything in sight is drawn as it always is.
        let passes = culling.take_if(|culling| culling.has_points && !has_points);
        // Culling that has points may find objects at the very edge of the frustum.
        scene.models = scene.models.filter(|models| has_points || !models.visible.is_empty());
        if let Some(models) = &scene.models
            && self.meshes.is_none()
        {
            self.meshes = Some(Box::new(Meshes::new(&gpu, models.model)?));
        }
        let settings = scene.settings;
        let by_pyramid = settings.answers == CullingAnswers::Pyramid;
        let is_other = |queries: &OcclusionQueries| queries.is_by_pyramid() != by_pyramid;
        if culling.is_some() && self.occlusion.as_deref().is_none_or(is_other) {
            self.occlusion = Some(Box::new(match by_pyramid {
                true => OcclusionQueries::by_pyramid(&gpu)?,
                false => OcclusionQueries::new(&gpu)?,
            }));
        }
        let is_two_pass = scene.models.is_some() && settings.culling == Algorithm::TwoPass;
        if !is_two_pass || !TwoPass::is_offered_by(&gpu) {
            self.two_pass = None;
        } else if self.two_pass.is_none() {
            self.two_pass = Some(Box::new(TwoPass::new(&gpu)?));
        }
        if let Some(meshes) = &mut self.meshes {
            meshes.repeat_shading(self.shading_repeats);
        }
        if !has_points {
            self.culled_depth = None;
        }
        let wants_depth =
            scene.settings.depth || !scene.settings.finish.is_nothing() || scene.models.is_some();
        self.has_depth = wants_depth || matches!(self.pass, GpuPass::Raster(_));
        match culling {
            Some(culling) if has_points => {
                let (counts, meshes, drawn) = gpu
                    .checked("draw a frame", || self.draw_culled(&scene, culling, wants_depth))??;
                Ok((counts, meshes, Some(drawn)))
            }
            culling => {
                let (counts, meshes) = gpu.checked("draw a frame", || {
                    self.draw_points_first(&scene, culling, wants_depth)
                })??;
                if let Some(culling) = passes {
                    culling.pass(scene.sources, scene.view);
                }
                Ok((counts, meshes, None))
            }
        }
    }

    /// Points, then models over them: all that are in sight, or those that culling finds to show.
    fn draw_points_first(
        &mut self,
        scene: &SceneDrawing,
        culling: Option<&mut SceneCulling>,
        wants_depth: bool,
    ) -> Result<(DrawCounts, MeshCounts), GpuError> {
        let gpu = self.gpu.clone();
        let targets = self.targets.as_ref().expect("they were just made");
        let drawing = point_drawing(scene, targets, wants_depth);
        let (pass, timer, finish) = (&mut self.pass, &mut self.timer, &mut self.finish);
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        let counts = match pass {
            GpuPass::Compute(pass) => pass.draw(&gpu, &mut encoder, timer, &drawing),
            GpuPass::Raster(pass) => pass.draw(&gpu, &mut encoder, timer, &drawing),
        }?;
        let settings = &scene.settings.finish;
        let finishing = finish.draw(&gpu, &mut encoder, timer, settings, targets)?;
        let over = finish.finished(targets);
        let (colors, depths) = over;
        let mut mesh_counts = MeshCounts::default();
        let (mut mesh_bytes, mut culling_dispatches) = (0, 0);
        let mut culled = None;
        // Where points are drawn, a model exactly as far away as one would be shaded over it.
        let shades_after = scene.settings.depth_first && scene.table.draws.is_empty();
        if let (Some(models), Some(meshes)) = (&scene.models, &mut self.meshes) {
            meshes.begin(&gpu, scene.view, scene.frame)?;
            match (culling, &mut self.occlusion, &mut self.two_pass, models.bounds) {
                (Some(culling), Some(queries), ..) => culled = Some((culling, queries, meshes)),
                (_, _, Some(two_pass), Some(bounds)) => {
                    let (visible, view, frame) = (models.visible, scene.view, scene.frame);
                    let targets = over;
                    let drawing =
                        TwoPassDrawing { shades_after, bounds, visible, view, frame, targets };
                    let counts = two_pass.record(&gpu, &mut encoder, meshes, &drawing)?;
                    mesh_counts = two_pass.counts().drawn();
                    (mesh_counts.draw_calls, culling_dispatches) = counts;
                    mesh_bytes = meshes.take_uploaded_bytes() + two_pass.take_uploaded_bytes();
                }
                _ => {
                    let list = meshes.list(&gpu, models.visible, DrawOrder::Grouped)?;
                    let mut output = MeshOutput::COLOR;
                    let mut calls = 0;
                    if shades_after {
                        let mut pass = begin_over(&mut encoder, timer, None, depths);
                        let depth = MeshOutput::DEPTH;
                        calls = meshes.record(&gpu, &mut pass, &list, depth)?.draw_calls;
                        output = MeshOutput::SHADE;
                    }
                    let mut pass = begin_over(&mut encoder, timer, Some(colors), depths);
                    mesh_counts = meshes.record(&gpu, &mut pass, &list, output)?;
                    mesh_counts.draw_calls += calls;
                    mesh_bytes = meshes.take_uploaded_bytes();
                }
            }
        }
        timer.end_frame(&mut encoder);
        gpu.queue().submit([encoder.finish()]);
        timer.after_submit();
        if let Some(two_pass) = &mut self.two_pass {
            two_pass.after_submit();
        }
        if let Some((culling, queries, meshes)) = culled {
            // Points are drawn by now: they hide objects too.
            let SceneCulling { culler, objects, meter, .. } = culling;
            let begun = meter.begin(&gpu, culler)?;
            let tree = SceneTree { first: &*objects, second: Default::default() };
            let mut drawing = CulledScene {
                gpu: &gpu,
                queries,
                tree: tree.clone(),
                meshes: Some(meshes),
                points: None,
                frame: scene.frame,
                output: CulledOutput::Over { colors, depths, shades_after },
                recording: CulledRecording::default(),
            };
            culler.frame(&tree, scene.view, &mut drawing);
            mesh_counts = drawing.finish()?.meshes;
            meter.end(&gpu, culler, begun)?;
            mesh_bytes = meshes.take_uploaded_bytes();
        }
        let culling = DrawCounts { dispatches: culling_dispatches, ..DrawCounts::default() };
        Ok((total(&[counts, finishing, culling], &mesh_counts, mesh_bytes), mesh_counts))
    }

    /// Points and models as culling finds that they show, by their depth alone; then the picture.
    fn draw_culled(
        &mut self,
        scene: &SceneDrawing,
        culling: &mut SceneCulling,
        wants_depth: bool,
    ) -> Result<(DrawCounts, MeshCounts, CulledDraws), GpuError> {
        let gpu = self.gpu.clone();
        let size_px = scene.frame.target_px;
        if self.culled_depth.as_ref().is_none_or(|depth| depth.size_px() != size_px) {
            self.culled_depth = None;
            self.culled_depth = Some(DepthTarget::new(&gpu, size_px)?);
        }
        let (Some(targets), Some(depth), Some(queries), GpuPass::Compute(pass)) =
            (&self.targets, &self.culled_depth, &mut self.occlusion, &mut self.pass)
        else {
            unreachable!("all of these were made, and other passes have no rounds")
        };
        let (timer, finish) = (&mut self.timer, &mut self.finish);
        let drawing = point_drawing(scene, targets, wants_depth);
        let mut meshes = self.meshes.as_deref_mut().filter(|_| scene.models.is_some());
        if let Some(meshes) = &mut meshes {
            meshes.begin(&gpu, scene.view, scene.frame)?;
        }
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        depth.clear(&mut encoder);
        let begun = pass.begin_rounds(&gpu, &mut encoder, &drawing)?;
        gpu.queue().submit([encoder.finish()]);

        let points = CulledPoints {
            pass: &mut *pass,
            drawing,
            draw_of: scene.draw_of,
            ready: scene.ready,
            spare_points: scene.settings.cut.point_budget.saturating_sub(scene.table.points),
        };
        let drawn = culling.draw(scene.sources, |tree, culler, meter| {
            let begun = meter.begin(&gpu, culler)?;
            let mut drawing = CulledScene {
                gpu: &gpu,
                queries,
                tree: tree.clone(),
                meshes: meshes.as_deref_mut(),
                points: Some(points),
                frame: scene.frame,
                output: CulledOutput::Depth(depth),
                recording: CulledRecording::default(),
            };
            culler.frame(tree, scene.view, &mut drawing);
            let drawn = drawing.finish()?;
            meter.end(&gpu, culler, begun)?;
            Ok::<_, GpuError>(drawn)
        })?;

        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        let ended = pass.end_rounds(&gpu, &mut encoder, timer, &drawing, &drawn.draws)?;
        let settings = &scene.settings.finish;
        let finishing = finish.draw(&gpu, &mut encoder, timer, settings, targets)?;
        let (mut mesh_counts, mut mesh_bytes) = (MeshCounts::default(), 0);
        if let Some(meshes) = meshes {
            let (colors, depths) = finish.finished(targets);
            let list = meshes.list(&gpu, &drawn.objects, DrawOrder::Grouped)?;
            let mut pass = begin_over(&mut encoder, timer, Some(colors), depths);
            mesh_counts = meshes.record(&gpu, &mut pass, &list, MeshOutput::COLOR)?;
            drop(pass);
            mesh_bytes = meshes.take_uploaded_bytes();
        }
        timer.end_frame(&mut encoder);
        gpu.queue().submit([encoder.finish()]);
        timer.after_submit();
        let rounds = DrawCounts {
            dispatches: drawn.dispatches,
            draw_calls: drawn.meshes.draw_calls,
            uploaded_bytes: drawn.uploaded_bytes,
        };
        let counts = total(&[begun, rounds, ended, finishing], &mesh_counts, mesh_bytes);
        Ok((counts, mesh_counts, drawn))
    }

    /// Whether the stamps around passes tell their time. Those of llvmpipe do not: both stamps of a
    /// compute pass are taken with the next pass that rasterizes.
    pub(super) fn has_true_clock(&self) -> bool {
        self.timer.measures() && !self.gpu.is_software()
    }

    pub(super) fn max_pixels(&self) -> u64 {
        match &self.pass {
            GpuPass::Compute(_) => PointsCompute::max_pixels(&self.gpu),
            // Reading back needs a buffer of 4 bytes per pixel.
            GpuPass::Raster(_) => self.gpu.device().limits().max_buffer_size / 8,
        }
    }

    pub(super) fn distances_of_rows(
        &self,
        view: &View,
        rows: std::ops::Range<u32>,
    ) -> Result<Vec<f32>, GpuError> {
        let Some(targets) = &self.targets else { return Ok(Vec::new()) };
        match &self.pass {
            GpuPass::Compute(pass) if !self.has_models_in_depth() => {
                pass.distances_of_rows(&self.gpu, rows)
            }
            _ => {
                let depths = match &self.meshes {
                    Some(_) if self.has_depth => self.finish.finished(targets).1,
                    _ => targets,
                };
                let distances = depths.read_distances(&self.gpu, view.camera.near as f32)?;
                let width = view.width_px as usize;
                Ok(distances[rows.start as usize * width..rows.end as usize * width].to_vec())
            }
        }
    }

    /// Whether the depths of the last frame may hold more than points.
    fn has_models_in_depth(&self) -> bool {
        // A frame without models in sight need not have written depth at all.
        self.meshes.is_some() && self.has_depth
    }

    /// The targets with the colours of the last frame, and those with its depths.
    pub(super) fn finished(&self) -> Option<(&Targets, &Targets)> {
        self.targets.as_ref().map(|targets| self.finish.finished(targets))
    }

    /// The last picture with its distances, read back.
    pub(super) fn read_picture(&self, near: f32) -> Result<Option<Picture>, GpuError> {
        let Some((colors, depths)) = self.finished() else { return Ok(None) };
        let (width, height) = depths.size_px();
        let mut distances = match &self.pass {
            GpuPass::Compute(pass) if !self.finish.fills_gaps() && !self.has_models_in_depth() => {
                pass.distances_of_rows(&self.gpu, 0..height)?
            }
            _ => depths.read_distances(&self.gpu, near)?,
        };
        // Nothing was drawn.
        distances.resize(width as usize * height as usize, f32::INFINITY);
        Ok(Some(Picture { distances, ..colors.read_colors(&self.gpu)? }))
    }
}

#[cfg(feature = "gpu")]
fn point_drawing<'a>(
    scene: &SceneDrawing<'a>,
    targets: &'a Targets,
    wants_depth: bool,
) -> PointDrawing<'a> {
    PointDrawing {
        frame: scene.frame,
        table: scene.table,
        arena: scene.arena,
        targets,
        splat_drawing: scene.settings.cut.splat.drawing,
        wants_depth,
    }
}

#[cfg(feature = "gpu")]
fn total(parts: &[DrawCounts], meshes: &MeshCounts, mesh_bytes: u64) -> DrawCounts {
    DrawCounts {
        dispatches: parts.iter().map(|part| part.dispatches).sum(),
        draw_calls: parts.iter().map(|part| part.draw_calls).sum::<u32>() + meshes.draw_calls,
        uploaded_bytes: parts.iter().map(|part| part.uploaded_bytes).sum::<u64>() + mesh_bytes,
    }
}

/// A pass that draws over a picture that is there, or over its depth alone.
#[cfg(feature = "gpu")]
fn begin_over<'a>(
    encoder: &'a mut wgpu::CommandEncoder,
    timer: &mut PassTimer,
    colors: Option<&Targets>,
    depths: &Targets,
) -> wgpu::RenderPass<'a> {
    let color = colors.map(|colors| wgpu::RenderPassColorAttachment {
        view: colors.color_view(),
        depth_slice: None,
        resolve_target: None,
        ops: wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store },
    });
    let color = [color];
    let label = if color[0].is_some() { "meshes" } else { "mesh depth" };
    let depth = depths.depth_view().map(|view| wgpu::RenderPassDepthStencilAttachment {
        view,
        depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store }),
        stencil_ops: None,
    });
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some(label),
        color_attachments: if color[0].is_some() { &color } else { &[] },
        depth_stencil_attachment: depth,
        timestamp_writes: timer.render_pass(label),
        ..Default::default()
    })
}
