//! What is done to a drawn picture, in memory: gaps filled, edges shaded. The twin of
//! `fill_gaps.wgsl` and `eye_dome.wgsl`, operation by operation.
//!
//! Both look at depths `near / distance`, which are linear on screen over a plane; 0 is empty.

use rayon::prelude::*;

use crate::gpu::layout::GpuFinish;
use crate::passes::{Picture, Tile};

/// What is done to a picture after its points were drawn. The default is nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FinishSettings {
    /// Fill gaps in surfaces that are up to twice as wide, pixels; 0: none. 1 to 3 are of use,
    /// larger ones take longer and close what was open.
    pub gap_radius_px: u32,
    /// Eye-dome lighting; none: colours stay.
    pub eye_dome: Option<EyeDome>,
}

/// Shading by the depths around a pixel, which needs no normals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EyeDome {
    /// How dark edges get: 1 by default, 0 not at all.
    pub strength: f32,
    /// How far the neighbours are, pixels: 1 by default; more draws broader lines.
    pub radius_px: u32,
}

impl Default for EyeDome {
    fn default() -> Self {
        EyeDome { strength: 1.0, radius_px: 1 }
    }
}

/// Largest radius of either, pixels.
pub const MAX_FINISH_RADIUS_PX: u32 = 8;
/// Response of eye-dome lighting of strength 1.
const EYE_DOME_UNIT: f32 = 2.5;

impl FinishSettings {
    /// Whether a picture stays as it is.
    pub fn is_nothing(&self) -> bool {
        self.gap_radius_px == 0 && self.eye_dome.is_none()
    }

    /// How far a pixel's neighbours are that it depends on.
    pub fn reach_px(&self) -> u32 {
        let settings = self.gpu_finish();
        settings.gap_radius_px + settings.eye_dome_radius_px
    }

    /// What the passes on the device are told.
    pub fn gpu_finish(&self) -> GpuFinish {
        let EyeDome { strength, radius_px } =
            self.eye_dome.unwrap_or(EyeDome { strength: 0.0, radius_px: 0 });
        GpuFinish {
            gap_radius_px: self.gap_radius_px.min(MAX_FINISH_RADIUS_PX),
            eye_dome_radius_px: match self.eye_dome {
                Some(_) => radius_px.clamp(1, MAX_FINISH_RADIUS_PX),
                None => 0,
            },
            // NaN is no strength.
            eye_dome_strength: strength.max(0.0) * EYE_DOME_UNIT,
            padding_0: 0,
        }
    }

    /// A part of a picture with as much around it as its pixels depend on, inside of the whole.
    pub fn widened(&self, tile: Tile, width_px: u32, height_px: u32) -> Tile {
        let reach = self.reach_px();
        let (left_px, top_px) =
            (tile.left_px.saturating_sub(reach), tile.top_px.saturating_sub(reach));
        let right = (tile.left_px + tile.width_px).saturating_add(reach).min(width_px);
        let bottom = (tile.top_px + tile.height_px).saturating_add(reach).min(height_px);
        Tile { left_px, top_px, width_px: right - left_px, height_px: bottom - top_px }
    }
}

/// Does all that the settings ask for; the picture must have distances.
pub fn finish(picture: &mut Picture, near: f32, settings: &FinishSettings) {
    let parameters = settings.gpu_finish();
    if parameters.gap_radius_px > 0 {
        fill_gaps(picture, near, &parameters);
    }
    if settings.eye_dome.is_some() {
        light_eye_dome(picture, near, &parameters);
    }
}

/// The eight neighbours, around.
const AROUND: [[i32; 2]; 8] =
    [[1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0], [-1, -1], [0, -1], [1, -1]];
/// Clearly nearer: by this share of the distance.
const BEHIND: f32 = 0.02;
/// One surface: within this share of the distance.
const TOGETHER: f32 = 0.05;

/// Depths of a picture.
struct Depths {
    size: [i32; 2],
    depths: Vec<f32>,
}

impl Depths {
    fn of(picture: &Picture, near: f32) -> Self {
        // Of what is not there, near over infinity is 0.
        let depths = picture.distances.par_iter().map(|distance| near / distance).collect();
        Depths { size: [picture.width_px as i32, picture.height_px as i32], depths }
    }

    /// Depth at a pixel; 0 outside of the picture.
    fn at(&self, x: i32, y: i32) -> f32 {
        let inside = x >= 0 && y >= 0 && x < self.size[0] && y < self.size[1];
        if inside { self.depths[(y * self.size[0] + x) as usize] } else { 0.0 }
    }
}

/// Fills gaps in surfaces: pixels that are empty, or show what lies behind, amid nearer points.
pub fn fill_gaps(picture: &mut Picture, near: f32, settings: &GpuFinish) {
    let depths = Depths::of(picture, near);
    let (colors, width) = (picture.colors.clone(), picture.width_px as usize);
    let rows = picture.colors.par_chunks_mut(width).zip(picture.distances.par_chunks_mut(width));
    rows.enumerate().for_each(|(y, (row, distances))| {
        for x in 0..width {
            let filled = filled(&depths, &colors, [x as i32, y as i32], settings.gap_radius_px);
            if let Some((color, depth)) = filled {
                (row[x], distances[x]) = (color, near / depth);
            }
        }
    });
}

fn filled(depths: &Depths, colors: &[u32], [x, y]: [i32; 2], radius: u32) -> Option<(u32, f32)> {
    let own = depths.at(x, y);
    let (mut depth, mut step) = ([0f32; 8], [0i32; 8]);
    let mut front = 0f32;
    for (i, [dx, dy]) in AROUND.into_iter().enumerate() {
        for s in 1..=radius as i32 {
            let there = depths.at(x + dx * s, y + dy * s);
            if there > own * (1.0 + BEHIND) {
                (depth[i], step[i]) = (there, s);
                break;
            }
        }
        front = front.max(depth[i]);
    }
    if front == 0.0 {
        return None;
    }
    // Directions without a front pixel: three in a row leave half a turn open.
    let mut open = 0u32;
    for (i, &depth) in depth.iter().enumerate() {
        if depth < front * (1.0 - TOGETHER) {
            open |= 257 << i;
        }
    }
    if open & open >> 1 & open >> 2 & 255 != 0 {
        return None;
    }
    let (mut sums, mut weights, mut depth_sum) = ([0u32; 4], 0u32, 0f32);
    for i in (0..8).filter(|i| open >> i & 1 == 0) {
        // By the inverse square of the distance; diagonals are twice as far.
        let weight = (3600 >> (i & 1)) / (step[i] * step[i]) as u32;
        let [dx, dy] = AROUND[i];
        let at = (y + dy * step[i]) * depths.size[0] + x + dx * step[i];
        let color = colors[at as usize].to_le_bytes();
        (0..4).for_each(|c| sums[c] += u32::from(color[c]) * weight);
        weights += weight;
        depth_sum += depth[i] * weight as f32;
    }
    let color = sums.map(|sum| ((sum + weights / 2) / weights) as u8);
    Some((u32::from_le_bytes(color), depth_sum / weights as f32))
}

/// Eye-dome lighting: pixels darken by how far nearer their neighbours are, in logarithms.
pub fn light_eye_dome(picture: &mut Picture, near: f32, settings: &GpuFinish) {
    let depths = Depths::of(picture, near);
    let (width, radius) = (picture.width_px as usize, settings.eye_dome_radius_px as i32);
    picture.colors.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, color) in row.iter_mut().enumerate() {
            let (x, y) = (x as i32, y as i32);
            let own = depths.at(x, y);
            if own == 0.0 {
                continue;
            }
            let own_log = log2_of(own);
            let mut nearer = 0f32;
            for [dx, dy] in AROUND {
                let there = depths.at(x + dx * radius, y + dy * radius);
                if there > own {
                    nearer += log2_of(there) - own_log;
                }
            }
            // A stand-in for the exponential function that is the same on every machine.
            let x = settings.eye_dome_strength * nearer;
            let light = 1.0 / (1.0 + x + x * x * 0.5);
            let [r, g, b, a] = color.to_le_bytes();
            let lit = [r, g, b].map(|c| (f32::from(c) * light + 0.5) as u8);
            *color = u32::from_le_bytes([lit[0], lit[1], lit[2], a]);
        }
    });
}

/// Logarithm to base 2 of a positive number, from its bits: within 0.01, without a step or a bend
/// where the exponent changes, and the same on every machine.
fn log2_of(x: f32) -> f32 {
    let bits = x.to_bits();
    let m = (bits & 0x7f_ffff) as f32 * 2f32.powi(-23);
    (bits >> 23) as f32 + m + m * (1.0 - m) * (1.0 / 3.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const NEAR: f32 = 0.1;

    /// Distances row by row, `.` for empty; the colour of a pixel says its column and row.
    fn picture(rows: &[&str]) -> Picture {
        let width_px = rows[0].len() as u32;
        let mut picture = Picture::empty(width_px, rows.len() as u32, 7);
        for (y, row) in rows.iter().enumerate() {
            for (x, letter) in row.chars().enumerate().filter(|(_, letter)| *letter != '.') {
                let at = y * width_px as usize + x;
                picture.distances[at] = letter.to_digit(36).expect("a digit") as f32;
                picture.colors[at] = u32::from_le_bytes([16 * x as u8, 16 * y as u8, 0, 255]);
            }
        }
        picture
    }

    fn fill(rows: &[&str], gap_radius_px: u32) -> Picture {
        let mut picture = picture(rows);
        finish(&mut picture, NEAR, &FinishSettings { gap_radius_px, eye_dome: None });
        picture
    }

    #[test]
    fn a_hole_in_a_plane_gets_its_mean() {
        let filled = fill(&["55555", "55555", "55.55", "55555", "55555"], 1);
        assert_eq!(filled.colors[12], 0xff00_2020, "the mean of what surrounds it");
        assert!((filled.distances[12] - 5.0).abs() < 1e-5);
        assert_eq!(filled.colors[6], 0xff00_1010, "others stay");
    }

    #[test]
    fn the_background_seen_through_a_surface_is_covered() {
        let filled = fill(&["555", "5z5", "555"], 1);
        assert!((filled.distances[4] - 5.0).abs() < 1e-5);
        let kept = fill(&["zzz", "z5z", "zzz"], 1);
        assert_eq!(kept, picture(&["zzz", "z5z", "zzz"]), "a point before a surface stays");
    }

    #[test]
    fn outlines_stay_as_they_are() {
        for rows in
            [["55...", "55...", "55..."], ["5....", "55...", "555.."], ["55555", ".....", "....."]]
        {
            assert_eq!(fill(&rows, 1), picture(&rows), "{rows:?}");
        }
    }

    #[test]
    fn wider_gaps_need_a_larger_radius() {
        let rows = ["5555555", "5.....5", "5.....5", "5.....5", "5.....5", "5.....5", "5555555"];
        let middle = 3 * 7 + 3;
        assert!(fill(&rows, 2).distances[middle].is_infinite());
        assert!((fill(&rows, 3).distances[middle] - 5.0).abs() < 1e-5);
    }

    #[test]
    fn what_is_behind_an_edge_darkens() {
        let mut lit = picture(&["5559", "5559", "5559", "...."]);
        lit.colors.iter_mut().for_each(|color| *color |= 0xff_ffff);
        let before = lit.clone();
        let eye_dome = Some(EyeDome::default());
        finish(&mut lit, NEAR, &FinishSettings { gap_radius_px: 0, eye_dome });
        assert!(lit.colors[7] & 0xff < 60, "{:x}", lit.colors[7]);
        assert_eq!((lit.colors[5], lit.colors[13]), (before.colors[5], before.colors[13]));
        assert_eq!(lit.distances, before.distances);
    }

    #[test]
    fn the_logarithm_is_near_and_smooth() {
        for i in 1..20_000 {
            let x = 1e-6 * 1.002f32.powi(i);
            if x.is_finite() {
                assert!((log2_of(x) - 127.0 - x.log2()).abs() < 0.011, "{x}");
            }
        }
        let slope = |x: f32| (log2_of(x * 1.001) - log2_of(x)) * 1000.0;
        assert!((slope(1.99) - slope(2.0)).abs() < 0.02, "{} {}", slope(1.99), slope(2.0));
    }

    #[test]
    fn parts_are_widened_within_the_picture() {
        let settings = FinishSettings { gap_radius_px: 2, eye_dome: Some(EyeDome::default()) };
        let tile = Tile { left_px: 2, top_px: 50, width_px: 10, height_px: 10 };
        let wide = Tile { left_px: 0, top_px: 47, width_px: 15, height_px: 13 };
        assert_eq!(settings.widened(tile, 100, 60), wide);
        assert_eq!(FinishSettings::default().widened(tile, 100, 60), tile);
    }
}
