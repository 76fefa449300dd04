//! Named views of a scene: from where, and how far away so that all of it is in the picture.
//!
//! World space with z up and y north, as surveys have it.

use std::fmt;
use std::str::FromStr;

use glam::DVec3;

use crate::geometry::{Aabb, Camera};

/// A direction to look at a scene from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ViewPreset {
    /// Straight down, north up.
    Top,
    /// From the south, level.
    Front,
    /// From the west, level.
    Left,
    /// From the south-west, 30 degrees above the horizon.
    #[default]
    Iso,
}

impl ViewPreset {
    /// All presets.
    pub const ALL: [ViewPreset; 4] =
        [ViewPreset::Top, ViewPreset::Front, ViewPreset::Left, ViewPreset::Iso];

    /// The preset in one word, for options and buttons.
    pub fn name(self) -> &'static str {
        match self {
            ViewPreset::Top => "top",
            ViewPreset::Front => "front",
            ViewPreset::Left => "left",
            ViewPreset::Iso => "iso",
        }
    }

    /// Unit viewing direction and the direction that is up on screen.
    pub fn directions(self) -> (DVec3, DVec3) {
        match self {
            ViewPreset::Top => (DVec3::NEG_Z, DVec3::Y),
            ViewPreset::Front => (DVec3::Y, DVec3::Z),
            ViewPreset::Left => (DVec3::X, DVec3::Z),
            ViewPreset::Iso => {
                let (sin, cos) = 30f64.to_radians().sin_cos();
                let level = DVec3::new(1.0, 1.0, 0.0).normalize() * cos;
                (level - DVec3::Z * sin, DVec3::Z)
            }
        }
    }
}

impl fmt::Display for ViewPreset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for ViewPreset {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = |preset: &ViewPreset| preset.name() == text;
        ViewPreset::ALL
            .into_iter()
            .find(known)
            .ok_or_else(|| format!("{text} is not one of top, front, left, iso"))
    }
}

/// Empty room around the scene, as a share of the picture's half width and height.
const MARGIN: f64 = 0.05;

impl Camera {
    /// A camera that sees all of `bounds` from a preset's side, as near as it can.
    ///
    /// An empty box counts as the cube of edge 1 around the origin, a box without size as a point
    /// in the middle of such a cube; the near plane is a millionth of the diagonal.
    pub fn framing(bounds: &Aabb, preset: ViewPreset, fov_y_rad: f64, aspect: f64) -> Camera {
        let bounds = with_size(bounds);
        let (forward, up) = preset.directions();
        let near = near_of(&bounds);
        let direction = Camera::looking_at(DVec3::ZERO, forward, up, fov_y_rad, near);
        let half_height = (0.5 * fov_y_rad).tan() * (1.0 - MARGIN);
        let half_width = half_height * aspect;
        let half = 0.5 * bounds.size();
        // A line seen end on would let the eye touch it.
        let nearest = 0.1 * bounds.diagonal();
        let mut distance = 0.0f64;
        for corner in 0..8u32 {
            let sign = |axis: u32| if corner >> axis & 1 == 0 { -1.0 } else { 1.0 };
            let corner = half * DVec3::new(sign(0), sign(1), sign(2));
            let beyond = corner.dot(direction.forward);
            let right = corner.dot(direction.right()).abs() / half_width;
            let up = corner.dot(direction.up).abs() / half_height;
            distance = distance.max(right.max(up) - beyond).max(nearest - beyond);
        }
        Camera { eye: bounds.center() - direction.forward * distance, ..direction }
    }

    /// A near plane that suits a scene: small enough that nothing one looks at is cut off. With
    /// reversed z and no far plane it costs no precision.
    pub fn near_for(bounds: &Aabb) -> f64 {
        near_of(&with_size(bounds))
    }
}

fn near_of(bounds: &Aabb) -> f64 {
    (1e-6 * bounds.diagonal()).max(f64::from(f32::MIN_POSITIVE))
}

fn with_size(bounds: &Aabb) -> Aabb {
    let center = if bounds.is_empty() { DVec3::ZERO } else { bounds.center() };
    match bounds.diagonal() > 0.0 {
        true => *bounds,
        false => Aabb::new(center - 0.5, center + 0.5),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::View;

    fn corners(bounds: &Aabb) -> impl Iterator<Item = DVec3> + '_ {
        (0..8u32).map(|corner| {
            let pick = |axis: usize| {
                if corner >> axis & 1 == 0 { bounds.min[axis] } else { bounds.max[axis] }
            };
            DVec3::new(pick(0), pick(1), pick(2))
        })
    }

    #[test]
    fn all_corners_are_in_the_picture_and_one_touches_the_margin() {
        let utm = DVec3::new(635_577.79, 848_882.15, 406.14);
        let boxes = [
            Aabb::new(utm, utm + DVec3::new(3425.0, 4655.0, 209.0)),
            Aabb::new(DVec3::splat(-1e-6), DVec3::splat(1e-6)),
            Aabb::new(DVec3::splat(-1e8), DVec3::new(1e8, 0.0, 1e8)),
            Aabb::new(DVec3::ZERO, DVec3::new(0.0, 0.0, 5.0)),
        ];
        for bounds in boxes {
            for preset in ViewPreset::ALL {
                for (width_px, height_px) in [(1280, 720), (300, 900)] {
                    let aspect = f64::from(width_px) / f64::from(height_px);
                    let camera = Camera::framing(&bounds, preset, 1.0, aspect);
                    let view = View { camera, width_px, height_px };
                    let mut fullest = 0.0f64;
                    for corner in corners(&bounds) {
                        let (x, y, _) = view.project(corner).expect("in front of the near plane");
                        let x = (2.0 * x / f64::from(width_px) - 1.0).abs();
                        let y = (2.0 * y / f64::from(height_px) - 1.0).abs();
                        fullest = fullest.max(x).max(y);
                    }
                    let flat_on = bounds.size().dot(camera.right()).abs() < 1e-12
                        && bounds.size().dot(camera.up).abs() < 1e-12;
                    assert!(fullest <= 1.0 - MARGIN + 1e-6, "{preset}: {fullest}");
                    assert!(flat_on || fullest >= 1.0 - MARGIN - 1e-6, "{preset}: {fullest}");
                }
            }
        }
    }

    #[test]
    fn boxes_without_size_or_points_still_give_a_camera() {
        for bounds in [Aabb::EMPTY, Aabb::new(DVec3::splat(3.0), DVec3::splat(3.0))] {
            let camera = Camera::framing(&bounds, ViewPreset::Iso, 1.0, 1.5);
            assert!(camera.eye.is_finite() && camera.near > 0.0);
        }
    }

    #[test]
    fn names_read_back() {
        for preset in ViewPreset::ALL {
            assert_eq!(preset.name().parse(), Ok(preset));
        }
        assert!("sideways".parse::<ViewPreset>().is_err());
    }
}
