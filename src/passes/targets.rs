//! The textures of one view: what the passes draw to, and what is read back or shown.

use crate::gpu::{Gpu, GpuError, HeldBytes, read_texture};
use crate::passes::Picture;

/// Colour and, mostly, reversed-z depth of one size.
#[derive(Debug)]
pub struct Targets {
    width_px: u32,
    height_px: u32,
    color: wgpu::Texture,
    color_view: wgpu::TextureView,
    depth: Option<(wgpu::Texture, wgpu::TextureView)>,
    _bytes: HeldBytes,
}

/// Reversed-z depth alone.
#[derive(Debug)]
pub struct DepthTarget {
    size_px: [u32; 2],
    view: wgpu::TextureView,
    _bytes: HeldBytes,
}

impl DepthTarget {
    /// A texture of that size, which the device must allow.
    pub fn new(gpu: &Gpu, size_px: [u32; 2]) -> Result<Self, GpuError> {
        let [width, height] = size_px;
        let held = gpu.hold("hold a depth target", 4 * u64::from(width) * u64::from(height))?;
        gpu.checked("hold a depth target", || {
            let texture = gpu.device().create_texture(&wgpu::TextureDescriptor {
                label: Some("depth"),
                size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: Targets::DEPTH_FORMAT,
                usage: wgpu::TextureUsages::RENDER_ATTACHMENT
                    | wgpu::TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            });
            DepthTarget { size_px, view: texture.create_view(&Default::default()), _bytes: held }
        })
    }

    /// Width and height.
    pub fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    /// To be attached or sampled.
    pub fn view(&self) -> &wgpu::TextureView {
        &self.view
    }

    /// Adds the commands that empty it.
    pub fn clear(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("clear depth"),
            depth_stencil_attachment: Some(self.cleared()),
            ..Default::default()
        });
    }

    /// The attachment of a pass that begins with nothing in it.
    pub fn cleared(&self) -> wgpu::RenderPassDepthStencilAttachment<'_> {
        let empty =
            wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Store };
        wgpu::RenderPassDepthStencilAttachment {
            view: &self.view,
            depth_ops: Some(empty),
            stencil_ops: None,
        }
    }
}

impl Targets {
    /// Colours are bytes as scans have them, not converted; sampling gives them back unchanged.
    pub const COLOR_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
    /// Depth is `near / distance`; 0 where nothing is.
    pub const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

    /// Textures of that size, which the device must allow.
    pub fn new(gpu: &Gpu, width_px: u32, height_px: u32) -> Result<Self, GpuError> {
        Targets::of(gpu, width_px, height_px, true)
    }

    /// A texture for colours alone.
    pub fn without_depth(gpu: &Gpu, width_px: u32, height_px: u32) -> Result<Self, GpuError> {
        Targets::of(gpu, width_px, height_px, false)
    }

    fn of(gpu: &Gpu, width_px: u32, height_px: u32, has_depth: bool) -> Result<Self, GpuError> {
        let textures = 1 + u64::from(has_depth);
        let bytes = 4 * textures * u64::from(width_px) * u64::from(height_px);
        let held = gpu.hold("hold the picture", bytes)?;
        gpu.checked("hold the picture", || {
            let texture = |label, format| {
                gpu.device().create_texture(&wgpu::TextureDescriptor {
                    label: Some(label),
                    size: wgpu::Extent3d {
                        width: width_px,
                        height: height_px,
                        depth_or_array_layers: 1,
                    },
                    mip_level_count: 1,
                    sample_count: 1,
                    dimension: wgpu::TextureDimension::D2,
                    format,
                    usage: wgpu::TextureUsages::RENDER_ATTACHMENT
                        | wgpu::TextureUsages::TEXTURE_BINDING
                        | wgpu::TextureUsages::COPY_SRC,
                    view_formats: &[],
                })
            };
            let color = texture("points color", Self::COLOR_FORMAT);
            let color_view = color.create_view(&Default::default());
            let depth = has_depth.then(|| {
                let depth = texture("points depth", Self::DEPTH_FORMAT);
                let view = depth.create_view(&Default::default());
                (depth, view)
            });
            Targets { width_px, height_px, color, color_view, depth, _bytes: held }
        })
    }

    /// Whether they have that size.
    pub fn fits(&self, width_px: u32, height_px: u32) -> bool {
        self.width_px == width_px && self.height_px == height_px
    }

    /// Width and height.
    pub fn size_px(&self) -> (u32, u32) {
        (self.width_px, self.height_px)
    }

    /// Colour, to be attached or sampled.
    pub fn color_view(&self) -> &wgpu::TextureView {
        &self.color_view
    }

    /// Depth, to be attached or sampled.
    pub fn depth_view(&self) -> Option<&wgpu::TextureView> {
        self.depth.as_ref().map(|(_, view)| view)
    }

    /// Bytes of the textures.
    pub fn held_bytes(&self) -> u64 {
        let textures = 1 + u64::from(self.depth.is_some());
        4 * textures * u64::from(self.width_px) * u64::from(self.height_px)
    }

    /// The attachments of a pass that begins with an empty picture.
    pub fn cleared(
        &self,
        background: u32,
    ) -> (wgpu::RenderPassColorAttachment<'_>, Option<wgpu::RenderPassDepthStencilAttachment<'_>>)
    {
        let [r, g, b, a] = background.to_le_bytes().map(|byte| f64::from(byte) / 255.0);
        let color = wgpu::RenderPassColorAttachment {
            view: &self.color_view,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations {
                load: wgpu::LoadOp::Clear(wgpu::Color { r, g, b, a }),
                store: wgpu::StoreOp::Store,
            },
        };
        let depth = self.depth.as_ref().map(|(_, view)| wgpu::RenderPassDepthStencilAttachment {
            view,
            depth_ops: Some(wgpu::Operations {
                load: wgpu::LoadOp::Clear(0.0),
                store: wgpu::StoreOp::Store,
            }),
            stencil_ops: None,
        });
        (color, depth)
    }

    /// Adds the commands that empty the picture.
    pub fn clear(&self, encoder: &mut wgpu::CommandEncoder, background: u32) {
        let (color, depth) = self.cleared(background);
        encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("clear"),
            color_attachments: &[Some(color)],
            depth_stencil_attachment: depth,
            ..Default::default()
        });
    }

    /// The depth state of pipelines that draw to these textures.
    pub fn depth_state(compare: wgpu::CompareFunction) -> wgpu::DepthStencilState {
        wgpu::DepthStencilState {
            format: Self::DEPTH_FORMAT,
            depth_write_enabled: Some(true),
            depth_compare: Some(compare),
            stencil: Default::default(),
            bias: Default::default(),
        }
    }

    /// The distances, read back from depth and as exact as it is; none without depth.
    pub fn read_distances(&self, gpu: &Gpu, near: f32) -> Result<Vec<f32>, GpuError> {
        let Some((depth, _)) = &self.depth else { return Ok(Vec::new()) };
        let depths = read_texture(gpu, depth)?;
        let distance = |bytes: &[u8]| {
            near / f32::from_le_bytes(bytes.try_into().expect("the chunk has 4 bytes"))
        };
        Ok(depths.chunks_exact(4).map(distance).collect())
    }

    /// The colours alone, read back; the picture has no distances.
    pub fn read_colors(&self, gpu: &Gpu) -> Result<Picture, GpuError> {
        Ok(Picture {
            width_px: self.width_px,
            height_px: self.height_px,
            colors: bytemuck::pod_collect_to_vec(&read_texture(gpu, &self.color)?),
            distances: Vec::new(),
        })
    }
}
