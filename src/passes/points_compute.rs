//! Points drawn by compute shaders with atomic maximum, and their resolve into textures.
//!
//! One dispatch per shard of words and kind of node, whatever the number of nodes: a batch table
//! tells each workgroup its node and points. With 64-bit atomics one pass over the points does;
//! with 32-bit ones a second finds the colours, and the picture is the same. Splats that all share
//! a size may be grown from single pixels afterwards ([`Grow`](crate::passes::grow::Grow)).
//! Shaders: `points_compute.wgsl`, `resolve.wgsl`. Twin: [`PointsCpu`](crate::passes::PointsCpu).

use std::ops::Range;

use crate::gpu::layout::{GpuBatch, GpuDispatch, GpuFrame, SQUARE, WORKGROUP_SIZE};
use crate::gpu::shader::{self, PixelAtomics};
use crate::gpu::{Gpu, GpuError, GrowingBuffer, PassTimer, WordArena, read_buffer};
use crate::passes::bindings::{
    bind, compute_pipeline, covering_pipeline, layout, part, pipeline_layout, whole,
};
use crate::passes::grow::Grow;
use crate::passes::{
    BatchKind, Batches, Checkpoint, CheckpointPlan, Decision, DrawCounts, DrawPart, DrawTable,
    PointDrawing,
};

/// The pass, its pipelines and its tables.
#[derive(Debug)]
pub struct PointsCompute {
    pub(super) atomics: PixelAtomics,
    pub(super) shader: wgpu::ShaderModule,
    pub(super) draw_layout: wgpu::PipelineLayout,
    /// Those that were needed so far.
    pub(super) pipelines: Vec<(Variant, wgpu::ComputePipeline)>,
    pub(super) batch_points: u32,
    pub(super) lane_group: u32,
    pub(super) is_software: bool,
    pub(super) early_out: EarlyOut,
    /// Without depth, with it.
    pub(super) resolve: [wgpu::RenderPipeline; 2],
    pub(super) grow: Option<Grow>,
    /// Only once points were drawn in rounds.
    pub(super) depth_resolve: Option<wgpu::RenderPipeline>,
    pub(super) checkpoint: Option<Checkpoint>,
    pub(super) frame_layout: wgpu::BindGroupLayout,
    pub(super) scene_layout: wgpu::BindGroupLayout,
    pub(super) draw_pixels_layout: wgpu::BindGroupLayout,
    pub(super) resolve_pixels_layout: wgpu::BindGroupLayout,
    pub(super) frame: GrowingBuffer,
    pub(super) nodes: GrowingBuffer,
    pub(super) batches: GrowingBuffer,
    pub(super) pixels: GrowingBuffer,
    pub(super) batch_list: Batches,
    pub(super) target_px: [u32; 2],
    pub(super) grew: bool,
}

/// What a pipeline is made for, so that its points pay for nothing else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Variant {
    wide: bool,
    single_pixels: bool,
    partly: bool,
    looks_first: bool,
    shape: u32,
    color_pass: bool,
}

/// What all batches of a frame have in common that pipelines are made for.
#[derive(Clone, Copy)]
pub(super) struct FrameKind {
    pub(super) shape: u32,
    pub(super) looks_first: bool,
}

/// Whether points look what is nearest at their pixel before they go to the atomic operation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EarlyOut {
    /// Where it pays: always on GPUs; on software adapters, where looking takes about as long as
    /// the operation, when so much is drawn that most of it is hidden.
    #[default]
    Auto,
    /// Always.
    Always,
    /// Never; in the second of two passes of 32 bits they do nevertheless, to find their pixel.
    Never,
}

/// Points of a workgroup on a GPU: enough to spread the look-up of the node, few enough to fill all
/// cores.
const BATCH_POINTS: u32 = 1024;
/// Points of a workgroup on a software adapter, which has few cores and pays more per workgroup.
const SOFTWARE_BATCH_POINTS: u32 = 4096;
/// Lanes of a vector of the processors that software adapters run on.
const SOFTWARE_LANE_GROUP: u32 = 8;
/// Splat pixels per pixel of the target from which on looking first pays on software adapters;
/// measured, see `docs/measurements/drawing.md`.
const SOFTWARE_LOOK_FROM: f64 = 12.0;
pub(super) const BATCH_BYTES: u64 = size_of::<GpuBatch>() as u64;
/// Bytes of a pixel, however its atomics are held.
pub(super) const PIXEL_BYTES: u64 = 8;

impl PointsCompute {
    /// Compiles the pass; the device must have the atomics.
    pub fn new(gpu: &Gpu, atomics: PixelAtomics, early_out: EarlyOut) -> Result<Self, GpuError> {
        if atomics == PixelAtomics::Narrow && !gpu.draws_by_narrow_compute() {
            return Err(gpu.unsupported("compute32", "no compute shaders"));
        }
        if atomics != PixelAtomics::Narrow && !gpu.draws_by_compute() {
            return Err(gpu.unsupported("compute", "no 64-bit atomic minimum and maximum"));
        }
        let shader = shader::module_with(gpu, "points_compute", atomics)?;
        let resolve_shader = shader::module(gpu, "resolve")?;
        gpu.checked("build the compute point pass", || {
            let compute = wgpu::ShaderStages::COMPUTE;
            let fragment = wgpu::ShaderStages::FRAGMENT;
            let read_only = wgpu::BufferBindingType::Storage { read_only: true };
            let read_write = wgpu::BufferBindingType::Storage { read_only: false };
            let everywhere = compute | wgpu::ShaderStages::VERTEX_FRAGMENT;
            let frame_layout =
                layout(gpu, "frame", &[(everywhere, wgpu::BufferBindingType::Uniform)]);
            let scene_layout = layout(gpu, "nodes, words, batches", &[(compute, read_only); 3]);
            let draw_pixels_layout = layout(gpu, "pixels, drawn", &[(compute, read_write)]);
            let resolve_pixels_layout = layout(gpu, "pixels, resolved", &[(fragment, read_only)]);
            let draw_groups = [Some(&frame_layout), Some(&scene_layout), Some(&draw_pixels_layout)];
            let draw_layout = pipeline_layout(gpu, "points", &draw_groups);
            let (batch_points, lane_group) = match gpu.is_software() {
                true => (SOFTWARE_BATCH_POINTS, SOFTWARE_LANE_GROUP),
                false => (BATCH_POINTS, WORKGROUP_SIZE),
            };
            let resolve_groups = [Some(&frame_layout), None, Some(&resolve_pixels_layout)];
            let resolve_layout = pipeline_layout(gpu, "resolve", &resolve_groups);
            let resolve =
                [("resolve_color", false), ("resolve", true)].map(|(entry, has_depth)| {
                    covering_pipeline(gpu, &resolve_layout, &resolve_shader, entry, has_depth)
                });
            let storage = wgpu::BufferUsages::STORAGE;
            PointsCompute {
                atomics,
                shader,
                draw_layout,
                pipelines: Vec::new(),
                batch_points,
                lane_group,
                is_software: gpu.is_software(),
                early_out,
                resolve,
                grow: None,
                depth_resolve: None,
                checkpoint: None,
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
                grew: false,
            }
        })
    }

    /// Which atomics it draws with.
    pub fn atomics(&self) -> PixelAtomics {
        self.atomics
    }

    /// Most pixels of one target: its pixels, with room for a margin, must fit one binding.
    pub fn max_pixels(gpu: &Gpu) -> u64 {
        let limits = gpu.device().limits();
        limits.max_storage_buffer_binding_size.min(limits.max_buffer_size) / (2 * PIXEL_BYTES)
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
        self.target_px = frame.target_px;
        self.grew = false;
        if table.draws.is_empty() {
            self.target_px = [0, 0];
            targets.clear(encoder, frame.background);
            return Ok(DrawCounts::default());
        }
        let alignment = u64::from(gpu.device().limits().min_storage_buffer_offset_alignment);
        // Batches have a multiple of 4 bytes.
        let align = (alignment / 4).max(1) as usize;
        table.batches(self.batch_points, align, &mut self.batch_list);
        let margin_px = Grow::margin_px(drawing, Self::max_pixels(gpu));
        if margin_px > 0 {
            // Grown splats start as single pixels.
            self.batch_list.groups.iter_mut().for_each(|(kind, _)| kind.single_pixels = true);
        }
        let kind = FrameKind {
            shape: frame.splat_shape,
            looks_first: self.looks_first(drawing, margin_px),
        };
        self.compile(gpu, kind)?;
        let frames = [
            GpuFrame { grow_margin_px: margin_px, ..*frame },
            GpuFrame {
                target_px: frame.target_px.map(|side| side + 2 * margin_px),
                grow_margin_px: margin_px,
                ..*frame
            },
        ];
        let uploaded_bytes = (size_of_val(&frames)
            + size_of_val(&table.nodes[..])
            + size_of_val(&self.batch_list.list[..])) as u64;
        let bytes_of = |frame: &GpuFrame| {
            PIXEL_BYTES * u64::from(frame.target_px[0]) * u64::from(frame.target_px[1])
        };
        // Two frames, each at an offset that every adapter allows.
        let spaced: Vec<u8> =
            frames.iter().flat_map(|frame| padded_to_256(bytemuck::bytes_of(frame))).collect();
        self.frame.write(gpu, &spaced)?;
        let frame_buffer = self.frame.get().expect("it was just written");
        self.nodes.write(gpu, &table.nodes)?;
        self.batches.write(gpu, &self.batch_list.list)?;
        self.pixels.reserve(gpu, bytes_of(&frames[1]))?;
        let pixels = self.pixels.get().expect("room was just made");

        let frame_bytes = size_of::<GpuFrame>() as u64;
        let [frame_group, points_group] = [0, 256].map(|offset| {
            bind(gpu, &self.frame_layout, &[part(frame_buffer, offset, frame_bytes)])
        });
        let drawn = part(pixels, 0, bytes_of(&frames[1]));
        let draw_pixels = bind(gpu, &self.draw_pixels_layout, std::slice::from_ref(&drawn));

        encoder.clear_buffer(pixels, 0, Some(bytes_of(&frames[1])));
        let work = self.bind_work(gpu, nodes_bytes(table), arena)?;
        let bound = PointBindings { frame: &points_group, pixels: &draw_pixels };
        let (always, rest): (Vec<_>, Vec<_>) =
            work.iter().partition(|work| work.kind.part == DrawPart::Always);
        let phases = color_passes(self.atomics);
        let mut dispatches = 0;
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("points"),
                timestamp_writes: timer.compute_pass("points"),
            });
            bound.set(&mut pass);
            // What comes later may be nearer: colours wait for it.
            let now = if rest.is_empty() { phases } else { &phases[..1] };
            for &color_pass in now {
                dispatches +=
                    dispatch(&self.pipelines, &mut pass, &always, (kind, color_pass), None);
            }
        }
        if !rest.is_empty() {
            let decided = match (table.checkpoint, timer.period_ns()) {
                (Some(plan), Some(period_ns)) => {
                    if self.checkpoint.is_none() {
                        self.checkpoint = Some(Checkpoint::new(gpu)?);
                    }
                    let mut checkpoint = self.checkpoint.take().expect("it was just made");
                    let arguments =
                        decide(gpu, encoder, timer, &mut checkpoint, &plan, period_ns, &rest);
                    self.checkpoint = Some(checkpoint);
                    arguments?
                }
                // Without a clock the full cut is drawn.
                _ => None,
            };
            let rest: Vec<&PointWork> = match decided {
                Some(_) => rest,
                None => rest.into_iter().filter(|w| w.kind.part == DrawPart::Full).collect(),
            };
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("points, the rest"),
                timestamp_writes: timer.compute_pass("points, the rest"),
            });
            bound.set(&mut pass);
            for &color_pass in phases {
                if color_pass {
                    dispatches +=
                        dispatch(&self.pipelines, &mut pass, &always, (kind, color_pass), None);
                }
                dispatches += dispatch(
                    &self.pipelines,
                    &mut pass,
                    &rest,
                    (kind, color_pass),
                    decided.as_ref(),
                );
            }
        }
        let resolved = match margin_px {
            0 => drawn,
            _ => {
                if self.grow.is_none() {
                    self.grow = Some(Grow::new(gpu, &self.frame_layout)?);
                }
                let grow = self.grow.as_mut().expect("it was just made");
                dispatches += grow.draw(gpu, encoder, timer, &frames[0], &frame_group, drawn)?;
                self.grew = true;
                part(grow.pixels().expect("it just drew"), 0, bytes_of(&frames[0]))
            }
        };
        let resolved = bind(gpu, &self.resolve_pixels_layout, &[resolved]);
        self.resolve_into(encoder, timer, drawing, &frame_group, &resolved);
        Ok(DrawCounts { dispatches, draw_calls: 1, uploaded_bytes })
    }

    /// Binds what each group of batches reads: the tables as they were written, and its words.
    pub(super) fn bind_work(
        &self,
        gpu: &Gpu,
        node_bytes: u64,
        arena: &WordArena,
    ) -> Result<Vec<PointWork>, GpuError> {
        let (Some(nodes), Some(batches)) = (self.nodes.get(), self.batches.get()) else {
            return Ok(Vec::new());
        };
        let work = |(kind, range): &(BatchKind, Range<usize>)| {
            let first_byte = range.start as u64 * BATCH_BYTES;
            let bytes = range.len() as u64 * BATCH_BYTES;
            let buffers = [
                part(nodes, 0, node_bytes),
                whole(arena.buffer(kind.shard)),
                part(batches, first_byte, bytes),
            ];
            let row = (range.len() as u32).min(MAX_WORKGROUPS_PER_ROW);
            PointWork {
                kind: *kind,
                scene: bind(gpu, &self.scene_layout, &buffers),
                workgroups: [row, (range.len() as u32).div_ceil(row)],
            }
        };
        Ok(self.batch_list.groups.iter().map(work).collect())
    }

    /// Turns pixels into colours, and depth where it is wanted.
    pub(super) fn resolve_into(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut PassTimer,
        drawing: &PointDrawing,
        frame: &wgpu::BindGroup,
        pixels: &wgpu::BindGroup,
    ) {
        let (color, depth) = drawing.targets.cleared(drawing.frame.background);
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("resolve"),
            color_attachments: &[Some(color)],
            depth_stencil_attachment: depth.filter(|_| drawing.wants_depth),
            timestamp_writes: timer.render_pass("resolve"),
            ..Default::default()
        });
        pass.set_pipeline(&self.resolve[usize::from(drawing.wants_depth)]);
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(2, pixels, &[]);
        pass.draw(0..3, 0..1);
    }

    /// Distances of whole rows of the last target drawn, infinite where nothing is. Waits for the
    /// GPU.
    pub fn distances_of_rows(&self, gpu: &Gpu, rows: Range<u32>) -> Result<Vec<f32>, GpuError> {
        let [width, height] = self.target_px;
        let pixels = match &self.grow {
            Some(grow) if self.grew => grow.pixels(),
            _ => self.pixels.get(),
        };
        let Some(pixels) = pixels.filter(|_| rows.end <= height) else {
            return Ok(Vec::new());
        };
        let row_bytes = PIXEL_BYTES * u64::from(width);
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
            .sum::<u64>()
            + self.grow.as_ref().map_or(0, Grow::held_bytes)
    }

    pub(super) fn looks_first(&self, drawing: &PointDrawing, margin_px: u32) -> bool {
        match self.early_out {
            EarlyOut::Always => true,
            EarlyOut::Never => false,
            EarlyOut::Auto if !self.is_software => true,
            EarlyOut::Auto => {
                let table = drawing.table;
                let drawn = if margin_px > 0 { table.points } else { table.splat_pixels };
                let target = drawing.frame.target_px.map(f64::from);
                drawn as f64 > SOFTWARE_LOOK_FROM * target[0] * target[1]
            }
        }
    }

    /// Makes the pipelines that this frame's kinds of batches need and no frame needed before.
    pub(super) fn compile(&mut self, gpu: &Gpu, frame: FrameKind) -> Result<(), GpuError> {
        for (kind, _) in &self.batch_list.groups {
            for &color_pass in color_passes(self.atomics) {
                let variant = Variant::of(kind, frame, color_pass);
                if self.pipelines.iter().any(|(known, _)| *known == variant) {
                    continue;
                }
                let mut constants = vec![
                    ("WIDE_NODES", f64::from(variant.wide)),
                    ("SINGLE_PIXELS", f64::from(variant.single_pixels)),
                    ("PARTLY", f64::from(variant.partly)),
                    ("LOOKS_FIRST", f64::from(variant.looks_first)),
                    ("SPLAT_SHAPE", f64::from(variant.shape)),
                    ("LANE_GROUP", f64::from(self.lane_group)),
                ];
                if self.atomics == PixelAtomics::Narrow {
                    constants.push(("COLOR_PASS", f64::from(color_pass)));
                }
                let pipeline = gpu.checked("build a point pipeline", || {
                    let entry = "draw_points";
                    compute_pipeline(gpu, &self.draw_layout, &self.shader, entry, &constants)
                })?;
                self.pipelines.push((variant, pipeline));
            }
        }
        Ok(())
    }
}

/// Bytes of a table's rows.
pub(super) fn nodes_bytes(table: &DrawTable) -> u64 {
    size_of_val(&table.nodes[..]) as u64
}

/// Adds dispatches, from `arguments` if they were decided on the device; returns their number.
pub(super) fn dispatch(
    pipelines: &[(Variant, wgpu::ComputePipeline)],
    pass: &mut wgpu::ComputePass,
    work: &[&PointWork],
    (frame, color_pass): (FrameKind, bool),
    arguments: Option<&wgpu::Buffer>,
) -> u32 {
    for (work, index) in work.iter().zip(0u64..) {
        let variant = Variant::of(&work.kind, frame, color_pass);
        let known = pipelines.iter().find(|(known, _)| *known == variant);
        pass.set_pipeline(&known.expect("it was just compiled").1);
        pass.set_bind_group(1, &work.scene, &[]);
        match arguments {
            Some(arguments) => pass.dispatch_workgroups_indirect(arguments, 12 * index),
            None => pass.dispatch_workgroups(work.workgroups[0], work.workgroups[1], 1),
        }
    }
    work.len() as u32
}

/// One dispatch.
pub(super) struct PointWork {
    pub(super) kind: BatchKind,
    pub(super) scene: wgpu::BindGroup,
    pub(super) workgroups: [u32; 2],
}

/// What all dispatches share.
pub(super) struct PointBindings<'a> {
    pub(super) frame: &'a wgpu::BindGroup,
    pub(super) pixels: &'a wgpu::BindGroup,
}

impl PointBindings<'_> {
    pub(super) fn set(&self, pass: &mut wgpu::ComputePass) {
        pass.set_bind_group(0, self.frame, &[]);
        pass.set_bind_group(2, self.pixels, &[]);
    }
}

/// Adds the decision between the alternatives; the arguments of their dispatches, in their order.
fn decide(
    gpu: &Gpu,
    encoder: &mut wgpu::CommandEncoder,
    timer: &mut PassTimer,
    checkpoint: &mut Checkpoint,
    plan: &CheckpointPlan,
    period_ns: f64,
    rest: &[&PointWork],
) -> Result<Option<wgpu::Buffer>, GpuError> {
    let Some(stamps) = timer.resolve_into(encoder, checkpoint.stamps()) else { return Ok(None) };
    let ticks = |ms: f64| (ms * 1e6 / period_ns) as u64;
    let dispatches: Vec<GpuDispatch> = rest
        .iter()
        .map(|work| GpuDispatch {
            alternative: u32::from(work.kind.part == DrawPart::Coarse),
            x: work.workgroups[0],
            y: work.workgroups[1],
            z: 1,
        })
        .collect();
    let decision = Decision {
        stamps,
        allowed: ticks(plan.allowed_ms),
        needs: &plan.needs_ms.map(ticks),
        dispatches: &dispatches,
    };
    let arguments = checkpoint.decide(gpu, encoder, &decision)?.clone();
    timer.note_choice(&arguments, 12 * dispatches.len() as u64);
    Ok(Some(arguments))
}

impl Variant {
    fn of(kind: &BatchKind, frame: FrameKind, color_pass: bool) -> Self {
        Variant {
            wide: kind.wide,
            single_pixels: kind.single_pixels,
            partly: kind.partly,
            looks_first: frame.looks_first,
            // Single pixels have no shape.
            shape: if kind.single_pixels { SQUARE } else { frame.shape },
            color_pass,
        }
    }
}

/// The passes over all points: whether each is for colours.
pub(super) fn color_passes(atomics: PixelAtomics) -> &'static [bool] {
    match atomics {
        PixelAtomics::Narrow => &[false, true],
        _ => &[false],
    }
}

/// Bytes, followed by zeros up to the offset that every adapter allows.
pub(super) fn padded_to_256(bytes: &[u8]) -> [u8; 256] {
    let mut padded = [0; 256];
    padded[..bytes.len()].copy_from_slice(bytes);
    padded
}

/// Within the limit that every adapter grants.
pub(super) const MAX_WORKGROUPS_PER_ROW: u32 = 32_768;
