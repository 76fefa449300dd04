//! Occlusion culling without read-back: what was visible in the last frame is drawn first, everything
//! else is tested on the device against the depth of that, and what newly shows is drawn second.
//!
//! Nothing comes back to the CPU before the picture is there, so nothing is waited for: draws take
//! their arguments from a buffer that the device fills. An object that the test finds is in the first
//! list of the next frame. A guess that something is visible costs time; whatever is not drawn first
//! is tested in the same frame, so no object is missing. Counts come back frames later.
//!
//! In the frustum by the CPU, as for every way of drawing models; boxes are widened as those of
//! occlusion queries are, and boxes that meet the near plane are drawn untested. Shader:
//! `two_pass.wgsl`. After: Haar and Aaltonen, "GPU-Driven Rendering Pipelines", 2015.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use crate::geometry::{Aabb, View};
use crate::gpu::layout::{GpuBox, GpuFrame, STATE_COUNTS, WORKGROUP_SIZE};
use crate::gpu::{Gpu, GpuError, GrowingBuffer, HeldBuffer, shader};
use crate::ids::ObjectId;
use crate::passes::bindings::{bind, compute_pipeline, layout, part, pipeline_layout};
use crate::passes::mesh_list::MeshDraw;
use crate::passes::pyramid_answers::groups_of;
use crate::passes::{DepthPyramid, MeshCounts, MeshList, MeshOutput, Meshes, Targets};
use crate::visibility::{CullCounters, Proxies, meets_near_plane};

/// Bytes of the counts at the start of the state.
const COUNT_BYTES: u64 = 4 * STATE_COUNTS as u64;
/// Words of a draw's arguments.
const DRAW_WORDS: u64 = 5;
/// Counts that may be on their way back at once; further frames go uncounted.
const MOST_UNDER_WAY: usize = 4;

/// What a frame of two passes did, known some frames later.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TwoPassCounts {
    /// Objects drawn because they were visible in the frame before, or could not be tested.
    pub first_objects: u32,
    /// Objects drawn because the test found them.
    pub second_objects: u32,
    /// Triangles of both.
    pub triangles: u64,
    /// Boxes tested.
    pub tested: u32,
}

impl TwoPassCounts {
    /// What was drawn; calls are not counted.
    pub fn drawn(&self) -> MeshCounts {
        let objects = self.first_objects + self.second_objects;
        MeshCounts { draw_calls: 0, objects, triangles: self.triangles }
    }

    /// The same as counters of culling: one submission, nothing waited for.
    pub fn counters(&self) -> CullCounters {
        let objects = u64::from(self.first_objects) + u64::from(self.second_objects);
        CullCounters {
            queries_issued: u64::from(self.tested),
            query_boxes: u64::from(self.tested),
            pulled_down: u64::from(self.second_objects),
            leaves_drawn: objects,
            triangles_drawn: self.triangles,
            rounds: 1,
            ..CullCounters::default()
        }
    }
}

/// The state of one view of one model.
#[derive(Debug)]
pub struct TwoPass {
    pyramid: DepthPyramid,
    test: wgpu::ComputePipeline,
    /// First and second list.
    gather: [wgpu::ComputePipeline; 2],
    frame_layout: wgpu::BindGroupLayout,
    object_layout: wgpu::BindGroupLayout,
    draw_layout: wgpu::BindGroupLayout,
    frame: GrowingBuffer,
    boxes: GrowingBuffer,
    drawn: GrowingBuffer,
    arguments: Option<Arc<HeldBuffer>>,
    state: Option<HeldBuffer>,
    box_list: Vec<GpuBox>,
    spare: Vec<wgpu::Buffer>,
    under_way: VecDeque<CountsUnderWay>,
    counts: TwoPassCounts,
    uploaded_bytes: u64,
}

#[derive(Debug)]
struct CountsUnderWay {
    buffer: wgpu::Buffer,
    is_done: Arc<AtomicBool>,
    is_asked_for: bool,
    tested: u32,
}

/// What is drawn, and where to.
#[derive(Clone, Copy)]
pub struct TwoPassDrawing<'a> {
    /// The boxes of all objects.
    pub bounds: &'a [Aabb],
    /// The objects in the view frustum.
    pub visible: &'a [ObjectId],
    /// From where.
    pub view: &'a View,
    /// What all draws share.
    pub frame: &'a GpuFrame,
    /// Targets with the colours, and with the depths; both are drawn over.
    pub targets: (&'a Targets, &'a Targets),
    /// Whether depth alone is drawn first, and colours when all of it is there.
    pub shades_after: bool,
}

impl TwoPass {
    /// Whether the device can: draws take the place of their first instance from a buffer.
    pub fn is_offered_by(gpu: &Gpu) -> bool {
        gpu.draws_meshes()
            && gpu.draws_by_narrow_compute()
            && gpu.device().features().contains(wgpu::Features::INDIRECT_FIRST_INSTANCE)
    }

    /// Compiles the passes; nothing was seen yet.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        if !TwoPass::is_offered_by(gpu) {
            return Err(
                gpu.unsupported("two-pass culling", "no instances from buffers of arguments")
            );
        }
        let pyramid = DepthPyramid::new(gpu)?;
        let module = shader::module(gpu, "two_pass")?;
        gpu.checked("build two-pass culling", || {
            let compute = wgpu::ShaderStages::COMPUTE;
            let [read, write] =
                [true, false].map(|read_only| wgpu::BufferBindingType::Storage { read_only });
            let uniform = wgpu::BufferBindingType::Uniform;
            let frame_layout = layout(gpu, "frame", &[(compute, uniform)]);
            let object_layout = layout(gpu, "boxes, state", &[(compute, read), (compute, write)]);
            let draw_layout =
                layout(gpu, "drawn, arguments", &[(compute, write), (compute, write)]);
            let test_groups =
                [Some(&frame_layout), Some(pyramid.test_layout()), Some(&object_layout)];
            let test = pipeline_layout(gpu, "test of boxes", &test_groups);
            let gather = pipeline_layout(
                gpu,
                "gather",
                &[None, None, Some(&object_layout), Some(&draw_layout)],
            );
            let gather_part = |number: f64| {
                compute_pipeline(gpu, &gather, &module, "gather", &[("PART", number)])
            };
            let storage = wgpu::BufferUsages::STORAGE;
            TwoPass {
                test: compute_pipeline(gpu, &test, &module, "test_boxes", &[]),
                gather: [gather_part(0.0), gather_part(1.0)],
                pyramid,
                frame_layout,
                object_layout,
                draw_layout,
                frame: GrowingBuffer::new("frame", wgpu::BufferUsages::UNIFORM),
                boxes: GrowingBuffer::new("boxes", storage),
                drawn: GrowingBuffer::new("drawn objects", storage),
                arguments: None,
                state: None,
                box_list: Vec::new(),
                spare: Vec::new(),
                under_way: VecDeque::new(),
                counts: TwoPassCounts::default(),
                uploaded_bytes: 0,
            }
        })
    }

    /// What the latest frame did whose counts are back.
    pub fn counts(&self) -> &TwoPassCounts {
        &self.counts
    }

    /// Bytes sent to the device since this was last asked.
    pub fn take_uploaded_bytes(&mut self) -> u64 {
        std::mem::take(&mut self.uploaded_bytes)
    }

    /// Bytes held on the device.
    pub fn held_bytes(&self) -> u64 {
        let buffers = [&self.frame, &self.boxes, &self.drawn].map(GrowingBuffer::held_bytes);
        self.pyramid.held_bytes()
            + buffers.iter().sum::<u64>()
            + self.arguments.as_ref().map_or(0, |buffer| buffer.size())
            + self.state.as_ref().map_or(0, |buffer| buffer.size())
    }

    /// Adds the commands of a frame; returns the calls that draw, and the dispatches.
    ///
    /// [`Meshes::begin`] comes before. [`after_submit`](Self::after_submit) must follow the
    /// submission.
    pub fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        meshes: &mut Meshes,
        drawing: &TwoPassDrawing,
    ) -> Result<(u32, u32), GpuError> {
        self.collect(gpu);
        let (colors, depths) = drawing.targets;
        let draws = meshes.draws_in_view(drawing.visible);
        if draws.objects.is_empty()
            || !self.pyramid.prepare(gpu, depths.depth_view(), depths.size_px())?
        {
            return Ok((0, 0));
        }
        let tested = self.write_boxes(gpu, drawing, &draws.objects)?;
        let count = draws.objects.len() as u64;
        self.write_arguments(gpu, meshes, &draws.draws, count as u32)?;
        self.frame.write(gpu, &[*drawing.frame])?;
        self.drawn.reserve(gpu, 8 * count)?;
        self.make_state(gpu, meshes.object_count())?;
        let (Some(frame), Some(boxes), Some(drawn), Some(arguments), Some(state), Some(test)) = (
            self.frame.get(),
            self.boxes.get(),
            self.drawn.get(),
            self.arguments.clone(),
            self.state.as_ref(),
            self.pyramid.test_group(),
        ) else {
            return Ok((0, 0));
        };
        let rows = draws.draws.len() as u64 + 1;
        let part_bytes = 4 * DRAW_WORDS * rows;
        let box_bytes = size_of::<GpuBox>() as u64 * count;
        let state_bytes = COUNT_BYTES + 4 * meshes.object_count() as u64;
        let frame = bind(gpu, &self.frame_layout, &[part(frame, 0, size_of::<GpuFrame>() as u64)]);
        let objects = [part(boxes, 0, box_bytes), part(state, 0, state_bytes)];
        let objects = bind(gpu, &self.object_layout, &objects);
        let lists = [part(drawn, 0, 8 * count), part(&arguments, 0, 2 * part_bytes)];
        let lists = bind(gpu, &self.draw_layout, &lists);
        let drawn = meshes.bind_drawn(gpu, part(drawn, 0, 8 * count));
        let [first, second] = [0, part_bytes].map(|offset| {
            MeshList::of_buffers(draws.draws.clone(), drawn.clone(), arguments.clone(), offset)
        });
        let [draw_x, draw_y] = groups_of(draws.draws.len() as u32);
        let [box_x, box_y] = groups_of((count as u32).div_ceil(WORKGROUP_SIZE));
        let gather = |pass: &mut wgpu::ComputePass, list: usize| {
            pass.set_pipeline(&self.gather[list]);
            pass.set_bind_group(2, &objects, &[]);
            pass.set_bind_group(3, &lists, &[]);
            pass.dispatch_workgroups(draw_x, draw_y, 1);
        };
        encoder.clear_buffer(state, 0, Some(COUNT_BYTES));
        gather(&mut begin_compute(encoder, "gather what was visible"), 0);
        let mut calls = 0;
        let (drawn_to, output) = match drawing.shades_after {
            true => (None, MeshOutput::DEPTH),
            false => (Some(colors), MeshOutput::COLOR),
        };
        {
            let mut pass = begin_over(encoder, drawn_to, depths);
            calls += meshes.record(gpu, &mut pass, &first, output)?.draw_calls;
        }
        let mut dispatches = 3;
        {
            let mut pass = begin_compute(encoder, "test the others");
            dispatches += self.pyramid.record(&mut pass);
            pass.set_pipeline(&self.test);
            pass.set_bind_group(0, &frame, &[]);
            pass.set_bind_group(1, test, &[]);
            pass.set_bind_group(2, &objects, &[]);
            pass.dispatch_workgroups(box_x, box_y, 1);
        }
        // A pass of its own: the groups of the test would be in the way.
        gather(&mut begin_compute(encoder, "gather what newly shows"), 1);
        {
            let mut pass = begin_over(encoder, drawn_to, depths);
            calls += meshes.record(gpu, &mut pass, &second, output)?.draw_calls;
        }
        if drawing.shades_after {
            let mut pass = begin_over(encoder, Some(colors), depths);
            for list in [&first, &second] {
                calls += meshes.record(gpu, &mut pass, list, MeshOutput::SHADE)?.draw_calls;
            }
        }
        self.copy_counts(gpu, encoder, tested);
        Ok((calls, dispatches))
    }

    /// Sends for the counts of what was just submitted.
    pub fn after_submit(&mut self) {
        if let Some(counts) = self.under_way.back_mut()
            && !counts.is_asked_for
        {
            counts.is_asked_for = true;
            let done = counts.is_done.clone();
            counts.buffer.slice(..).map_async(wgpu::MapMode::Read, move |_| {
                done.store(true, Ordering::Release);
            });
        }
    }

    /// Writes the boxes of the objects in view, in the order of the draws; how many are tested.
    fn write_boxes(
        &mut self,
        gpu: &Gpu,
        drawing: &TwoPassDrawing,
        objects: &[ObjectId],
    ) -> Result<u32, GpuError> {
        let proxies = Proxies::new(drawing.view);
        let row = |&object: &ObjectId| {
            box_row(drawing.view, &proxies, &drawing.bounds[object.index()], object)
        };
        objects.par_iter().with_min_len(1024).map(row).collect_into_vec(&mut self.box_list);
        self.boxes.write(gpu, &self.box_list)?;
        self.uploaded_bytes += size_of_val(&self.box_list[..]) as u64;
        Ok(self.box_list.iter().filter(|row| row.untested == 0).count() as u32)
    }

    /// Writes the arguments of both lists without instances, each with a row that ends it.
    fn write_arguments(
        &mut self,
        gpu: &Gpu,
        meshes: &Meshes,
        draws: &[MeshDraw],
        count: u32,
    ) -> Result<(), GpuError> {
        let mut words: Vec<[u32; DRAW_WORDS as usize]> = Vec::with_capacity(2 * draws.len() + 2);
        for first in [0, count] {
            words.extend(draws.iter().map(|draw| {
                let [indices, _, first_index, base_vertex, instance] = meshes.arguments_of(draw);
                [indices, 0, first_index, base_vertex, first + instance]
            }));
            words.push([0, 0, 0, 0, first + count]);
        }
        let bytes: &[u8] = bytemuck::cast_slice(&words);
        let length = bytes.len() as u64;
        if self.arguments.as_ref().is_none_or(|buffer| buffer.size() < length) {
            self.arguments = None;
            let descriptor = wgpu::BufferDescriptor {
                label: Some("draw arguments"),
                size: length
                    .next_power_of_two()
                    .min(gpu.device().limits().max_buffer_size.max(length)),
                usage: wgpu::BufferUsages::STORAGE
                    | wgpu::BufferUsages::INDIRECT
                    | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            };
            self.arguments =
                Some(Arc::new(gpu.create_buffer("hold arguments of draws", &descriptor)?));
        }
        if let Some(buffer) = &self.arguments {
            gpu.queue().write_buffer(buffer, 0, bytes);
        }
        self.uploaded_bytes += length;
        Ok(())
    }

    /// A word for each object, all hidden at first.
    fn make_state(&mut self, gpu: &Gpu, objects: usize) -> Result<(), GpuError> {
        let bytes = COUNT_BYTES + 4 * objects as u64;
        if self.state.as_ref().is_none_or(|state| state.size() != bytes) {
            self.state = None;
            self.state = Some(gpu.create_buffer(
                "remember what is visible",
                &wgpu::BufferDescriptor {
                    label: Some("culling state"),
                    size: bytes,
                    usage: wgpu::BufferUsages::STORAGE
                        | wgpu::BufferUsages::COPY_SRC
                        | wgpu::BufferUsages::COPY_DST,
                    mapped_at_creation: false,
                },
            )?);
        }
        Ok(())
    }

    fn copy_counts(&mut self, gpu: &Gpu, encoder: &mut wgpu::CommandEncoder, tested: u32) {
        let Some(state) = &self.state else { return };
        if self.under_way.len() >= MOST_UNDER_WAY {
            return;
        }
        let buffer = self.spare.pop().unwrap_or_else(|| {
            gpu.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some("counts to read"),
                size: COUNT_BYTES,
                usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
                mapped_at_creation: false,
            })
        });
        encoder.copy_buffer_to_buffer(state, 0, &buffer, 0, COUNT_BYTES);
        let is_done = Arc::new(AtomicBool::new(false));
        let is_asked_for = false;
        self.under_way.push_back(CountsUnderWay { buffer, is_done, is_asked_for, tested });
    }

    /// Takes in the counts that have arrived; waits for nothing.
    fn collect(&mut self, gpu: &Gpu) {
        // A device that is gone shows in the next submission.
        let _ = gpu.device().poll(wgpu::PollType::Poll);
        while let Some(front) = self.under_way.front()
            && front.is_done.load(Ordering::Acquire)
        {
            let Some(CountsUnderWay { buffer, tested, .. }) = self.under_way.pop_front() else {
                return;
            };
            if let Ok(view) = buffer.slice(..).get_mapped_range() {
                let words: Vec<u32> = bytemuck::pod_collect_to_vec(&view);
                if let [first_objects, second_objects, low, high] = words[..] {
                    let triangles = u64::from(low) | u64::from(high) << 32;
                    self.counts =
                        TwoPassCounts { first_objects, second_objects, triangles, tested };
                }
            }
            buffer.unmap();
            self.spare.push(buffer);
        }
    }
}

/// Numbers beyond this overflow where places on screen are computed.
const LARGEST: f32 = 1e18;

/// The row of an object: its widened box, relative to the eye.
fn box_row(view: &View, proxies: &Proxies, bounds: &Aabb, object: ObjectId) -> GpuBox {
    let widened = proxies.widened(bounds, 0.0);
    let low = (widened.min - view.camera.eye).as_vec3();
    let high = (widened.max - view.camera.eye).as_vec3();
    // Not a number is not below either.
    let is_sound = low.abs().max_element() < LARGEST && high.abs().max_element() < LARGEST;
    let untested = !is_sound || low.is_nan() || high.is_nan() || meets_near_plane(view, &widened);
    let [low, high] = match untested {
        true => [[0.0; 3]; 2],
        false => [low.to_array(), high.to_array()],
    };
    GpuBox { low, item: object.0, high, untested: u32::from(untested) }
}

fn begin_compute<'a>(
    encoder: &'a mut wgpu::CommandEncoder,
    label: &'static str,
) -> wgpu::ComputePass<'a> {
    encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
        label: Some(label),
        timestamp_writes: None,
    })
}

/// A pass that draws over a picture that is there, or over its depth alone.
fn begin_over<'a>(
    encoder: &'a mut wgpu::CommandEncoder,
    colors: Option<&Targets>,
    depths: &Targets,
) -> wgpu::RenderPass<'a> {
    let load = wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store };
    let color = colors.map(|colors| wgpu::RenderPassColorAttachment {
        view: colors.color_view(),
        depth_slice: None,
        resolve_target: None,
        ops: load,
    });
    let colors = [color];
    let depth = depths.depth_view().map(|view| wgpu::RenderPassDepthStencilAttachment {
        view,
        depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store }),
        stencil_ops: None,
    });
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("meshes, two passes"),
        color_attachments: if colors[0].is_some() { &colors } else { &[] },
        depth_stencil_attachment: depth,
        ..Default::default()
    })
}
