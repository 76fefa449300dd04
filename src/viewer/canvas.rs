//! The frame's picture as a texture that egui shows.
//!
//! A picture on the device is shown where it is, without a copy; one from the CPU is uploaded.
//! Nearest sampling at whole pixels: what is on screen is what was drawn.

use std::fmt;

use egui::{ColorImage, TextureHandle, TextureId, TextureOptions};

use crate::frame::Renderer;

/// Where pictures are shown.
#[derive(Default)]
pub struct Canvas {
    /// The window's renderer; none where egui runs without a device.
    window: Option<egui_wgpu::RenderState>,
    on_device: Option<OnDevice>,
    uploaded: Option<TextureHandle>,
    shown: Option<TextureId>,
}

struct OnDevice {
    id: TextureId,
    view: wgpu::TextureView,
}

impl Canvas {
    /// A canvas in a window.
    pub fn of_window(window: egui_wgpu::RenderState) -> Self {
        Canvas { window: Some(window), ..Canvas::default() }
    }

    /// Shows the picture that a renderer has just drawn.
    pub fn take(&mut self, ctx: &egui::Context, renderer: &Renderer) {
        if let (Some(window), Some(view)) = (&self.window, renderer.color_view()) {
            let mut painter = window.renderer.write();
            let filter = wgpu::FilterMode::Nearest;
            let id = match &self.on_device {
                Some(known) if known.view == *view => known.id,
                Some(known) => {
                    let (device, id) = (&window.device, known.id);
                    painter.update_egui_texture_from_wgpu_texture(device, view, filter, id);
                    id
                }
                None => painter.register_native_texture(&window.device, view, filter),
            };
            self.on_device = Some(OnDevice { id, view: view.clone() });
            self.shown = Some(id);
        } else if let Some(picture) = renderer.picture() {
            let size = [picture.width_px as usize, picture.height_px as usize];
            let bytes = bytemuck::cast_slice(&picture.colors);
            let image = ColorImage::from_rgba_premultiplied(size, bytes);
            match &mut self.uploaded {
                Some(texture) => texture.set(image, TextureOptions::NEAREST),
                None => {
                    let texture = ctx.load_texture("points", image, TextureOptions::NEAREST);
                    self.uploaded = Some(texture);
                }
            }
            self.shown = self.uploaded.as_ref().map(TextureHandle::id);
        }
    }

    /// The texture to paint; none before the first picture.
    pub fn texture(&self) -> Option<TextureId> {
        self.shown
    }
}

impl fmt::Debug for Canvas {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Canvas").field("shown", &self.shown).finish_non_exhaustive()
    }
}
