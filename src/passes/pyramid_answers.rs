//! Questions of culling answered by compute: boxes against a depth pyramid of what is drawn so far.
//!
//! Stands in for occlusion queries where these are slow or missing. An answer may be "visible" where
//! a query says "hidden", since a texel knows only its farthest depth, never the other way round.
//! Shader: `pyramid_answers.wgsl`. Twin: [`DepthPyramidCpu`](crate::passes::DepthPyramidCpu).

use crate::gpu::layout::{GpuBox, GpuFrame, WORKGROUP_SIZE};
use crate::gpu::{Gpu, GpuError, GrowingBuffer, shader};
use crate::passes::DepthPyramid;
use crate::passes::bindings::{bind, compute_pipeline, layout, part, pipeline_layout};

/// Workgroups along one axis of a dispatch.
pub(super) const MOST_GROUPS: u32 = 65_535;

/// The pyramid and the test.
#[derive(Debug)]
pub struct PyramidAnswers {
    pyramid: DepthPyramid,
    pipeline: wgpu::ComputePipeline,
    frame_layout: wgpu::BindGroupLayout,
    box_layout: wgpu::BindGroupLayout,
    frame: GrowingBuffer,
    answers: GrowingBuffer,
}

impl PyramidAnswers {
    /// Compiles the passes.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let pyramid = DepthPyramid::new(gpu)?;
        let module = shader::module(gpu, "pyramid_answers")?;
        gpu.checked("build the test of boxes", || {
            let compute = wgpu::ShaderStages::COMPUTE;
            let storage = |read_only| wgpu::BufferBindingType::Storage { read_only };
            let frame_layout = layout(gpu, "frame", &[(compute, wgpu::BufferBindingType::Uniform)]);
            let box_layout = layout(
                gpu,
                "boxes, answers",
                &[(compute, storage(true)), (compute, storage(false))],
            );
            let groups = [Some(&frame_layout), Some(pyramid.test_layout()), Some(&box_layout)];
            let pipelines = pipeline_layout(gpu, "pyramid answers", &groups);
            PyramidAnswers {
                pipeline: compute_pipeline(gpu, &pipelines, &module, "answer_questions", &[]),
                pyramid,
                frame_layout,
                box_layout,
                frame: GrowingBuffer::new("frame", wgpu::BufferUsages::UNIFORM),
                answers: GrowingBuffer::new(
                    "answers",
                    wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
                ),
            }
        })
    }

    /// The pyramid as it was last made.
    pub fn pyramid(&self) -> &DepthPyramid {
        &self.pyramid
    }

    /// Adds the commands that answer `questions` questions about boxes, numbered in
    /// [`GpuBox::item`], against the depth as it then is. The buffer has a word a question, 1 if
    /// any of its boxes may show. Without depth there is none.
    ///
    /// `boxes` must not be empty; it is the caller's, because a later call within a submission
    /// must not overwrite what an earlier one reads.
    pub fn record(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        frame: &GpuFrame,
        (depth, size_px): (Option<&wgpu::TextureView>, (u32, u32)),
        boxes: (&wgpu::Buffer, u32),
        questions: u32,
    ) -> Result<Option<&wgpu::Buffer>, GpuError> {
        if !self.pyramid.prepare(gpu, depth, size_px)? {
            return Ok(None);
        }
        let answer_bytes = 4 * u64::from(questions.max(1));
        self.frame.write(gpu, &[*frame])?;
        self.answers.reserve(gpu, answer_bytes)?;
        let (Some(frame), Some(answers), Some(test)) =
            (self.frame.get(), self.answers.get(), self.pyramid.test_group())
        else {
            return Ok(None);
        };
        let (buffer, count) = boxes;
        let box_bytes = size_of::<GpuBox>() as u64 * u64::from(count);
        let frame = bind(gpu, &self.frame_layout, &[part(frame, 0, size_of::<GpuFrame>() as u64)]);
        let bound = [part(buffer, 0, box_bytes), part(answers, 0, answer_bytes)];
        let asked = bind(gpu, &self.box_layout, &bound);
        encoder.clear_buffer(answers, 0, Some(answer_bytes));
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some("pyramid answers"),
            timestamp_writes: None,
        });
        self.pyramid.record(&mut pass);
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &frame, &[]);
        pass.set_bind_group(1, test, &[]);
        pass.set_bind_group(2, &asked, &[]);
        let [x, y] = groups_of(count.div_ceil(WORKGROUP_SIZE));
        pass.dispatch_workgroups(x, y, 1);
        Ok(Some(answers))
    }
}

/// Workgroups along two axes that are at least so many.
pub(super) fn groups_of(count: u32) -> [u32; 2] {
    let x = count.clamp(1, MOST_GROUPS);
    [x, count.div_ceil(x).max(1)]
}
