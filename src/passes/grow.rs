//! Splats grown from single pixels in screen space, for frames whose splats all share a size.
//!
//! Drawing splats one by one takes time with their number times their area; growing takes time
//! with the area of the picture times the side of a splat (the area, for discs), whatever the
//! number of points. Both give the same picture, see `grow.wgsl` and `docs/splats.md`. Shader:
//! `grow.wgsl`. Twin: [`PointsCpu`](crate::passes::PointsCpu), which draws splats one by one.

use crate::gpu::layout::{GpuFrame, ROUND, SPHERE, WORKGROUP_SIZE};
use crate::gpu::{Gpu, GpuError, GrowingBuffer, PassTimer, shader};
use crate::passes::PointDrawing;
use crate::passes::bindings::{bind, compute_pipeline, layout, part, pipeline_layout};
use crate::select::SplatDrawing;

/// The pass and its pixels.
#[derive(Debug)]
pub(super) struct Grow {
    rows: wgpu::ComputePipeline,
    columns: wgpu::ComputePipeline,
    discs: wgpu::ComputePipeline,
    pixels_layout: wgpu::BindGroupLayout,
    /// As wide as the picture, as high as what was drawn.
    between: GrowingBuffer,
    grown: GrowingBuffer,
}

/// Reads of a pixel that take as long as drawing one pixel of a splat, which is an atomic
/// operation; measured, see `docs/splats.md`.
const READS_PER_SPLAT_PIXEL: f64 = 0.4;

impl Grow {
    /// Compiles the pass.
    pub(super) fn new(gpu: &Gpu, frame_layout: &wgpu::BindGroupLayout) -> Result<Self, GpuError> {
        let module = shader::module(gpu, "grow")?;
        gpu.checked("build the growing pass", || {
            let compute = wgpu::ShaderStages::COMPUTE;
            let storage = |read_only| wgpu::BufferBindingType::Storage { read_only };
            let pixels_layout = layout(
                gpu,
                "pixels, grown",
                &[(compute, storage(true)), (compute, storage(false))],
            );
            let groups = [Some(frame_layout), None, Some(&pixels_layout)];
            let pipelines = pipeline_layout(gpu, "grow", &groups);
            let pipeline = |entry, shape: u32| {
                let constants = [("SPLAT_SHAPE", f64::from(shape))];
                compute_pipeline(gpu, &pipelines, &module, entry, &constants)
            };
            let usage = wgpu::BufferUsages::STORAGE;
            Grow {
                rows: pipeline("grow_rows", 0),
                columns: pipeline("grow_columns", 0),
                discs: pipeline("grow_discs", ROUND),
                pixels_layout,
                between: GrowingBuffer::new("grown rows", usage),
                grown: GrowingBuffer::new("grown", usage | wgpu::BufferUsages::COPY_SRC),
            }
        })
    }

    /// Pixels around the picture that are drawn so that splats can be grown; 0 if they are not to
    /// be.
    pub(super) fn margin_px(drawing: &PointDrawing, max_pixels: u64) -> u32 {
        let PointDrawing { frame, table, .. } = *drawing;
        let may = frame.nested_splats != 0 && frame.splat_shape != SPHERE;
        if !may || drawing.splat_drawing == SplatDrawing::OneByOne {
            return 0;
        }
        let largest_px = table.largest_splat_px.min(f64::from(frame.max_splat_px)).ceil() as u32;
        let side = largest_px | u32::from(frame.splat_shape == ROUND);
        let margin = side / 2;
        let [width, height] = frame.target_px.map(|px| u64::from(px) + 2 * u64::from(margin));
        if margin == 0 || width * height > 2 * max_pixels {
            return 0;
        }
        let pixels = f64::from(frame.target_px[0]) * f64::from(frame.target_px[1]);
        let reads = match frame.splat_shape {
            ROUND => f64::from(side) * f64::from(side),
            _ => 2.0 * f64::from(side),
        };
        let pays = reads * pixels < table.splat_pixels as f64 * READS_PER_SPLAT_PIXEL;
        if pays || drawing.splat_drawing == SplatDrawing::Grown { margin } else { 0 }
    }

    /// Adds the commands that grow what was drawn; returns their dispatches. `frame` is that of the
    /// picture.
    pub(super) fn draw(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut PassTimer,
        frame: &GpuFrame,
        frame_group: &wgpu::BindGroup,
        drawn: wgpu::BindingResource,
    ) -> Result<u32, GpuError> {
        let [width, height] = frame.target_px;
        let high = height + 2 * frame.grow_margin_px;
        let bytes = |rows: u32| 8 * u64::from(width) * u64::from(rows);
        let is_round = frame.splat_shape == ROUND;
        let grown = part(self.grown.reserve(gpu, bytes(height))?, 0, bytes(height));
        let steps: Vec<_> = if is_round {
            vec![(&self.discs, bind(gpu, &self.pixels_layout, &[drawn, grown]), height)]
        } else {
            let between = part(self.between.reserve(gpu, bytes(high))?, 0, bytes(high));
            vec![
                (&self.rows, bind(gpu, &self.pixels_layout, &[drawn, between.clone()]), high),
                (&self.columns, bind(gpu, &self.pixels_layout, &[between, grown]), height),
            ]
        };
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("grow"),
            timestamp_writes: timer.compute_pass("grow"),
        });
        pass.set_bind_group(0, frame_group, &[]);
        for (pipeline, pixels, rows) in &steps {
            pass.set_pipeline(pipeline);
            pass.set_bind_group(2, pixels, &[]);
            pass.dispatch_workgroups(width.div_ceil(WORKGROUP_SIZE), *rows, 1);
        }
        Ok(steps.len() as u32)
    }

    /// The grown pixels, once some were.
    pub(super) fn pixels(&self) -> Option<&wgpu::Buffer> {
        self.grown.get()
    }

    /// Bytes held on the device.
    pub(super) fn held_bytes(&self) -> u64 {
        self.between.held_bytes() + self.grown.held_bytes()
    }
}
