//! What a cut costs, in counts that are known before it is drawn.
//!
//! Points and nodes are counted. Pixels are estimated node by node: the mean area of a splat over
//! the part of the node that is in the picture, times the points there; points around which finer
//! nodes are drawn take the area of those. Points behind others count like all: fitted prices take
//! in how many there are.

use glam::DVec3;

use crate::budget::Workload;
use crate::geometry::{Aabb, Containment, Frustum, View};
use crate::octree::Octree;
use crate::passes::splat_edge;
use crate::select::{Cut, DrawnRow, SplatSettings, SplatSize};

/// Places per axis at which a node is looked at that the edge of the picture cuts through, and one
/// that reaches around the eye.
const PLACES: [u32; 2] = [3, 6];
/// Ratio of a node's depths up to which one of them stands for all.
const FLAT: f64 = 1.3;

/// Counts of one cloud's cut. `areas` is memory to work in.
pub(super) fn workload(
    octree: &Octree,
    cut: &Cut,
    view: &View,
    splat: &SplatSettings,
    areas: &mut Vec<f64>,
) -> Workload {
    areas.clear();
    areas.resize(cut.table.len(), f64::INFINITY);
    // First the edges of splats, which never grow on the way down; then areas take their places.
    for (index, row) in cut.table.iter().enumerate() {
        let edge = own_edge(octree, row, cut, splat).min(areas[index]);
        areas[index] = edge;
        let first = row.first_drawn_child as usize;
        if splat.takes_finest_around() {
            areas[first..first + row.child_drawn_mask.count_ones() as usize].fill(edge);
        }
    }
    let eye = Eye { view, frustum: Frustum::new(view), focal_px: view.focal_px() };
    let (mut points, mut pixels) = (0.0, 0.0);
    // Children stand after their parents: backwards, they are done first.
    for (index, row) in cut.table.iter().enumerate().rev() {
        let drawn = cut.draw[row.draw as usize];
        let own = own_area(&octree.tight_box(row.node), areas[index], &eye, splat);
        let first = row.first_drawn_child as usize;
        let drawn_children = row.child_drawn_mask.count_ones();
        let children = first..first + drawn_children as usize;
        // Points lie where there are children, evenly as far as one can tell.
        let all_children = octree.node(row.node).child_mask.count_ones().max(drawn_children);
        let area = match splat.takes_finest_around() && all_children > 0 {
            true => {
                let below: f64 = areas[children].iter().sum();
                let rest = f64::from(all_children - drawn_children);
                (below + own * rest) / f64::from(all_children)
            }
            false => own,
        };
        areas[index] = area;
        if drawn.concealed {
            continue;
        }
        points += f64::from(drawn.count);
        pixels += f64::from(drawn.count) * area;
    }
    Workload::points(cut.shown().count() as f64, points, pixels)
}

struct Eye<'a> {
    view: &'a View,
    frustum: Frustum,
    focal_px: f64,
}

/// World edge of the node's own splats.
fn own_edge(octree: &Octree, row: &DrawnRow, cut: &Cut, splat: &SplatSettings) -> f64 {
    let drawn = cut.draw[row.draw as usize];
    match splat.size {
        SplatSize::Fixed { .. } => 0.0,
        SplatSize::Attenuated { length } => length,
        SplatSize::Adaptive if splat.takes_finest_around() => {
            splat_edge(octree, cut, row, &|row| cut.draw[row.draw as usize].share)
        }
        SplatSize::Adaptive => octree.cell_size(drawn.splat_level).max_element(),
    }
}

/// Mean pixels of a point in a box with splats of one size, in the picture or not.
fn own_area(bounds: &Aabb, edge: f64, eye: &Eye, splat: &SplatSettings) -> f64 {
    let most_px = splat.max_px.max(1.0);
    let px_m = splat.multiplier * edge * eye.focal_px;
    let area_at = |depth: f64| {
        let size_px = match splat.size {
            SplatSize::Fixed { px } => px * splat.multiplier,
            _ => px_m / depth,
        };
        size_px.clamp(1.0, most_px).ceil().powi(2)
    };
    mean_over(bounds, eye, area_at)
}

/// Mean of a function of depth over a box, where what is outside of the picture counts as 0.
fn mean_over(bounds: &Aabb, eye: &Eye, of_depth: impl Fn(f64) -> f64) -> f64 {
    let camera = &eye.view.camera;
    let relative = Aabb::new(bounds.min - camera.eye, bounds.max - camera.eye);
    let middle = relative.center().dot(camera.forward);
    let half = 0.5 * relative.size().dot(camera.forward.abs());
    let is_flat = middle - half > 0.0 && middle + half <= FLAT * (middle - half);
    match eye.frustum.test_box(bounds) {
        Containment::Outside => return 0.0,
        Containment::Inside if is_flat => return of_depth(middle),
        _ => {}
    }
    let side = PLACES[usize::from(middle - half < 0.3 * (middle + half))];
    let place = |i: u32| {
        let step = |n: u32| (f64::from(n) + 0.5) / f64::from(side);
        let share = DVec3::new(step(i % side), step(i / side % side), step(i / (side * side)));
        relative.min + share * relative.size()
    };
    let (half_x, half_y) =
        (0.5 * f64::from(eye.view.width_px), 0.5 * f64::from(eye.view.height_px));
    let (right, up) = (camera.right(), camera.up);
    let value = |i: u32| {
        let place = place(i);
        let depth = place.dot(camera.forward);
        let is_seen = depth >= camera.near
            && (place.dot(right) * eye.focal_px).abs() <= half_x * depth
            && (place.dot(up) * eye.focal_px).abs() <= half_y * depth;
        if is_seen { of_depth(depth) } else { 0.0 }
    };
    let places = side * side * side;
    (0..places).map(value).sum::<f64>() / f64::from(places)
}
