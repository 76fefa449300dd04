//! Lines in the world as lines on screen.

use glam::{DVec2, DVec3, DVec4};

use crate::geometry::{Aabb, View};

/// The twelve edges of a box, as numbers of corners: bit 0 of a number chooses x, bit 1 y, bit 2 z.
const EDGES: [(usize, usize); 12] = [
    (0, 1),
    (2, 3),
    (4, 5),
    (6, 7),
    (0, 2),
    (1, 3),
    (4, 6),
    (5, 7),
    (0, 4),
    (1, 5),
    (2, 6),
    (3, 7),
];

/// The part of a line between two places (world) that lies before the camera and in the picture, in
/// pixels; `None` if there is none, or a coordinate is no number.
pub fn segment_on_screen(view: &View, from: DVec3, to: DVec3) -> Option<[DVec2; 2]> {
    let matrix = view.clip_from_eye_relative();
    let [a, b] = [from, to].map(|place| matrix * (place - view.camera.eye).extend(1.0));
    if !(a.is_finite() && b.is_finite()) {
        return None;
    }
    // Inside where not negative: before the near plane (z is the near distance), and the four sides.
    let planes: [fn(DVec4) -> f64; 5] =
        [|c| c.w - c.z, |c| c.w + c.x, |c| c.w - c.x, |c| c.w + c.y, |c| c.w - c.y];
    let (mut first, mut last) = (0.0f64, 1.0f64);
    for plane in planes {
        let (here, there) = (plane(a), plane(b));
        if here < 0.0 && there < 0.0 {
            return None;
        }
        if here < 0.0 {
            first = first.max(here / (here - there));
        } else if there < 0.0 {
            last = last.min(here / (here - there));
        }
    }
    let size = DVec2::new(f64::from(view.width_px), f64::from(view.height_px));
    let pixel = |share: f64| {
        let clip = a + (b - a) * share;
        DVec2::new(clip.x / clip.w * 0.5 + 0.5, 0.5 - clip.y / clip.w * 0.5) * size
    };
    (first <= last).then(|| [pixel(first), pixel(last)])
}

/// The ends of the edges of a box, in the world.
pub fn box_edges(bounds: &Aabb) -> [[DVec3; 2]; 12] {
    let corner = |number: usize| {
        let pick = |axis: usize| [bounds.min, bounds.max][number >> axis & 1][axis];
        DVec3::new(pick(0), pick(1), pick(2))
    };
    EDGES.map(|(from, to)| [corner(from), corner(to)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;

    fn view() -> View {
        let camera = Camera::looking_at(DVec3::ZERO, DVec3::Y, DVec3::Z, 1.0, 0.5);
        View { camera, width_px: 200, height_px: 100 }
    }

    #[test]
    fn ends_are_where_points_project_to() {
        let view = view();
        let (a, b) = (DVec3::new(-1.0, 9.0, 0.5), DVec3::new(2.0, 7.0, -1.0));
        let found = segment_on_screen(&view, a, b).expect("in the picture");
        for (place, end) in [a, b].into_iter().zip(found) {
            let (x, y, _) = view.project(place).expect("in front");
            assert!((DVec2::new(x, y) - end).length() < 1e-9);
        }
    }

    #[test]
    fn lines_end_at_the_near_plane_and_at_the_edge() {
        let view = view();
        // From behind the eye through the picture at the near plane to far ahead, right of it.
        let line =
            segment_on_screen(&view, DVec3::new(-6.3, -5.0, 0.0), DVec3::new(23.7, 20.0, 0.0));
        let [from, to] = line.expect("part of it is seen");
        assert!(from.x >= 0.0 && (to.x - 200.0).abs() < 1e-6 && (to.y - 50.0).abs() < 1e-6);
        let behind = [DVec3::new(0.0, -5.0, 0.0), DVec3::new(3.0, 0.4, 0.0)];
        assert_eq!(segment_on_screen(&view, behind[0], behind[1]), None);
        let above = [DVec3::new(-1.0, 2.0, 9.0), DVec3::new(1.0, 2.0, 9.0)];
        assert_eq!(segment_on_screen(&view, above[0], above[1]), None);
        assert_eq!(segment_on_screen(&view, DVec3::NAN, DVec3::Y), None);
        assert_eq!(segment_on_screen(&view, DVec3::Y, DVec3::INFINITY), None);
    }

    #[test]
    fn a_box_has_twelve_edges_of_its_lengths() {
        let bounds = Aabb::new(DVec3::ZERO, DVec3::new(1.0, 2.0, 4.0));
        let lengths: f64 = box_edges(&bounds).iter().map(|[a, b]| a.distance(*b)).sum();
        assert_eq!(lengths, 4.0 * (1.0 + 2.0 + 4.0));
    }
}
