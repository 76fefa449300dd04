//! Questions of culling put to the device: occlusion queries around boxes, read back without
//! stopping it.
//!
//! A round is one submission: all draws recorded since the last one, then all questions, so that
//! each sees the depth of the whole round; then the answers are copied to memory that the CPU maps
//! when they are done. Queries of all backends tell only none from some. In their place a depth
//! pyramid can answer, by compute ([`OcclusionQueries::by_pyramid`]).
//! Of [`OcclusionQueries`] one is kept per view; [`CulledScene`](crate::passes::CulledScene) lends
//! it what is drawn for a frame.
//!
//! Shader: `occlusion_boxes.wgsl`. Twin: [`SoftwareDevice`](crate::visibility::SoftwareDevice).

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::gpu::{Gpu, GpuError, GrowingBuffer, shader};
use crate::passes::bindings::{layout, pipeline_layout};
use crate::passes::{PyramidAnswers, Targets};
use crate::visibility::{Answer, QueryId};

/// Questions of one pass; more go into further passes of the same round.
pub(super) const SET_SIZE: u32 = 4096;
pub(super) const ANSWER_BYTES: u64 = 8;
/// How long another thread may take to tell that answers are there.
pub(super) const CALLBACK_LIMIT: Duration = Duration::from_secs(10);

/// The questions of one view: those under way, and answers of the last frame and this one.
#[derive(Debug)]
pub struct OcclusionQueries {
    /// In passes with colours, and in passes with depth alone.
    pub(super) pipelines: [wgpu::RenderPipeline; 2],
    pub(super) frame_layout: wgpu::BindGroupLayout,
    pub(super) box_layout: wgpu::BindGroupLayout,
    pub(super) frame: GrowingBuffer,
    pub(super) boxes: GrowingBuffer,
    pub(super) set: wgpu::QuerySet,
    pub(super) resolved: wgpu::Buffer,
    /// Answers in place of the queries.
    pub(super) pyramid: Option<Box<PyramidAnswers>>,
    /// Memory for answers that nobody reads now.
    spare: Vec<wgpu::Buffer>,
    pub(super) under_way: VecDeque<Submission>,
    answers: VecDeque<Option<bool>>,
    /// Number of the first question in `answers`, and of the first one of this frame.
    first: u64,
    first_of_frame: u64,
}

#[derive(Debug)]
pub(super) struct Submission {
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
                boxes: GrowingBuffer::new("boxes", wgpu::BufferUsages::STORAGE),
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

    pub(super) fn begin_frame(&mut self, gpu: &Gpu) {
        // A device that does not answer is found out by whoever waits for it.
        let _ = gpu.device().poll(wgpu::PollType::Poll);
        self.collect();
        let old = self.first_of_frame - self.first;
        self.answers.drain(..old as usize);
        self.first = self.first_of_frame;
        self.first_of_frame += self.answers.len() as u64;
    }

    pub(super) fn ask(&mut self) -> QueryId {
        self.answers.push_back(None);
        QueryId(self.first + self.answers.len() as u64 - 1)
    }

    /// What is known of a question.
    pub(super) fn answer(&self, query: QueryId) -> Answer {
        let at = query.0.checked_sub(self.first);
        match at.and_then(|at| self.answers.get(at as usize)) {
            Some(Some(seen)) => Answer::Samples(u64::from(*seen)),
            _ => Answer::Unknown,
        }
    }

    /// Has answers copied to memory as soon as they are there.
    pub(super) fn read_back(&mut self, buffer: wgpu::Buffer, ids: &[QueryId], answer_bytes: usize) {
        let is_done = Arc::new(AtomicBool::new(false));
        let done = is_done.clone();
        let bytes = (answer_bytes * ids.len()) as u64;
        buffer.slice(..bytes).map_async(wgpu::MapMode::Read, move |_| {
            // What could not be mapped stays unknown, which counts as visible.
            done.store(true, Ordering::Release);
        });
        let queries = ids.to_vec();
        self.under_way.push_back(Submission { buffer, queries, answer_bytes, is_done });
    }

    /// Takes in what has arrived.
    pub(super) fn collect(&mut self) {
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

    pub(super) fn memory(&mut self, gpu: &Gpu) -> wgpu::Buffer {
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
        // Fronts alone: a box that is asked about lies behind the near plane, so wherever its back would
        // show, its front does.
        primitive: wgpu::PrimitiveState {
            cull_mode: Some(wgpu::Face::Back),
            ..wgpu::PrimitiveState::default()
        },
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
