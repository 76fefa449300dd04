//! The builder: top-down splits by the surface area heuristic over binned centres.
//!
//! The cost of a split is the area of each side times its work, so that boxes that rays and views
//! are likely to meet hold little. Where no split separates the centres, or the tree gets deeper
//! than [`DEPTH_OF_SPLITS_BY_AREA`], the centres' median splits, which bounds the depth.
//! The result depends on the input alone, not on the number of threads.
//!
//! After: MacDonald and Booth 1990 (the heuristic); Wald 2007 (binning).

use glam::DVec3;

use crate::geometry::Aabb;
use crate::hierarchy::surface_area;

/// Classes of centres along each axis.
const BINS: usize = 16;
/// From this depth on the median splits, so that a chain of boxes gives no deep tree.
const DEPTH_OF_SPLITS_BY_AREA: u32 = 48;
/// Items from which the two halves are built by two threads.
const ITEMS_FOR_TWO_THREADS: usize = 4096;

/// What is sorted into the tree.
#[derive(Clone, Copy, Debug)]
pub(super) struct Item {
    pub bounds: Aabb,
    pub center: DVec3,
    pub cost: u64,
    pub object: u32,
}

/// A finished subtree, before it is laid out.
#[derive(Debug)]
pub(super) enum Subtree {
    Leaf(Vec<u32>),
    Inner(Box<[Subtree; 2]>),
}

/// Builds the tree over items; a leaf holds at most `leaf_items`, at least 1.
pub(super) fn build(items: &mut [Item], leaf_items: usize, depth: u32) -> Subtree {
    if items.len() <= leaf_items.max(1) {
        let mut objects: Vec<u32> = items.iter().map(|item| item.object).collect();
        objects.sort_unstable();
        return Subtree::Leaf(objects);
    }
    let at = split(items, depth);
    let large = items.len() >= ITEMS_FOR_TWO_THREADS;
    let (left, right) = items.split_at_mut(at);
    let (left, right) = if large {
        rayon::join(|| build(left, leaf_items, depth + 1), || build(right, leaf_items, depth + 1))
    } else {
        (build(left, leaf_items, depth + 1), build(right, leaf_items, depth + 1))
    };
    Subtree::Inner(Box::new([left, right]))
}

/// Orders items so that a split falls at the returned place, with items on both sides.
fn split(items: &mut [Item], depth: u32) -> usize {
    let centers = items.iter().fold(Aabb::EMPTY, |bounds, item| bounds.including(item.center));
    if depth < DEPTH_OF_SPLITS_BY_AREA
        && let Some(best) = best_split(items, &centers)
    {
        // A stable partition keeps the order of equal items, and so the result.
        let bin = |item: &Item| best.bins.of(item.center);
        items.sort_by_key(|item| bin(item) >= best.first_right);
        return items.partition_point(|item| bin(item) < best.first_right);
    }
    let axis = longest_axis(centers.size());
    let middle = items.len() / 2;
    items.select_nth_unstable_by(middle, |a, b| {
        a.center[axis].total_cmp(&b.center[axis]).then(a.object.cmp(&b.object))
    });
    middle
}

fn longest_axis(size: DVec3) -> usize {
    let mut longest = 0;
    for axis in 1..3 {
        if size[axis] > size[longest] {
            longest = axis;
        }
    }
    longest
}

/// Classes of centres along an axis.
#[derive(Clone, Copy)]
struct Bins {
    axis: usize,
    low: f64,
    per_length: f64,
}

impl Bins {
    fn of(&self, center: DVec3) -> usize {
        (((center[self.axis] - self.low) * self.per_length) as usize).min(BINS - 1)
    }
}

struct Split {
    bins: Bins,
    first_right: usize,
}

#[derive(Clone, Copy)]
struct Side {
    bounds: Aabb,
    cost: f64,
}

impl Side {
    const EMPTY: Side = Side { bounds: Aabb::EMPTY, cost: 0.0 };

    fn with(self, other: &Side) -> Side {
        Side { bounds: self.bounds.union(&other.bounds), cost: self.cost + other.cost }
    }

    fn weight(&self) -> f64 {
        surface_area(&self.bounds) * self.cost
    }
}

/// The cheapest split of all three axes; `None` where all centres fall together.
fn best_split(items: &[Item], centers: &Aabb) -> Option<Split> {
    let mut best: Option<(f64, Split)> = None;
    for axis in 0..3 {
        let (low, high) = (centers.min[axis], centers.max[axis]);
        let per_length = BINS as f64 / (high - low);
        if !(per_length.is_finite() && per_length > 0.0) {
            continue;
        }
        let bins = Bins { axis, low, per_length };
        let mut sides = [Side::EMPTY; BINS];
        let mut counts = [0usize; BINS];
        for item in items {
            let bin = bins.of(item.center);
            // Every item weighs something, so that free ones are split too.
            let cost = 1.0 + item.cost as f64;
            sides[bin] = sides[bin].with(&Side { bounds: item.bounds, cost });
            counts[bin] += 1;
        }
        let mut right_weights = [0.0; BINS];
        let mut right = Side::EMPTY;
        for bin in (1..BINS).rev() {
            right = right.with(&sides[bin]);
            right_weights[bin] = right.weight();
        }
        let (mut left, mut left_count) = (Side::EMPTY, 0);
        for first_right in 1..BINS {
            left = left.with(&sides[first_right - 1]);
            left_count += counts[first_right - 1];
            if left_count == 0 || left_count == items.len() {
                continue;
            }
            let weight = left.weight() + right_weights[first_right];
            if best.as_ref().is_none_or(|(least, _)| weight < *least) {
                best = Some((weight, Split { bins, first_right }));
            }
        }
    }
    best.map(|(_, split)| split)
}
