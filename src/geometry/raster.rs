//! Which pixels a triangle covers, and at what depth: the rules of the GPU, done exactly.
//!
//! A pixel is covered if its centre lies inside; a centre on an edge belongs to the triangle whose
//! top or left edge it is, so neighbours share no pixel and leave none. Corners are snapped to 1/256
//! pixel, edges are integers from then on. Depth is reversed: near / distance, linear on screen.
//! Triangles that cross the near plane or reach far outside the picture are clipped first.
//!
//! Not here: what is done with a pixel; culling of whole objects.
//! After: Pineda, "A parallel algorithm for polygon rasterization", 1988.

use glam::DVec4;

/// Steps of a snapped coordinate per pixel.
const STEPS: i64 = 256;
/// Clip space is cut at this many picture widths, which keeps edge products in 64 bits.
const GUARD: f64 = 16.0;
/// Clipping against five planes adds at most five corners.
const MOST_CORNERS: usize = 8;

/// Which side of a triangle is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Faces {
    /// Both.
    Both,
    /// Only triangles that run counter-clockwise on screen.
    Front,
}

/// Draws a triangle given in clip space (reversed z, far plane at infinity) into a picture of
/// `size` pixels, up to 16,384 a side: `pixel(index, depth)` is called once for each covered pixel,
/// row by row.
///
/// Corners that are not finite and triangles without area on screen cover nothing.
pub fn triangle(clip: [DVec4; 3], size: [u32; 2], faces: Faces, mut pixel: impl FnMut(usize, f32)) {
    if !clip.iter().all(|corner| corner.is_finite()) {
        return;
    }
    let inside = |c: &DVec4| c.w >= c.z && c.w > 0.0 && c.x.abs().max(c.y.abs()) <= GUARD * c.w;
    if clip.iter().all(inside) {
        flat(clip.map(|corner| on_screen(corner, size)), size, faces, &mut pixel);
        return;
    }
    let mut corners = [DVec4::ZERO; MOST_CORNERS];
    let count = clipped(clip, &mut corners);
    for at in 2..count {
        let fan = [corners[0], corners[at - 1], corners[at]];
        flat(fan.map(|corner| on_screen(corner, size)), size, faces, &mut pixel);
    }
}

/// A corner in 1/256 pixels, y down, with its depth.
#[derive(Clone, Copy)]
struct Corner {
    x: i64,
    y: i64,
    depth: f64,
}

fn on_screen(clip: DVec4, [width, height]: [u32; 2]) -> Corner {
    let steps = STEPS as f64;
    let x = (clip.x / clip.w * 0.5 + 0.5) * f64::from(width) * steps;
    let y = (0.5 - clip.y / clip.w * 0.5) * f64::from(height) * steps;
    Corner { x: x.round() as i64, y: y.round() as i64, depth: clip.z / clip.w }
}

/// Cuts a triangle at the near plane and the guard planes; the number of corners left.
fn clipped(clip: [DVec4; 3], out: &mut [DVec4; MOST_CORNERS]) -> usize {
    let planes: [fn(DVec4) -> f64; 5] = [
        |c| c.w - c.z,
        |c| GUARD * c.w + c.x,
        |c| GUARD * c.w - c.x,
        |c| GUARD * c.w + c.y,
        |c| GUARD * c.w - c.y,
    ];
    let mut count = 3;
    out[..3].copy_from_slice(&clip);
    for plane in planes {
        let before = *out;
        let mut kept = 0;
        for at in 0..count {
            let (a, b) = (before[at], before[(at + 1) % count]);
            let (da, db) = (plane(a), plane(b));
            if da >= 0.0 {
                out[kept] = a;
                kept += 1;
            }
            if (da >= 0.0) != (db >= 0.0) {
                // From the inner corner outward, so that neighbours get the same new corner.
                let (from, to, df, dt) = if da >= 0.0 { (a, b, da, db) } else { (b, a, db, da) };
                out[kept] = from + (to - from) * (df / (df - dt));
                kept += 1;
            }
        }
        count = kept;
        if count < 3 {
            return 0;
        }
    }
    count
}

/// An edge: how its value changes by pixel, and its value at the first pixel's centre, moved so
/// that covered means not negative.
#[derive(Clone, Copy)]
struct Edge {
    per_column: i64,
    per_row: i64,
    start: i64,
    /// What the fill rule took off.
    taken: i64,
}

impl Edge {
    /// The edge from `a` to `b` with the inside on its left in y-down coordinates turned positive.
    fn new(a: Corner, b: Corner, column: i64, row: i64) -> Self {
        let (dx, dy) = (b.x - a.x, b.y - a.y);
        let half = STEPS / 2;
        let (px, py) = (column * STEPS + half - a.x, row * STEPS + half - a.y);
        let top_left = dy < 0 || (dy == 0 && dx > 0);
        let taken = i64::from(!top_left);
        Edge {
            per_column: -dy * STEPS,
            per_row: dx * STEPS,
            start: dx * py - dy * px - taken,
            taken,
        }
    }
}

fn flat(
    corners: [Corner; 3],
    [width, height]: [u32; 2],
    faces: Faces,
    pixel: &mut impl FnMut(usize, f32),
) {
    let [a, mut b, mut c] = corners;
    let mut area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    // With y down, a triangle that is counter-clockwise as seen has a negative area.
    if area == 0 || (faces == Faces::Front && area > 0) {
        return;
    }
    if area < 0 {
        std::mem::swap(&mut b, &mut c);
        area = -area;
    }
    let half = STEPS / 2;
    let first = |least: i64| (least - half + STEPS - 1).div_euclid(STEPS).max(0);
    let last = |most: i64, size: u32| (most - half).div_euclid(STEPS).min(i64::from(size) - 1);
    let (left, right) = (first(a.x.min(b.x).min(c.x)), last(a.x.max(b.x).max(c.x), width));
    let (top, bottom) = (first(a.y.min(b.y).min(c.y)), last(a.y.max(b.y).max(c.y), height));
    if left > right || top > bottom {
        return;
    }
    // Edge i lies opposite corner i, so its value is the corner's share of the area.
    let edges = [(b, c), (c, a), (a, b)].map(|(from, to)| Edge::new(from, to, left, top));
    let per_area = 1.0 / area as f64;
    let depths = [a.depth, b.depth, c.depth];
    for row in top..=bottom {
        let values = edges.map(|edge| edge.start + edge.per_row * (row - top));
        let (mut from, mut to) = (0, right - left);
        for (edge, value) in edges.iter().zip(values) {
            match edge.per_column.signum() {
                1 => from = from.max((-value + edge.per_column - 1).div_euclid(edge.per_column)),
                -1 => to = to.min(value.div_euclid(-edge.per_column)),
                _ if value < 0 => to = -1,
                _ => {}
            }
        }
        let line = row as usize * width as usize + left as usize;
        for column in from..=to {
            let mut depth = 0.0;
            for ((edge, value), corner) in edges.iter().zip(values).zip(depths) {
                depth += (value + edge.taken + edge.per_column * column) as f64 * corner;
            }
            pixel(line + column as usize, (depth * per_area) as f32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;

    const SIZE: [u32; 2] = [64, 48];

    /// A corner at a place in pixels with a distance, near plane at 1.
    fn at(x: f64, y: f64, w: f64) -> DVec4 {
        let ndc = DVec2::new(x / 32.0 - 1.0, 1.0 - y / 24.0);
        DVec4::new(ndc.x * w, ndc.y * w, 1.0, w)
    }

    fn covered(clip: [DVec4; 3], faces: Faces) -> Vec<(usize, f32)> {
        let mut pixels = Vec::new();
        triangle(clip, SIZE, faces, |index, depth| pixels.push((index, depth)));
        pixels
    }

    #[test]
    fn a_fan_covers_every_pixel_once_whatever_the_middle() {
        for seed in 0..200u32 {
            // Middles on pixel centres and corners too, where the fill rule decides.
            let snap = [1.0, 2.0, 1e6][(seed % 3) as usize];
            let place = |v: f64| (v * snap).round() / snap;
            let share = |step: f64| (step * f64::from(seed)).fract();
            let (mx, my) = (place(64.0 * share(0.618_034)), place(48.0 * share(0.754_878)));
            let rim = [(0.0, 0.0), (64.0, 0.0), (64.0, 48.0), (0.0, 48.0)];
            let mut counts = vec![0; 64 * 48];
            for i in 0..4 {
                let ((x0, y0), (x1, y1)) = (rim[i], rim[(i + 1) % 4]);
                for (pixel, _) in
                    covered([at(mx, my, 2.0), at(x0, y0, 3.0), at(x1, y1, 4.0)], Faces::Both)
                {
                    counts[pixel] += 1;
                }
            }
            assert!(counts.iter().all(|&count| count == 1), "seed {seed}");
        }
    }

    #[test]
    fn depth_is_linear_on_screen_and_sides_are_told_apart() {
        let corners = [at(5.0, 4.0, 2.0), at(60.0, 9.0, 8.0), at(20.0, 44.0, 4.0)];
        let pixels = covered(corners, Faces::Both);
        assert!(pixels.len() > 900);
        // The plane through the three corners' depths.
        let p = [(5.0, 4.0, 0.5), (60.0, 9.0, 0.125), (20.0, 44.0, 0.25)];
        let (u, v) = ((p[1].0 - p[0].0, p[1].1 - p[0].1), (p[2].0 - p[0].0, p[2].1 - p[0].1));
        let area = u.0 * v.1 - u.1 * v.0;
        for (index, depth) in &pixels {
            let (x, y) = ((index % 64) as f64 + 0.5, (index / 64) as f64 + 0.5);
            let (dx, dy) = (x - p[0].0, y - p[0].1);
            let (s, t) = ((dx * v.1 - dy * v.0) / area, (u.0 * dy - u.1 * dx) / area);
            let expected = p[0].2 + s * (p[1].2 - p[0].2) + t * (p[2].2 - p[0].2);
            assert!((f64::from(*depth) - expected).abs() < 2e-4);
        }
        // Clockwise on screen with y down: the back side.
        let [a, b, c] = corners;
        assert_eq!(covered([a, b, c], Faces::Front).len(), 0);
        assert_eq!(covered([a, c, b], Faces::Front).len(), pixels.len());
    }

    #[test]
    fn triangles_through_the_near_plane_and_far_outside_are_cut() {
        // A floor below the eye that runs from behind it to far ahead: the lower half of the picture.
        let (f, near) = (1.0, 0.1);
        let clip = |x: f64, y: f64, z: f64| DVec4::new(f * x, f * y, near, z);
        let wide = 1e7;
        let floor = [clip(-wide, -1.0, -50.0), clip(wide, -1.0, -50.0), clip(0.0, -1.0, wide)];
        let pixels = covered(floor, Faces::Both);
        let rows: Vec<usize> = pixels.iter().map(|(index, _)| index / 64).collect();
        assert!(rows.iter().all(|&row| row >= 24), "nothing above the horizon");
        assert!(pixels.len() >= 64 * 23, "{} pixels", pixels.len());
        assert!(covered([clip(0.0, 0.0, -1.0); 3], Faces::Both).is_empty());
        let nan = DVec4::splat(f64::NAN);
        assert!(covered([nan, floor[1], floor[2]], Faces::Both).is_empty());
    }
}
