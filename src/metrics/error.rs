//! Errors of a picture against the reference picture, and of places against their exact place.
//!
//! All are taken over the pixels that the reference covers; where the picture is empty there, it
//! counts as black. Structural similarity after Wang et al. 2004: luma (Rec. 709 weights on the
//! stored values), Gaussian window 11 x 11 with sigma 1.5, cut off and renormalized at the border,
//! K1 = 0.01, K2 = 0.03, L = 255.

use rayon::prelude::*;
use serde::Serialize;

/// The pixels of a picture, row by row.
#[derive(Clone, Copy, Debug)]
pub struct Pixels<'a> {
    /// Pixels per row, at least 1.
    pub width_px: u32,
    /// RGBA8 words, red in the lowest byte.
    pub colors: &'a [u32],
    /// Distance of what each pixel shows; infinite where no point covers it.
    pub distances: &'a [f32],
}

impl Pixels<'_> {
    /// Whether a point covers the pixel.
    fn covers(&self, pixel: usize) -> bool {
        self.distances[pixel].is_finite()
    }

    /// Red, green, blue; black where nothing is covered.
    fn rgb(&self, pixel: usize) -> [u8; 3] {
        match self.covers(pixel) {
            true => [0, 8, 16].map(|shift| (self.colors[pixel] >> shift) as u8),
            false => [0; 3],
        }
    }
}

/// How far a picture is from the reference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PictureError {
    /// Share of the reference's covered pixels that the picture leaves empty.
    pub hole_fraction: f64,
    /// Covered pixels where the reference has none, as a share of the reference's covered pixels.
    pub excess_fraction: f64,
    /// Root of the mean squared colour difference (0-255, mean of the three channels).
    pub rmse: f64,
    /// Mean structural similarity; 1 for equal pictures.
    pub ssim: f64,
}

/// Compares a picture with the reference of the same size. A reference without a covered pixel
/// has no error.
///
/// # Panics
/// If the sizes differ.
pub fn compare(reference: Pixels, picture: Pixels) -> PictureError {
    let shape = |p: &Pixels| (p.width_px, p.colors.len(), p.distances.len());
    assert!(shape(&reference) == shape(&picture), "pictures of different sizes cannot be compared");
    let (mut covered, mut holes, mut excess, mut squares) = (0u64, 0u64, 0u64, 0u64);
    for pixel in 0..reference.colors.len() {
        match (reference.covers(pixel), picture.covers(pixel)) {
            (true, seen) => {
                covered += 1;
                holes += u64::from(!seen);
                squares += squared_difference(reference.rgb(pixel), picture.rgb(pixel));
            }
            (false, true) => excess += 1,
            (false, false) => {}
        }
    }
    if covered == 0 {
        return PictureError { hole_fraction: 0.0, excess_fraction: 0.0, rmse: 0.0, ssim: 1.0 };
    }
    let share = |count: u64| count as f64 / covered as f64;
    PictureError {
        hole_fraction: share(holes),
        excess_fraction: share(excess),
        rmse: (share(squares) / 3.0).sqrt(),
        ssim: mean_ssim(&reference, &picture),
    }
}

fn squared_difference(a: [u8; 3], b: [u8; 3]) -> u64 {
    a.iter().zip(b).map(|(&a, b)| u64::from(a.abs_diff(b)).pow(2)).sum()
}

const WINDOW_RADIUS: usize = 5;
const WINDOW_SIGMA: f64 = 1.5;

/// Mean over the pixels that the reference covers (at least one).
fn mean_ssim(reference: &Pixels, picture: &Pixels) -> f64 {
    let width = reference.width_px as usize;
    let luma = |p: &Pixels| -> Vec<f32> {
        (0..p.colors.len())
            .map(|pixel| {
                let [r, g, b] = p.rgb(pixel).map(f32::from);
                0.2126 * r + 0.7152 * g + 0.0722 * b
            })
            .collect()
    };
    let (x, y) = (luma(reference), luma(picture));
    let product =
        |a: &[f32], b: &[f32]| -> Vec<f32> { a.iter().zip(b).map(|(a, b)| a * b).collect() };
    let planes = [product(&x, &x), product(&y, &y), product(&x, &y)];
    let [xx, yy, xy] = planes.map(|plane| blurred(&plane, width));
    let (mean_x, mean_y) = (blurred(&x, width), blurred(&y, width));
    let (c1, c2) = ((0.01f64 * 255.0).powi(2), (0.03f64 * 255.0).powi(2));
    let (mut sum, mut count) = (0.0, 0u64);
    for pixel in (0..x.len()).filter(|&pixel| reference.covers(pixel)) {
        let (mx, my) = (f64::from(mean_x[pixel]), f64::from(mean_y[pixel]));
        let variance_x = f64::from(xx[pixel]) - mx * mx;
        let variance_y = f64::from(yy[pixel]) - my * my;
        let covariance = f64::from(xy[pixel]) - mx * my;
        sum += (2.0 * mx * my + c1) * (2.0 * covariance + c2)
            / ((mx * mx + my * my + c1) * (variance_x + variance_y + c2));
        count += 1;
    }
    sum / count as f64
}

/// Gaussian mean around each pixel; the window is cut off and renormalized at the border.
fn blurred(plane: &[f32], width: usize) -> Vec<f32> {
    let weights: [f32; WINDOW_RADIUS + 1] = std::array::from_fn(|offset| {
        (-((offset * offset) as f64) / (2.0 * WINDOW_SIGMA * WINDOW_SIGMA)).exp() as f32
    });
    let height = plane.len() / width;
    let mean = |at: usize, length: usize, value: &dyn Fn(usize) -> f32| {
        let window = at.saturating_sub(WINDOW_RADIUS)..(at + WINDOW_RADIUS + 1).min(length);
        let weighted = |i: usize| weights[i.abs_diff(at)] * value(i);
        let total: f32 = window.clone().map(|i| weights[i.abs_diff(at)]).sum();
        window.map(weighted).sum::<f32>() / total
    };
    let mut rows = vec![0.0; plane.len()];
    rows.par_chunks_mut(width).zip(plane.par_chunks(width)).for_each(|(out, row)| {
        for (x, out) in out.iter_mut().enumerate() {
            *out = mean(x, width, &|i| row[i]);
        }
    });
    let mut both = vec![0.0; plane.len()];
    both.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
        for (x, out) in out.iter_mut().enumerate() {
            *out = mean(y, height, &|i| rows[i * width + x]);
        }
    });
    both
}

/// How far places on screen are from where f64 puts them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Displacement {
    /// Places compared.
    pub count: u64,
    /// Largest distance, pixels.
    pub max_px: f64,
    sum_of_squares: f64,
}

impl Displacement {
    /// Takes in one place. A place that is not a number counts as infinitely far.
    pub fn add(&mut self, exact: (f64, f64), drawn: (f64, f64)) {
        let distance = (exact.0 - drawn.0).hypot(exact.1 - drawn.1);
        let distance = if distance.is_nan() { f64::INFINITY } else { distance };
        self.count += 1;
        self.max_px = self.max_px.max(distance);
        self.sum_of_squares += distance * distance;
    }

    /// Root of the mean squared distance, pixels; 0 without places.
    pub fn rms_px(&self) -> f64 {
        (self.sum_of_squares / (self.count.max(1)) as f64).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gray values, `None` where nothing is covered.
    struct Gray {
        width_px: u32,
        colors: Vec<u32>,
        distances: Vec<f32>,
    }

    impl Gray {
        fn new(width_px: u32, values: impl IntoIterator<Item = Option<u8>>) -> Self {
            let (mut colors, mut distances) = (Vec::new(), Vec::new());
            for value in values {
                let v = value.unwrap_or(77);
                colors.push(u32::from_le_bytes([v, v, v, 255]));
                distances.push(value.map_or(f32::INFINITY, |_| 1.0));
            }
            Gray { width_px, colors, distances }
        }

        fn pixels(&self) -> Pixels<'_> {
            Pixels { width_px: self.width_px, colors: &self.colors, distances: &self.distances }
        }
    }

    /// A slanted pattern, so that windows differ.
    fn pattern(shift: u32) -> Gray {
        let value = |i: u32| ((i % 40) * 5 + (i / 40) * 3 + shift) % 256;
        Gray::new(40, (0..40 * 30).map(|i| Some(value(i) as u8)))
    }

    #[test]
    fn equal_pictures_have_no_error() {
        let error = compare(pattern(0).pixels(), pattern(0).pixels());
        assert_eq!((error.hole_fraction, error.excess_fraction, error.rmse), (0.0, 0.0, 0.0));
        assert!((error.ssim - 1.0).abs() < 1e-6, "{}", error.ssim);
    }

    #[test]
    fn holes_count_where_the_reference_covers() {
        let reference = Gray::new(4, [Some(30), Some(30), None, None]);
        let picture = Gray::new(4, [Some(30), None, Some(9), None]);
        let error = compare(reference.pixels(), picture.pixels());
        assert_eq!((error.hole_fraction, error.excess_fraction), (0.5, 0.5));
        assert!((error.rmse - (30.0f64 * 30.0 / 2.0).sqrt()).abs() < 1e-12, "a hole is black");
    }

    #[test]
    fn a_reference_without_points_has_no_error() {
        let empty = Gray::new(4, [None; 4]);
        assert_eq!(compare(empty.pixels(), empty.pixels()).ssim, 1.0);
    }

    /// The window taken literally, one pixel at a time in f64.
    #[test]
    fn similarity_matches_the_definition() {
        let (a, b) = (pattern(0), pattern(37));
        let (width, height) = (40i32, 30i32);
        let value = |p: &Gray, x: i32, y: i32| f64::from(p.colors[(y * width + x) as usize] & 0xff);
        let mut sum = 0.0;
        for (cx, cy) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
            let mut moments = [0.0; 6];
            for (dx, dy) in (-5..=5).flat_map(|dy| (-5..=5).map(move |dx| (dx, dy))) {
                let (x, y) = (cx + dx, cy + dy);
                if (0..width).contains(&x) && (0..height).contains(&y) {
                    let w = (-f64::from(dx * dx + dy * dy) / 4.5).exp();
                    let (p, q) = (value(&a, x, y), value(&b, x, y));
                    for (m, v) in moments.iter_mut().zip([1.0, p, q, p * p, q * q, p * q]) {
                        *m += w * v;
                    }
                }
            }
            let [p, q, pp, qq, pq] = [1, 2, 3, 4, 5].map(|i| moments[i] / moments[0]);
            let (c1, c2) = (6.5025, 58.5225);
            sum += (2.0 * p * q + c1) * (2.0 * (pq - p * q) + c2)
                / ((p * p + q * q + c1) * (pp - p * p + qq - q * q + c2));
        }
        let expected = sum / f64::from(width * height);
        let error = compare(a.pixels(), b.pixels());
        assert!((error.ssim - expected).abs() < 1e-4, "{} against {expected}", error.ssim);
        assert!(error.ssim < 0.9);
    }

    #[test]
    fn displacement_keeps_the_largest_and_the_mean_square() {
        let mut displacement = Displacement::default();
        displacement.add((0.0, 0.0), (3.0, 4.0));
        displacement.add((1.0, 1.0), (1.0, 1.0));
        assert_eq!(displacement.max_px, 5.0);
        assert!((displacement.rms_px() - 12.5f64.sqrt()).abs() < 1e-12);
        displacement.add((0.0, 0.0), (f64::NAN, 0.0));
        assert_eq!(displacement.max_px, f64::INFINITY);
    }
}
