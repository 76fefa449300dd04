//! What is done to a drawn picture on the device: gaps filled, edges shaded. Each is a pass over
//! the picture into textures of its own; what is off has neither pass nor textures.
//!
//! They read colour and depth of the targets, so they take whatever was drawn into these, points or
//! meshes. Shaders: `fill_gaps.wgsl`, `eye_dome.wgsl`. Twin: `finish_cpu`.

use crate::gpu::layout::GpuFinish;
use crate::gpu::{Gpu, GpuError, GrowingBuffer, PassTimer, shader};
use crate::passes::bindings::{covering_pipeline, pipeline_layout};
use crate::passes::{DrawCounts, FinishSettings, Targets};

/// The passes that were ever asked for.
#[derive(Debug)]
pub struct Finish {
    inputs: wgpu::BindGroupLayout,
    parameters: GrowingBuffer,
    fill_gaps: Option<Step>,
    eye_dome: Option<Step>,
}

/// One pass and what it draws to.
#[derive(Debug)]
struct Step {
    pipeline: wgpu::RenderPipeline,
    targets: Option<Targets>,
}

impl Finish {
    /// Compiles nothing yet.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty,
            count: None,
        };
        let texture = |sample_type| wgpu::BindingType::Texture {
            sample_type,
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: false,
        };
        let uniform = wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: false,
            min_binding_size: None,
        };
        let inputs = gpu.checked("build the finishing passes", || {
            gpu.device().create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("finish"),
                entries: &[
                    entry(0, uniform),
                    entry(1, texture(wgpu::TextureSampleType::Float { filterable: false })),
                    entry(2, texture(wgpu::TextureSampleType::Depth)),
                ],
            })
        })?;
        Ok(Finish {
            inputs,
            parameters: GrowingBuffer::new("finish", wgpu::BufferUsages::UNIFORM),
            fill_gaps: None,
            eye_dome: None,
        })
    }

    /// Adds the commands; the finished picture is then in [`finished`](Self::finished).
    pub fn draw(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut PassTimer,
        settings: &FinishSettings,
        drawn: &Targets,
    ) -> Result<DrawCounts, GpuError> {
        let mut counts = DrawCounts::default();
        let (fills, lights) = (settings.gap_radius_px > 0, settings.eye_dome.is_some());
        // What is switched off gives its memory back.
        if !fills {
            self.fill_gaps = None;
        }
        if !lights {
            self.eye_dome = None;
        }
        if settings.is_nothing() {
            return Ok(counts);
        }
        let parameters = settings.gpu_finish();
        counts.uploaded_bytes += size_of::<GpuFinish>() as u64;
        let parameters = self.parameters.write(gpu, &[parameters])?;
        if fills {
            let step = Step::ready(&mut self.fill_gaps, gpu, &self.inputs, "fill_gaps", drawn)?;
            step.draw(gpu, encoder, timer, &self.inputs, parameters, drawn)?;
            counts.draw_calls += 1;
        }
        let drawn = self.fill_gaps.as_ref().and_then(|step| step.targets.as_ref()).unwrap_or(drawn);
        if lights {
            let step = Step::ready(&mut self.eye_dome, gpu, &self.inputs, "eye_dome", drawn)?;
            step.draw(gpu, encoder, timer, &self.inputs, parameters, drawn)?;
            counts.draw_calls += 1;
        }
        Ok(counts)
    }

    /// The targets with the colours of the last frame, and those with its depths; `drawn` are
    /// those that the points were drawn to.
    pub fn finished<'a>(&'a self, drawn: &'a Targets) -> (&'a Targets, &'a Targets) {
        let of = |step: &'a Option<Step>| step.as_ref().and_then(|step| step.targets.as_ref());
        let depths = of(&self.fill_gaps).unwrap_or(drawn);
        (of(&self.eye_dome).unwrap_or(depths), depths)
    }

    /// Whether the last frame's gaps were filled, which changes depths.
    pub fn fills_gaps(&self) -> bool {
        self.fill_gaps.is_some()
    }

    /// Bytes of textures held on the device.
    pub fn held_bytes(&self) -> u64 {
        let steps = [&self.fill_gaps, &self.eye_dome];
        let targets = steps.into_iter().flatten().filter_map(|step| step.targets.as_ref());
        self.parameters.held_bytes() + targets.map(Targets::held_bytes).sum::<u64>()
    }
}

impl Step {
    /// The step of that name with targets like those of the picture.
    fn ready<'a>(
        step: &'a mut Option<Step>,
        gpu: &Gpu,
        inputs: &wgpu::BindGroupLayout,
        name: &'static str,
        like: &Targets,
    ) -> Result<&'a mut Step, GpuError> {
        if step.is_none() {
            let (entry, has_depth) = match name {
                "fill_gaps" => ("fill_gaps", true),
                _ => ("light_eye_dome", false),
            };
            let module = shader::module(gpu, name)?;
            let pipeline = gpu.checked("build a finishing pass", || {
                let layout = pipeline_layout(gpu, name, &[Some(inputs)]);
                covering_pipeline(gpu, &layout, &module, entry, has_depth)
            })?;
            *step = Some(Step { pipeline, targets: None });
        }
        let step = step.as_mut().expect("it was just made");
        let (width, height) = like.size_px();
        if !step.targets.as_ref().is_some_and(|targets| targets.fits(width, height)) {
            step.targets = None;
            step.targets = Some(match name {
                "fill_gaps" => Targets::new(gpu, width, height)?,
                _ => Targets::without_depth(gpu, width, height)?,
            });
        }
        Ok(step)
    }

    fn draw(
        &self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut PassTimer,
        inputs: &wgpu::BindGroupLayout,
        parameters: &wgpu::Buffer,
        drawn: &Targets,
    ) -> Result<(), GpuError> {
        let targets = self.targets.as_ref().expect("they were made for this frame");
        let Some(depth) = drawn.depth_view() else { return Ok(()) };
        let resource = [
            parameters.as_entire_binding(),
            wgpu::BindingResource::TextureView(drawn.color_view()),
            wgpu::BindingResource::TextureView(depth),
        ];
        let entries: Vec<_> = resource
            .into_iter()
            .zip(0..)
            .map(|(resource, binding)| wgpu::BindGroupEntry { binding, resource })
            .collect();
        let group = gpu.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: inputs,
            entries: &entries,
        });
        let name = if targets.depth_view().is_some() { "fill_gaps" } else { "eye_dome" };
        let (color, depth) = targets.cleared(0);
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some(name),
            color_attachments: &[Some(color)],
            depth_stencil_attachment: depth,
            timestamp_writes: timer.render_pass(name),
            ..Default::default()
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.draw(0..3, 0..1);
        Ok(())
    }
}
