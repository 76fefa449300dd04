//! Times of one object, measured from all sides: a table over how large it appears and from where.
//!
//! The angle between the supporting lines halves from row to row, because covered pixels go with
//! its square; look-ups between rows are in proportion to the square. Measuring starts large and
//! stops where the time no longer depends on the view (the vertices are all the work): smaller
//! angles share that row.

use std::f64::consts::PI;

use glam::DVec3;

/// From where an object is seen, in its own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewAngles {
    /// Angle between the supporting lines of its sphere, 0 to pi; pi with the eye inside.
    pub size_rad: f64,
    /// Azimuth of the direction to the eye.
    pub azimuth_rad: f64,
    /// Elevation of the direction to the eye, -pi/2 to pi/2.
    pub elevation_rad: f64,
}

impl ViewAngles {
    /// Of a sphere seen from `eye`; an eye at its centre looks from azimuth and elevation 0.
    pub fn of(eye: DVec3, center: DVec3, radius: f64) -> ViewAngles {
        let to_eye = eye - center;
        let distance = to_eye.length();
        if !distance.is_finite() || distance == 0.0 {
            return ViewAngles { size_rad: PI, azimuth_rad: 0.0, elevation_rad: 0.0 };
        }
        let size_rad = if distance > radius { 2.0 * (radius / distance).asin() } else { PI };
        ViewAngles {
            size_rad,
            azimuth_rad: to_eye.y.atan2(to_eye.x),
            elevation_rad: (to_eye.z / distance).clamp(-1.0, 1.0).asin(),
        }
    }
}

/// How a value between measured ones is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lookup {
    /// In proportion to the distance from the eight neighbours.
    Expected,
    /// The largest of the eight neighbours: never too little where the time is monotone between
    /// them.
    Conservative,
}

/// The table of one object: 8 sizes, 12 azimuths, 5 elevations, 1.9 KB.
#[derive(Clone, Debug, PartialEq)]
pub struct PosTable {
    /// Rows from `plateau` on, each with azimuths within elevations.
    times_ms: Vec<f32>,
    plateau: usize,
}

const SIZES: usize = 8;
const AZIMUTHS: usize = 12;
const ELEVATIONS: usize = 5;
const ROW: usize = AZIMUTHS * ELEVATIONS;
/// Relative difference up to which times count as the same.
const SAME: f64 = 0.05;

impl PosTable {
    /// Measures an object: `measure` gives milliseconds for a view. Rows are taken from large to
    /// small until neither direction nor size matters.
    ///
    /// Answers that are no times are replaced by the longest time that was seen.
    pub fn measure(mut measure: impl FnMut(ViewAngles) -> f64) -> PosTable {
        let mut rows: Vec<[f64; ROW]> = Vec::new();
        let mut plateau = SIZES - 1;
        for size in (0..SIZES).rev() {
            plateau = size;
            let row: [f64; ROW] = std::array::from_fn(|i| {
                let time_ms = measure(ViewAngles {
                    size_rad: size_of_row(size),
                    azimuth_rad: 2.0 * PI * (i % AZIMUTHS) as f64 / AZIMUTHS as f64,
                    elevation_rad: PI * ((i / AZIMUTHS) as f64 / (ELEVATIONS - 1) as f64 - 0.5),
                });
                if time_ms >= 0.0 && time_ms.is_finite() { time_ms } else { f64::NAN }
            });
            rows.push(row);
            let [.., larger, smaller] = rows.as_slice() else { continue };
            let both = larger.iter().chain(smaller).copied();
            let (least, most) =
                both.fold((f64::INFINITY, 0.0f64), |(l, m), t| (l.min(t), m.max(t)));
            if most - least <= SAME * most {
                break;
            }
        }
        let seen = rows.iter().flatten().copied().filter(|t| t.is_finite());
        let longest = seen.fold(0.0, f64::max);
        let stored = |t: f64| {
            let t = if t.is_finite() { t } else { longest };
            // Rounded up, so that what is stored is never less than what was measured.
            let nearest = t as f32;
            if f64::from(nearest) < t { nearest.next_up() } else { nearest }
        };
        let times_ms = rows.iter().rev().flatten().map(|&t| stored(t)).collect();
        PosTable { times_ms, plateau }
    }

    /// Predicted time of a view; 0 for an object of no size.
    pub fn time_ms(&self, view: &ViewAngles, lookup: Lookup) -> f64 {
        if view.size_rad <= 0.0 {
            return 0.0;
        }
        let (row, row_share) = self.row_of(view.size_rad);
        let around = (view.azimuth_rad / (2.0 * PI)).rem_euclid(1.0) * AZIMUTHS as f64;
        let around = if around.is_finite() { around } else { 0.0 };
        let azimuth = (around as usize) % AZIMUTHS;
        let up = (view.elevation_rad / PI + 0.5) * (ELEVATIONS - 1) as f64;
        let up = if up.is_finite() { up.clamp(0.0, (ELEVATIONS - 1) as f64) } else { 0.0 };
        let elevation = (up as usize).min(ELEVATIONS - 2);
        let shares = [row_share, around.fract(), up - elevation as f64];
        let (mut sum, mut most) = (0.0, 0.0f64);
        for corner in 0..8usize {
            let bits = [corner & 1, corner >> 1 & 1, corner >> 2];
            let row = (row + bits[0]).min(SIZES - 1);
            let at = (row - self.plateau) * ROW
                + (elevation + bits[2]) * AZIMUTHS
                + (azimuth + bits[1]) % AZIMUTHS;
            let time_ms = f64::from(self.times_ms[at]);
            let share = |i: usize| if bits[i] == 1 { shares[i] } else { 1.0 - shares[i] };
            sum += time_ms * share(0) * share(1) * share(2);
            most = most.max(time_ms);
        }
        match lookup {
            Lookup::Expected => sum,
            Lookup::Conservative => most,
        }
    }

    /// The longest time from any side at any angle up to `size_rad`.
    pub fn longest_ms(&self, size_rad: f64) -> f64 {
        if size_rad <= 0.0 {
            return 0.0;
        }
        let (row, _) = self.row_of(size_rad);
        let rows = ((row + 2).min(SIZES) - self.plateau) * ROW;
        self.times_ms[..rows].iter().copied().fold(0.0f32, f32::max).into()
    }

    /// Views that were measured.
    pub fn measured(&self) -> usize {
        self.times_ms.len()
    }

    /// The row below an angle, and how far it is to the next, by covered pixels.
    fn row_of(&self, size_rad: f64) -> (usize, f64) {
        if size_rad.is_nan() || size_rad >= PI {
            return (SIZES - 1, 0.0);
        }
        let row = (size_rad / size_of_row(0)).log2().floor().max(0.0) as usize;
        let row = row.min(SIZES - 2).max(self.plateau);
        if row == SIZES - 1 {
            return (row, 0.0);
        }
        let (low, high) = (size_of_row(row).powi(2), size_of_row(row + 1).powi(2));
        (row, ((size_rad * size_rad - low) / (high - low)).clamp(0.0, 1.0))
    }
}

fn size_of_row(row: usize) -> f64 {
    PI * (row as f64 - (SIZES - 1) as f64).exp2()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Random;

    /// Vertices that always count, pixels that grow with the size and are more from the front.
    fn analytic(view: ViewAngles) -> f64 {
        let front = 1.0 + 0.3 * view.azimuth_rad.cos() * view.elevation_rad.cos();
        let above = 1.0 + 0.1 * view.elevation_rad.sin();
        0.2 + 0.15 * view.size_rad.powi(2) * front * above
    }

    fn random_view(index: u64) -> ViewAngles {
        let mut random = Random::new(14, index);
        ViewAngles {
            size_rad: PI * random.between(-9.0, 0.0).exp2(),
            azimuth_rad: random.between(-PI, PI),
            elevation_rad: random.between(-0.5 * PI, 0.5 * PI),
        }
    }

    #[test]
    fn expected_times_are_near_and_conservative_ones_never_below() {
        let table = PosTable::measure(analytic);
        // Monotone between neighbours: in steps of the azimuth's grid, flat in between.
        let stepped = |view: ViewAngles| {
            let step = 2.0 * PI / AZIMUTHS as f64;
            let azimuth_rad = (view.azimuth_rad / step).round() * step;
            let elevation_rad = (view.elevation_rad / (0.25 * PI)).round() * (0.25 * PI);
            analytic(ViewAngles { azimuth_rad, elevation_rad, ..view })
        };
        let stepped_table = PosTable::measure(stepped);
        let (mut squares, mut below) = (0.0, 0);
        for index in 0..100_000 {
            let view = random_view(index);
            let expected = table.time_ms(&view, Lookup::Expected);
            squares += (expected / analytic(view) - 1.0).powi(2);
            let conservative = stepped_table.time_ms(&view, Lookup::Conservative);
            below += u32::from(conservative < stepped(view));
        }
        let rms = (squares / 1e5f64).sqrt();
        assert!(rms < 0.05, "{rms}");
        assert_eq!(below, 0);
    }

    #[test]
    fn measuring_stops_where_the_view_no_longer_matters() {
        let mut asked = 0;
        let table = PosTable::measure(|view| {
            asked += 1;
            analytic(view)
        });
        assert_eq!(asked, table.measured());
        assert!(asked < SIZES * ROW && asked > 2 * ROW, "{asked}");
        let mut always = 0;
        PosTable::measure(|_| {
            always += 1;
            3.0
        });
        assert_eq!(always, 2 * ROW, "two equal rows are enough");
        let tiny = ViewAngles { size_rad: 1e-9, azimuth_rad: 0.0, elevation_rad: 0.0 };
        assert!((table.time_ms(&tiny, Lookup::Expected) / 0.2 - 1.0).abs() < 0.1);
    }

    #[test]
    fn what_is_no_time_becomes_the_longest() {
        let table = PosTable::measure(|view| if view.azimuth_rad > 6.0 { f64::NAN } else { 1.0 });
        let nan = PosTable::measure(|_| f64::NAN);
        for lookup in [Lookup::Expected, Lookup::Conservative] {
            for index in 0..100 {
                let time_ms = table.time_ms(&random_view(index), lookup);
                assert!((time_ms - 1.0).abs() < 1e-6, "{time_ms}");
                assert_eq!(nan.time_ms(&random_view(index), lookup), 0.0);
            }
        }
    }

    #[test]
    fn angles_of_odd_places_are_defined() {
        let inside = ViewAngles::of(DVec3::X * 0.5, DVec3::ZERO, 1.0);
        assert_eq!(inside.size_rad, PI);
        let center = ViewAngles::of(DVec3::ZERO, DVec3::ZERO, 1.0);
        assert_eq!((center.size_rad, center.azimuth_rad), (PI, 0.0));
        assert_eq!(ViewAngles::of(DVec3::NAN, DVec3::ZERO, 1.0).size_rad, PI);
        let table = PosTable::measure(analytic);
        let odd = ViewAngles { size_rad: f64::NAN, azimuth_rad: f64::NAN, elevation_rad: f64::NAN };
        assert!(table.time_ms(&odd, Lookup::Conservative).is_finite());
        let none = ViewAngles { size_rad: 0.0, ..odd };
        assert_eq!(table.time_ms(&none, Lookup::Conservative), 0.0);
        assert!(table.longest_ms(PI) >= table.longest_ms(0.1));
    }
}
