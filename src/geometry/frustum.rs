//! What a view can see: tests of boxes against the view frustum in clip space.
//!
//! Positions enter relative to the eye, in f64, so the answers are as good at UTM coordinates as
//! at the origin. A box is outside a plane when its centre lies farther behind it than its half
//! axes reach; the test may keep a box that only passes a corner of the frustum, and never drops
//! one that is seen. The far plane lies at infinity, so clip space's `z >= 0` always holds and five
//! planes remain. For an octree the signed distances of a child follow from its parent's by
//! additions alone ([`CellDescent`]).
//!
//! Not here: what is hidden behind something else.
//! After: Duguet and Drettakis 2004, section 5.2, as cited by the Instant Points chapter, 6.5.3.

use glam::{DMat4, DVec3};

use crate::geometry::{Aabb, View};

/// Left, right, bottom, top, near.
const PLANES: usize = 5;

/// Share of the magnitudes involved that a distance may be off after all roundings of a descent.
///
/// Thirty-two levels of three additions each, and the transform of the root before them, stay below
/// 128 roundings.
const ROUNDING: f64 = 128.0 * f64::EPSILON;

/// Where a box stands relative to the frustum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Containment {
    /// No part is seen.
    Outside,
    /// Some part may be seen.
    Partial,
    /// Every part is seen.
    Inside,
}

/// The visible volume of a view.
#[derive(Clone, Copy, Debug)]
pub struct Frustum {
    eye: DVec3,
    /// `planes[i]` dotted with `(offset from the eye, 1)` is not negative inside.
    normals: [DVec3; PLANES],
    offsets: [f64; PLANES],
}

impl Frustum {
    /// The frustum of a view: the whole picture, from the near plane on.
    pub fn new(view: &View) -> Self {
        let m: DMat4 = view.clip_from_eye_relative();
        let (x, y, z, w) = (m.row(0), m.row(1), m.row(2), m.row(3));
        let planes = [w + x, w - x, w + y, w - y, w - z];
        Frustum {
            eye: view.camera.eye,
            normals: planes.map(|plane| plane.truncate()),
            offsets: planes.map(|plane| plane.w),
        }
    }

    /// Where a closed box in the world stands; an empty box is outside.
    pub fn test_box(&self, bounds: &Aabb) -> Containment {
        if bounds.is_empty() {
            return Containment::Outside;
        }
        let half = 0.5 * bounds.size();
        let distances = self.distances(bounds.center());
        classify(&distances, &self.reach(half, self.slack(bounds.center(), half)))
    }

    /// Prepares the descent of an octree whose root cell has this centre and half edges (world).
    pub fn descend(&self, center: DVec3, half: DVec3) -> CellDescent {
        let slack = self.slack(center, half);
        let mut steps = [Step::default(); CellDescent::LEVELS];
        for (level, step) in steps.iter_mut().enumerate() {
            let half = half * (-(level as f64)).exp2();
            for (axis, along) in step.along.iter_mut().enumerate() {
                *along = self.normals.map(|normal| normal[axis] * half[axis]);
            }
            step.reach = self.reach(half, slack);
        }
        CellDescent { root: self.distances(center), steps }
    }

    /// Signed distances of a world position from the planes, in clip units.
    fn distances(&self, world: DVec3) -> Distances {
        let relative = world - self.eye;
        std::array::from_fn(|i| self.normals[i].dot(relative) + self.offsets[i])
    }

    /// How far half edges reach along each plane's normal.
    fn reach(&self, half: DVec3, slack: f64) -> Distances {
        self.normals.map(|normal| normal.abs().dot(half) + slack)
    }

    /// Bound of the rounding error of any distance inside a box.
    fn slack(&self, center: DVec3, half: DVec3) -> f64 {
        let largest = (center.abs() + half + self.eye.abs()).element_sum();
        let steepest = self.normals.iter().map(|n| n.abs().max_element()).fold(1.0, f64::max);
        ROUNDING * steepest * largest
    }
}

/// Signed distances from the planes, in clip units.
type Distances = [f64; PLANES];

/// The half axes of the cells of one level, measured along each plane's normal.
#[derive(Clone, Copy, Debug, Default)]
struct Step {
    /// Per axis: what half an edge adds to the distances.
    along: [Distances; 3],
    /// How far a cell reaches from its centre.
    reach: Distances,
}

/// One cell on the way down: its centre's distances from the planes.
#[derive(Clone, Copy, Debug, Default)]
pub struct ClipCell {
    distances: Distances,
}

/// The frustum seen from one octree: root cell, and what one step down adds.
#[derive(Clone, Debug)]
pub struct CellDescent {
    root: Distances,
    steps: [Step; Self::LEVELS],
}

impl CellDescent {
    /// Depths that can be reached, root included: an integer lattice has at most 32 bits per axis.
    pub const LEVELS: usize = 33;

    /// The root cell.
    pub fn root(&self) -> ClipCell {
        ClipCell { distances: self.root }
    }

    /// The child in `octant` of a cell whose depth is `depth - 1`.
    pub fn child(&self, parent: &ClipCell, depth: u32, octant: usize) -> ClipCell {
        let mut distances = parent.distances;
        for (axis, along) in self.steps[depth as usize].along.iter().enumerate() {
            let upper = octant >> axis & 1 == 1;
            for (distance, step) in distances.iter_mut().zip(along) {
                *distance += if upper { *step } else { -*step };
            }
        }
        ClipCell { distances }
    }

    /// Where a cell of that depth stands.
    pub fn test(&self, cell: &ClipCell, depth: u32) -> Containment {
        classify(&cell.distances, &self.steps[depth as usize].reach)
    }
}

fn classify(distances: &Distances, reach: &Distances) -> Containment {
    let planes = || distances.iter().zip(reach);
    if planes().any(|(distance, reach)| distance + reach < 0.0) {
        Containment::Outside
    } else if planes().all(|(distance, reach)| distance - reach >= 0.0) {
        Containment::Inside
    } else {
        Containment::Partial
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;

    fn view(eye: DVec3) -> View {
        let camera = Camera::looking_at(eye, eye + DVec3::X, DVec3::Z, 60f64.to_radians(), 0.5);
        View { camera, width_px: 800, height_px: 600 }
    }

    fn cube(center: DVec3, half: f64) -> Aabb {
        Aabb::new(center - half, center + half)
    }

    #[test]
    fn boxes_before_beside_behind_and_far_away() {
        for eye in [DVec3::ZERO, DVec3::new(4.5e5, 5.2e6, 300.0)] {
            let frustum = Frustum::new(&view(eye));
            let at = |x, y, z, half| frustum.test_box(&cube(eye + DVec3::new(x, y, z), half));
            assert_eq!(at(10.0, 0.0, 0.0, 1.0), Containment::Inside);
            assert_eq!(at(1e9, 0.0, 0.0, 1.0), Containment::Inside, "the far plane is at infinity");
            assert_eq!(at(-2.0, 0.0, 0.0, 1.0), Containment::Outside);
            assert_eq!(at(0.2, 0.0, 0.0, 0.1), Containment::Outside, "before the near plane");
            assert_eq!(at(0.0, 0.0, 0.0, 1.0), Containment::Partial, "around the eye");
            assert_eq!(at(10.0, 0.0, 9.0, 1.0), Containment::Outside);
            assert_eq!(at(10.0, 0.0, 6.0, 1.0), Containment::Partial);
        }
        assert_eq!(Frustum::new(&view(DVec3::ZERO)).test_box(&Aabb::EMPTY), Containment::Outside);
    }

    /// Descending by additions gives the distances that each cell has by itself.
    #[test]
    fn descent_agrees_with_the_direct_test() {
        let eye = DVec3::new(4.5e5 - 3.0, 5.2e6, 300.0);
        let frustum = Frustum::new(&view(eye));
        let (mut center, mut half) = (DVec3::new(4.5e5, 5.2e6, 300.0), DVec3::splat(64.0));
        let descent = frustum.descend(center, half);
        let mut cell = descent.root();
        for depth in 1..=20u32 {
            let octant = (depth as usize * 5 + 3) & 7;
            half *= 0.5;
            for axis in 0..3 {
                center[axis] += if octant >> axis & 1 == 1 { half[axis] } else { -half[axis] };
            }
            cell = descent.child(&cell, depth, octant);
            for (a, b) in cell.distances.iter().zip(frustum.distances(center)) {
                assert!((a - b).abs() < 1e-9, "depth {depth}: {a} against {b}");
            }
        }
    }
}
