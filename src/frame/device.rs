//! What draws: the CPU, or a pass on a device with its targets and its clock.

#[cfg(feature = "gpu")]
use std::sync::Arc;

#[cfg(feature = "gpu")]
use crate::frame::models::ModelCulling;
#[cfg(feature = "gpu")]
use crate::frame::{CullingAnswers, FrameSettings};
#[cfg(feature = "gpu")]
use crate::geometry::{Aabb, View};
#[cfg(feature = "gpu")]
use crate::gpu::{Gpu, GpuError, PassTimer, WordArena};
#[cfg(feature = "gpu")]
use crate::ids::ObjectId;
#[cfg(feature = "gpu")]
use crate::mesh::Model;
#[cfg(feature = "gpu")]
use crate::passes::{
    CulledMeshes, DrawCounts, DrawOrder, DrawTable, Finish, MeshCounts, MeshOutput, Meshes,
    OcclusionQueries, PointDrawing, PointsCompute, PointsRaster, Targets, TwoPass, TwoPassDrawing,
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
    /// Whether the last frame wrote depth.
    pub(super) has_depth: bool,
    /// How often pixels of models are shaded; other than once to measure.
    pub(super) shading_repeats: u32,
}

/// The pass that draws points there.
#[cfg(feature = "gpu")]
pub(super) enum GpuPass {
    Compute(Box<PointsCompute>),
    Raster(PointsRaster),
}

/// The objects of models that a frame shows.
#[cfg(feature = "gpu")]
pub(super) struct ModelDrawing<'a> {
    pub(super) model: &'a Model,
    pub(super) visible: &'a [ObjectId],
    /// The boxes of all objects; none while what is drawn stays as another camera chose it.
    pub(super) bounds: Option<&'a [Aabb]>,
    pub(super) culling: Option<&'a mut ModelCulling>,
    pub(super) view: &'a View,
}

#[cfg(feature = "gpu")]
impl OnGpu {
    pub(super) fn draw(
        &mut self,
        frame: &crate::gpu::layout::GpuFrame,
        table: &DrawTable,
        arena: &WordArena,
        settings: &FrameSettings,
        models: Option<ModelDrawing>,
    ) -> Result<(DrawCounts, MeshCounts), GpuError> {
        let [width_px, height_px] = frame.target_px;
        if !self.targets.as_ref().is_some_and(|targets| targets.fits(width_px, height_px)) {
            self.targets = None;
            self.targets = Some(Targets::new(&self.gpu, width_px, height_px)?);
        }
        let targets = self.targets.as_ref().expect("they were just made");
        self.timer.begin_frame();
        let gpu = self.gpu.clone();
        let models = models.filter(|models| !models.visible.is_empty());
        if let Some(models) = &models {
            if self.meshes.is_none() {
                self.meshes = Some(Box::new(Meshes::new(&gpu, models.model)?));
            }
            let by_pyramid = settings.answers == CullingAnswers::Pyramid;
            let is_other = |queries: &OcclusionQueries| queries.is_by_pyramid() != by_pyramid;
            if models.culling.is_some() && self.occlusion.as_deref().is_none_or(is_other) {
                self.occlusion = Some(Box::new(match by_pyramid {
                    true => OcclusionQueries::by_pyramid(&gpu)?,
                    false => OcclusionQueries::new(&gpu)?,
                }));
            }
            if settings.culling != Algorithm::TwoPass || !TwoPass::is_offered_by(&gpu) {
                self.two_pass = None;
            } else if self.two_pass.is_none() {
                self.two_pass = Some(Box::new(TwoPass::new(&gpu)?));
            }
        }
        if let Some(meshes) = &mut self.meshes {
            meshes.repeat_shading(self.shading_repeats);
        }
        let (meshes, occlusion) = (&mut self.meshes, &mut self.occlusion);
        let two_pass = &mut self.two_pass;
        let (pass, timer, finish) = (&mut self.pass, &mut self.timer, &mut self.finish);
        let wants_depth = settings.depth || !settings.finish.is_nothing() || models.is_some();
        self.has_depth = wants_depth || matches!(pass, GpuPass::Raster(_));
        let splat_drawing = settings.cut.splat.drawing;
        let drawing = PointDrawing { frame, table, arena, targets, splat_drawing, wants_depth };
        gpu.checked("draw a frame", || {
            let mut encoder = gpu.device().create_command_encoder(&Default::default());
            let counts = match pass {
                GpuPass::Compute(pass) => pass.draw(&gpu, &mut encoder, timer, &drawing),
                GpuPass::Raster(pass) => pass.draw(&gpu, &mut encoder, timer, &drawing),
            }?;
            let finishing = finish.draw(&gpu, &mut encoder, timer, &settings.finish, targets)?;
            let mut mesh_counts = MeshCounts::default();
            let mut mesh_bytes = 0;
            let mut culled = None;
            let mut culling_dispatches = 0;
            // Where points are drawn, a model exactly as far away as one would be shaded over it.
            let shades_after = settings.depth_first && table.draws.is_empty();
            if let (Some(models), Some(meshes)) = (models, meshes) {
                meshes.begin(&gpu, models.view, frame)?;
                match (models.culling, occlusion) {
                    (Some(culling), Some(queries)) => {
                        culled = Some((culling, queries, meshes, models.view));
                    }
                    _ if let (Some(two_pass), Some(bounds)) =
                        (two_pass.as_mut(), models.bounds) =>
                    {
                        let (visible, view) = (models.visible, models.view);
                        let targets = finish.finished(targets);
                        let drawing =
                            TwoPassDrawing { shades_after, bounds, visible, view, frame, targets };
                        let counts = two_pass.record(&gpu, &mut encoder, meshes, &drawing)?;
                        mesh_counts = two_pass.counts().drawn();
                        (mesh_counts.draw_calls, culling_dispatches) = counts;
                        mesh_bytes = meshes.take_uploaded_bytes() + two_pass.take_uploaded_bytes();
                    }
                    _ => {
                        let list = meshes.list(&gpu, models.visible, DrawOrder::Grouped)?;
                        let (colors, depths) = finish.finished(targets);
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
            if let Some(two_pass) = two_pass {
                two_pass.after_submit();
            }
            if let Some((culling, queries, meshes, view)) = culled {
                // Points are drawn by now: they hide objects too.
                let over = finish.finished(targets);
                let ModelCulling { tree, culler, meter } = culling;
                let begun = meter.begin(&gpu, culler)?;
                let mut drawing = CulledMeshes::new(&gpu, queries, meshes, tree, frame, over);
                drawing.shades_after = shades_after;
                culler.frame(tree, view, &mut drawing);
                mesh_counts = drawing.finish()?;
                meter.end(&gpu, culler, begun)?;
                mesh_bytes = meshes.take_uploaded_bytes();
            }
            let counts = DrawCounts {
                dispatches: counts.dispatches + finishing.dispatches + culling_dispatches,
                draw_calls: counts.draw_calls + finishing.draw_calls + mesh_counts.draw_calls,
                uploaded_bytes: counts.uploaded_bytes + finishing.uploaded_bytes + mesh_bytes,
            };
            Ok((counts, mesh_counts))
        })?
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
            GpuPass::Compute(pass) if self.meshes.is_none() => {
                pass.distances_of_rows(&self.gpu, rows)
            }
            _ => {
                let depths = match &self.meshes {
                    Some(_) => self.finish.finished(targets).1,
                    None => targets,
                };
                let distances = depths.read_distances(&self.gpu, view.camera.near as f32)?;
                let width = view.width_px as usize;
                Ok(distances[rows.start as usize * width..rows.end as usize * width].to_vec())
            }
        }
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
            GpuPass::Compute(pass) if !self.finish.fills_gaps() && self.meshes.is_none() => {
                pass.distances_of_rows(&self.gpu, 0..height)?
            }
            _ => depths.read_distances(&self.gpu, near)?,
        };
        // Nothing was drawn.
        distances.resize(width as usize * height as usize, f32::INFINITY);
        Ok(Some(Picture { distances, ..colors.read_colors(&self.gpu)? }))
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
