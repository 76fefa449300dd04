//! How much of the picture a sphere covers, clipped to the picture.
//!
//! Unclipped, near objects that straddle the edge of the picture would make sums of per-object
//! times grossly too large. The note scales the angle by the square root of the visible share of
//! the sphere's ellipse; a sphere across the plane of the eye has no ellipse, so here the angle is
//! that of a sphere on the image axis that covers as many pixels as are visible, and never more
//! than the sphere's own. On the axis both say the same; off it ours is the larger.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DVec2, DVec3};

use crate::geometry::View;

/// A sphere as a view sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// Angle between the two supporting lines; pi with the eye inside.
    pub angle_rad: f64,
    /// Area in the picture, pixels.
    pub visible_px: f64,
    /// Area without clipping; infinite if the sphere reaches the plane of the eye.
    pub full_px: f64,
}

/// Corners of the polygon that stands for an ellipse, around it.
const CORNERS: u32 = 96;
/// Largest angle off the axis at which ellipses are used; beyond, they are too large for their
/// polygons to be exact within the picture, and from a right angle on there are none.
const MOST_OBLIQUE: f64 = 1.4;
/// Cells across and down the picture for other spheres.
const CELLS: u32 = 48;

/// The footprint of a sphere. What is not finite covers the whole picture.
pub fn sphere_footprint(view: &View, center: DVec3, radius: f64) -> Footprint {
    let camera = &view.camera;
    let size = DVec2::new(f64::from(view.width_px), f64::from(view.height_px));
    let everything =
        Footprint { angle_rad: PI, visible_px: size.x * size.y, full_px: f64::INFINITY };
    let nothing = |angle_rad| Footprint { angle_rad, visible_px: 0.0, full_px: 0.0 };
    let to_center = center - camera.eye;
    let distance = to_center.length();
    if !distance.is_finite() || radius.is_nan() || distance <= radius {
        return everything;
    }
    if radius <= 0.0 {
        return nothing(0.0);
    }
    let half = (radius / distance).asin();
    let angle_rad = 2.0 * half;
    let aside = DVec2::new(to_center.dot(camera.right()), to_center.dot(camera.up));
    let off_axis = aside.length().atan2(to_center.dot(camera.forward));
    if off_axis - half >= FRAC_PI_2 {
        return nothing(angle_rad);
    }
    let focal_px = view.focal_px();
    if off_axis + half > MOST_OBLIQUE {
        let visible_px = covered_cells(view, to_center / distance, half, focal_px);
        return Footprint { angle_rad, visible_px, full_px: f64::INFINITY };
    }
    // The section of the cone with the image plane: an ellipse along the direction off the axis.
    let (near, far) = ((off_axis - half).tan(), (off_axis + half).tan());
    let (middle, major) = (0.5 * (near + far), 0.5 * (far - near));
    let axis = middle * off_axis.sin() + off_axis.cos();
    let minor = ((axis / half.cos()).powi(2) - middle * middle - 1.0).max(0.0).sqrt();
    let along = aside.try_normalize().unwrap_or(DVec2::X);
    // Most spheres lie wholly in the picture or wholly beside it.
    let full_px = PI * major * minor * focal_px * focal_px;
    let place = (along * (middle * focal_px)).abs();
    let reach = major.max(minor) * focal_px;
    if (place + reach).cmple(0.5 * size).all() {
        return Footprint { angle_rad, visible_px: full_px, full_px };
    }
    if (place - reach).cmpge(0.5 * size).any() {
        return Footprint { angle_rad, visible_px: 0.0, full_px };
    }
    let around = 1.0 / (PI / f64::from(CORNERS)).cos();
    let corner = |i: u32| {
        let (sin, cos) = (2.0 * PI * f64::from(i) / f64::from(CORNERS)).sin_cos();
        let place = along * (middle + around * major * cos) + along.perp() * (around * minor * sin);
        place * focal_px
    };
    let polygon: Vec<DVec2> = (0..CORNERS).map(corner).collect();
    Footprint { angle_rad, visible_px: area(&clipped(polygon, 0.5 * size)).min(full_px), full_px }
}

/// The angle that stands for a footprint in look-ups: 0 if nothing is visible, pi with the eye
/// inside.
pub fn visible_angle(view: &View, footprint: &Footprint) -> f64 {
    if footprint.visible_px <= 0.0 {
        return 0.0;
    }
    let as_centred = 2.0 * ((footprint.visible_px / PI).sqrt() / view.focal_px()).atan();
    if footprint.angle_rad >= PI { PI } else { as_centred.min(footprint.angle_rad) }
}

/// Pixels of the cells of the picture that a cone of directions may touch.
fn covered_cells(view: &View, axis: DVec3, half: f64, focal_px: f64) -> f64 {
    let (width, height) = (f64::from(view.width_px), f64::from(view.height_px));
    let cell = DVec2::new(width, height) / f64::from(CELLS);
    // A cell's corner is at most that far from its middle, seen from the eye.
    let reach = (0.5 * cell.length() / focal_px).atan();
    let camera = &view.camera;
    let touches = |x: u32, y: u32| {
        let place = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5) * cell;
        let (right, up) = (place.x - 0.5 * width, 0.5 * height - place.y);
        let direction = camera.forward * focal_px + camera.right() * right + camera.up * up;
        direction.angle_between(axis) <= half + reach
    };
    let cells = (0..CELLS).flat_map(|y| (0..CELLS).map(move |x| (x, y)));
    cells.filter(|&(x, y)| touches(x, y)).count() as f64 * cell.x * cell.y
}

/// The part of a polygon within `-half..=half` (Sutherland and Hodgman).
fn clipped(mut polygon: Vec<DVec2>, half: DVec2) -> Vec<DVec2> {
    for normal in [DVec2::X, DVec2::NEG_X, DVec2::Y, DVec2::NEG_Y] {
        let inside = |p: DVec2| half.dot(normal.abs()) - p.dot(normal);
        let mut kept = Vec::with_capacity(polygon.len() + 4);
        for (i, &here) in polygon.iter().enumerate() {
            let next = polygon[(i + 1) % polygon.len()];
            let (a, b) = (inside(here), inside(next));
            if a >= 0.0 {
                kept.push(here);
            }
            if (a >= 0.0) != (b >= 0.0) {
                kept.push(here + (next - here) * (a / (a - b)));
            }
        }
        polygon = kept;
    }
    polygon
}

fn area(polygon: &[DVec2]) -> f64 {
    let next = polygon.iter().cycle().skip(1);
    0.5 * polygon.iter().zip(next).map(|(a, b)| a.perp_dot(*b)).sum::<f64>().abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;
    use crate::sampling::Random;

    fn view() -> View {
        let camera = Camera::looking_at(DVec3::ZERO, DVec3::Y, DVec3::Z, 1.0, 0.1);
        View { camera, width_px: 640, height_px: 360 }
    }

    /// Pixels whose ray meets the sphere, counted.
    fn counted(view: &View, center: DVec3, radius: f64) -> f64 {
        let camera = &view.camera;
        let mut count = 0;
        for (x, y) in (0..view.height_px).flat_map(|y| (0..view.width_px).map(move |x| (x, y))) {
            let direction = (camera.forward * view.focal_px()
                + camera.right() * (f64::from(x) + 0.5 - 320.0)
                + camera.up * (180.0 - f64::from(y) - 0.5))
                .normalize();
            let along = (center - camera.eye).dot(direction);
            let off = (center - camera.eye - direction * along).length();
            count += u32::from(along > 0.0 && off <= radius);
        }
        f64::from(count)
    }

    #[test]
    fn visible_areas_are_those_that_rays_count() {
        let view = view();
        for index in 0..60 {
            let mut random = Random::new(12, index);
            let center = DVec3::new(
                random.between(-6.0, 6.0),
                random.between(-2.0, 8.0),
                random.between(-4.0, 4.0),
            );
            let radius = random.between(0.2, 0.95) * center.length();
            let footprint = sphere_footprint(&view, center, radius);
            let counted = counted(&view, center, radius);
            // Never less; more by the polygon's share, or by the edge of the coarse cells.
            let slack =
                if footprint.full_px.is_finite() { 0.01 * counted + 60.0 } else { 30_000.0 };
            assert!(footprint.visible_px >= counted - 60.0, "{center} {radius} {footprint:?}");
            assert!(footprint.visible_px <= counted + slack, "{counted} {center} {footprint:?}");
        }
    }

    #[test]
    fn clipping_never_adds_and_what_is_outside_counts_nothing() {
        let view = view();
        let mut least = f64::INFINITY;
        for index in 0..5000 {
            let mut random = Random::new(13, index);
            let center = DVec3::new(
                random.between(-20.0, 20.0),
                random.between(-20.0, 20.0),
                random.between(-20.0, 20.0),
            );
            let radius = random.between(0.01, 6.0);
            let footprint = sphere_footprint(&view, center, radius);
            let angle = visible_angle(&view, &footprint);
            assert!(angle <= footprint.angle_rad, "{center} {radius}");
            assert!(footprint.visible_px <= footprint.full_px);
            if center.y < -radius {
                assert_eq!(angle, 0.0, "it lies behind");
            }
            if angle > 0.0 {
                least = least.min(angle / footprint.angle_rad);
            }
        }
        assert!(least < 0.5, "some spheres straddle the edge: {least}");
    }

    #[test]
    fn on_the_axis_the_angle_is_the_spheres_own() {
        let view = view();
        let footprint = sphere_footprint(&view, DVec3::Y * 10.0, 1.0);
        let angle = visible_angle(&view, &footprint);
        assert!((angle / footprint.angle_rad - 1.0).abs() < 2e-3, "{angle} {footprint:?}");
    }

    #[test]
    fn eyes_inside_and_numbers_that_are_none_cover_everything() {
        let view = view();
        for (center, radius) in
            [(DVec3::ZERO, 1.0), (DVec3::ZERO, 0.0), (DVec3::NAN, 1.0), (DVec3::Y, f64::NAN)]
        {
            let footprint = sphere_footprint(&view, center, radius);
            assert_eq!(visible_angle(&view, &footprint), PI, "{center} {radius}");
        }
        let point = sphere_footprint(&view, DVec3::Y, 0.0);
        assert_eq!(visible_angle(&view, &point), 0.0);
    }
}
