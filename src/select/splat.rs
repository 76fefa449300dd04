//! How large points are drawn: the splat level of each drawn node, and the table through which a
//! point finds the deepest drawn node around it.
//!
//! A point's splat covers the cell of the finest level drawn around it, so that what is not drawn
//! (not loaded yet, or beyond the budget) leaves larger splats instead of gaps. The four policies
//! differ in whether one size per node answers for all of its octants.
//!
//! Units: global levels (outer depth plus level within the node), pixels on screen.
//! After: the Instant Points chapter, 6.5.3; the variants but `Paper` are ours.

use crate::ids::NodeId;
use crate::octree::{Node, Octree};
use crate::select::cut::Cut;

/// Which drawn level sets the size of a point's splat.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum SplatPolicy {
    /// The node's own finest: no gaps, blurred where children are drawn, most pixels touched.
    Own,
    /// The deepest drawn descendant without a missing child, literally as the paper says. Octants
    /// that are less deep show gaps.
    Paper,
    /// The node's own if any wanted child is not drawn, else the coarsest of its children's.
    Conservative,
    /// Of the deepest drawn node around each point: as sharp as what is drawn there allows.
    #[default]
    PerPoint,
}

impl SplatPolicy {
    /// All policies.
    pub const ALL: [SplatPolicy; 4] =
        [SplatPolicy::Own, SplatPolicy::Paper, SplatPolicy::Conservative, SplatPolicy::PerPoint];

    /// The policy in words, for options, tables and plots.
    pub fn name(self) -> &'static str {
        match self {
            SplatPolicy::Own => "own",
            SplatPolicy::Paper => "paper",
            SplatPolicy::Conservative => "conservative",
            SplatPolicy::PerPoint => "per-point",
        }
    }
}

/// What decides how large a point is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum SplatSize {
    /// The spacing of the points drawn around it: gaps close, detail stays.
    #[default]
    Adaptive,
    /// The same on screen everywhere.
    Fixed {
        /// Side, pixels.
        px: f64,
    },
    /// The same in the world everywhere, smaller far away.
    Attenuated {
        /// Side, metres; 0: the mean spacing of the scene's points.
        length: f64,
    },
}

impl SplatSize {
    /// The mode in words, for options, tables and plots.
    pub fn name(self) -> &'static str {
        match self {
            SplatSize::Adaptive => "adaptive",
            SplatSize::Fixed { .. } => "fixed",
            SplatSize::Attenuated { .. } => "attenuated",
        }
    }
}

/// What a point larger than a pixel looks like.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum SplatShape {
    /// A square of whole pixels: no gaps between neighbours.
    #[default]
    Square,
    /// A disc.
    Round,
    /// A ball lit from the eye, nearer in the middle: points stand apart.
    Sphere,
}

impl SplatShape {
    /// All shapes.
    pub const ALL: [SplatShape; 3] = [SplatShape::Square, SplatShape::Round, SplatShape::Sphere];

    /// The shape in words, for options, tables and plots.
    pub fn name(self) -> &'static str {
        match self {
            SplatShape::Square => "square",
            SplatShape::Round => "round",
            SplatShape::Sphere => "sphere",
        }
    }
}

/// How splats that share a size are drawn; the picture is the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum SplatDrawing {
    /// Whichever takes less time by the number of points and pixels.
    #[default]
    Auto,
    /// Each point writes all its pixels.
    OneByOne,
    /// Each point writes one pixel; splats are grown from these in screen space. Sizes that differ
    /// from node to node and balls are drawn one by one all the same.
    Grown,
}

/// How large the points are drawn, and what they look like.
///
/// An adaptive splat's side is `multiplier` times the cell edge of its level, as large as it
/// appears at the point's depth. Sides are at least one pixel and at most `max_px`; `passes` rounds
/// them up to whole pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplatSettings {
    /// What decides the size.
    pub size: SplatSize,
    /// What they look like.
    pub shape: SplatShape,
    /// Which drawn level sets an adaptive size.
    pub policy: SplatPolicy,
    /// Factor on the size, 0.5..=4, default 1. Larger closes gaps of sparse data and blurs.
    pub multiplier: f64,
    /// Largest size, pixels, default 24. Smaller bounds the cost of near views and shows gaps there.
    pub max_px: f64,
    /// How splats that share a size are drawn; for measurements.
    pub drawing: SplatDrawing,
}

impl Default for SplatSettings {
    fn default() -> Self {
        SplatSettings {
            size: SplatSize::default(),
            shape: SplatShape::default(),
            policy: SplatPolicy::default(),
            multiplier: 1.0,
            max_px: 24.0,
            drawing: SplatDrawing::default(),
        }
    }
}

/// Mean spacing of a cloud's points where they are densest in each place, metres; 0 without
/// points.
pub fn mean_spacing(octree: &Octree) -> f64 {
    let leaves = || octree.nodes().iter().filter(|node| node.child_mask == 0);
    let points: u64 = leaves().map(|node| u64::from(node.point_count())).sum();
    let weighted = |node: &Node| {
        let edge = octree.cell_size(node.depth).max_element();
        f64::from(node.point_count()) * edge * node.levels.surface_spacing()
    };
    match points {
        0 => 0.0,
        _ => leaves().map(weighted).sum::<f64>() / points as f64,
    }
}

impl SplatSettings {
    /// Whether a point takes the size of the deepest drawn node around it.
    pub fn takes_finest_around(&self) -> bool {
        self.size == SplatSize::Adaptive && self.policy == SplatPolicy::PerPoint
    }
}

/// One drawn node in the table that is sorted by node id.
///
/// The drawn children of a node stand in consecutive rows, in octant order: the child in octant
/// `o` is in row `first_drawn_child + (bits of child_drawn_mask below o)`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DrawnRow {
    /// The node.
    pub node: NodeId,
    /// Its place in [`Cut::draw`].
    pub draw: u32,
    /// Finest global level drawn throughout its cell: by itself, or by an ancestor if only some of
    /// its levels are drawn.
    pub level: u32,
    /// Row of the first drawn child; 0 if none.
    pub first_drawn_child: u32,
    /// Bit `o` is set if the child in octant `o` is drawn.
    pub child_drawn_mask: u8,
}

impl DrawnRow {
    /// Row of the drawn child in `octant`.
    pub fn drawn_child(&self, octant: usize) -> Option<usize> {
        let below = self.child_drawn_mask & ((1u8 << octant) - 1);
        (self.child_drawn_mask >> octant & 1 == 1)
            .then(|| (self.first_drawn_child + below.count_ones()) as usize)
    }
}

/// Memory that linking reuses.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    /// Per node of the octree: its row, or `NO_ROW`.
    row_of_node: Vec<u32>,
    /// Per row: octants whose child was asked for.
    requested: Vec<u8>,
    /// Per row: the splat level under construction.
    levels: Vec<u32>,
}

const NO_ROW: u32 = u32::MAX;

/// Fills `cut.table` and the splat level of each drawn node.
///
/// `wanted` holds, per drawn node, the octants whose child the view wants.
pub(super) fn link(
    octree: &Octree,
    cut: &mut Cut,
    wanted: &[u8],
    policy: SplatPolicy,
    scratch: &mut Scratch,
) {
    build_table(octree, cut, scratch);
    let rows = &cut.table;
    scratch.levels.clear();
    scratch.levels.extend(rows.iter().map(|row| row.level));
    match policy {
        SplatPolicy::Own | SplatPolicy::PerPoint => {}
        SplatPolicy::Paper => {
            mark_requested(octree, cut, scratch);
            deepest_complete(&cut.table, scratch);
        }
        SplatPolicy::Conservative => coarsest_complete(rows, wanted, &mut scratch.levels),
    }
    for (row, &level) in cut.table.iter().zip(&scratch.levels) {
        cut.draw[row.draw as usize].splat_level = level;
    }
    for row in &cut.table {
        scratch.row_of_node[row.node.index()] = NO_ROW;
    }
}

fn build_table(octree: &Octree, cut: &mut Cut, scratch: &mut Scratch) {
    let depths = cut.draw.iter().enumerate().map(|(i, drawn)| {
        let node = octree.node(drawn.node);
        let totals = node.levels.totals();
        let levels = totals.partition_point(|&total| total <= drawn.count) as u32;
        let level = node.depth + levels.saturating_sub(1);
        DrawnRow { node: drawn.node, draw: i as u32, level, ..DrawnRow::default() }
    });
    cut.table.clear();
    cut.table.extend(depths);
    cut.table.sort_unstable_by_key(|row| row.node);

    if scratch.row_of_node.len() < octree.nodes().len() {
        scratch.row_of_node.resize(octree.nodes().len(), NO_ROW);
    }
    for row in 0..cut.table.len() {
        let id = cut.table[row].node;
        scratch.row_of_node[id.index()] = row as u32;
        let Some(parent) = drawn_parent(octree, id, scratch) else { continue };
        let parent_row = &mut cut.table[parent];
        if parent_row.child_drawn_mask == 0 {
            parent_row.first_drawn_child = row as u32;
        }
        parent_row.child_drawn_mask |= 1 << octant(octree, id);
        let level = parent_row.level;
        cut.table[row].level = cut.table[row].level.max(level);
    }
}

/// Row of a node's parent, if it is drawn.
fn drawn_parent(octree: &Octree, id: NodeId, scratch: &Scratch) -> Option<usize> {
    let parent = octree.node(id).parent?;
    let row = scratch.row_of_node[parent.index()];
    (row != NO_ROW).then_some(row as usize)
}

/// Octant of a node within its parent.
fn octant(octree: &Octree, id: NodeId) -> usize {
    let cell = octree.node(id).cell & 1;
    (cell.x | cell.y << 1 | cell.z << 2) as usize
}

fn mark_requested(octree: &Octree, cut: &Cut, scratch: &mut Scratch) {
    scratch.requested.clear();
    scratch.requested.resize(cut.table.len(), 0);
    for request in &cut.requests {
        if let Some(parent) = drawn_parent(octree, request.node, scratch) {
            scratch.requested[parent] |= 1 << octant(octree, request.node);
        }
    }
}

/// `Paper`: the finest level of any node below (or the node itself) that misses no child.
fn deepest_complete(rows: &[DrawnRow], scratch: &mut Scratch) {
    let Scratch { requested, levels, .. } = scratch;
    for (i, row) in rows.iter().enumerate().rev() {
        let complete_below = drawn_children(row).filter(|&child| requested[child] == 0);
        if let Some(level) = complete_below.map(|child| levels[child]).max() {
            levels[i] = level;
            // From above, a node counts as complete if one below it does.
            requested[i] = 0;
        }
    }
}

/// `Conservative`: a node's own level if a wanted child is not drawn, else the coarsest below.
fn coarsest_complete(rows: &[DrawnRow], wanted: &[u8], levels: &mut [u32]) {
    for (i, row) in rows.iter().enumerate().rev() {
        if wanted[row.draw as usize] & !row.child_drawn_mask == 0 {
            let coarsest = drawn_children(row).map(|child| levels[child]).min();
            levels[i] = coarsest.unwrap_or(row.level);
        }
    }
}

fn drawn_children(row: &DrawnRow) -> std::ops::Range<usize> {
    let first = row.first_drawn_child as usize;
    first..first + row.child_drawn_mask.count_ones() as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::{LevelIndex, RootCube};
    use crate::points::Lattice;
    use crate::select::{DrawNode, Request};
    use glam::{DVec3, I64Vec3, UVec3};

    /// Two levels per node, so that the nodes show levels 2, 3, 3 and 4:
    ///
    /// ```text
    /// 0 root ─┬─ 1 (octant 0) ─── 3 (octant 5)
    ///         └─ 2 (octant 7)
    /// ```
    fn octree() -> Octree {
        let row = |depth, cell: [u32; 3], parent: Option<u32>, first_child, child_mask| Node {
            depth,
            cell: UVec3::from_array(cell),
            parent: parent.map(NodeId),
            first_child: NodeId(first_child),
            child_mask,
            levels: LevelIndex::new(vec![1, 4, 12]).expect("valid"),
            tight_min: UVec3::ZERO,
            tight_max: UVec3::ZERO,
        };
        let nodes = vec![
            row(0, [0, 0, 0], None, 1, 0b1000_0001),
            row(1, [0, 0, 0], Some(0), 3, 0b0010_0000),
            row(1, [1, 1, 1], Some(0), 4, 0),
            row(2, [1, 0, 1], Some(1), 4, 0),
        ];
        let lattice = Lattice { scale: DVec3::ONE, offset: DVec3::ZERO };
        let root = RootCube { min: I64Vec3::ZERO, bits: 6 };
        Octree::new(lattice, root, 2, nodes).expect("valid")
    }

    /// Links a cut; the children of the root and of node 1 are wanted. Splat levels by node.
    fn linked(drawn: &[(u32, u32)], requested: &[u32], policy: SplatPolicy) -> (Cut, Vec<u32>) {
        let draw = drawn
            .iter()
            .map(|&(node, count)| DrawNode {
                node: NodeId(node),
                count,
                splat_level: 0,
                share: 1.0,
                priority_px: 0.0,
                concealed: false,
            })
            .collect();
        let requests = requested
            .iter()
            .map(|&node| Request { node: NodeId(node), count: 12, priority_px: 1.0 })
            .collect();
        let mut cut = Cut { draw, requests, ..Cut::default() };
        let wanted: Vec<u8> = drawn
            .iter()
            .map(|(node, _)| [0b1000_0001, 0b0010_0000, 0, 0][*node as usize])
            .collect();
        link(&octree(), &mut cut, &wanted, policy, &mut Scratch::default());
        let level = |row: &DrawnRow| cut.draw[row.draw as usize].splat_level;
        let levels = cut.table.iter().map(level).collect();
        (cut, levels)
    }

    #[test]
    fn rows_are_sorted_and_lead_to_drawn_children() {
        let (cut, _) = linked(&[(0, 12), (2, 12), (1, 12), (3, 12)], &[], SplatPolicy::Own);
        assert_eq!(cut.table.iter().map(|row| row.node.0).collect::<Vec<_>>(), [0, 1, 2, 3]);
        assert_eq!(cut.table.iter().map(|row| row.draw).collect::<Vec<_>>(), [0, 2, 1, 3]);
        let child = |row: usize, octant| cut.table[row].drawn_child(octant);
        assert_eq!((child(0, 0), child(0, 7), child(1, 5)), (Some(1), Some(2), Some(3)));
        assert_eq!((child(0, 3), child(1, 4), child(2, 0), child(3, 7)), (None, None, None, None));
    }

    #[test]
    fn a_missing_child_is_in_no_row() {
        let (cut, _) = linked(&[(0, 12), (1, 12), (3, 12)], &[2], SplatPolicy::PerPoint);
        assert_eq!(cut.table[0].child_drawn_mask, 1);
        assert_eq!((cut.table[0].drawn_child(7), cut.table[1].drawn_child(5)), (None, Some(2)));
    }

    #[test]
    fn the_policies_differ_where_a_child_is_missing() {
        let drawn = [(0, 12), (1, 12), (3, 12)];
        let levels = |policy| linked(&drawn, &[2], policy).1;
        assert_eq!(levels(SplatPolicy::Own), [2, 3, 4]);
        assert_eq!(levels(SplatPolicy::PerPoint), [2, 3, 4]);
        assert_eq!(levels(SplatPolicy::Paper), [4, 4, 4], "the root takes the deepest branch");
        assert_eq!(levels(SplatPolicy::Conservative), [2, 4, 4], "the root keeps its own");
    }

    /// Node 2 did not fit the budget: it was never asked for, so only `Conservative` minds.
    #[test]
    fn a_child_beyond_the_budget_counts_as_missing_for_conservative_sizes_only() {
        let drawn = [(0, 12), (1, 12)];
        assert_eq!(linked(&drawn, &[], SplatPolicy::Paper).1, [3, 3]);
        assert_eq!(linked(&drawn, &[], SplatPolicy::Conservative).1, [2, 3]);
    }

    #[test]
    fn with_all_children_the_coarsest_and_the_deepest_differ() {
        let drawn = [(0, 12), (1, 12), (2, 12), (3, 12)];
        assert_eq!(linked(&drawn, &[], SplatPolicy::Paper).1, [4, 4, 3, 4]);
        assert_eq!(linked(&drawn, &[], SplatPolicy::Conservative).1, [3, 4, 3, 4]);
    }

    /// A parent whose only drawn child misses one itself is not complete by it.
    #[test]
    fn incomplete_descendants_do_not_count_for_the_paper() {
        assert_eq!(linked(&[(0, 12), (1, 12)], &[2, 3], SplatPolicy::Paper).1, [2, 3]);
    }

    /// A prefix shows a coarser level, but never coarser than what the parent shows there.
    #[test]
    fn partly_drawn_nodes_show_the_level_of_their_prefix() {
        assert_eq!(linked(&[(0, 4)], &[], SplatPolicy::Own).1, [1]);
        assert_eq!(linked(&[(0, 12), (1, 1)], &[], SplatPolicy::Own).1, [2, 2]);
        assert_eq!(linked(&[(0, 12), (1, 11)], &[], SplatPolicy::Own).1, [2, 2]);
    }
}
