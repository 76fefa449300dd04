//! Points drawn by the rasterizer, for adapters without 64-bit atomics.
//!
//! One draw per node: a point list where no splat exceeds a pixel (WebGPU has no point size), two
//! triangles per point elsewhere. Both cover exactly the pixels of the compute pass; of points at
//! the same depth the first drawn stays, where compute keeps the smaller colour word. Shader:
//! `points_raster.wgsl`.

use crate::gpu::layout::{GpuFrame, ROUND, SPHERE, SQUARE};
use crate::gpu::{Gpu, GpuError, GrowingBuffer, PassTimer, shader};
use crate::passes::bindings::{bind, layout, part, pipeline_layout, whole};
use crate::passes::{BatchKind, DrawCounts, PointDrawing, Targets};

/// The pass, its pipelines and its tables.
#[derive(Debug)]
pub struct PointsRaster {
    shader: wgpu::ShaderModule,
    draw_layout: wgpu::PipelineLayout,
    /// Those that were needed so far.
    pipelines: Vec<(Variant, wgpu::RenderPipeline)>,
    frame_layout: wgpu::BindGroupLayout,
    scene_layout: wgpu::BindGroupLayout,
    frame: GrowingBuffer,
    nodes: GrowingBuffer,
}

/// What a pipeline is made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Variant {
    wide: bool,
    single_pixels: bool,
    partly: bool,
    shape: u32,
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
            let both = vertex | wgpu::ShaderStages::FRAGMENT;
            let read_only = wgpu::BufferBindingType::Storage { read_only: true };
            let frame_layout = layout(gpu, "frame", &[(both, wgpu::BufferBindingType::Uniform)]);
            let scene_layout = layout(gpu, "nodes, words", &[(vertex, read_only); 2]);
            let draw_layout =
                pipeline_layout(gpu, "points", &[Some(&frame_layout), Some(&scene_layout)]);
            PointsRaster {
                shader,
                draw_layout,
                pipelines: Vec::new(),
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
        let PointDrawing { frame, table, arena, targets, .. } = *drawing;
        if table.draws.is_empty() {
            targets.clear(encoder, frame.background);
            return Ok(DrawCounts::default());
        }
        self.compile(gpu, drawing)?;
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
            depth_stencil_attachment: depth,
            timestamp_writes: timer.render_pass("points"),
            ..Default::default()
        });
        pass.set_bind_group(0, &frame_group, &[]);
        for draw in &table.draws {
            pass.set_bind_group(1, &scenes[draw.shard], &[]);
            let instances = draw.slot..draw.slot + 1;
            let variant = Variant::of(&table.kind(draw), frame.splat_shape);
            let known = self.pipelines.iter().find(|(known, _)| *known == variant);
            pass.set_pipeline(&known.expect("it was just compiled").1);
            let vertices = if draw.single_pixels { 1 } else { SQUARE_VERTICES };
            // A node has at most 2^32 points in all, and far fewer in any that is drawn.
            pass.draw(0..draw.count.saturating_mul(vertices), instances);
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

    /// Makes the pipelines that this frame's nodes need and no frame needed before.
    fn compile(&mut self, gpu: &Gpu, drawing: &PointDrawing) -> Result<(), GpuError> {
        for draw in &drawing.table.draws {
            let variant = Variant::of(&drawing.table.kind(draw), drawing.frame.splat_shape);
            if self.pipelines.iter().all(|(known, _)| *known != variant) {
                let pipeline =
                    gpu.checked("build a point pipeline", || self.pipeline(gpu, variant))?;
                self.pipelines.push((variant, pipeline));
            }
        }
        Ok(())
    }

    fn pipeline(&self, gpu: &Gpu, variant: Variant) -> wgpu::RenderPipeline {
        let (vertex_entry, topology) = match variant.single_pixels {
            true => ("pixel_vertex", wgpu::PrimitiveTopology::PointList),
            false => ("square_vertex", wgpu::PrimitiveTopology::TriangleList),
        };
        let fragment_entry = match variant.shape {
            ROUND => "disc_color",
            SPHERE => "ball_color_and_depth",
            _ => "point_color",
        };
        let shape = ("SPLAT_SHAPE", f64::from(variant.shape));
        gpu.device().create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(vertex_entry),
            layout: Some(&self.draw_layout),
            vertex: wgpu::VertexState {
                module: &self.shader,
                entry_point: Some(vertex_entry),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants: &[
                        ("WIDE_NODES", f64::from(variant.wide)),
                        ("PARTLY", f64::from(variant.partly)),
                        shape,
                    ],
                    ..Default::default()
                },
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState { topology, ..Default::default() },
            depth_stencil: Some(Targets::depth_state(wgpu::CompareFunction::Greater)),
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &self.shader,
                entry_point: Some(fragment_entry),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants: &[shape],
                    ..Default::default()
                },
                targets: &[Some(Targets::COLOR_FORMAT.into())],
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}

impl Variant {
    fn of(kind: &BatchKind, shape: u32) -> Self {
        let BatchKind { wide, single_pixels, partly, .. } = *kind;
        // Single pixels have no shape.
        let shape = if single_pixels { SQUARE } else { shape };
        Variant { wide, single_pixels, partly, shape }
    }
}
