//! Questions of culling put to the device: occlusion queries around boxes, read back without
//! stopping it.
//!
//! A round is one submission: all draws recorded since the last one, then all questions, so that
//! each sees the depth of the whole round; then the answers are copied to memory that the CPU maps
//! when they are done. Queries of all backends tell only none from some. In their place a depth
//! pyramid can answer, by compute ([`OcclusionQueries::by_pyramid`]).
//!  Of [`OcclusionQueries`] one
//! is kept per view; [`CulledMeshes`] lends it the models and the picture for a frame.
//!
//! Shader: `occlusion_boxes.wgsl`. Twin: [`SoftwareDevice`](crate::visibility::SoftwareDevice).

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::geometry::{Aabb, View};
use crate::gpu::layout::{GpuBox, GpuFrame};
use crate::gpu::{Gpu, GpuError, GrowingBuffer, shader};
use crate::hierarchy::Bvh;
use crate::ids::{ObjectId, TreeNodeId};
use crate::passes::bindings::{bind, layout, part, pipeline_layout};
use crate::passes::{DrawOrder, MeshCounts, MeshOutput, Meshes, PyramidAnswers, Targets};
use crate::visibility::{Answer, OcclusionDevice, Proxies, QueryId};

/// Questions of one pass; more go into further passes of the same round.
const SET_SIZE: u32 = 4096;
const ANSWER_BYTES: u64 = 8;
/// How long another thread may take to tell that answers are there.
const CALLBACK_LIMIT: Duration = Duration::from_secs(10);

/// The questions of one view: those under way, and answers of the last frame and this one.
#[derive(Debug)]
pub struct OcclusionQueries {
    /// In passes with colours, and in passes with depth alone.
    pipelines: [wgpu::RenderPipeline; 2],
    frame_layout: wgpu::BindGroupLayout,
    box_layout: wgpu::BindGroupLayout,
    frame: GrowingBuffer,
    set: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    /// Answers in place of the queries.
    pyramid: Option<Box<PyramidAnswers>>,
    /// Memory for answers that nobody reads now.
    spare: Vec<wgpu::Buffer>,
    under_way: VecDeque<Submission>,
    answers: VecDeque<Option<bool>>,
    /// Number of the first question in `answers`, and of the first one of this frame.
    first: u64,
    first_of_frame: u64,
}

#[derive(Debug)]
struct Submission {
    buffer: wgpu::Buffer,
    queries: Vec<QueryId>,
    answer_bytes: usize,
    is_done: Arc<AtomicBool>,
}

impl OcclusionQueries {
    /// Makes the pipeline and the pool.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        if !gpu.draws_meshes() {
            return Err(gpu.unsupported("models", "no storage buffers in shaders that draw"));
        }
        let module = shader::module(gpu, "occlusion_boxes")?;
        gpu.checked("build the occlusion queries", || {
            let vertex = wgpu::ShaderStages::VERTEX;
            let read_only = wgpu::BufferBindingType::Storage { read_only: true };
            let frame_layout = layout(gpu, "frame", &[(vertex, wgpu::BufferBindingType::Uniform)]);
            let box_layout = layout(gpu, "boxes", &[(vertex, read_only)]);
            let layouts =
                pipeline_layout(gpu, "occlusion boxes", &[Some(&frame_layout), Some(&box_layout)]);
            OcclusionQueries {
                pipelines: [true, false].map(|colors| pipeline(gpu, &layouts, &module, colors)),
                frame_layout,
                box_layout,
                frame: GrowingBuffer::new("frame", wgpu::BufferUsages::UNIFORM),
                set: gpu.device().create_query_set(&wgpu::QuerySetDescriptor {
                    label: Some("occlusion"),
                    ty: wgpu::QueryType::Occlusion,
                    count: SET_SIZE,
                }),
                resolved: gpu.device().create_buffer(&wgpu::BufferDescriptor {
                    label: Some("occlusion answers"),
                    size: u64::from(SET_SIZE) * ANSWER_BYTES,
                    usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
                    mapped_at_creation: false,
                }),
                pyramid: None,
                spare: Vec::new(),
                under_way: VecDeque::new(),
                answers: VecDeque::new(),
                first: 0,
                first_of_frame: 0,
            }
        })
    }

    /// The same with a depth pyramid that answers in place of queries.
    pub fn by_pyramid(gpu: &Gpu) -> Result<Self, GpuError> {
        let pyramid = Some(Box::new(PyramidAnswers::new(gpu)?));
        Ok(OcclusionQueries { pyramid, ..OcclusionQueries::new(gpu)? })
    }

    /// Whether a depth pyramid answers.
    pub fn is_by_pyramid(&self) -> bool {
        self.pyramid.is_some()
    }

    fn begin_frame(&mut self, gpu: &Gpu) {
        // A device that does not answer is found out by whoever waits for it.
        let _ = gpu.device().poll(wgpu::PollType::Poll);
        self.collect();
        let old = self.first_of_frame - self.first;
        self.answers.drain(..old as usize);
        self.first = self.first_of_frame;
        self.first_of_frame += self.answers.len() as u64;
    }

    fn ask(&mut self) -> QueryId {
        self.answers.push_back(None);
        QueryId(self.first + self.answers.len() as u64 - 1)
    }

    /// Takes in what has arrived.
    fn collect(&mut self) {
        while let Some(submission) = self.under_way.front()
            && submission.is_done.load(Ordering::Acquire)
        {
            let Some(Submission { buffer, queries, answer_bytes, .. }) = self.under_way.pop_front()
            else {
                return;
            };
            let bytes = (answer_bytes * queries.len()) as u64;
            if let Ok(view) = buffer.slice(..bytes).get_mapped_range() {
                let words = view.chunks_exact(answer_bytes);
                for (query, word) in queries.iter().zip(words) {
                    // Questions of frames long past are of no concern.
                    if let Some(at) = query.0.checked_sub(self.first)
                        && let Some(answer) = self.answers.get_mut(at as usize)
                    {
                        *answer = Some(word.iter().any(|byte| *byte != 0));
                    }
                }
            }
            buffer.unmap();
            self.spare.push(buffer);
        }
    }

    fn memory(&mut self, gpu: &Gpu) -> wgpu::Buffer {
        self.spare.pop().unwrap_or_else(|| {
            gpu.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some("occlusion answers to read"),
                size: u64::from(SET_SIZE) * ANSWER_BYTES,
                usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
                mapped_at_creation: false,
            })
        })
    }
}

fn pipeline(
    gpu: &Gpu,
    layouts: &wgpu::PipelineLayout,
    module: &wgpu::ShaderModule,
    has_colors: bool,
) -> wgpu::RenderPipeline {
    gpu.device().create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("occlusion boxes"),
        layout: Some(layouts),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("box_corner"),
            compilation_options: Default::default(),
            buffers: &[],
        },
        // Both sides: a box is closed, and its front may be cut away.
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(wgpu::DepthStencilState {
            depth_write_enabled: Some(false),
            ..Targets::depth_state(wgpu::CompareFunction::GreaterEqual)
        }),
        multisample: wgpu::MultisampleState::default(),
        fragment: has_colors.then_some(wgpu::FragmentState {
            module,
            entry_point: Some("no_color"),
            compilation_options: Default::default(),
            targets: &[Some(wgpu::ColorTargetState {
                format: Targets::COLOR_FORMAT,
                blend: None,
                write_mask: wgpu::ColorWrites::empty(),
            })],
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// A picture that models are drawn into, object by object as culling wants it.
pub struct CulledMeshes<'a> {
    /// The device.
    pub gpu: &'a Gpu,
    /// The questions of this view.
    pub queries: &'a mut OcclusionQueries,
    /// The models; their recordings for this view were begun.
    pub meshes: &'a mut Meshes,
    /// The tree that is walked.
    pub tree: &'a Bvh,
    /// What all draws share.
    pub frame: &'a GpuFrame,
    /// Targets with the colours, and with the depths; both are drawn over.
    pub targets: (&'a Targets, &'a Targets),
    /// Whether depth alone is drawn in the rounds, and colours when all of it is there.
    pub shades_after: bool,
    recording: Recording,
    /// Objects to shade after the rounds.
    shaded: Vec<ObjectId>,
}

/// What waits for the next submission.
#[derive(Default)]
struct Recording {
    drawn: Vec<ObjectId>,
    /// Objects that are drawn inside of a question, as ranges of `asked_objects`.
    asked: Vec<(QueryId, Range<usize>)>,
    asked_objects: Vec<ObjectId>,
    /// Questions, as ranges of `boxes`.
    queries: Vec<(QueryId, Range<u32>)>,
    boxes: Vec<GpuBox>,
    view: Option<View>,
    counts: MeshCounts,
    rounds: u64,
    switches: u64,
    failure: Option<GpuError>,
}

impl<'a> CulledMeshes<'a> {
    /// Begins a frame over what the targets hold.
    pub fn new(
        gpu: &'a Gpu,
        queries: &'a mut OcclusionQueries,
        meshes: &'a mut Meshes,
        tree: &'a Bvh,
        frame: &'a GpuFrame,
        targets: (&'a Targets, &'a Targets),
    ) -> Self {
        let recording = Recording::default();
        let (shades_after, shaded) = (false, Vec::new());
        CulledMeshes { gpu, queries, meshes, tree, frame, targets, shades_after, recording, shaded }
    }

    /// What was drawn.
    ///
    /// # Errors
    /// The first refusal of the device; from then on nothing was drawn or asked.
    pub fn finish(self) -> Result<MeshCounts, GpuError> {
        match self.recording.failure {
            Some(error) => Err(error),
            None => Ok(self.recording.counts),
        }
    }

    fn submit(&mut self) {
        let recording = &self.recording;
        let is_empty = recording.drawn.is_empty()
            && recording.asked.is_empty()
            && recording.queries.is_empty();
        if is_empty || recording.failure.is_some() {
            return;
        }
        let work = std::mem::take(&mut self.recording);
        let (view, mut counts, rounds) = (work.view, work.counts, work.rounds + 1);
        if self.shades_after {
            self.shaded.extend(work.drawn.iter().chain(&work.asked_objects));
        }
        let asks = !work.queries.is_empty();
        let draws = !work.drawn.is_empty() || !work.asked.is_empty();
        // From the last round's questions back to drawing, and on to asking.
        let switches = work.switches + u64::from(draws && rounds > 1) + u64::from(draws && asks);
        let gpu = self.gpu;
        let submitted = gpu.checked("draw a round of culling", || self.round(&work));
        let failure = match submitted.and_then(|counts| counts) {
            Ok(round) => {
                counts += round;
                None
            }
            Err(error) => Some(error),
        };
        self.recording =
            Recording { view, counts, rounds, switches, failure, ..Recording::default() };
    }

    fn round(&mut self, work: &Recording) -> Result<MeshCounts, GpuError> {
        let gpu = self.gpu;
        let output = if self.shades_after { MeshOutput::DEPTH } else { MeshOutput::COLOR };
        let list = self.meshes.list(gpu, &work.drawn, DrawOrder::Grouped)?;
        let asked = self.meshes.list(gpu, &work.asked_objects, DrawOrder::Kept)?;
        // A buffer of its own: submissions of a frame must not overwrite each other's boxes before
        // they run.
        let mut boxes = GrowingBuffer::new("boxes", wgpu::BufferUsages::STORAGE);
        let none = [GpuBox { low: [0.0; 3], item: 0, high: [0.0; 3], untested: 0 }];
        boxes.write(gpu, if work.boxes.is_empty() { &none } else { &work.boxes })?;
        self.queries.frame.write(gpu, &[*self.frame])?;
        let (boxes, frame) = (boxes.get(), self.queries.frame.get());
        let (Some(boxes), Some(frame)) = (boxes, frame) else { return Ok(MeshCounts::default()) };
        let box_bytes = size_of::<GpuBox>() as u64 * work.boxes.len().max(1) as u64;
        let groups = [
            bind(gpu, &self.queries.frame_layout, &[part(frame, 0, size_of::<GpuFrame>() as u64)]),
            bind(gpu, &self.queries.box_layout, &[part(boxes, 0, box_bytes)]),
        ];
        let mut counts = MeshCounts::default();
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        let mut parts = Vec::new();
        // Draws inside of questions take the first slots.
        let slots = work.asked.len() + work.queries.len();
        if self.queries.pyramid.is_some() {
            counts += self.meshes.record(
                gpu,
                &mut self.begin_pass(&mut encoder, !self.shades_after),
                &list,
                output,
            )?;
            parts = self.ask_pyramid(&mut encoder, boxes, work)?;
            gpu.queue().submit([encoder.finish()]);
            let ids: Vec<QueryId> = work.queries.iter().map(|(id, _)| *id).collect();
            for (buffer, slots) in parts {
                self.read_back(buffer, &ids[slots], size_of::<u32>());
            }
            return Ok(counts);
        }
        let mut from = 0;
        loop {
            let to = slots.min(from + SET_SIZE as usize);
            {
                let mut pass = self.begin_pass(&mut encoder, !self.shades_after);
                if from == 0 {
                    counts += self.meshes.record(gpu, &mut pass, &list, output)?;
                }
                for slot in from..to.min(work.asked.len()) {
                    pass.begin_occlusion_query((slot - from) as u32);
                    let objects = work.asked[slot].1.clone();
                    counts += self.meshes.record_part(gpu, &mut pass, &asked, objects, output)?;
                    pass.end_occlusion_query();
                }
                pass.set_pipeline(&self.queries.pipelines[usize::from(self.shades_after)]);
                pass.set_bind_group(0, &groups[0], &[]);
                pass.set_bind_group(1, &groups[1], &[]);
                for slot in from.max(work.asked.len())..to {
                    pass.begin_occlusion_query((slot - from) as u32);
                    pass.draw(0..36, work.queries[slot - work.asked.len()].1.clone());
                    pass.end_occlusion_query();
                }
            }
            if to > from {
                let count = (to - from) as u32;
                let buffer = self.queries.memory(gpu);
                encoder.resolve_query_set(&self.queries.set, 0..count, &self.queries.resolved, 0);
                let bytes = u64::from(count) * ANSWER_BYTES;
                encoder.copy_buffer_to_buffer(&self.queries.resolved, 0, &buffer, 0, bytes);
                parts.push((buffer, from..to));
            }
            from = to;
            if from == slots {
                break;
            }
        }
        gpu.queue().submit([encoder.finish()]);
        // Questions are numbered in the order in which they were put, which is not that of slots.
        let ids: Vec<QueryId> = work
            .asked
            .iter()
            .map(|(id, _)| *id)
            .chain(work.queries.iter().map(|(id, _)| *id))
            .collect();
        for (buffer, slots) in parts {
            self.read_back(buffer, &ids[slots], ANSWER_BYTES as usize);
        }
        Ok(counts)
    }

    /// Adds the commands by which a depth pyramid answers, and copies of the answers to be read: each
    /// with the questions it answers.
    fn ask_pyramid(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        boxes: &wgpu::Buffer,
        work: &Recording,
    ) -> Result<Vec<(wgpu::Buffer, Range<usize>)>, GpuError> {
        let mut parts = Vec::new();
        if work.queries.is_empty() {
            return Ok(parts);
        }
        let asked = (boxes, work.boxes.len() as u32);
        let depths = self.targets.1;
        let Some(mut pyramid) = self.queries.pyramid.take() else { return Ok(parts) };
        let count = work.queries.len() as u32;
        let answered = pyramid.record(self.gpu, encoder, self.frame, depths, asked, count);
        if let Ok(Some(answers)) = &answered {
            let most = (u64::from(SET_SIZE) * ANSWER_BYTES / 4) as usize;
            for from in (0..work.queries.len()).step_by(most) {
                let to = work.queries.len().min(from + most);
                let buffer = self.queries.memory(self.gpu);
                let bytes = 4 * (to - from) as u64;
                encoder.copy_buffer_to_buffer(answers, 4 * from as u64, &buffer, 0, bytes);
                parts.push((buffer, from..to));
            }
        }
        let failure = answered.err();
        self.queries.pyramid = Some(pyramid);
        failure.map_or(Ok(parts), Err)
    }

    fn read_back(&mut self, buffer: wgpu::Buffer, ids: &[QueryId], answer_bytes: usize) {
        let is_done = Arc::new(AtomicBool::new(false));
        let done = is_done.clone();
        let bytes = (answer_bytes * ids.len()) as u64;
        buffer.slice(..bytes).map_async(wgpu::MapMode::Read, move |_| {
            // What could not be mapped stays unknown, which counts as visible.
            done.store(true, Ordering::Release);
        });
        let queries = ids.to_vec();
        self.queries.under_way.push_back(Submission { buffer, queries, answer_bytes, is_done });
    }

    /// Gives the objects of all rounds their colours; the calls it took.
    fn shade(&mut self) -> Result<u32, GpuError> {
        let gpu = self.gpu;
        let list = self.meshes.list(gpu, &self.shaded, DrawOrder::Grouped)?;
        self.shaded.clear();
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        let mut pass = self.begin_pass(&mut encoder, true);
        let counts = self.meshes.record(gpu, &mut pass, &list, MeshOutput::SHADE)?;
        drop(pass);
        gpu.queue().submit([encoder.finish()]);
        Ok(counts.draw_calls)
    }

    fn begin_pass<'e>(
        &self,
        encoder: &'e mut wgpu::CommandEncoder,
        has_colors: bool,
    ) -> wgpu::RenderPass<'e> {
        let (colors, depths) = self.targets;
        let over = wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store };
        let color = [Some(wgpu::RenderPassColorAttachment {
            view: colors.color_view(),
            depth_slice: None,
            resolve_target: None,
            ops: over,
        })];
        let depth = depths.depth_view().map(|view| wgpu::RenderPassDepthStencilAttachment {
            view,
            depth_ops: Some(wgpu::Operations {
                load: wgpu::LoadOp::Load,
                store: wgpu::StoreOp::Store,
            }),
            stencil_ops: None,
        });
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("culled meshes"),
            color_attachments: if has_colors { &color } else { &[] },
            depth_stencil_attachment: depth,
            occlusion_query_set: Some(&self.queries.set),
            ..Default::default()
        })
    }
}

impl OcclusionDevice for CulledMeshes<'_> {
    fn begin_frame(&mut self, view: &View) {
        self.recording.view = Some(*view);
        self.queries.begin_frame(self.gpu);
    }

    fn draw(&mut self, node: TreeNodeId) {
        self.recording.drawn.extend_from_slice(self.tree.objects_of(node));
    }

    fn query(&mut self, boxes: &[Aabb]) -> QueryId {
        let id = self.queries.ask();
        let recording = &mut self.recording;
        let first = recording.boxes.len() as u32;
        let eye = recording.view.map_or(glam::DVec3::ZERO, |view| view.camera.eye);
        let item = recording.queries.len() as u32;
        recording.boxes.extend(boxes.iter().map(|bounds| GpuBox {
            low: (bounds.min - eye).as_vec3().to_array(),
            item,
            high: (bounds.max - eye).as_vec3().to_array(),
            untested: 0,
        }));
        recording.queries.push((id, first..recording.boxes.len() as u32));
        id
    }

    fn draw_and_query(&mut self, node: TreeNodeId) -> QueryId {
        if self.queries.is_by_pyramid()
            && let Some(view) = self.recording.view
        {
            // The box is in front of what it holds, which is drawn by then.
            self.draw(node);
            return self.query(&[Proxies::new(&view).of(self.tree, node)]);
        }
        let id = self.queries.ask();
        let recording = &mut self.recording;
        let first = recording.asked_objects.len();
        recording.asked_objects.extend_from_slice(self.tree.objects_of(node));
        recording.asked.push((id, first..recording.asked_objects.len()));
        id
    }

    fn answer(&mut self, query: QueryId) -> Answer {
        let at = query.0.checked_sub(self.queries.first);
        match at.and_then(|at| self.queries.answers.get(at as usize)) {
            Some(Some(seen)) => Answer::Samples(u64::from(*seen)),
            _ => Answer::Unknown,
        }
    }

    fn wait(&mut self, _query: QueryId) {
        self.submit();
        if self.recording.failure.is_some() {
            return;
        }
        if let Err(error) = self.gpu.wait() {
            self.recording.failure = Some(error);
            return;
        }
        self.queries.collect();
        // The work is done, but another thread that polls the device may be about to say so.
        let started = Instant::now();
        while !self.queries.under_way.is_empty() && started.elapsed() < CALLBACK_LIMIT {
            std::thread::yield_now();
            self.queries.collect();
        }
    }

    fn end_frame(&mut self) {
        self.submit();
        if self.shades_after && !self.shaded.is_empty() && self.recording.failure.is_none() {
            let gpu = self.gpu;
            let shaded = gpu.checked("shade what culling left", || self.shade());
            match shaded.and_then(|calls| calls) {
                Ok(calls) => self.recording.counts.draw_calls += calls,
                Err(error) => self.recording.failure = Some(error),
            }
        }
    }

    fn state_switches(&self) -> u64 {
        self.recording.switches
    }

    fn rounds(&self) -> u64 {
        self.recording.rounds
    }
}
