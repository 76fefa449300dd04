//! Prices of drawing on the adapter that is there, measured once on a made-up surface.
//!
//! Views are designed so that points, pixels and nodes vary against each other: few points under
//! large splats, many under single pixels, nodes of 64 and of 16,384 points. Each is drawn until
//! half a millisecond of drawing or three frames are together; the median counts. The first frames
//! of a pipeline, which compile it, do not.

use std::sync::Arc;
use std::time::Instant;

use crate::budget::{
    CostModel, FrameModel, Heuristic, OverlapSample, Sample, SystemNoise, Workload, quantile,
};
use crate::frame::calibration_cloud::{CalibrationCloud, EDGE};
use crate::frame::device::Device;
use crate::frame::renderer::milliseconds;
use crate::frame::settings::check_view;
use crate::frame::{FrameError, FrameSettings, Renderer};
use crate::geometry::{Camera, View};
use crate::passes::Tile;
use glam::DVec3;

/// What drawing costs on one adapter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// Prices of points, pixels and nodes.
    pub model: CostModel,
    /// The point pass without points, per pixel of the target, milliseconds.
    pub base_px_ms: f64,
    /// All other passes and what no clock sees, per pixel of the target, milliseconds.
    pub setup_px_ms: f64,
    /// CPU part of a frame without points, milliseconds.
    pub cpu_ms: f64,
    /// Per byte sent to the device, milliseconds.
    pub byte_ms: f64,
    /// The system's noise, and how far CPU and GPU work beside each other.
    pub frame: FrameModel,
    /// Views that were timed.
    pub views: usize,
    /// Whether the views did not tell the prices apart, so that points alone are priced.
    pub refused: bool,
    /// Time that measuring took.
    pub calibration_ms: f64,
}

/// Bytes of points that the surface needs.
const MEMORY_BYTES: u64 = 64 << 20;
/// Fewest frames of each view, and most.
const FRAMES: (usize, usize) = (3, 12);
/// Drawing time of each view that is enough.
const ENOUGH_MS: f64 = 0.5;
/// Frames without points that tell the system's noise.
const NOISE_FRAMES: usize = 24;
/// Frames in a row that tell the overlap of CPU and GPU.
const OVERLAP_FRAMES: usize = 6;
/// Confidence of the system's noise.
const CONFIDENCE: f64 = 0.99;
/// Bytes sent to measure sending.
#[cfg(feature = "gpu")]
const UPLOAD_BYTES: usize = 4 << 20;

/// The times of one frame that was waited for, and what was drawn. Loading does not count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameTime {
    /// Counts known before drawing.
    pub work: Workload,
    /// The passes that draw points, by the GPU's clock where it has one, milliseconds.
    pub points_ms: f64,
    /// Until the commands were handed over, milliseconds.
    pub cpu_ms: f64,
    /// Until all was done, milliseconds.
    pub total_ms: f64,
}

/// Distance as a multiple of the one that fits the picture, budget in nodes, factor on splats.
type Design = (f64, u64, f64);
const LARGE_NODES: [Design; 9] = [
    (1.0, 1, 1.0),
    (1.0, 5, 1.0),
    (1.0, 21, 1.0),
    (1.0, 85, 1.0),
    (1.0, 1, 2.5),
    (1.0, 5, 2.5),
    (1.0, 21, 2.5),
    (6.0, 21, 0.5),
    (6.0, 85, 0.5),
];
const SMALL_NODES: [Design; 3] = [(1.0, 341, 1.0), (6.0, 341, 0.5), (1.0, 85, 2.5)];

impl Renderer {
    /// Measures what drawing costs here, for pictures of that size. Takes about a second on a
    /// software adapter; what is loaded of the scene stays.
    pub fn calibrate(&self, width_px: u32, height_px: u32) -> Result<Calibration, FrameError> {
        let start = Instant::now();
        let mut twin = self.twin()?;
        let pixels = f64::from(width_px) * f64::from(height_px);
        let mut samples = Vec::new();
        let mut overlap = Vec::new();
        let mut empty = Vec::new();
        for (levels, depth, designs) in [(7, 3, &LARGE_NODES[..]), (3, 4, &SMALL_NODES[..])] {
            let cloud = CalibrationCloud::new(levels, depth);
            let node_points = 4u64.pow(levels);
            twin.set_scene(vec![Arc::new(cloud)]);
            if empty.is_empty() {
                // One point: what a frame costs before it draws any.
                let (view, settings) = designed((1.0, 0, 1.0), 1, width_px, height_px);
                twin.warm_up(&view, &settings)?;
                for _ in 0..NOISE_FRAMES {
                    empty.push(twin.time_frame(&view, &settings)?);
                }
            }
            for &design in designs {
                let (view, settings) = designed(design, node_points, width_px, height_px);
                twin.warm_up(&view, &settings)?;
                let mut times = Vec::new();
                while times.len() < FRAMES.0
                    || times.len() < FRAMES.1
                        && times.iter().map(|t: &FrameTime| t.points_ms).sum::<f64>() < ENOUGH_MS
                {
                    times.push(twin.time_frame(&view, &settings)?);
                }
                let work = times[0].work;
                samples.push((work, median(&times, |t| t.points_ms)));
                if design == (1.0, 21, 1.0) {
                    overlap.push(twin.overlap_sample(&view, &settings, &times)?);
                }
            }
        }
        let base_ms = median(&empty, |t| t.points_ms);
        let samples: Vec<Sample> = samples
            .into_iter()
            .map(|(work, points_ms)| Sample { work, time_ms: beyond_base(points_ms, base_ms) })
            .collect();
        let fitted = CostModel::fit(Heuristic::Blend, &samples)
            .or_else(|_| CostModel::fit(Heuristic::Transformed, &samples));
        let refused = fitted.as_ref().map_or(true, |m| m.heuristic != Heuristic::Blend);
        let totals: Vec<f64> = empty.iter().map(|t| t.total_ms).collect();
        let noise = SystemNoise::of(&totals, CONFIDENCE);
        let system_ms = noise.map_or(0.0, |noise| noise.constant_ms);
        let cpu_ms = median(&empty, |t| t.cpu_ms);
        let setup_ms = median(&empty, |t| t.total_ms) - cpu_ms - base_ms;
        Ok(Calibration {
            model: fitted.unwrap_or_else(|_| careful_guess()),
            base_px_ms: base_ms / pixels,
            setup_px_ms: setup_ms.max(0.0) / pixels,
            cpu_ms,
            byte_ms: twin.upload_byte_ms()?,
            // With noise left out, because the samples are medians.
            frame: FrameModel {
                system_ms,
                ..FrameModel::fit(0.0, &overlap).unwrap_or(FrameModel::PARALLEL)
            },
            views: samples.len(),
            refused,
            calibration_ms: milliseconds(start),
        })
    }

    /// Another renderer on the same device, without a scene.
    fn twin(&self) -> Result<Renderer, FrameError> {
        match &self.device {
            Device::Cpu { .. } => Ok(Renderer::on_cpu(MEMORY_BYTES)),
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => Renderer::on_gpu(on_gpu.gpu.clone(), self.path(), MEMORY_BYTES),
        }
    }

    /// Loads what a view needs, and lets pipelines compile.
    fn warm_up(&mut self, view: &View, settings: &FrameSettings) -> Result<(), FrameError> {
        (0..2).try_for_each(|_| self.time_frame(view, settings).map(drop))
    }

    /// Draws a frame and waits for it; for measurements.
    pub fn time_frame(
        &mut self,
        view: &View,
        settings: &FrameSettings,
    ) -> Result<FrameTime, FrameError> {
        check_view(view)?;
        self.last = None;
        let work = self.trial_workload(view, settings);
        let start = Instant::now();
        self.prepare(view, settings, settings)?;
        #[cfg(feature = "gpu")]
        let prepared_ms = milliseconds(start);
        self.draw(view, Tile::whole(view), settings)?;
        let cpu_ms = milliseconds(start);
        let spent = |renderer: &Renderer, pass: &str| {
            let of_pass =
                renderer.stats.passes.iter().filter(|p| p.pass == pass && p.clock == "cpu");
            of_pass.map(|p| p.pass_ms).sum::<f64>()
        };
        // The first frame reads nodes; later ones do not.
        let load_ms = spent(self, "load");
        let cpu_ms = cpu_ms - load_ms;
        match &mut self.device {
            Device::Cpu { .. } => {
                let drawing_ms = spent(self, "points") + spent(self, "resolve");
                let points_ms = spent(self, "points");
                Ok(FrameTime { work, points_ms, cpu_ms: cpu_ms - drawing_ms, total_ms: cpu_ms })
            }
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => {
                on_gpu.gpu.wait()?;
                let total_ms = milliseconds(start);
                let measured = on_gpu.timer.take_measured().pop();
                let points_ms = match measured.filter(|_| on_gpu.has_true_clock()) {
                    Some(frame) => super::pacing::points_ms(&frame.passes),
                    // Without the GPU's clock, the time from the first command to the end. Software
                    // adapters work while commands are handed over.
                    None => total_ms - prepared_ms,
                };
                let cpu_ms = match on_gpu.has_true_clock() {
                    true => cpu_ms,
                    false => prepared_ms - load_ms,
                };
                Ok(FrameTime { work, points_ms, cpu_ms, total_ms: total_ms - load_ms })
            }
        }
    }

    /// Draws frames one after the other without waiting in between: the time per frame beside the
    /// times of its parts.
    fn overlap_sample(
        &mut self,
        view: &View,
        settings: &FrameSettings,
        alone: &[FrameTime],
    ) -> Result<OverlapSample, FrameError> {
        let cpu_ms = median(alone, |t| t.cpu_ms);
        let gpu_ms = median(alone, |t| t.total_ms - t.cpu_ms);
        let start = Instant::now();
        for _ in 0..OVERLAP_FRAMES {
            self.prepare(view, settings, settings)?;
            self.draw(view, Tile::whole(view), settings)?;
        }
        #[cfg(feature = "gpu")]
        if let Device::Gpu(on_gpu) = &mut self.device {
            on_gpu.gpu.wait()?;
            on_gpu.timer.take_measured();
        }
        let frame_ms = milliseconds(start) / OVERLAP_FRAMES as f64;
        Ok(OverlapSample { cpu_ms, gpu_ms, frame_ms })
    }

    /// Milliseconds per byte on the way to the device.
    fn upload_byte_ms(&self) -> Result<f64, FrameError> {
        match &self.device {
            // Nodes stay where they were decoded; a copy within memory is the least it can cost.
            Device::Cpu { .. } => Ok(1e-7),
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => {
                let gpu = &on_gpu.gpu;
                let buffer = gpu.checked("measure uploads", || {
                    gpu.device().create_buffer(&wgpu::BufferDescriptor {
                        label: Some("measured uploads"),
                        size: UPLOAD_BYTES as u64,
                        usage: wgpu::BufferUsages::COPY_DST,
                        mapped_at_creation: false,
                    })
                })?;
                let bytes = vec![0x5au8; UPLOAD_BYTES];
                let mut times = Vec::new();
                for _ in 0..4 {
                    let start = Instant::now();
                    gpu.queue().write_buffer(&buffer, 0, &bytes);
                    gpu.queue().submit([]);
                    gpu.wait()?;
                    times.push(milliseconds(start));
                }
                // The first one makes room.
                Ok(quantile(&times[1..], 0.5).unwrap_or(1.0) / UPLOAD_BYTES as f64)
            }
        }
    }
}

/// What a point pass takes beyond one without points. Never less than a quarter of it: a base that
/// was measured while the machine was busy must not leave nothing.
pub(super) fn beyond_base(points_ms: f64, base_ms: f64) -> f64 {
    (points_ms - base_ms).max(0.25 * points_ms)
}

/// The view and settings of a design.
fn designed(
    (distance, nodes, multiplier): Design,
    node_points: u64,
    width_px: u32,
    height_px: u32,
) -> (View, FrameSettings) {
    let fov_y_rad = 60f64.to_radians();
    let fit = 0.5 * EDGE / (0.5 * fov_y_rad).tan();
    let middle = DVec3::new(0.5 * EDGE, 0.5 * EDGE, 0.0);
    let eye = middle + DVec3::Z * (fit * distance);
    let camera = Camera::looking_at(eye, middle, DVec3::Y, fov_y_rad, 0.1);
    let mut settings = FrameSettings::default();
    settings.cut.point_budget = nodes * node_points;
    settings.cut.error_px = 1e-6;
    settings.cut.splat.multiplier = multiplier;
    (View { camera, width_px, height_px }, settings)
}

/// Prices where nothing could be measured: a slow machine's.
fn careful_guess() -> CostModel {
    CostModel { vertex_ms: 1e-4, pixel_ms: 1e-5, draw_ms: 1e-2, ..CostModel::free(Heuristic::Sum) }
}

fn median(times: &[FrameTime], of: impl Fn(&FrameTime) -> f64) -> f64 {
    quantile(&times.iter().map(of).collect::<Vec<_>>(), 0.5).unwrap_or(0.0)
}
