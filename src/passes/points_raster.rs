//! Points drawn by the rasterizer, for adapters without 64-bit atomics.
//!
//! One draw per node: a point list where no splat exceeds a pixel (WebGPU has no point size), two
//! triangles per point elsewhere. Both cover exactly the pixels of the compute pass; of points at
//! the same depth the first drawn stays, where compute keeps the smaller colour word. Shader:
//! `points_raster.wgsl`.

use crate::gpu::layout::GpuFrame;
use crate::gpu::{Gpu, GpuError, GrowingBuffer, PassTimer, shader};
use crate::passes::points_compute::{bind, layout, part, whole};
use crate::passes::{DrawCounts, PointDrawing, Targets};

/// The pass, its pipelines and its tables.
#[derive(Debug)]
pub struct PointsRaster {
    /// Narrow, wide.
    pixels: [wgpu::RenderPipeline; 2],
    /// Narrow, wide.
    squares: [wgpu::RenderPipeline; 2],
    frame_layout: wgpu::BindGroupLayout,
    scene_layout: wgpu::BindGroupLayout,
    frame: GrowingBuffer,
    nodes: GrowingBuffer,
}

/// Vertices per point of the pipeline that draws squares.
const SQUARE_VERTICES: u32 = 6;

impl PointsRaster {
    /// Compiles the pass; vertex shaders of the device must read storage buffers.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        if !gpu.draws_by_raster() {
            return Err(gpu.unsupported("raster", "no storage buffers in vertex shaders"));
        }
        let shader = shader::module(gpu, "points_raster")?;
        gpu.checked("build the raster point pass", || {
            let vertex = wgpu::ShaderStages::VERTEX;
            let read_only = wgpu::BufferBindingType::Storage { read_only: true };
            let frame_layout = layout(gpu, "frame", &[(vertex, wgpu::BufferBindingType::Uniform)]);
            let scene_layout = layout(gpu, "nodes, words", &[(vertex, read_only); 2]);
            let groups = gpu.device().create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some("points"),
                bind_group_layouts: &[Some(&frame_layout), Some(&scene_layout)],
                immediate_size: 0,
            });
            let point_list = wgpu::PrimitiveTopology::PointList;
            let triangle_list = wgpu::PrimitiveTopology::TriangleList;
            PointsRaster {
                pixels: [false, true]
                    .map(|wide| pipeline(gpu, &groups, &shader, "pixel_vertex", point_list, wide)),
                squares: [false, true].map(|wide| {
                    pipeline(gpu, &groups, &shader, "square_vertex", triangle_list, wide)
                }),
                frame_layout,
                scene_layout,
                frame: GrowingBuffer::new("frame", wgpu::BufferUsages::UNIFORM),
                nodes: GrowingBuffer::new("drawn nodes", wgpu::BufferUsages::STORAGE),
            }
        })
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
        if table.draws.is_empty() {
            targets.clear(encoder, frame.background);
            return Ok(DrawCounts::default());
        }
        let node_bytes = size_of_val(&table.nodes[..]) as u64;
        let frame_buffer = self.frame.write(gpu, &[*frame])?;
        let nodes = self.nodes.write(gpu, &table.nodes)?;
        let frame_group = bind(gpu, &self.frame_layout, &[whole(frame_buffer)]);
        let shards = table.draws.iter().map(|draw| draw.shard).max().map_or(0, |last| last + 1);
        let scenes: Vec<_> = (0..shards)
            .map(|shard| {
                let buffers = [part(nodes, 0, node_bytes), whole(arena.buffer(shard))];
                bind(gpu, &self.scene_layout, &buffers)
            })
            .collect();
        let (color, depth) = targets.cleared(frame.background);
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("points"),
            color_attachments: &[Some(color)],
            depth_stencil_attachment: Some(depth),
            timestamp_writes: timer.render_pass("points"),
            ..Default::default()
        });
        pass.set_bind_group(0, &frame_group, &[]);
        for draw in &table.draws {
            pass.set_bind_group(1, &scenes[draw.shard], &[]);
            let instances = draw.slot..draw.slot + 1;
            let wide = usize::from(table.kind(draw).wide);
            if draw.single_pixels {
                pass.set_pipeline(&self.pixels[wide]);
                pass.draw(0..draw.count, instances);
            } else {
                pass.set_pipeline(&self.squares[wide]);
                pass.draw(0..SQUARE_VERTICES * draw.count, instances);
            }
        }
        drop(pass);
        Ok(DrawCounts {
            dispatches: 0,
            draw_calls: table.draws.len() as u32,
            uploaded_bytes: size_of::<GpuFrame>() as u64 + node_bytes,
        })
    }

    /// Bytes held on the device.
    pub fn held_bytes(&self) -> u64 {
        self.frame.held_bytes() + self.nodes.held_bytes()
    }
}

fn pipeline(
    gpu: &Gpu,
    groups: &wgpu::PipelineLayout,
    shader: &wgpu::ShaderModule,
    vertex_entry: &str,
    topology: wgpu::PrimitiveTopology,
    wide: bool,
) -> wgpu::RenderPipeline {
    gpu.device().create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(vertex_entry),
        layout: Some(groups),
        vertex: wgpu::VertexState {
            module: shader,
            entry_point: Some(vertex_entry),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &[("WIDE_NODES", f64::from(wide))],
                ..Default::default()
            },
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState { topology, ..Default::default() },
        depth_stencil: Some(Targets::depth_state(wgpu::CompareFunction::Greater)),
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: shader,
            entry_point: Some("point_color"),
            compilation_options: Default::default(),
            targets: &[Some(Targets::COLOR_FORMAT.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
