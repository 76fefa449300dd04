//! The exact picture of what is where: for every pixel the nearest item and its depth, on the CPU.
//!
//! Nearer wins; at equal depth the smaller item, so that the picture does not depend on the order of
//! drawing. It is the oracle for culling: the set of items it shows is the visible set.

use glam::{DMat4, DVec3, DVec4};

use crate::geometry::raster::{self, Faces};
use crate::geometry::{Aabb, View};

/// The item of a pixel that shows nothing.
pub const NO_ITEM: u32 = u32::MAX;

/// Depth and item of every pixel of a view.
#[derive(Clone, Debug)]
pub struct ItemBuffer {
    eye: DVec3,
    clip_from_relative: DMat4,
    size: [u32; 2],
    depths: Vec<f32>,
    items: Vec<u32>,
    /// Scratch: corners of a shape in clip space.
    corners: Vec<DVec4>,
}

impl ItemBuffer {
    /// An empty picture of a view, at most 16,384 pixels a side.
    pub fn new(view: &View) -> Self {
        let mut buffer = ItemBuffer {
            eye: DVec3::ZERO,
            clip_from_relative: DMat4::IDENTITY,
            size: [0, 0],
            depths: Vec::new(),
            items: Vec::new(),
            corners: Vec::new(),
        };
        buffer.clear(view);
        buffer
    }

    /// Starts a new picture.
    pub fn clear(&mut self, view: &View) {
        self.eye = view.camera.eye;
        self.clip_from_relative = view.clip_from_eye_relative();
        self.size = [view.width_px, view.height_px];
        let pixels = view.width_px as usize * view.height_px as usize;
        self.depths.clear();
        self.depths.resize(pixels, 0.0);
        self.items.clear();
        self.items.resize(pixels, NO_ITEM);
    }

    /// The item of every pixel, row by row, [`NO_ITEM`] where there is none.
    pub fn items(&self) -> &[u32] {
        &self.items
    }

    /// The depth of every pixel: near / distance, 0 where there is nothing.
    pub fn depths(&self) -> &[f32] {
        &self.depths
    }

    /// The items that are seen, sorted.
    pub fn visible_items(&self) -> Vec<u32> {
        let mut seen: Vec<u32> = self.items.iter().copied().filter(|&i| i != NO_ITEM).collect();
        seen.sort_unstable();
        seen.dedup();
        seen
    }

    /// Pixels whose item or depth differs from another picture of the same size.
    pub fn differing_pixels(&self, other: &ItemBuffer) -> u64 {
        let mine = self.items.iter().zip(&self.depths);
        let theirs = other.items.iter().zip(&other.depths);
        mine.zip(theirs).filter(|(a, b)| a != b).count() as u64
    }

    fn clip(&self, world: DVec3) -> DVec4 {
        self.clip_from_relative * (world - self.eye).extend(1.0)
    }

    /// Draws triangles over shared corners (world); the number of pixels that passed the depth test
    /// at or before what was there.
    pub fn triangles(
        &mut self,
        item: u32,
        corners: impl Iterator<Item = DVec3>,
        triangles: &[[u32; 3]],
    ) -> u64 {
        let mut clip = std::mem::take(&mut self.corners);
        clip.clear();
        clip.extend(corners.map(|corner| self.clip(corner)));
        let (depths, items) = (&mut self.depths, &mut self.items);
        let mut passed = 0;
        for triangle in triangles {
            let corners = triangle.map(|corner| clip[corner as usize]);
            raster::triangle(corners, self.size, Faces::Both, |at, depth| {
                passed += u64::from(depth >= depths[at]);
                set(&mut depths[at], &mut items[at], depth, item);
            });
        }
        self.corners = clip;
        passed
    }

    /// Draws a square splat, `diameter_px` wide, about a world position; the number of pixels that
    /// passed. It covers the pixel of its centre at least.
    pub fn splat(&mut self, item: u32, world: DVec3, diameter_px: f64) -> u64 {
        let clip = self.clip(world);
        if !(clip.is_finite() && clip.w >= clip.z && clip.w > 0.0) {
            return 0;
        }
        let [width, height] = self.size.map(f64::from);
        let x = (clip.x / clip.w * 0.5 + 0.5) * width;
        let y = (0.5 - clip.y / clip.w * 0.5) * height;
        let half = (0.5 * diameter_px - 0.5).max(0.0);
        // Comparing as floats first keeps far away places out of the integers.
        let range = |v: f64, size: f64| {
            let (low, high) = ((v - half).floor().max(0.0), (v + half).floor().min(size - 1.0));
            (low <= high).then_some((low as usize, high as usize))
        };
        let (Some((left, right)), Some((top, bottom))) = (range(x, width), range(y, height)) else {
            return 0;
        };
        let depth = (clip.z / clip.w) as f32;
        let mut passed = 0;
        for row in top..=bottom {
            for column in left..=right {
                let at = row * self.size[0] as usize + column;
                passed += u64::from(depth >= self.depths[at]);
                set(&mut self.depths[at], &mut self.items[at], depth, item);
            }
        }
        passed
    }

    /// Pixels of a box (world) that would show at or before what is drawn. The box must not meet the
    /// near plane.
    pub fn count_box(&self, bounds: &Aabb) -> u64 {
        if bounds.is_empty() {
            return 0;
        }
        let corner = |i: usize| {
            let pick = |axis: usize| [bounds.min, bounds.max][i >> axis & 1][axis];
            self.clip(DVec3::new(pick(0), pick(1), pick(2)))
        };
        let corners: [DVec4; 8] = std::array::from_fn(corner);
        // Each face counter-clockwise seen from outside.
        const FACES: [[usize; 4]; 6] =
            [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let mut passed = 0;
        for [a, b, c, d] in FACES {
            for triangle in [[a, b, c], [a, c, d]] {
                let triangle = triangle.map(|corner| corners[corner]);
                raster::triangle(triangle, self.size, Faces::Front, |at, depth| {
                    passed += u64::from(depth >= self.depths[at]);
                });
            }
        }
        passed
    }
}

fn set(depth: &mut f32, item: &mut u32, new_depth: f32, new_item: u32) {
    if new_depth > *depth || (new_depth == *depth && new_item < *item) {
        *depth = new_depth;
        *item = new_item;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;

    fn view(eye: DVec3) -> View {
        let camera = Camera::looking_at(eye, eye + DVec3::Y, DVec3::Z, 1.0, 0.1);
        View { camera, width_px: 120, height_px: 90 }
    }

    #[test]
    fn boxes_are_counted_once_a_pixel() {
        for eye in [DVec3::ZERO, DVec3::new(4.5e5, 5.2e6, 100.0)] {
            let view = view(eye);
            let mut buffer = ItemBuffer::new(&view);
            let bounds =
                Aabb::new(eye + DVec3::new(-1.0, 4.0, -1.0), eye + DVec3::new(1.0, 6.0, 1.0));
            let all = buffer.count_box(&bounds);
            // The front face alone: 2 x 2 at distance 4.
            let side = 2.0 * view.focal_px() / 4.0;
            assert!((all as f64 - side * side).abs() < 2.5 * side, "{all} of {}", side * side);
            // A wall in front of its right half leaves the left half.
            let wall = [(0.0, -9.0), (9.0, -9.0), (9.0, 9.0), (0.0, 9.0)]
                .map(|(x, z)| eye + DVec3::new(x, 3.0, z));
            buffer.triangles(7, wall.into_iter(), &[[0, 1, 2], [0, 2, 3]]);
            let left = buffer.count_box(&bounds);
            assert_eq!(left, all / 2);
            assert_eq!(buffer.visible_items(), [7]);
        }
    }

    #[test]
    fn ties_do_not_depend_on_the_order() {
        let view = view(DVec3::ZERO);
        let square = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(x, z)| DVec3::new(x, 3.0, z));
        let draw = |order: [u32; 2]| {
            let mut buffer = ItemBuffer::new(&view);
            for item in order {
                buffer.triangles(item, square.into_iter(), &[[0, 1, 2], [0, 2, 3]]);
            }
            buffer
        };
        assert_eq!(draw([1, 2]).differing_pixels(&draw([2, 1])), 0);
        assert_eq!(draw([2, 1]).visible_items(), [1]);
    }

    #[test]
    fn splats_cover_their_centre() {
        let view = view(DVec3::ZERO);
        let mut buffer = ItemBuffer::new(&view);
        assert_eq!(buffer.splat(3, DVec3::new(0.2, 5.0, 0.1), 1.0), 1);
        assert!((16..=25).contains(&buffer.splat(4, DVec3::new(0.2, 4.0, 0.1), 4.0)));
        assert_eq!(buffer.splat(4, DVec3::new(0.0, -4.0, 0.0), 4.0), 0);
        assert_eq!(buffer.splat(4, DVec3::NAN, 4.0), 0);
        assert_eq!(buffer.visible_items(), [4]);
    }
}
