//! Points drawn by the rasterizer, for adapters without 64-bit atomics.
//!
//! One draw per node: a point list where no splat exceeds a pixel (WebGPU has no point size), two
//! triangles per point elsewhere. Both cover exactly the pixels of the compute pass. Of points at
//! the same depth a depth test keeps the first that is drawn, where compute keeps the smallest
//! colour: scans with several points at one place (a coarse lattice is enough) would be another
//! picture, and one that depends on the order of nodes. So points are drawn twice ([`Ties`]).
//! Shader: `points_raster.wgsl`.

use crate::gpu::layout::{GpuFrame, ROUND, SPHERE, SQUARE};
use crate::gpu::{Gpu, GpuError, GrowingBuffer, PassTimer, shader};
use crate::passes::bindings::{bind, layout, part, pipeline_layout, whole};
use crate::passes::points_raster_ties::{SharedOrders, Step};
use crate::passes::{BatchKind, DrawCounts, DrawTable, PointDrawing, Targets};

/// Which of several points at one depth a pixel shows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Ties {
    /// That of the smallest colour word, as on all other paths; points are drawn twice.
    #[default]
    SmallestColor,
    /// The first that is drawn: a plain point list, to measure what rasterizers do by themselves.
    FirstDrawn,
}

/// The pass, its pipelines and its tables.
#[derive(Debug)]
pub struct PointsRaster {
    shader: wgpu::ShaderModule,
    draw_layout: wgpu::PipelineLayout,
    /// Only where ties are decided.
    orders: Option<SharedOrders>,
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
    step: Step,
    wide: bool,
    single_pixels: bool,
    partly: bool,
    shape: u32,
}

/// Vertices per point of the pipeline that draws squares.
const SQUARE_VERTICES: u32 = 6;

impl PointsRaster {
    /// Compiles the pass; vertex shaders of the device must read storage buffers.
    pub fn new(gpu: &Gpu, ties: Ties) -> Result<Self, GpuError> {
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
            let orders = match ties {
                Ties::SmallestColor => {
                    Some(SharedOrders::new(gpu, &shader, &frame_layout, &scene_layout))
                }
                Ties::FirstDrawn => None,
            };
            PointsRaster {
                shader,
                draw_layout,
                orders,
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
        if let Some(orders) = &mut self.orders {
            orders.fit(gpu, targets.size_px())?;
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
        let rasterized =
            Rasterized { raster: self, frame, table, frame_group: &frame_group, scenes: &scenes };
        let draws = table.draws.len() as u32;
        let draw_calls = match &self.orders {
            Some(orders) => {
                for step in [Step::Order, Step::Color] {
                    let mut pass = orders.begin(encoder, timer, targets, frame, step);
                    rasterized.draw(&mut pass, step);
                }
                orders.write_depth(encoder, timer, targets, &frame_group);
                2 * draws + 1
            }
            None => {
                let (color, depth) = targets.cleared(frame.background);
                let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                    label: Some("points"),
                    color_attachments: &[Some(color)],
                    depth_stencil_attachment: depth,
                    timestamp_writes: timer.render_pass("points"),
                    ..Default::default()
                });
                rasterized.draw(&mut pass, Step::Plain);
                draws
            }
        };
        Ok(DrawCounts {
            dispatches: 0,
            draw_calls,
            uploaded_bytes: size_of::<GpuFrame>() as u64 + node_bytes,
        })
    }

    /// Bytes held on the device.
    pub fn held_bytes(&self) -> u64 {
        let orders = self.orders.as_ref().map_or(0, SharedOrders::held_bytes);
        self.frame.held_bytes() + self.nodes.held_bytes() + orders
    }

    /// Makes the pipelines that this frame's nodes need and no frame needed before.
    fn compile(&mut self, gpu: &Gpu, drawing: &PointDrawing) -> Result<(), GpuError> {
        let steps: &[Step] = match self.orders {
            Some(_) => &[Step::Order, Step::Color],
            None => &[Step::Plain],
        };
        for draw in &drawing.table.draws {
            let kind = drawing.table.kind(draw);
            for &step in steps {
                let variant = Variant::of(&kind, drawing.frame.splat_shape, step);
                if self.pipelines.iter().all(|(known, _)| *known != variant) {
                    let pipeline =
                        gpu.checked("build a point pipeline", || self.pipeline(gpu, variant))?;
                    self.pipelines.push((variant, pipeline));
                }
            }
        }
        Ok(())
    }

    fn pipeline(&self, gpu: &Gpu, variant: Variant) -> wgpu::RenderPipeline {
        let (vertex_entry, topology) = match variant.single_pixels {
            true => ("pixel_vertex", wgpu::PrimitiveTopology::PointList),
            false => ("square_vertex", wgpu::PrimitiveTopology::TriangleList),
        };
        let fragment_entry = match (variant.step, variant.shape) {
            (Step::Order, _) => "nearest_order",
            (Step::Color, _) => "color_of_nearest",
            (Step::Plain, ROUND) => "disc_color",
            (Step::Plain, SPHERE) => "ball_color_and_depth",
            (Step::Plain, _) => "point_color",
        };
        let colors = [Some(Targets::COLOR_FORMAT.into())];
        let targets = if variant.step == Step::Order { &[][..] } else { &colors[..] };
        let layout = match (&self.orders, variant.step) {
            (Some(orders), Step::Color) => orders.color_layout(),
            _ => &self.draw_layout,
        };
        let shape = ("SPLAT_SHAPE", f64::from(variant.shape));
        gpu.device().create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(vertex_entry),
            layout: Some(layout),
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
                targets,
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}

impl Variant {
    fn of(kind: &BatchKind, shape: u32, step: Step) -> Self {
        let BatchKind { wide, single_pixels, partly, .. } = *kind;
        // Single pixels have no shape.
        let shape = if single_pixels { SQUARE } else { shape };
        Variant { step, wide, single_pixels, partly, shape }
    }
}

/// A frame's points, ready to be drawn as often as it takes.
struct Rasterized<'a> {
    raster: &'a PointsRaster,
    frame: &'a GpuFrame,
    table: &'a DrawTable,
    frame_group: &'a wgpu::BindGroup,
    scenes: &'a [wgpu::BindGroup],
}

impl Rasterized<'_> {
    fn draw(&self, pass: &mut wgpu::RenderPass, step: Step) {
        pass.set_bind_group(0, self.frame_group, &[]);
        for draw in &self.table.draws {
            pass.set_bind_group(1, &self.scenes[draw.shard], &[]);
            let instances = draw.slot..draw.slot + 1;
            let variant = Variant::of(&self.table.kind(draw), self.frame.splat_shape, step);
            let known = self.raster.pipelines.iter().find(|(known, _)| *known == variant);
            pass.set_pipeline(&known.expect("it was just compiled").1);
            let vertices = if draw.single_pixels { 1 } else { SQUARE_VERTICES };
            // A node has at most 2^32 points in all, and far fewer in any that is drawn.
            pass.draw(0..draw.count.saturating_mul(vertices), instances);
        }
    }
}
