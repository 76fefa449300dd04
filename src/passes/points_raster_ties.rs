//! What the rasterizing pass needs so that points at one depth are decided by their colours.
//!
//! Points are drawn for the order of the nearest distance, then, of those at that distance, for the
//! colour, with the order of colours in place of depth. Both orders are depths of textures of their
//! own, because they are not `near / distance`: the first keeps every bit of a distance, which a
//! quotient does not. One more pass writes the depth that everything else reads.

use crate::gpu::layout::GpuFrame;
use crate::gpu::{Gpu, GpuError, PassTimer};
use crate::passes::Targets;
use crate::passes::bindings::pipeline_layout;
use crate::passes::targets::DepthTarget;

/// What points are drawn for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    /// Colour and depth at once, the first of several points at one depth.
    Plain,
    /// The order of the nearest distance.
    Order,
    /// The smallest colour of the points there.
    Color,
}

/// The two orders, and what reads them. Textures are held from the first frame on.
#[derive(Debug)]
pub(super) struct SharedOrders {
    nearest_layout: wgpu::BindGroupLayout,
    color_layout: wgpu::PipelineLayout,
    write_depth: wgpu::RenderPipeline,
    held: Option<Held>,
}

#[derive(Debug)]
struct Held {
    nearest: DepthTarget,
    colors: DepthTarget,
    nearest_group: wgpu::BindGroup,
}

impl SharedOrders {
    pub(super) fn new(
        gpu: &Gpu,
        shader: &wgpu::ShaderModule,
        frame: &wgpu::BindGroupLayout,
        scene: &wgpu::BindGroupLayout,
    ) -> Self {
        let nearest_layout =
            gpu.device().create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("nearest"),
                entries: &[wgpu::BindGroupLayoutEntry {
                    binding: 0,
                    visibility: wgpu::ShaderStages::FRAGMENT,
                    ty: wgpu::BindingType::Texture {
                        sample_type: wgpu::TextureSampleType::Depth,
                        view_dimension: wgpu::TextureViewDimension::D2,
                        multisampled: false,
                    },
                    count: None,
                }],
            });
        let groups = [Some(frame), Some(scene), Some(&nearest_layout)];
        let color_layout = pipeline_layout(gpu, "colors of points", &groups);
        let depth_layout =
            pipeline_layout(gpu, "depth of points", &[Some(frame), None, Some(&nearest_layout)]);
        let write_depth = gpu.device().create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("depth of points"),
            layout: Some(&depth_layout),
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
                entry_point: Some("depth_of_nearest"),
                compilation_options: Default::default(),
                targets: &[],
            }),
            multiview_mask: None,
            cache: None,
        });
        SharedOrders { nearest_layout, color_layout, write_depth, held: None }
    }

    /// The layout of pipelines that draw [`Step::Color`].
    pub(super) fn color_layout(&self) -> &wgpu::PipelineLayout {
        &self.color_layout
    }

    /// Makes textures of that size, unless there are some.
    pub(super) fn fit(&mut self, gpu: &Gpu, (width, height): (u32, u32)) -> Result<(), GpuError> {
        let size_px = [width, height];
        if self.held.as_ref().is_some_and(|held| held.nearest.size_px() == size_px) {
            return Ok(());
        }
        self.held = None;
        let nearest = DepthTarget::new(gpu, size_px)?;
        let colors = DepthTarget::new(gpu, size_px)?;
        let nearest_group = gpu.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("nearest"),
            layout: &self.nearest_layout,
            entries: &[wgpu::BindGroupEntry {
                binding: 0,
                resource: wgpu::BindingResource::TextureView(nearest.view()),
            }],
        });
        self.held = Some(Held { nearest, colors, nearest_group });
        Ok(())
    }

    /// Begins the pass of a step, which must not be the plain one.
    pub(super) fn begin<'a>(
        &self,
        encoder: &'a mut wgpu::CommandEncoder,
        timer: &mut PassTimer,
        targets: &Targets,
        frame: &GpuFrame,
        step: Step,
    ) -> wgpu::RenderPass<'a> {
        let held = self.held.as_ref().expect("they were made for this frame");
        let (color, _) = targets.cleared(frame.background);
        let (name, color, order) = match step {
            Step::Color => ("points", Some(color), &held.colors),
            _ => ("points nearest", None, &held.nearest),
        };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some(name),
            color_attachments: &[color][..usize::from(step == Step::Color)],
            depth_stencil_attachment: Some(order.cleared()),
            timestamp_writes: timer.render_pass(name),
            ..Default::default()
        });
        if step == Step::Color {
            pass.set_bind_group(2, &held.nearest_group, &[]);
        }
        pass
    }

    /// Turns orders into depth, where the targets have any.
    pub(super) fn write_depth(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        timer: &mut PassTimer,
        targets: &Targets,
        frame_group: &wgpu::BindGroup,
    ) {
        let (_, depth) = targets.cleared(0);
        let (Some(held), Some(depth)) = (&self.held, depth) else { return };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("points depth"),
            depth_stencil_attachment: Some(depth),
            timestamp_writes: timer.render_pass("points depth"),
            ..Default::default()
        });
        pass.set_pipeline(&self.write_depth);
        pass.set_bind_group(0, frame_group, &[]);
        pass.set_bind_group(2, &held.nearest_group, &[]);
        pass.draw(0..3, 0..1);
    }

    /// Bytes of the textures.
    pub(super) fn held_bytes(&self) -> u64 {
        let texture = |[width, height]: [u32; 2]| 4 * u64::from(width) * u64::from(height);
        self.held.as_ref().map_or(0, |held| 2 * texture(held.nearest.size_px()))
    }
}
