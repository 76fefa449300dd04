//! The farthest depths of a picture's regions on the CPU, and whether boxes show before them.
//!
//! Twin of `depth_pyramid.wgsl` and `shared/pyramid_test.wgsl`: the same levels to the bit, the same
//! test step by step in f32. Levels have sizes rounded up, so that a texel covers the pixels it
//! stands for and no others.

use glam::{BVec3, UVec2, Vec2, Vec3};

use crate::gpu::layout::{GpuFrame, MOST_TEXELS};

/// Room for the rounding of places on screen, pixels, and of depths, relative.
const PLACE_MARGIN: f32 = 0.0625;
const DEPTH_MARGIN: f32 = 1.00001;
const ENDLESS: f32 = 1e30;
/// A plane through the eye lies as far on the side where it is not entered.
const TINY: f32 = 1e-20;

/// Farthest depths of a picture, level by level; depth is reversed, so the farthest is the smallest.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthPyramidCpu {
    size: UVec2,
    levels: Vec<Vec<f32>>,
}

impl DepthPyramidCpu {
    /// The pyramid over a picture's depths, row by row.
    ///
    /// # Panics
    /// If there is not a depth for each pixel.
    pub fn new(width_px: u32, height_px: u32, depths: Vec<f32>) -> Self {
        let size = UVec2::new(width_px, height_px);
        assert_eq!(depths.len() as u64, u64::from(size.x) * u64::from(size.y), "a depth a pixel");
        let mut levels = vec![depths];
        let mut from = size;
        while from.max_element() > 1 {
            let last = levels.last().expect("there is the picture");
            let to = (from + 1) / 2;
            let texel = |x: u32, y: u32| {
                let (right, below) = ((2 * x + 1).min(from.x - 1), (2 * y + 1).min(from.y - 1));
                let at = |x: u32, y: u32| last[(y * from.x + x) as usize];
                let above = at(2 * x, 2 * y).min(at(right, 2 * y));
                above.min(at(2 * x, below).min(at(right, below)))
            };
            let texels = (0..to.y).flat_map(|y| (0..to.x).map(move |x| (x, y)));
            let level = texels.map(|(x, y)| texel(x, y)).collect();
            levels.push(level);
            from = to;
        }
        DepthPyramidCpu { size, levels }
    }

    /// The levels; the first is the picture, the last one texel.
    pub fn levels(&self) -> &[Vec<f32>] {
        &self.levels
    }

    /// Whether any of a box may show: `false` only if what is inside is hidden in every pixel.
    ///
    /// The box is relative to the eye, in world axes, and wholly behind the near plane.
    pub fn may_show(&self, frame: &GpuFrame, low: Vec3, high: Vec3) -> bool {
        let column = |lanes: [f32; 4]| Vec3::new(lanes[0], lanes[1], lanes[2]);
        let columns = [
            column(frame.screen_from_world_x),
            column(frame.screen_from_world_y),
            column(frame.screen_from_world_z),
        ];
        let center = Vec2::from(frame.center_px);
        let (mut first_px, mut last_px) = (Vec2::splat(ENDLESS), Vec2::splat(-ENDLESS));
        let mut nearest = ENDLESS;
        for corner in 0..8u32 {
            let upper = BVec3::new(corner & 1 != 0, corner & 2 != 0, corner & 4 != 0);
            let p = Vec3::select(upper, high, low);
            let screen = columns[0] * p.x + columns[1] * p.y + columns[2] * p.z;
            let px = screen.truncate() / screen.z + center;
            (first_px, last_px) = (first_px.min(px), last_px.max(px));
            nearest = nearest.min(screen.z);
        }
        let is_ahead = nearest > 0.0;
        if !is_ahead {
            return true;
        }
        let first_px = (first_px - PLACE_MARGIN).max(Vec2::ZERO);
        let last_px = (last_px + PLACE_MARGIN).min(self.size.as_vec2());
        if first_px.cmpge(last_px).any() {
            return false;
        }
        let first = first_px.as_uvec2();
        let last = last_px.as_uvec2().min(self.size - 1);
        let mut level = 0u32;
        while ((last >> level) - (first >> level)).cmpgt(UVec2::ONE).any() {
            level += 1;
        }
        let rays = BoxRays::new(frame, columns, low, high, nearest);
        loop {
            let (from, to) = (first >> level, last >> level);
            if (to - from).cmpge(UVec2::splat(MOST_TEXELS)).any() {
                return true;
            }
            let width = (self.size.x + ((1 << level) - 1)) >> level;
            let texels = &self.levels[level as usize];
            let mut shows = false;
            for y in from.y..=to.y {
                for x in from.x..=to.x {
                    let farthest = texels[(y * width + x) as usize];
                    shows = shows || rays.may_show(center, level, UVec2::new(x, y), farthest);
                }
            }
            if !shows || level == 0 {
                return shows;
            }
            level -= 1;
        }
    }
}

/// The rays through the picture, and where they cross a box.
struct BoxRays {
    near: f32,
    forward: Vec3,
    along_x: Vec3,
    along_y: Vec3,
    enter: Vec3,
    leave: Vec3,
    leave_too: Vec3,
    cap: f32,
}

impl BoxRays {
    fn new(frame: &GpuFrame, columns: [Vec3; 3], low: Vec3, high: Vec3, nearest: f32) -> Self {
        let (below, above) = (low.cmpgt(Vec3::ZERO), high.cmplt(Vec3::ZERO));
        let tiny = Vec3::splat(TINY);
        let to_low = Vec3::select(below, low.max(tiny), low.min(-tiny)).recip();
        let to_high = Vec3::select(above, high.min(-tiny), high.max(tiny)).recip();
        let scale = frame.pixel_m * frame.pixel_m;
        let leave = Vec3::select(above, to_low, to_high);
        BoxRays {
            near: frame.near,
            forward: Vec3::new(columns[0].z, columns[1].z, columns[2].z),
            along_x: Vec3::new(columns[0].x, columns[1].x, columns[2].x) * scale,
            along_y: Vec3::new(columns[0].y, columns[1].y, columns[2].y) * scale,
            enter: Vec3::select(below, to_low, Vec3::select(above, to_high, Vec3::ZERO)),
            leave,
            leave_too: Vec3::select(below | above, leave, to_low),
            cap: 1.0 / nearest,
        }
    }

    fn may_show(&self, center: Vec2, level: u32, at: UVec2, farthest: f32) -> bool {
        let side = (1u32 << level) as f32;
        let half = 0.5 * side + PLACE_MARGIN;
        let middle = (at.as_vec2() + 0.5) * side - center;
        let ray = self.forward + self.along_x * middle.x + self.along_y * middle.y;
        let reach = (self.along_x.abs() + self.along_y.abs()) * half;
        let is_between = self.enter.cmpeq(Vec3::ZERO);
        let bound = ray * self.enter + reach * self.enter.abs();
        let entered = Vec3::select(is_between, Vec3::splat(self.cap), bound);
        let near = entered.min_element().min(self.cap);
        if self.near * near * DEPTH_MARGIN < farthest {
            return false;
        }
        (0..3).all(|axis| !self.misses(ray, half, axis))
    }

    fn misses(&self, ray: Vec3, half: f32, axis: usize) -> bool {
        let enter = self.enter[axis];
        if enter == 0.0 {
            return false;
        }
        [self.leave, self.leave_too].iter().any(|&leave| {
            let (entered, left) = (Vec3::splat(ray[axis] * enter), ray * leave);
            let slope_x = (Vec3::splat(self.along_x[axis] * enter) - self.along_x * leave).abs();
            let slope_y = (Vec3::splat(self.along_y[axis] * enter) - self.along_y * leave).abs();
            let rounding = (entered.abs() + left.abs()) * 1e-6;
            let most = entered - left + (slope_x + slope_y) * half + rounding;
            most.cmplt(Vec3::ZERO).any()
        })
    }
}
