//! The least that drawing points by compute can be: one flat list of points, one thread each, no
//! nodes, no splats, no resolve. What suites measure the passes against. Shader:
//! `points_bare.wgsl`.

use crate::gpu::layout::{GpuFrame, GpuNode};
use crate::gpu::{Gpu, GpuError, GrowingBuffer, PassTimer, shader};
use crate::passes::bindings::{bind, compute_pipeline, layout, pipeline_layout, whole};

/// As in `points_bare.wgsl`.
const WORKGROUP_SIZE: u32 = 128;
/// Within the limit that every adapter grants.
const MAX_WORKGROUPS_PER_ROW: u32 = 32_768;

/// The pass over one list.
#[derive(Debug)]
pub struct PointsBare {
    pipeline: wgpu::ComputePipeline,
    groups: [wgpu::BindGroup; 3],
    frame: GrowingBuffer,
    node: GrowingBuffer,
    pixels: GrowingBuffer,
    _words: GrowingBuffer,
    pixel_bytes: u64,
    count: u32,
}

impl PointsBare {
    /// A pass over `count` points: two words per position (Morton codes), then one per colour. The
    /// device must have 64-bit atomics.
    pub fn new(
        gpu: &Gpu,
        words: &[u32],
        count: u32,
        [width_px, height_px]: [u32; 2],
    ) -> Result<Self, GpuError> {
        if !gpu.draws_by_compute() {
            return Err(gpu.unsupported("compute", "no 64-bit atomic minimum and maximum"));
        }
        let module = shader::module_with(gpu, "points_bare", gpu.wide_atomics())?;
        let storage = wgpu::BufferUsages::STORAGE;
        let mut frame = GrowingBuffer::new("bare frame", wgpu::BufferUsages::UNIFORM);
        let mut node = GrowingBuffer::new("bare node", storage);
        let mut pixels = GrowingBuffer::new("bare pixels", storage);
        let mut held = GrowingBuffer::new("bare words", storage);
        let pixel_bytes = 8 * u64::from(width_px) * u64::from(height_px);
        frame.reserve(gpu, size_of::<GpuFrame>() as u64)?;
        node.reserve(gpu, size_of::<GpuNode>() as u64)?;
        pixels.reserve(gpu, pixel_bytes)?;
        held.write(gpu, words)?;
        let buffers = [&frame, &node, &held, &pixels].map(|buffer| buffer.get().expect("reserved"));
        let (pipeline, groups) = gpu.checked("build the bare pass", || {
            let compute = wgpu::ShaderStages::COMPUTE;
            let stored = |read_only| (compute, wgpu::BufferBindingType::Storage { read_only });
            let frames = layout(gpu, "bare", &[(compute, wgpu::BufferBindingType::Uniform)]);
            let scene = layout(gpu, "bare", &[stored(true), stored(true)]);
            let targets = layout(gpu, "bare", &[stored(false)]);
            let layouts = [Some(&frames), Some(&scene), Some(&targets)];
            let pipelines = pipeline_layout(gpu, "bare", &layouts);
            let groups = [
                bind(gpu, &frames, &[whole(buffers[0])]),
                bind(gpu, &scene, &[whole(buffers[1]), whole(buffers[2])]),
                bind(gpu, &targets, &[whole(buffers[3])]),
            ];
            let constants = [("LOOKS_FIRST", f64::from(!gpu.is_software()))];
            (compute_pipeline(gpu, &pipelines, &module, "draw_bare", &constants), groups)
        })?;
        Ok(PointsBare { pipeline, groups, frame, node, pixels, _words: held, pixel_bytes, count })
    }

    /// Draws the list and waits for it. `node` places the list as a node of its own: its
    /// `drawn_count` and `colors_at` are those of the list.
    pub fn draw(
        &mut self,
        gpu: &Gpu,
        timer: &mut PassTimer,
        frame: &GpuFrame,
        node: &GpuNode,
    ) -> Result<(), GpuError> {
        let node = GpuNode { drawn_count: self.count, colors_at: 2 * self.count, ..*node };
        self.frame.write(gpu, &[*frame])?;
        self.node.write(gpu, &[node])?;
        timer.begin_frame();
        gpu.checked("draw the bare pass", || {
            let mut encoder = gpu.device().create_command_encoder(&Default::default());
            let pixels = self.pixels.get().expect("reserved");
            encoder.clear_buffer(pixels, 0, Some(self.pixel_bytes));
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("bare"),
                timestamp_writes: timer.compute_pass("bare"),
            });
            pass.set_pipeline(&self.pipeline);
            for (group, index) in self.groups.iter().zip(0..) {
                pass.set_bind_group(index, group, &[]);
            }
            let workgroups = self.count.div_ceil(WORKGROUP_SIZE).max(1);
            let row = workgroups.min(MAX_WORKGROUPS_PER_ROW);
            pass.dispatch_workgroups(row, workgroups.div_ceil(row), 1);
            drop(pass);
            timer.end_frame(&mut encoder);
            gpu.queue().submit([encoder.finish()]);
            timer.after_submit();
        })?;
        gpu.wait()
    }
}
