//! A drawn picture in memory, and the parts of one.

use crate::geometry::View;
use crate::gpu::layout::{GpuFrame, ROUND, SPHERE, SQUARE};
use crate::select::{SplatSettings, SplatShape, SplatSize};

/// Largest side of a splat, pixels.
const MAX_SPLAT_PX: f64 = 4096.0;
/// Smallest distance of the near plane.
const MIN_NEAR: f32 = 1e-30;

/// Colours and distances of a picture, row by row from the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Width, pixels.
    pub width_px: u32,
    /// Height, pixels.
    pub height_px: u32,
    /// RGBA8 words, red in the lowest byte; the background where nothing is.
    pub colors: Vec<u32>,
    /// Distance along the viewing direction, infinite where nothing is; or none at all, where only
    /// colours were asked for.
    pub distances: Vec<f32>,
}

impl Picture {
    /// A picture of nothing.
    pub fn empty(width_px: u32, height_px: u32, background: u32) -> Self {
        let count = width_px as usize * height_px as usize;
        Picture {
            width_px,
            height_px,
            colors: vec![background; count],
            distances: vec![f32::INFINITY; count],
        }
    }

    /// A picture of nothing that has no distances.
    pub fn colors_only(width_px: u32, height_px: u32, background: u32) -> Self {
        let colors = vec![background; width_px as usize * height_px as usize];
        Picture { width_px, height_px, colors, distances: Vec::new() }
    }

    /// Number of pixels that a point covers.
    pub fn covered(&self) -> usize {
        self.distances.iter().filter(|distance| distance.is_finite()).count()
    }

    /// Copies a part to its place.
    pub fn paste(&mut self, part: &Picture, tile: Tile) {
        self.paste_part(part, tile, tile);
    }

    /// Copies what lies within `tile` of a part that shows `drawn`, which contains it.
    pub fn paste_part(&mut self, part: &Picture, drawn: Tile, tile: Tile) {
        let (whole_px, part_px) = (self.width_px as usize, part.width_px as usize);
        let left = (tile.left_px - drawn.left_px) as usize;
        let top = (tile.top_px - drawn.top_px) as usize;
        let width = tile.width_px as usize;
        for row in 0..tile.height_px as usize {
            let to = (tile.top_px as usize + row) * whole_px + tile.left_px as usize;
            let from = (top + row) * part_px + left;
            let (to, from) = (to..to + width, from..from + width);
            self.colors[to.clone()].copy_from_slice(&part.colors[from.clone()]);
            if !self.distances.is_empty() && !part.distances.is_empty() {
                self.distances[to].copy_from_slice(&part.distances[from]);
            }
        }
    }
}

/// The part of a view that one target shows, in pixels of the whole picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tile {
    /// First column.
    pub left_px: u32,
    /// First row.
    pub top_px: u32,
    /// Columns, at least 1.
    pub width_px: u32,
    /// Rows, at least 1.
    pub height_px: u32,
}

impl Tile {
    /// The whole picture.
    pub fn whole(view: &View) -> Self {
        Tile { left_px: 0, top_px: 0, width_px: view.width_px, height_px: view.height_px }
    }

    /// Parts of at most `max_side_px` a side and `max_pixels` that together cover a view.
    pub fn cover(view: &View, max_side_px: u32, max_pixels: u64) -> Vec<Self> {
        let width_px = view.width_px.min(max_side_px);
        let rows = (max_pixels / u64::from(width_px)).max(1);
        let height_px = view.height_px.min(max_side_px).min(rows.min(u64::from(u32::MAX)) as u32);
        let mut tiles = Vec::new();
        for top_px in (0..view.height_px).step_by(height_px as usize) {
            for left_px in (0..view.width_px).step_by(width_px as usize) {
                tiles.push(Tile {
                    left_px,
                    top_px,
                    width_px: width_px.min(view.width_px - left_px),
                    height_px: height_px.min(view.height_px - top_px),
                });
            }
        }
        tiles
    }

    /// Number of pixels.
    pub fn pixels(&self) -> u64 {
        u64::from(self.width_px) * u64::from(self.height_px)
    }

    /// What the draws of this part of a view share.
    pub fn gpu_frame(&self, view: &View, splat: &SplatSettings, background: u32) -> GpuFrame {
        let camera = &view.camera;
        let focal_px = view.focal_px();
        let (right, down) = (camera.right() * focal_px, camera.up * -focal_px);
        let column =
            |axis: usize| [right[axis] as f32, down[axis] as f32, camera.forward[axis] as f32, 0.0];
        let center = |size: u32, start: u32| (0.5 * f64::from(size) - f64::from(start)) as f32;
        // NaN counts as the least.
        let side = |px: f64| if px >= 1.0 { px.min(MAX_SPLAT_PX) as f32 } else { 1.0 };
        let max_splat_px = side(splat.max_px);
        let (min_splat_px, max_splat_px, shared_splat_px_m) = match splat.size {
            SplatSize::Adaptive => (1.0, max_splat_px, 0.0),
            SplatSize::Fixed { px } => {
                (side(px * splat.multiplier), side(px * splat.multiplier), 0.0)
            }
            SplatSize::Attenuated { length } => {
                (1.0, max_splat_px, (length * splat.multiplier * focal_px) as f32)
            }
        };
        GpuFrame {
            screen_from_world_x: column(0),
            screen_from_world_y: column(1),
            screen_from_world_z: column(2),
            center_px: [center(view.width_px, self.left_px), center(view.height_px, self.top_px)],
            target_px: [self.width_px, self.height_px],
            // Depths are multiples of it, so it must not vanish.
            near: (camera.near as f32).max(MIN_NEAR),
            max_splat_px,
            per_point_splats: u32::from(splat.takes_finest_around()),
            background,
            min_splat_px,
            nested_splats: u32::from(splat.size != SplatSize::Adaptive),
            splat_shape: match splat.shape {
                SplatShape::Square => SQUARE,
                SplatShape::Round => ROUND,
                SplatShape::Sphere => SPHERE,
            },
            pixel_m: focal_px.recip() as f32,
            shared_splat_px_m,
            grow_margin_px: 0,
            padding_0: 0,
            padding_1: 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;
    use glam::DVec3;

    fn view(width_px: u32, height_px: u32) -> View {
        let camera = Camera::looking_at(DVec3::ZERO, DVec3::Y, DVec3::Z, 1.0, 0.1);
        View { camera, width_px, height_px }
    }

    #[test]
    fn tiles_cover_each_pixel_once() {
        for (width_px, height_px, side, pixels) in
            [(1, 1, 8, 64), (100, 70, 32, 10_000), (100, 70, 1000, 450), (16, 16, 1000, 3)]
        {
            let view = view(width_px, height_px);
            let mut seen = vec![0; (width_px * height_px) as usize];
            for tile in Tile::cover(&view, side, pixels) {
                assert!(tile.width_px <= side && tile.height_px <= side, "{tile:?}");
                for y in tile.top_px..tile.top_px + tile.height_px {
                    for x in tile.left_px..tile.left_px + tile.width_px {
                        seen[(y * width_px + x) as usize] += 1;
                    }
                }
            }
            assert!(seen.iter().all(|&count| count == 1), "{width_px}x{height_px}");
        }
    }

    #[test]
    fn parts_paste_to_their_place() {
        let mut whole = Picture::empty(4, 3, 7);
        let tile = Tile { left_px: 1, top_px: 1, width_px: 2, height_px: 2 };
        whole.paste(&Picture::empty(2, 2, 9), tile);
        assert_eq!(whole.colors, [7, 7, 7, 7, 7, 9, 9, 7, 7, 9, 9, 7]);
    }
}
