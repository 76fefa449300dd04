//! The frame's picture, and plain areas, in the window.
//!
//! A picture on the device is shown where it is, without a copy; one from the CPU is uploaded.
//! Nearest sampling at whole pixels: what is on screen is what was drawn. On a device large areas
//! are painted by a shader of their own (`show.wgsl`), because egui's takes a program on the CPU
//! some 80 ns a pixel.

use std::collections::HashMap;
use std::fmt;

use egui::{Color32, ColorImage, Painter, Pos2, Rect, Shape, TextureHandle, TextureOptions};

use crate::frame::Renderer;
use crate::viewer::shown::{Shower, Shown};

/// Where pictures are shown.
#[derive(Default)]
pub struct Canvas {
    /// Paints on the window's device; none where egui runs without one.
    shower: Option<Shower>,
    on_device: Option<OnDevice>,
    uploaded: Option<TextureHandle>,
    /// Areas of one colour.
    plain: HashMap<Color32, Shown>,
}

struct OnDevice {
    shown: Shown,
    view: wgpu::TextureView,
}

/// Most colours kept.
const MOST_COLORS: usize = 16;

impl Canvas {
    /// A canvas in a window.
    pub fn of_window(window: egui_wgpu::RenderState) -> Self {
        Canvas::on_device(window.device, window.queue, window.target_format)
    }

    /// A canvas in what egui paints on a device, in that format.
    pub fn on_device(
        device: wgpu::Device,
        queue: wgpu::Queue,
        format: wgpu::TextureFormat,
    ) -> Self {
        Canvas { shower: Some(Shower::new(device, queue, format)), ..Canvas::default() }
    }

    /// Shows the picture that a renderer has just drawn.
    pub fn take(&mut self, ctx: &egui::Context, renderer: &Renderer) {
        if let (Some(shower), Some(view)) = (&self.shower, renderer.color_view()) {
            if self.on_device.as_ref().is_none_or(|known| known.view != *view) {
                self.on_device = Some(OnDevice { shown: shower.picture(view), view: view.clone() });
            }
            self.uploaded = None;
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
            self.on_device = None;
        }
    }

    /// Paints the picture over all of a rectangle; nothing before the first picture.
    pub fn paint(&self, painter: &Painter, rect: Rect) {
        if let Some(OnDevice { shown, .. }) = &self.on_device {
            painter.add(shown.shape(rect));
        } else if let Some(texture) = &self.uploaded {
            let whole = Rect::from_min_max(Pos2::ZERO, Pos2::new(1.0, 1.0));
            painter.image(texture.id(), rect, whole, Color32::WHITE);
        }
    }

    /// Whether there is a picture to paint.
    pub fn has_picture(&self) -> bool {
        self.on_device.is_some() || self.uploaded.is_some()
    }

    /// A rectangle of one opaque colour.
    pub fn plain(&mut self, rect: Rect, color: Color32) -> Shape {
        let Some(shower) = &self.shower else { return Shape::rect_filled(rect, 0.0, color) };
        if self.plain.len() >= MOST_COLORS && !self.plain.contains_key(&color) {
            self.plain.clear();
        }
        self.plain.entry(color).or_insert_with(|| shower.plain(color)).shape(rect)
    }
}

impl fmt::Debug for Canvas {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Canvas").field("has_picture", &self.has_picture()).finish_non_exhaustive()
    }
}
