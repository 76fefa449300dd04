//! When a cell is fine enough: projected sizes against the wanted error in pixels.
//!
//! A node at outer depth k holds levels 0..=D, so all of its points show global level k + D. If a
//! cell of that level is no larger than the wanted error, finer points would not change the
//! picture by more than that. The point budget is applied later, in `select::cut`.
//!
//! Units: world lengths, pixels on screen. Distances run from the eye to the nearest point of a
//! box. After: the Instant Points chapter, 6.4.2 and 6.5.3; the parent rule and the off-axis
//! correction are ours.

use glam::DVec3;

use crate::geometry::View;
use crate::octree::LevelIndex;

/// Whose finest cell is compared with the wanted error before a node is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum RuleCell {
    /// The node's own, as the paper has it: what stays visible has a spacing of up to twice the
    /// wanted error.
    Own,
    /// Its parent's: a node is drawn unless what is there already suffices. About 1.5-2 times the
    /// points of `Own`.
    #[default]
    Parent,
}

/// Which length stands for the size of a cell.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum CellSpan {
    /// Its (largest) edge.
    #[default]
    Edge,
    /// Its space diagonal: no two points of the cell are farther apart, so the error is a bound on
    /// the image axis. About 1.5-2 times the points of `Edge`.
    Diagonal,
}

/// How a node is judged fine enough.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct LevelRule {
    /// Whose cell counts.
    pub cell: RuleCell,
    /// Which length of it.
    pub span: CellSpan,
    /// Whether to allow for the stretching of the picture towards its corners: lengths grow by up
    /// to `1 / cos(angle off axis)^2` there (2.4 in the corner of a 16:9 picture 60 degrees high).
    /// Default off: the error is then exceeded by that factor away from the axis.
    pub off_axis: bool,
}

impl LevelRule {
    /// The four rules without off-axis correction, coarse to fine.
    pub const FOUR: [LevelRule; 4] = [
        LevelRule { cell: RuleCell::Own, span: CellSpan::Edge, off_axis: false },
        LevelRule { cell: RuleCell::Own, span: CellSpan::Diagonal, off_axis: false },
        LevelRule { cell: RuleCell::Parent, span: CellSpan::Edge, off_axis: false },
        LevelRule { cell: RuleCell::Parent, span: CellSpan::Diagonal, off_axis: false },
    ];

    /// The rule in words, for tables and plots.
    pub fn name(&self) -> &'static str {
        match (self.cell, self.span, self.off_axis) {
            (RuleCell::Own, CellSpan::Edge, false) => "own cell, edge",
            (RuleCell::Own, CellSpan::Diagonal, false) => "own cell, diagonal",
            (RuleCell::Parent, CellSpan::Edge, false) => "parent cell, edge",
            (RuleCell::Parent, CellSpan::Diagonal, false) => "parent cell, diagonal",
            (RuleCell::Own, CellSpan::Edge, true) => "own cell, edge, off-axis",
            (RuleCell::Own, CellSpan::Diagonal, true) => "own cell, diagonal, off-axis",
            (RuleCell::Parent, CellSpan::Edge, true) => "parent cell, edge, off-axis",
            (RuleCell::Parent, CellSpan::Diagonal, true) => "parent cell, diagonal, off-axis",
        }
    }

    /// The length that stands for a cell with these world edges.
    pub fn span(&self, cell_size: DVec3) -> f64 {
        match self.span {
            CellSpan::Edge => cell_size.max_element(),
            CellSpan::Diagonal => cell_size.length(),
        }
    }
}

/// Size on screen, in pixels, of a length seen from `distance`.
///
/// Zero distance or less (eye inside) gives infinity, so callers refine. Exact on the image axis;
/// elsewhere see [`off_axis_cosine`].
pub fn projected_px(length: f64, distance: f64, focal_px: f64) -> f64 {
    if distance > 0.0 { length * focal_px / distance } else { f64::INFINITY }
}

/// Smallest level in 0..=`depth` whose cells appear no larger than `wanted_px`; `depth` if none.
///
/// `coarsest_px` is the projected size of a cell of level 0; each level halves it.
pub fn required_level(coarsest_px: f64, wanted_px: f64, depth: u32) -> u32 {
    let mut cell_px = coarsest_px;
    for level in 0..depth {
        if cell_px <= wanted_px {
            return level;
        }
        cell_px *= 0.5;
    }
    depth
}

/// Leading points of a node whose cells appear as large as wanted, between levels: how many may be
/// drawn, and the share of these that is.
///
/// At the distances at which [`required_level`] changes half of the next level is drawn, so that
/// the number of points passes from level to level without a step.
pub fn continuous_prefix(levels: &LevelIndex, coarsest_px: f64, wanted_px: f64) -> (u32, f32) {
    let totals = levels.totals();
    let all = (totals.last().copied().unwrap_or(0), 1.0);
    let wanted_level = (coarsest_px / wanted_px).log2() + 0.5;
    if wanted_level.is_nan() || wanted_level >= totals.len() as f64 - 1.0 {
        return all;
    }
    if wanted_level <= 0.0 {
        return (totals[0], 1.0);
    }
    let below = wanted_level.floor() as usize;
    let [coarse, fine] = [totals[below], totals[below + 1]];
    let points = f64::from(coarse) + f64::from(fine - coarse) * wanted_level.fract();
    (fine, (points / f64::from(fine.max(1))) as f32)
}

/// Smallest cosine of the angle off the image axis over the visible part of a sphere.
///
/// `center` is relative to the eye. Distances are multiplied by its square where the off-axis
/// correction is on: a segment of length d at distance r and angle a spans at most
/// `d focal_px / (r cos(a)^2)` pixels along either picture axis.
pub fn off_axis_cosine(view: &View, center: DVec3, radius: f64) -> f64 {
    let tan_y = (0.5 * view.camera.fov_y_rad).tan();
    let corner = (1.0 + tan_y * tan_y * (1.0 + view.aspect() * view.aspect())).sqrt().recip();
    let distance = center.length();
    if distance <= radius {
        return corner;
    }
    let cos_center = (center.dot(view.camera.forward) / distance).clamp(-1.0, 1.0);
    let sin_center = (1.0 - cos_center * cos_center).sqrt();
    let sin_radius = radius / distance;
    let cos_radius = (1.0 - sin_radius * sin_radius).sqrt();
    (cos_center * cos_radius - sin_center * sin_radius).max(corner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Camera;
    use proptest::prelude::*;

    proptest! {
        /// The smallest admissible level, straight from its definition, and coarser from afar.
        #[test]
        fn the_smallest_level_that_is_fine_enough(
            edge in 1e-3..1e6f64, distance in -10.0..1e7f64, wanted_px in 0.25..8.0f64, depth in 0u32..12,
        ) {
            let focal_px = 700.0;
            let level_at = |r| required_level(projected_px(edge, r, focal_px), wanted_px, depth);
            let level = level_at(distance);
            let px = |i: u32| if distance > 0.0 {
                edge / f64::from(1u32 << i) * focal_px / distance
            } else {
                f64::INFINITY
            };
            let admissible = (0..=depth).find(|&i| px(i) <= wanted_px);
            prop_assert_eq!(level, admissible.unwrap_or(depth));
            prop_assert!(level_at(distance + 1.0) <= level && level_at(distance * 2.0 + 20.0) <= level);
        }

        /// No visible direction into the sphere lies farther off axis than the bound.
        #[test]
        fn the_off_axis_bound_holds(
            x in -50.0..50.0f64, y in -50.0..50.0f64, z in -50.0..5.0f64, radius in 0.0..20.0f64,
            dx in -1.0..1.0f64, dy in -1.0..1.0f64, dz in -1.0..1.0f64,
        ) {
            let camera = Camera::looking_at(DVec3::ZERO, -DVec3::Z, DVec3::Y, 1.0, 0.1);
            let view = View { camera, width_px: 1280, height_px: 720 };
            let center = DVec3::new(x, y, z);
            let bound = off_axis_cosine(&view, center, radius);
            let inside = center + DVec3::new(dx, dy, dz).normalize_or_zero() * radius;
            let seen = view.project(inside).is_some_and(|(px, py, _)| {
                (0.0..=1280.0).contains(&px) && (0.0..=720.0).contains(&py)
            });
            if seen {
                prop_assert!(-inside.z / inside.length() >= bound - 1e-12);
            }
        }
    }

    #[test]
    fn between_levels_points_come_little_by_little() {
        let levels = LevelIndex::new(vec![1, 4, 16, 64]).expect("valid");
        let points = |coarsest_px| {
            let (count, share) = continuous_prefix(&levels, coarsest_px, 1.0);
            f64::from(count) * f64::from(share)
        };
        assert_eq!([points(0.1), points(100.0), points(f64::INFINITY)], [1.0, 64.0, 64.0]);
        let mut before = 1.0;
        for step in 0..400 {
            let now = points(0.5 * 1.01f64.powi(step));
            assert!(now >= before && now <= before * 1.05, "{before} then {now}");
            before = now;
        }
        assert_eq!(before, 64.0);
        // Where the plain rule steps from level 1 to level 2, half of level 2 is drawn.
        assert!((points(2.0) - 10.0).abs() < 1e-3, "{}", points(2.0));
    }

    #[test]
    fn an_eye_inside_needs_everything() {
        assert_eq!(projected_px(1.0, 0.0, 500.0), f64::INFINITY);
        assert_eq!(required_level(f64::INFINITY, 1.0, 7), 7);
    }

    #[test]
    fn the_span_is_the_largest_edge_or_the_diagonal() {
        let size = DVec3::new(2.0, 3.0, 6.0);
        assert_eq!(LevelRule::FOUR.map(|rule| rule.span(size)), [6.0, 7.0, 6.0, 7.0]);
    }
}
