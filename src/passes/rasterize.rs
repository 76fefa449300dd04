//! Triangles into pixels with the precision of devices: f32 corners, the depth of each pixel, and
//! where within the triangle it lies. Colours or anything else are made of that by the caller.
//!
//! Which pixels are covered is found in `geometry::raster`. Depth is reversed, `near / distance`,
//! and is linear on screen; what lies before the near plane is cut off. Both sides of a triangle
//! are seen.

use crate::geometry::raster::{Coverage, STEPS, clip};

/// A corner in clip space: `x` and `y` in -w..w where it is seen, depth `near / w`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClipVertex {
    /// To the right.
    pub x: f32,
    /// Up.
    pub y: f32,
    /// Distance along the viewing direction.
    pub w: f32,
}

/// Where triangles are drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct RasterTarget {
    /// Width of the picture, pixels.
    pub width_px: u32,
    /// Its height.
    pub height_px: u32,
    /// Rows that are wanted; others are left out.
    pub rows: std::ops::Range<u32>,
    /// Distance of the near plane.
    pub near: f32,
}

impl RasterTarget {
    fn wanted_rows(&self) -> std::ops::Range<u32> {
        self.rows.start..self.rows.end.min(self.height_px)
    }
}

/// A covered pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fragment {
    /// Column.
    pub x: u32,
    /// Row.
    pub y: u32,
    /// `near / distance`.
    pub depth: f32,
}

/// A triangle on screen: finds the shares of its corners at any place, covered or not.
#[derive(Clone, Copy, Debug)]
pub struct ScreenTriangle {
    /// Pixels, and 1 / w.
    corners: [[f64; 3]; 3],
    /// What the shares of the uncut triangle are at these corners.
    shares: [[f64; 3]; 3],
    inverse_area: f64,
}

impl ScreenTriangle {
    /// Shares of the three corners at a pixel's middle, in perspective.
    pub fn shares_at(&self, x: i32, y: i32) -> [f32; 3] {
        let (flat, inverse_w) = self.at(x, y);
        let inverse = inverse_w.recip();
        std::array::from_fn(|corner| {
            let sum: f64 =
                (0..3).map(|i| flat[i] * self.corners[i][2] * self.shares[i][corner]).sum();
            (sum * inverse) as f32
        })
    }

    /// Shares on screen, and 1 / w.
    fn at(&self, x: i32, y: i32) -> ([f64; 3], f64) {
        let [a, b, c] = self.corners;
        let (x, y) = (f64::from(x) + 0.5 - a[0], f64::from(y) + 0.5 - a[1]);
        let of_b = (x * (c[1] - a[1]) - y * (c[0] - a[0])) * self.inverse_area;
        let of_c = (y * (b[0] - a[0]) - x * (b[1] - a[1])) * self.inverse_area;
        let flat = [1.0 - of_b - of_c, of_b, of_c];
        (flat, flat[0] * a[2] + flat[1] * b[2] + flat[2] * c[2])
    }
}

/// Pixels beyond the picture that need no cutting: within them all products fit 64 bits.
const GUARD_PX: f32 = 1_048_576.0;

/// Finds the pixels of a triangle, row by row. `emit` gets whether the front (counter-clockwise)
/// is seen.
pub fn rasterize(
    triangle: &[ClipVertex; 3],
    target: &RasterTarget,
    mut emit: impl FnMut(Fragment, &ScreenTriangle, bool),
) {
    if triangle.iter().any(|v| !(v.x.is_finite() && v.y.is_finite() && v.w.is_finite())) {
        return;
    }
    let share = |corner: usize| std::array::from_fn(|i| f64::from(u8::from(i == corner)));
    let whole = [0, 1, 2].map(|corner| Corner { clip: triangle[corner], shares: share(corner) });
    let (width, height) = (target.width_px as f32, target.height_px as f32);
    let guard = |size: f32| GUARD_PX / size.max(1.0);
    let is_inside = |v: &ClipVertex| {
        v.w >= target.near && v.x.abs() <= guard(width) * v.w && v.y.abs() <= guard(height) * v.w
    };
    if triangle.iter().all(is_inside) {
        return fill(&whole, target, &mut emit);
    }
    // Planes as (x, y, w, constant), inside where not negative.
    let [gx, gy] = [guard(width), guard(height)].map(f64::from);
    let planes = [
        [0.0, 0.0, 1.0, -f64::from(target.near)],
        [1.0, 0.0, gx, 0.0],
        [-1.0, 0.0, gx, 0.0],
        [0.0, 1.0, gy, 0.0],
        [0.0, -1.0, gy, 0.0],
    ];
    let side = |plane: usize, corner: &Corner| {
        let (ClipVertex { x, y, w }, plane) = (corner.clip, planes[plane]);
        plane[0] * f64::from(x) + plane[1] * f64::from(y) + plane[2] * f64::from(w) + plane[3]
    };
    let between = |[corner, next]: [&Corner; 2], [here, there]: [f64; 2]| {
        let t = here / (here - there);
        let mix = |a: f32, b: f32| (f64::from(a) * (1.0 - t) + f64::from(b) * t) as f32;
        let (a, b) = (corner.clip, next.clip);
        Corner {
            clip: ClipVertex { x: mix(a.x, b.x), y: mix(a.y, b.y), w: mix(a.w, b.w) },
            shares: std::array::from_fn(|i| corner.shares[i] * (1.0 - t) + next.shares[i] * t),
        }
    };
    for part in clip(whole, side, between).fan() {
        fill(&part, target, &mut emit);
    }
}

#[derive(Clone, Copy)]
struct Corner {
    clip: ClipVertex,
    shares: [f64; 3],
}

fn fill(
    corners: &[Corner; 3],
    target: &RasterTarget,
    emit: &mut impl FnMut(Fragment, &ScreenTriangle, bool),
) {
    let (half_width, half_height) = (0.5 * target.width_px as f32, 0.5 * target.height_px as f32);
    let mut pixels = [[0f32; 2]; 3];
    let mut snapped = [[0i64; 2]; 3];
    for (i, corner) in corners.iter().enumerate() {
        let inverse = 1.0 / corner.clip.w;
        let x = corner.clip.x * inverse * half_width + half_width;
        let y = half_height - corner.clip.y * inverse * half_height;
        pixels[i] = [x, y];
        snapped[i] = [x, y].map(|px| (px * STEPS as f32).round_ties_even() as i64);
    }
    let Some(coverage) = Coverage::new(snapped, target.width_px, target.wanted_rows()) else {
        return;
    };
    let float = |i: usize| {
        [f64::from(pixels[i][0]), f64::from(pixels[i][1]), f64::from(corners[i].clip.w).recip()]
    };
    let (fa, fb, fc) = (float(0), float(1), float(2));
    let float_area = (fb[0] - fa[0]) * (fc[1] - fa[1]) - (fc[0] - fa[0]) * (fb[1] - fa[1]);
    if float_area == 0.0 {
        return;
    }
    let screen = ScreenTriangle {
        corners: [fa, fb, fc],
        shares: [corners[0].shares, corners[1].shares, corners[2].shares],
        inverse_area: float_area.recip(),
    };
    let near = f64::from(target.near);
    for (y, columns) in coverage.spans() {
        for x in columns {
            let (_, inverse_w) = screen.at(x as i32, y as i32);
            let depth = (near * inverse_w) as f32;
            emit(Fragment { x, y, depth }, &screen, coverage.is_front());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn target(side: u32) -> RasterTarget {
        RasterTarget { width_px: side, height_px: side, rows: 0..side, near: 0.5 }
    }

    /// A corner at a pixel of a picture with that many pixels a side.
    fn at(x: f32, y: f32, w: f32, side: f32) -> ClipVertex {
        ClipVertex { x: (2.0 * x / side - 1.0) * w, y: (1.0 - 2.0 * y / side) * w, w }
    }

    fn covered(triangles: &[[ClipVertex; 3]], side: u32) -> Vec<u32> {
        let mut counts = vec![0; (side * side) as usize];
        for triangle in triangles {
            rasterize(triangle, &target(side), |fragment, _, _| {
                counts[(fragment.y * side + fragment.x) as usize] += 1;
            });
        }
        counts
    }

    #[test]
    fn triangles_around_a_point_cover_each_pixel_once() {
        for middle in [[8.0, 8.0], [7.5, 7.5], [3.21, 11.7], [8.5, 4.0]] {
            let rim = [[0.0, 0.0], [9.0, 0.0], [16.0, 0.0], [16.0, 16.0], [5.5, 16.0], [0.0, 16.0]];
            let corner = |[x, y]: [f32; 2]| at(x, y, 2.0, 16.0);
            for flip in [false, true] {
                let triangles: Vec<_> = (0..rim.len())
                    .map(|i| {
                        let (p, q) = (corner(rim[i]), corner(rim[(i + 1) % rim.len()]));
                        if flip { [corner(middle), q, p] } else { [corner(middle), p, q] }
                    })
                    .collect();
                assert!(covered(&triangles, 16).iter().all(|&count| count == 1), "{middle:?}");
            }
        }
    }

    #[test]
    fn shares_and_depth_are_in_perspective() {
        let triangle = [at(0.0, 0.0, 1.0, 8.0), at(8.0, 0.0, 4.0, 8.0), at(0.0, 8.0, 1.0, 8.0)];
        let mut seen = 0;
        rasterize(&triangle, &target(8), |fragment, screen, is_front| {
            let [a, b, c] = screen.shares_at(fragment.x as i32, fragment.y as i32);
            assert!((a + b + c - 1.0).abs() < 1e-5);
            let w = a + 4.0 * b + c;
            assert!((fragment.depth - 0.5 / w).abs() < 1e-5);
            assert!(!is_front, "down the picture it goes clockwise");
            seen += 1;
        });
        assert_eq!(seen, 28, "the long edge belongs to the neighbour");
    }

    #[test]
    fn what_is_before_the_near_plane_or_far_beside_is_cut() {
        let behind = ClipVertex { x: 0.0, y: -100.0, w: -50.0 };
        let floor = [
            ClipVertex { x: -9.0, y: -1.0, w: 2.0 },
            ClipVertex { x: 9.0, y: -1.0, w: 2.0 },
            behind,
        ];
        let counts = covered(&[floor], 16);
        assert!(counts.iter().sum::<u32>() > 50, "the part in front is seen");
        assert!(counts[..16 * 8].iter().all(|&count| count == 0), "nothing above the horizon");
        let far = [at(-1e9, -1e9, 1.0, 16.0), at(1e9, -1e9, 1.0, 16.0), at(8.0, 1e9, 1.0, 16.0)];
        assert!(covered(&[far], 16).iter().all(|&count| count == 1));
        let odd = [at(0.0, 0.0, 1.0, 16.0), at(f32::NAN, 0.0, 1.0, 16.0), at(0.0, 9.0, 1.0, 16.0)];
        assert_eq!(covered(&[odd], 16).iter().sum::<u32>(), 0);
    }
}
