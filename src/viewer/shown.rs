//! Textures painted into the window as they are.
//!
//! A callback in egui's own pass: one triangle over the rectangle, cut off at its edges by the
//! viewport. Shader: `show.wgsl`.

use std::borrow::Cow;

use egui::{Color32, PaintCallbackInfo, Rect, Shape};
use egui_wgpu::{Callback, CallbackResources, CallbackTrait};

use crate::gpu::shader::{PixelAtomics, source};

/// Makes textures ready to be painted.
pub struct Shower {
    device: wgpu::Device,
    queue: wgpu::Queue,
    layout: wgpu::BindGroupLayout,
    pipeline: wgpu::RenderPipeline,
}

/// A texture that can be painted.
#[derive(Clone)]
pub struct Shown {
    pipeline: wgpu::RenderPipeline,
    texture: wgpu::BindGroup,
}

impl Shower {
    /// For targets of a format. What the device has against it, it tells its handler of errors.
    pub fn new(device: wgpu::Device, queue: wgpu::Queue, format: wgpu::TextureFormat) -> Self {
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("shown"),
            entries: &[wgpu::BindGroupLayoutEntry {
                binding: 0,
                visibility: wgpu::ShaderStages::FRAGMENT,
                ty: wgpu::BindingType::Texture {
                    sample_type: wgpu::TextureSampleType::Float { filterable: false },
                    view_dimension: wgpu::TextureViewDimension::D2,
                    multisampled: false,
                },
                count: None,
            }],
        });
        let pipeline = pipeline(&device, &layout, format);
        Shower { device, queue, layout, pipeline }
    }

    /// A picture on the window's device.
    pub fn picture(&self, view: &wgpu::TextureView) -> Shown {
        let texture = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("shown"),
            layout: &self.layout,
            entries: &[wgpu::BindGroupEntry {
                binding: 0,
                resource: wgpu::BindingResource::TextureView(view),
            }],
        });
        Shown { pipeline: self.pipeline.clone(), texture }
    }

    /// A picture of one colour.
    pub fn plain(&self, color: Color32) -> Shown {
        let texture = self.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("one colour"),
            size: wgpu::Extent3d { width: 1, height: 1, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba8Unorm,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        });
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(4),
            rows_per_image: Some(1),
        };
        let size = texture.size();
        self.queue.write_texture(texture.as_image_copy(), &color.to_array(), layout, size);
        self.picture(&texture.create_view(&wgpu::TextureViewDescriptor::default()))
    }
}

impl Shown {
    /// Fills a rectangle of the window.
    pub fn shape(&self, rect: Rect) -> Shape {
        Shape::Callback(Callback::new_paint_callback(rect, self.clone()))
    }
}

impl CallbackTrait for Shown {
    fn paint(
        &self,
        _: PaintCallbackInfo,
        pass: &mut wgpu::RenderPass<'static>,
        _: &CallbackResources,
    ) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &self.texture, &[]);
        pass.draw(0..3, 0..1);
    }
}

fn pipeline(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    format: wgpu::TextureFormat,
) -> wgpu::RenderPipeline {
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("show"),
        source: wgpu::ShaderSource::Wgsl(Cow::Owned(source("show", PixelAtomics::Narrow))),
    });
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("show"),
        bind_group_layouts: &[Some(layout)],
        ..Default::default()
    });
    let constants = [("IS_LINEAR", f64::from(format.is_srgb()))];
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("show"),
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("corner"),
            compilation_options: Default::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("show"),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &constants,
                ..Default::default()
            },
            targets: &[Some(format.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
