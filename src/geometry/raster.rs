//! Which pixels a triangle covers: the rules of the GPU, done exactly; the one place where pixels of
//! triangles are found.
//!
//! A pixel is covered if its centre lies inside; a centre on an edge belongs to the triangle whose
//! top or left edge it is, so neighbours share no pixel and leave none. Corners are snapped to 1/256
//! pixel, edges are integers from then on. Triangles that cross the near plane or reach far outside
//! the picture are cut first.
//!
//! [`clip`] and [`Coverage`] leave to the caller in which precision corners come and what is made of
//! a pixel; [`triangle`] is the two with corners in f64 and depths, for the exact item buffer. The
//! renderer on the CPU has its corners and depths as the shaders have them (`passes::rasterize`).
//!
//! Not here: what is done with a pixel; culling of whole objects.
//! After: Pineda, "A parallel algorithm for polygon rasterization", 1988.

use std::ops::Range;

use glam::DVec4;

/// Steps of a snapped coordinate per pixel.
pub const STEPS: i64 = 256;
/// Clip space is cut at this many picture widths, which keeps edge products in 64 bits.
const GUARD: f64 = 16.0;
/// Cutting at five planes adds at most five corners.
const MOST_CORNERS: usize = 8;

/// Which side of a triangle is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Faces {
    /// Both.
    Both,
    /// Only triangles that run counter-clockwise on screen.
    Front,
}

/// A triangle cut at planes: up to eight corners in order, none if nothing is left.
#[derive(Clone, Copy, Debug)]
pub struct Polygon<V> {
    corners: [V; MOST_CORNERS],
    count: usize,
}

impl<V: Copy> Polygon<V> {
    /// The triangles of a fan that together are this polygon.
    pub fn fan(&self) -> impl Iterator<Item = [V; 3]> + '_ {
        let corners = &self.corners[..self.count];
        (2..corners.len()).map(|at| [corners[0], corners[at - 1], corners[at]])
    }
}

/// Cuts a triangle at five planes. `side(plane, corner)` is not negative inside; `mix` makes the new
/// corner between two neighbours, given these and what their sides are.
pub fn clip<V: Copy>(
    triangle: [V; 3],
    side: impl Fn(usize, &V) -> f64,
    mix: impl Fn([&V; 2], [f64; 2]) -> V,
) -> Polygon<V> {
    let mut corners = [triangle[0]; MOST_CORNERS];
    corners[..3].copy_from_slice(&triangle);
    let mut count = 3;
    for plane in 0..MOST_CORNERS - 3 {
        let before = corners;
        let mut kept = 0;
        for at in 0..count {
            let (a, b) = (&before[at], &before[(at + 1) % count]);
            let (da, db) = (side(plane, a), side(plane, b));
            if da >= 0.0 {
                corners[kept] = *a;
                kept += 1;
            }
            if (da >= 0.0) != (db >= 0.0) {
                corners[kept] = mix([a, b], [da, db]);
                kept += 1;
            }
        }
        count = kept;
        if count < 3 {
            return Polygon { corners, count: 0 };
        }
    }
    Polygon { corners, count }
}

/// The pixels of a triangle on screen.
#[derive(Clone, Copy, Debug)]
pub struct Coverage {
    /// Edge i lies opposite corner i of the triangle, with the last two corners swapped where it
    /// runs counter-clockwise.
    edges: [Edge; 3],
    left: i64,
    right: i64,
    top: i64,
    bottom: i64,
    area: i64,
    is_front: bool,
}

impl Coverage {
    /// The pixels of a triangle, given in 1/[`STEPS`] pixels, y down, at most 2^28 in size, in a
    /// picture of `width` and the given rows; `None` if it covers none.
    pub fn new([a, b, c]: [[i64; 2]; 3], width: u32, rows: Range<u32>) -> Option<Self> {
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if area == 0 {
            return None;
        }
        // With y down, a triangle that is counter-clockwise as seen has a negative area.
        let is_front = area < 0;
        let (b, c) = if is_front { (c, b) } else { (b, c) };
        let half = STEPS / 2;
        let range = |axis: usize, low: u32, high: u32| {
            let (least, most) =
                (a[axis].min(b[axis]).min(c[axis]), a[axis].max(b[axis]).max(c[axis]));
            let first = (least - half + STEPS - 1).div_euclid(STEPS).max(i64::from(low));
            (first, (most - half).div_euclid(STEPS).min(i64::from(high) - 1))
        };
        let (left, right) = range(0, 0, width);
        let (top, bottom) = range(1, rows.start, rows.end);
        if left > right || top > bottom {
            return None;
        }
        let edges = [(b, c), (c, a), (a, b)].map(|(from, to)| Edge::new(from, to, left, top));
        Some(Coverage { edges, left, right, top, bottom, area: area.abs(), is_front })
    }

    /// Whether the triangle runs counter-clockwise on screen.
    pub fn is_front(&self) -> bool {
        self.is_front
    }

    /// Covered columns, row by row from the top.
    pub fn spans(&self) -> impl Iterator<Item = (u32, Range<u32>)> + '_ {
        (self.top..=self.bottom).filter_map(|row| {
            let (mut from, mut to) = (0, self.right - self.left);
            for edge in &self.edges {
                let value = edge.start + edge.per_row * (row - self.top);
                match edge.per_column.signum() {
                    1 => {
                        from = from.max((-value + edge.per_column - 1).div_euclid(edge.per_column));
                    }
                    -1 => to = to.min(value.div_euclid(-edge.per_column)),
                    _ if value < 0 => to = -1,
                    _ => {}
                }
            }
            let columns = (self.left + from) as u32..(self.left + to + 1) as u32;
            (from <= to).then_some((row as u32, columns))
        })
    }

    /// What each corner has of the triangle's area, at a pixel's middle, in units of the area's
    /// share; the corners in the order of the triangle with the last two swapped if it is a front.
    fn shares(&self, column: i64, row: i64) -> [i64; 3] {
        self.edges.map(|edge| {
            edge.start
                + edge.taken
                + edge.per_row * (row - self.top)
                + edge.per_column * (column - self.left)
        })
    }
}

/// An edge: how its value changes by pixel, and its value at the first pixel's centre, moved so
/// that covered means not negative.
#[derive(Clone, Copy, Debug)]
struct Edge {
    per_column: i64,
    per_row: i64,
    start: i64,
    /// What the fill rule took off.
    taken: i64,
}

impl Edge {
    /// The edge from `a` to `b` with the inside on its left in y-down coordinates turned positive.
    fn new(a: [i64; 2], b: [i64; 2], column: i64, row: i64) -> Self {
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let half = STEPS / 2;
        let (px, py) = (column * STEPS + half - a[0], row * STEPS + half - a[1]);
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

/// Draws a triangle given in clip space (reversed z, far plane at infinity) into a picture of
/// `size` pixels, up to 16,384 a side: `pixel(index, depth)` is called once for each covered pixel,
/// row by row. Depth is reversed: near / distance, linear on screen.
///
/// Corners that are not finite and triangles without area on screen cover nothing.
pub fn triangle(clip: [DVec4; 3], size: [u32; 2], faces: Faces, mut pixel: impl FnMut(usize, f32)) {
    if !clip.iter().all(|corner| corner.is_finite()) {
        return;
    }
    let inside = |c: &DVec4| c.w >= c.z && c.w > 0.0 && c.x.abs().max(c.y.abs()) <= GUARD * c.w;
    if clip.iter().all(inside) {
        flat(clip, size, faces, &mut pixel);
        return;
    }
    let side = |plane: usize, c: &DVec4| match plane {
        0 => c.w - c.z,
        1 => GUARD * c.w + c.x,
        2 => GUARD * c.w - c.x,
        3 => GUARD * c.w + c.y,
        _ => GUARD * c.w - c.y,
    };
    let mix = |[a, b]: [&DVec4; 2], [da, db]: [f64; 2]| {
        // From the inner corner outward, so that neighbours get the same new corner.
        let (from, to, df, dt) = if da >= 0.0 { (*a, *b, da, db) } else { (*b, *a, db, da) };
        from + (to - from) * (df / (df - dt))
    };
    for part in self::clip(clip, side, mix).fan() {
        flat(part, size, faces, &mut pixel);
    }
}

/// Fills a triangle that lies before the near plane.
fn flat(
    clip: [DVec4; 3],
    [width, height]: [u32; 2],
    faces: Faces,
    pixel: &mut impl FnMut(usize, f32),
) {
    let snapped = clip.map(|corner| {
        let steps = STEPS as f64;
        let x = (corner.x / corner.w * 0.5 + 0.5) * f64::from(width) * steps;
        let y = (0.5 - corner.y / corner.w * 0.5) * f64::from(height) * steps;
        [x.round() as i64, y.round() as i64]
    });
    let Some(coverage) = Coverage::new(snapped, width, 0..height) else { return };
    if faces == Faces::Front && !coverage.is_front() {
        return;
    }
    let [a, b, c] = clip.map(|corner| corner.z / corner.w);
    let depths = if coverage.is_front() { [a, c, b] } else { [a, b, c] };
    let per_area = 1.0 / coverage.area as f64;
    for (row, columns) in coverage.spans() {
        let line = row as usize * width as usize;
        let mut shares = coverage.shares(i64::from(columns.start), i64::from(row));
        for column in columns {
            let mut depth = 0.0;
            for (share, corner) in shares.iter().zip(depths) {
                depth += *share as f64 * corner;
            }
            pixel(line + column as usize, (depth * per_area) as f32);
            for (share, edge) in shares.iter_mut().zip(&coverage.edges) {
                *share += edge.per_column;
            }
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
