//! The decision in the middle of a frame: which of several alternatives still fits.
//!
//! The stamps of the passes so far are copied into a buffer on the device; one thread there
//! compares the time that is left with what each alternative needs and writes the arguments of
//! indirect dispatches, zeros for all alternatives but one. Nobody waits: the CPU learns of the
//! choice frames later, with the stamps. Shader: `checkpoint.wgsl`. Twin:
//! [`choose_alternative`](crate::budget::choose_alternative).

use crate::gpu::layout::{GpuCheckpoint, GpuDispatch};
use crate::gpu::{Gpu, GpuError, GrowingBuffer, PassTimer, shader};
use crate::passes::bindings::{bind, compute_pipeline, layout, part, pipeline_layout, whole};

/// What is to be decided.
#[derive(Clone, Copy, Debug)]
pub struct Decision<'a> {
    /// Places of the frame's first stamp and of the latest one, in stamps of 8 bytes.
    pub stamps: (u32, u32),
    /// Ticks that the frame may take from its first stamp on.
    pub allowed: u64,
    /// Ticks that each alternative needs, with all that follows; fine to coarse.
    pub needs: &'a [u64],
    /// What is dispatched for which alternative.
    pub dispatches: &'a [GpuDispatch],
}

/// The pass and its buffers.
#[derive(Debug)]
pub struct Checkpoint {
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    stamps: wgpu::Buffer,
    parameters: GrowingBuffer,
    needs: GrowingBuffer,
    dispatches: GrowingBuffer,
    arguments: GrowingBuffer,
}

impl Checkpoint {
    /// Compiles the pass.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let module = shader::module(gpu, "checkpoint")?;
        gpu.checked("build the checkpoint", || {
            let compute = wgpu::ShaderStages::COMPUTE;
            let read = (compute, wgpu::BufferBindingType::Storage { read_only: true });
            let write = (compute, wgpu::BufferBindingType::Storage { read_only: false });
            let uniform = (compute, wgpu::BufferBindingType::Uniform);
            let layout = layout(gpu, "checkpoint", &[uniform, read, read, read, write]);
            let of_pipeline = pipeline_layout(gpu, "checkpoint", &[Some(&layout)]);
            let storage = wgpu::BufferUsages::STORAGE;
            Checkpoint {
                pipeline: compute_pipeline(gpu, &of_pipeline, &module, "decide", &[]),
                layout,
                stamps: gpu.device().create_buffer(&wgpu::BufferDescriptor {
                    label: Some("stamps of the frame so far"),
                    size: PassTimer::RESOLVED_BYTES,
                    usage: storage
                        | wgpu::BufferUsages::QUERY_RESOLVE
                        | wgpu::BufferUsages::COPY_DST,
                    mapped_at_creation: false,
                }),
                parameters: GrowingBuffer::new("checkpoint", wgpu::BufferUsages::UNIFORM),
                needs: GrowingBuffer::new("needs of alternatives", storage),
                dispatches: GrowingBuffer::new("dispatches of alternatives", storage),
                arguments: GrowingBuffer::new(
                    "arguments of dispatches",
                    storage | wgpu::BufferUsages::INDIRECT | wgpu::BufferUsages::COPY_SRC,
                ),
            }
        })
    }

    /// Where the stamps must stand before [`decide`](Self::decide).
    pub fn stamps(&self) -> &wgpu::Buffer {
        &self.stamps
    }

    /// Adds the commands that decide. The buffer then holds three words per dispatch, and after
    /// them the number of the chosen alternative.
    pub fn decide(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        decision: &Decision,
    ) -> Result<&wgpu::Buffer, GpuError> {
        let Decision { stamps, allowed, needs, dispatches } = *decision;
        assert!(!needs.is_empty() && !dispatches.is_empty(), "there is something to decide");
        let parameters = GpuCheckpoint {
            first_stamp: stamps.0,
            last_stamp: stamps.1,
            alternative_count: needs.len() as u32,
            dispatch_count: dispatches.len() as u32,
            allowed_low: allowed as u32,
            allowed_high: (allowed >> 32) as u32,
        };
        let words: Vec<[u32; 2]> =
            needs.iter().map(|&need| [need as u32, (need >> 32) as u32]).collect();
        let arguments_bytes = 4 * (3 * dispatches.len() as u64 + 1);
        let parameter_buffer = self.parameters.write(gpu, &[parameters])?;
        let need_buffer = self.needs.write(gpu, &words)?;
        let dispatch_buffer = self.dispatches.write(gpu, dispatches)?;
        let arguments = self.arguments.reserve(gpu, arguments_bytes)?;
        let group = bind(
            gpu,
            &self.layout,
            &[
                part(parameter_buffer, 0, size_of::<GpuCheckpoint>() as u64),
                whole(&self.stamps),
                whole(need_buffer),
                whole(dispatch_buffer),
                whole(arguments),
            ],
        );
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("checkpoint"),
            timestamp_writes: None,
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(1, 1, 1);
        drop(pass);
        Ok(arguments)
    }
}
