//! What a cut costs, in counts that are known before it is drawn.
//!
//! Points and nodes are counted. Pixels are estimated node by node: the area of a splat at the
//! node's middle depth, times its points; points around which finer nodes are drawn take the area
//! of those. What falls outside of the picture or behind other points is not told apart here:
//! fitted prices take it in.

use crate::budget::Workload;
use crate::geometry::{Aabb, View};
use crate::octree::Octree;
use crate::select::{Cut, DrawnRow, SplatSettings, SplatSize};

/// Share by which splats of a node without finer points exceed its mean spacing; as in
/// [`passes`](crate::passes).
const UNEVENNESS: f64 = 1.5;

/// Counts of one cloud's cut. `areas` is memory to work in.
pub(super) fn workload(
    octree: &Octree,
    cut: &Cut,
    view: &View,
    splat: &SplatSettings,
    areas: &mut Vec<f64>,
) -> Workload {
    areas.clear();
    areas.resize(cut.table.len(), 0.0);
    let (mut points, mut pixels) = (0.0, 0.0);
    // Children stand after their parents: backwards, they are done first.
    for (index, row) in cut.table.iter().enumerate().rev() {
        let drawn = cut.draw[row.draw as usize];
        let own = splat_area(octree, row, drawn.count, drawn.splat_level, view, splat);
        let first = row.first_drawn_child as usize;
        let children = first..first + row.child_drawn_mask.count_ones() as usize;
        let area = match splat.takes_finest_around() {
            // An eighth of the points lies in each octant, as far as one can tell.
            true if !children.is_empty() => {
                let below: f64 = areas[children.clone()].iter().sum();
                (below + own * (8.0 - children.len() as f64)) / 8.0
            }
            _ => own,
        };
        areas[index] = area;
        points += f64::from(drawn.count);
        pixels += f64::from(drawn.count) * area;
    }
    Workload::points(cut.table.len() as f64, points, pixels)
}

/// Pixels of a splat of the node's own size.
fn splat_area(
    octree: &Octree,
    row: &DrawnRow,
    count: u32,
    splat_level: u32,
    view: &View,
    splat: &SplatSettings,
) -> f64 {
    let node = octree.node(row.node);
    let is_all = count == node.point_count() && node.child_mask == row.child_drawn_mask;
    let most_px = splat.max_px.max(1.0);
    let edge = match splat.size {
        SplatSize::Fixed { px } => {
            return (px * splat.multiplier).clamp(1.0, most_px).ceil().powi(2);
        }
        SplatSize::Attenuated { length } => length,
        SplatSize::Adaptive if splat.takes_finest_around() && is_all && node.child_mask == 0 => {
            let node_edge = octree.cell_size(node.depth).max_element();
            UNEVENNESS * node_edge * node.levels.surface_spacing()
        }
        SplatSize::Adaptive => octree.cell_size(splat_level).max_element(),
    };
    let px_m = splat.multiplier * edge * view.focal_px();
    let (near, far) = depths(&octree.tight_box(row.node), view);
    // Areas fall with the square of the depth, whose mean inverse over a range is that of the
    // geometric middle.
    let size_px = (px_m / (near * far).sqrt()).clamp(1.0, most_px);
    size_px.ceil().powi(2)
}

/// Smallest and largest depth of a box in front of the near plane.
fn depths(bounds: &Aabb, view: &View) -> (f64, f64) {
    let camera = &view.camera;
    let middle = (bounds.center() - camera.eye).dot(camera.forward);
    let half = 0.5 * bounds.size().dot(camera.forward.abs());
    let near = (middle - half).max(camera.near);
    (near, (middle + half).max(near))
}
