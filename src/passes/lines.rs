//! Lines over a picture that is finished, in memory.

use crate::passes::Picture;

/// A straight line, one pixel wide.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScreenLine {
    /// Where it begins and ends, pixels; the first pixel covers 0..1.
    pub ends: [[f32; 2]; 2],
    /// Red, green, blue.
    pub color: [u8; 3],
}

/// Draws a line over a picture, whatever the depth there; what lies beside the picture is left out.
pub fn draw_line(picture: &mut Picture, line: &ScreenLine) {
    let [[x0, y0], [x1, y1]] = line.ends;
    let [r, g, b] = line.color;
    let (dx, dy) = (x1 - x0, y1 - y0);
    let length = dx.abs().max(dy.abs());
    // Ends far beside the picture would take as many steps; lines come cut to it.
    if length.is_nan() || length > 4.0 * picture.width_px.max(picture.height_px) as f32 {
        return;
    }
    let steps = length.ceil().max(1.0);
    for step in 0..=steps as u32 {
        let share = step as f32 / steps;
        let (x, y) = ((x0 + dx * share).floor(), (y0 + dy * share).floor());
        let (width, height) = (picture.width_px as f32, picture.height_px as f32);
        if x >= 0.0 && y >= 0.0 && x <= width && y <= height {
            // A line that ends at the edge ends in the last pixel.
            let (x, y) = (x.min(width - 1.0), y.min(height - 1.0));
            let at = y as usize * picture.width_px as usize + x as usize;
            picture.colors[at] = u32::from_le_bytes([r, g, b, 255]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawn(ends: [[f32; 2]; 2]) -> Vec<(usize, usize)> {
        let mut picture = Picture::colors_only(8, 6, 0);
        draw_line(&mut picture, &ScreenLine { ends, color: [255, 0, 0] });
        let lit = picture.colors.iter().enumerate().filter(|(_, color)| **color == 0xff00_00ff);
        lit.map(|(at, _)| (at % 8, at / 8)).collect()
    }

    #[test]
    fn lines_touch_every_column_or_row_and_nothing_beside() {
        assert_eq!(drawn([[0.5, 2.5], [7.5, 2.5]]).len(), 8);
        assert_eq!(drawn([[3.5, 5.5], [3.5, 0.5]]).len(), 6);
        assert_eq!(drawn([[0.0, 0.0], [8.0, 6.0]]).len(), 8);
        assert_eq!(drawn([[2.2, 3.3], [2.2, 3.3]]), [(2, 3)]);
        assert!(drawn([[-9.0, -9.0], [-2.0, -1.0]]).is_empty());
        assert!(drawn([[f32::NAN, 0.0], [2.0, 1.0]]).is_empty());
        assert!(drawn([[0.0, 0.0], [f32::INFINITY, 1.0]]).is_empty());
    }
}
