//! The last frame: its targets, its pixels in memory, the point under a pixel.

use glam::DVec3;

use crate::frame::device::Device;
use crate::frame::{FrameError, Renderer};
use crate::passes::Picture;

impl Renderer {
    /// The colours of the last frame on the device; `None` on the CPU or before the first frame.
    #[cfg(feature = "gpu")]
    pub fn color_view(&self) -> Option<&wgpu::TextureView> {
        match &self.device {
            Device::Gpu(on_gpu) => on_gpu.finished().map(|(colors, _)| colors.color_view()),
            Device::Cpu { .. } => None,
        }
    }

    /// The reversed-z depth of the last frame on the device, if the frame wrote it:
    /// [`FrameSettings::depth`](crate::frame::FrameSettings::depth).
    #[cfg(feature = "gpu")]
    pub fn depth_view(&self) -> Option<&wgpu::TextureView> {
        match &self.device {
            Device::Gpu(on_gpu) => {
                let depths = on_gpu.finished().filter(|_| on_gpu.has_depth);
                depths.and_then(|(_, depths)| depths.depth_view())
            }
            Device::Cpu { .. } => None,
        }
    }

    /// The last frame in memory, if it was drawn on the CPU.
    pub fn picture(&self) -> Option<&Picture> {
        match &self.device {
            Device::Cpu { picture, .. } => picture.as_ref(),
            #[cfg(feature = "gpu")]
            Device::Gpu(_) => None,
        }
    }

    /// The last frame with its distances, read back from wherever it is.
    pub fn read_picture(&mut self) -> Result<Option<Picture>, FrameError> {
        match &self.device {
            Device::Cpu { picture, .. } => Ok(picture.clone()),
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => match &self.last {
                Some((view, ..)) => Ok(on_gpu.read_picture(view.camera.near as f32)?),
                None => Ok(None),
            },
        }
    }

    /// The drawn point that is nearest on screen to a pixel of the last frame, within `radius_px`:
    /// its place in the world (as exact as one pixel). Waits for the GPU.
    pub fn pick(&self, x_px: u32, y_px: u32, radius_px: u32) -> Result<Option<DVec3>, FrameError> {
        let Some((view, ..)) = &self.last else { return Ok(None) };
        let (width, height) = (view.width_px, view.height_px);
        if x_px >= width || y_px >= height {
            return Ok(None);
        }
        let rows = y_px.saturating_sub(radius_px)..(y_px + radius_px + 1).min(height);
        let columns = x_px.saturating_sub(radius_px)..(x_px + radius_px + 1).min(width);
        let distances = self.distances_of_rows(view, rows.clone())?;
        let mut nearest: Option<(u32, u32, u32)> = None;
        for y in rows.clone() {
            for x in columns.clone() {
                let at = ((y - rows.start) * width + x) as usize;
                let off = x.abs_diff(x_px).pow(2) + y.abs_diff(y_px).pow(2);
                let closer = nearest.is_none_or(|(_, _, best)| off < best);
                if distances.get(at).is_some_and(|d| d.is_finite()) && closer {
                    nearest = Some((x, y, off));
                }
            }
        }
        Ok(nearest.map(|(x, y, _)| {
            let distance = f64::from(distances[((y - rows.start) * width + x) as usize]);
            view.unproject(f64::from(x) + 0.5, f64::from(y) + 0.5, distance)
        }))
    }
}
