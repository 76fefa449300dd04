//! Points drawn by compute shaders with 64-bit atomic maximum, and their resolve into textures.
//!
//! One dispatch per shard of words and kind of node, whatever the number of nodes: a batch table
//! tells each workgroup its node and points. Shaders: `points_compute.wgsl`, `resolve.wgsl`. Twin:
//! [`PointsCpu`](crate::passes::PointsCpu).

use std::num::NonZeroU64;
use std::ops::Range;

use crate::gpu::layout::{GpuBatch, GpuFrame};
use crate::gpu::{Gpu, GpuError, GrowingBuffer, PassTimer, read_buffer, shader};
use crate::passes::{Batches, DrawCounts, PointDrawing, Targets};

/// The pass, its pipelines and its tables.
#[derive(Debug)]
pub struct PointsCompute {
    /// By [`variant`] of the kind of batch.
    points: [wgpu::ComputePipeline; 4],
    batch_points: u32,
    resolve: wgpu::RenderPipeline,
    frame_layout: wgpu::BindGroupLayout,
    scene_layout: wgpu::BindGroupLayout,
    draw_pixels_layout: wgpu::BindGroupLayout,
    resolve_pixels_layout: wgpu::BindGroupLayout,
    frame: GrowingBuffer,
    nodes: GrowingBuffer,
    batches: GrowingBuffer,
    pixels: GrowingBuffer,
    batch_list: Batches,
    target_px: [u32; 2],
}

/// Points of a workgroup on a GPU: enough to spread the look-up of the node, few enough to fill all
/// cores.
const BATCH_POINTS: u32 = 1024;
/// Points of a workgroup on a software adapter, which has few cores and pays more per workgroup.
const SOFTWARE_BATCH_POINTS: u32 = 4096;
/// The pipelines: whether nodes are wide, whether all splats are single pixels.
const KINDS: [(bool, bool); 4] = [(false, false), (false, true), (true, false), (true, true)];
const BATCH_BYTES: u64 = size_of::<GpuBatch>() as u64;

impl PointsCompute {
    /// Compiles the pass; the device must have 64-bit atomic minimum and maximum.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        if !gpu.draws_by_compute() {
            return Err(gpu.unsupported("compute", "no 64-bit atomic minimum and maximum"));
        }
        let points_shader = shader::module(gpu, "points_compute")?;
        let resolve_shader = shader::module(gpu, "resolve")?;
        gpu.checked("build the compute point pass", || {
            let compute = wgpu::ShaderStages::COMPUTE;
            let fragment = wgpu::ShaderStages::FRAGMENT;
            let read_only = wgpu::BufferBindingType::Storage { read_only: true };
            let read_write = wgpu::BufferBindingType::Storage { read_only: false };
            let frame_layout =
                layout(gpu, "frame", &[(compute | fragment, wgpu::BufferBindingType::Uniform)]);
            let scene_layout = layout(gpu, "nodes, words, batches", &[(compute, read_only); 3]);
            let draw_pixels_layout = layout(gpu, "pixels, drawn", &[(compute, read_write)]);
            let resolve_pixels_layout = layout(gpu, "pixels, resolved", &[(fragment, read_only)]);
            let draw_groups = [Some(&frame_layout), Some(&scene_layout), Some(&draw_pixels_layout)];
            let points = KINDS.map(|(wide, single_pixels)| {
                compute_pipeline(gpu, &points_shader, &draw_groups, wide, single_pixels)
            });
            let batch_points = match gpu.is_software() {
                true => SOFTWARE_BATCH_POINTS,
                false => BATCH_POINTS,
            };
            let resolve = resolve_pipeline(
                gpu,
                &resolve_shader,
                &[Some(&frame_layout), None, Some(&resolve_pixels_layout)],
            );
            let storage = wgpu::BufferUsages::STORAGE;
            PointsCompute {
                points,
                batch_points,
                resolve,
                frame_layout,
                scene_layout,
                draw_pixels_layout,
                resolve_pixels_layout,
                frame: GrowingBuffer::new("frame", wgpu::BufferUsages::UNIFORM),
                nodes: GrowingBuffer::new("drawn nodes", storage),
                batches: GrowingBuffer::new("batches", storage),
                pixels: GrowingBuffer::new("pixels", storage | wgpu::BufferUsages::COPY_SRC),
                batch_list: Batches::default(),
                target_px: [0, 0],
            }
        })
    }

    /// Most pixels of one target: its pixels must fit one binding.
    pub fn max_pixels(gpu: &Gpu) -> u64 {
        let limits = gpu.device().limits();
        limits.max_storage_buffer_binding_size.min(limits.max_buffer_size) / 8
    }

    /// Adds the commands that draw a table into its targets.
    pub fn draw(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut PassTimer,
        drawing: &PointDrawing,
    ) -> Result<DrawCounts, GpuError> {
        let PointDrawing { frame, table, arena, targets } = *drawing;
        self.target_px = frame.target_px;
        if table.draws.is_empty() {
            self.target_px = [0, 0];
            targets.clear(encoder, frame.background);
            return Ok(DrawCounts::default());
        }
        let alignment = u64::from(gpu.device().limits().min_storage_buffer_offset_alignment);
        // Batches have a multiple of 4 bytes.
        let align = (alignment / 4).max(1) as usize;
        table.batches(self.batch_points, align, &mut self.batch_list);
        let uploaded_bytes = (size_of::<GpuFrame>()
            + size_of_val(&table.nodes[..])
            + size_of_val(&self.batch_list.list[..])) as u64;
        let pixel_bytes = 8 * u64::from(frame.target_px[0]) * u64::from(frame.target_px[1]);
        let frame_buffer = self.frame.write(gpu, &[*frame])?;
        let nodes = self.nodes.write(gpu, &table.nodes)?;
        let batches = self.batches.write(gpu, &self.batch_list.list)?;
        let pixels = self.pixels.reserve(gpu, pixel_bytes)?;

        let frame_group = bind(gpu, &self.frame_layout, &[whole(frame_buffer)]);
        let pixel_range = part(pixels, 0, pixel_bytes);
        let draw_pixels = bind(gpu, &self.draw_pixels_layout, std::slice::from_ref(&pixel_range));
        let resolve_pixels = bind(gpu, &self.resolve_pixels_layout, &[pixel_range]);

        encoder.clear_buffer(pixels, 0, Some(pixel_bytes));
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("points"),
                timestamp_writes: timer.compute_pass("points"),
            });
            pass.set_bind_group(0, &frame_group, &[]);
            pass.set_bind_group(2, &draw_pixels, &[]);
            for (kind, range) in &self.batch_list.groups {
                let first_byte = range.start as u64 * BATCH_BYTES;
                let bytes = range.len() as u64 * BATCH_BYTES;
                let scene = bind(
                    gpu,
                    &self.scene_layout,
                    &[
                        part(nodes, 0, size_of_val(&table.nodes[..]) as u64),
                        whole(arena.buffer(kind.shard)),
                        part(batches, first_byte, bytes),
                    ],
                );
                pass.set_pipeline(&self.points[variant(kind.wide, kind.single_pixels)]);
                pass.set_bind_group(1, &scene, &[]);
                let row = (range.len() as u32).min(MAX_WORKGROUPS_PER_ROW);
                pass.dispatch_workgroups(row, (range.len() as u32).div_ceil(row), 1);
            }
        }
        let (color, depth) = targets.cleared(frame.background);
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("resolve"),
            color_attachments: &[Some(color)],
            depth_stencil_attachment: Some(depth),
            timestamp_writes: timer.render_pass("resolve"),
            ..Default::default()
        });
        pass.set_pipeline(&self.resolve);
        pass.set_bind_group(0, &frame_group, &[]);
        pass.set_bind_group(2, &resolve_pixels, &[]);
        pass.draw(0..3, 0..1);
        drop(pass);
        Ok(DrawCounts {
            dispatches: self.batch_list.groups.len() as u32,
            draw_calls: 1,
            uploaded_bytes,
        })
    }

    /// Distances of whole rows of the last target drawn, infinite where nothing is. Waits for the
    /// GPU.
    pub fn distances_of_rows(&self, gpu: &Gpu, rows: Range<u32>) -> Result<Vec<f32>, GpuError> {
        let [width, height] = self.target_px;
        let Some(pixels) = self.pixels.get().filter(|_| rows.end <= height) else {
            return Ok(Vec::new());
        };
        let row_bytes = 8 * u64::from(width);
        let (offset, bytes) = (u64::from(rows.start) * row_bytes, rows.len() as u64 * row_bytes);
        let bytes = read_buffer(gpu, pixels, offset, bytes)?;
        let words: Vec<u32> = bytemuck::pod_collect_to_vec(&bytes);
        let distance = |pixel: &[u32]| match pixel[1] {
            0 => f32::INFINITY,
            inverted => f32::from_bits(!inverted),
        };
        Ok(words.chunks_exact(2).map(distance).collect())
    }

    /// Bytes held on the device.
    pub fn held_bytes(&self) -> u64 {
        [&self.frame, &self.nodes, &self.batches, &self.pixels]
            .map(GrowingBuffer::held_bytes)
            .iter()
            .sum()
    }
}

/// Within the limit that every adapter grants.
const MAX_WORKGROUPS_PER_ROW: u32 = 32_768;

/// Index in [`KINDS`].
fn variant(wide: bool, single_pixels: bool) -> usize {
    2 * usize::from(wide) + usize::from(single_pixels)
}

/// A layout of buffers, bound in order.
pub(super) fn layout(
    gpu: &Gpu,
    label: &str,
    entries: &[(wgpu::ShaderStages, wgpu::BufferBindingType)],
) -> wgpu::BindGroupLayout {
    let entries: Vec<_> = entries
        .iter()
        .zip(0..)
        .map(|(&(visibility, ty), binding)| wgpu::BindGroupLayoutEntry {
            binding,
            visibility,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
            count: None,
        })
        .collect();
    gpu.device().create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some(label),
        entries: &entries,
    })
}

/// Buffers for a layout, in order.
pub(super) fn bind(
    gpu: &Gpu,
    layout: &wgpu::BindGroupLayout,
    buffers: &[wgpu::BindingResource],
) -> wgpu::BindGroup {
    let entries: Vec<_> = buffers
        .iter()
        .zip(0..)
        .map(|(resource, binding)| wgpu::BindGroupEntry { binding, resource: resource.clone() })
        .collect();
    gpu.device().create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout,
        entries: &entries,
    })
}

/// A whole buffer as a binding.
pub(super) fn whole(buffer: &wgpu::Buffer) -> wgpu::BindingResource<'_> {
    buffer.as_entire_binding()
}

/// Bytes of a buffer as a binding.
pub(super) fn part(buffer: &wgpu::Buffer, offset: u64, bytes: u64) -> wgpu::BindingResource<'_> {
    let size = NonZeroU64::new(bytes);
    wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer, offset, size })
}

fn compute_pipeline(
    gpu: &Gpu,
    shader: &wgpu::ShaderModule,
    groups: &[Option<&wgpu::BindGroupLayout>],
    wide: bool,
    single_pixels: bool,
) -> wgpu::ComputePipeline {
    let layout = gpu.device().create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("points"),
        bind_group_layouts: groups,
        immediate_size: 0,
    });
    gpu.device().create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some("points"),
        layout: Some(&layout),
        module: shader,
        entry_point: Some("draw_points"),
        compilation_options: wgpu::PipelineCompilationOptions {
            constants: &[
                ("WIDE_NODES", f64::from(wide)),
                ("SINGLE_PIXELS", f64::from(single_pixels)),
            ],
            ..Default::default()
        },
        cache: None,
    })
}

fn resolve_pipeline(
    gpu: &Gpu,
    shader: &wgpu::ShaderModule,
    groups: &[Option<&wgpu::BindGroupLayout>],
) -> wgpu::RenderPipeline {
    let layout = gpu.device().create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("resolve"),
        bind_group_layouts: groups,
        immediate_size: 0,
    });
    gpu.device().create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("resolve"),
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module: shader,
            entry_point: Some("cover_target"),
            compilation_options: Default::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(Targets::depth_state(wgpu::CompareFunction::Always)),
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: shader,
            entry_point: Some("resolve"),
            compilation_options: Default::default(),
            targets: &[Some(Targets::COLOR_FORMAT.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
