//! What draws: the CPU, or a pass on a device with its targets and its clock.

#[cfg(feature = "gpu")]
use std::sync::Arc;

#[cfg(feature = "gpu")]
use crate::frame::FrameSettings;
#[cfg(feature = "gpu")]
use crate::geometry::View;
#[cfg(feature = "gpu")]
use crate::gpu::{Gpu, GpuError, PassTimer, WordArena};
#[cfg(feature = "gpu")]
use crate::passes::{
    DrawCounts, DrawTable, Finish, PointDrawing, PointsCompute, PointsRaster, Targets,
};
use crate::passes::{Picture, PointsCpu};

/// Where points are drawn.
pub(super) enum Device {
    Cpu {
        pass: PointsCpu,
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
    /// Whether the last frame wrote depth.
    pub(super) has_depth: bool,
}

/// The pass that draws points there.
#[cfg(feature = "gpu")]
pub(super) enum GpuPass {
    Compute(Box<PointsCompute>),
    Raster(PointsRaster),
}
#[cfg(feature = "gpu")]
impl OnGpu {
    pub(super) fn draw(
        &mut self,
        frame: &crate::gpu::layout::GpuFrame,
        table: &DrawTable,
        arena: &WordArena,
        settings: &FrameSettings,
    ) -> Result<DrawCounts, GpuError> {
        let [width_px, height_px] = frame.target_px;
        if !self.targets.as_ref().is_some_and(|targets| targets.fits(width_px, height_px)) {
            self.targets = None;
            self.targets = Some(Targets::new(&self.gpu, width_px, height_px)?);
        }
        let targets = self.targets.as_ref().expect("they were just made");
        self.timer.begin_frame();
        let gpu = self.gpu.clone();
        let (pass, timer, finish) = (&mut self.pass, &mut self.timer, &mut self.finish);
        let wants_depth = settings.depth || !settings.finish.is_nothing();
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
            timer.end_frame(&mut encoder);
            gpu.queue().submit([encoder.finish()]);
            timer.after_submit();
            Ok(DrawCounts {
                dispatches: counts.dispatches + finishing.dispatches,
                draw_calls: counts.draw_calls + finishing.draw_calls,
                uploaded_bytes: counts.uploaded_bytes + finishing.uploaded_bytes,
            })
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
            GpuPass::Compute(pass) => pass.distances_of_rows(&self.gpu, rows),
            GpuPass::Raster(_) => {
                let distances = targets.read_distances(&self.gpu, view.camera.near as f32)?;
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
            GpuPass::Compute(pass) if !self.finish.fills_gaps() => {
                pass.distances_of_rows(&self.gpu, 0..height)?
            }
            _ => depths.read_distances(&self.gpu, near)?,
        };
        // Nothing was drawn.
        distances.resize(width as usize * height as usize, f32::INFINITY);
        Ok(Some(Picture { distances, ..colors.read_colors(&self.gpu)? }))
    }
}
