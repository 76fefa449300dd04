//! Pictures on the device are shown as they are.
//!
//! Protects the way from the frame's picture to the window's pixels: every pixel of the rectangle
//! is the picture's, none outside of it, and plain areas have their colour, whether the window's
//! format encodes colours itself or not.
#![cfg(feature = "viewer")]

#[path = "support/device.rs"]
mod device;
#[path = "support/memory_cloud.rs"]
mod memory_cloud;

use std::sync::Arc;

use device::gpu;
use egui::{Color32, Pos2, RawInput, Rect, Vec2};
use egui_wgpu::{RendererOptions, ScreenDescriptor};
use esker::frame::{FrameSettings, NodeSource, RasterPath, Renderer};
use esker::geometry::{Camera, View, ViewPreset};
use esker::gpu::{Gpu, read_texture};
use esker::points::Lattice;
use esker::viewer::Canvas;
use glam::{DVec3, UVec3};
use memory_cloud::MemoryCloud;

const WINDOW: (u32, u32) = (300, 200);
const PICTURE: (u32, u32) = (160, 120);
/// Left upper corner of the picture.
const AT: (u32, u32) = (37, 11);
const LEFT: Color32 = Color32::from_rgb(200, 100, 3);

/// A cube of points of all colours.
fn renderer(gpu: &Arc<Gpu>) -> Renderer {
    let point = |i: u32| {
        let place = UVec3::new(i % 1024, i * 7919 % 1024, i * 10_007 % 1024);
        (place, 0xff00_0000 | i.wrapping_mul(0x9e37_79b9) >> 8)
    };
    let lattice = Lattice { scale: DVec3::splat(1e-3), offset: DVec3::ZERO };
    let cloud = MemoryCloud::new(lattice, 10, 4, &(0..20_000).map(point).collect::<Vec<_>>());
    let path = RasterPath::offered_by(gpu)[0];
    let mut renderer = Renderer::on_gpu(Arc::clone(gpu), path, 1 << 28).expect("it draws");
    renderer.set_scene(vec![Arc::new(cloud) as Arc<dyn NodeSource>]);
    renderer
}

/// What egui paints into a window of that format, pixel by pixel.
fn painted(gpu: &Gpu, format: wgpu::TextureFormat, paint: impl Fn(&mut egui::Ui)) -> Vec<[u8; 4]> {
    let (device, queue) = (gpu.device(), gpu.queue());
    let ctx = egui::Context::default();
    let screen = Rect::from_min_size(Pos2::ZERO, Vec2::new(WINDOW.0 as f32, WINDOW.1 as f32));
    let input = RawInput { screen_rect: Some(screen), ..RawInput::default() };
    let mut output = ctx.run_ui(input, |ui| paint(ui));
    output.textures_delta.clear();
    let shapes = ctx.tessellate(output.shapes, 1.0);
    let mut painter = egui_wgpu::Renderer::new(device, format, RendererOptions::default());
    let target = device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: wgpu::Extent3d { width: WINDOW.0, height: WINDOW.1, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    });
    let view = target.create_view(&wgpu::TextureViewDescriptor::default());
    let window = ScreenDescriptor { size_in_pixels: [WINDOW.0, WINDOW.1], pixels_per_point: 1.0 };
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let before = painter.update_buffers(device, queue, &mut encoder, &shapes, &window);
    {
        let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: None,
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &view,
                resolve_target: None,
                depth_slice: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                    store: wgpu::StoreOp::Store,
                },
            })],
            ..Default::default()
        });
        painter.render(&mut pass.forget_lifetime(), &shapes, &window);
    }
    queue.submit(before.into_iter().chain([encoder.finish()]));
    let bytes = read_texture(gpu, &target).expect("it reads back");
    bytes.chunks_exact(4).map(|pixel| pixel.try_into().expect("4 bytes")).collect()
}

#[test]
fn the_window_shows_the_pixels_of_the_picture() {
    let Some(gpu) = gpu() else { return };
    let mut renderer = renderer(&gpu);
    let camera = Camera::framing(&renderer.bounds(), ViewPreset::Iso, 1.0, 4.0 / 3.0);
    let view = View { camera, width_px: PICTURE.0, height_px: PICTURE.1 };
    let settings = FrameSettings::default();
    let picture = renderer.render_picture(&view, &settings).expect("a picture");
    let colors: std::collections::BTreeSet<u32> = picture.colors.iter().copied().collect();
    assert!(colors.len() > 500, "a picture of {} colours tells little", colors.len());
    for (format, off) in
        [(wgpu::TextureFormat::Rgba8Unorm, 0), (wgpu::TextureFormat::Rgba8UnormSrgb, 1)]
    {
        renderer.render(&view, &settings).expect("a frame");
        let mut canvas = Canvas::on_device(gpu.device().clone(), gpu.queue().clone(), format);
        canvas.take(&egui::Context::default(), &renderer);
        assert!(canvas.has_picture());
        let at = |x: u32, y: u32| Pos2::new(x as f32, y as f32);
        let left = canvas.plain(Rect::from_min_max(at(0, 0), at(AT.0, WINDOW.1)), LEFT);
        let place = Rect::from_min_max(at(AT.0, AT.1), at(AT.0 + PICTURE.0, AT.1 + PICTURE.1));
        let pixels = painted(&gpu, format, |ui| {
            ui.painter().add(left.clone());
            canvas.paint(ui.painter(), place);
        });
        for (i, pixel) in (0u32..).zip(pixels) {
            let (x, y) = (i % WINDOW.0, i / WINDOW.0);
            let (across, down) = (x.wrapping_sub(AT.0), y.wrapping_sub(AT.1));
            let expected = match (across < PICTURE.0 && down < PICTURE.1, x < AT.0) {
                (true, _) => picture.colors[(down * PICTURE.0 + across) as usize].to_le_bytes(),
                (_, true) => LEFT.to_array(),
                _ => [0, 0, 0, 255],
            };
            let is_near = pixel.iter().zip(expected).all(|(&a, b)| a.abs_diff(b) <= off);
            assert!(is_near, "{format:?}, pixel {x}, {y}: {pixel:?} instead of {expected:?}");
        }
    }
}
