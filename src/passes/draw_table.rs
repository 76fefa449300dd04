//! The drawn nodes as the point passes read them: one row per node, and the list of draws.
//!
//! Rows of a cloud stand in the order of its node ids, so that drawn children stand side by side
//! and a point finds the deepest drawn node around it; draws keep the order of the cut, nearest
//! first, so that later points fail the depth test early. The eye goes into each row in f64, the
//! GPU gets only what is relative to it.

use std::ops::Range;

use crate::geometry::{Aabb, View};
use crate::gpu::layout::{GpuBatch, GpuNode, NARROW_BITS, position_words};
use crate::ids::NodeId;
use crate::octree::{LevelIndex, Octree};
use crate::passes::shown::Shown;
use crate::passes::{CheckpointPlan, DrawPart};
use crate::select::{Cut, DrawnRow, SplatSettings, SplatSize};

/// Where the words of a node are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NodePlace {
    /// The buffer.
    pub shard: usize,
    /// First position word within it.
    pub positions_at: u32,
    /// First colour word within it.
    pub colors_at: u32,
}

/// What is drawn of one cloud.
#[derive(Clone, Copy)]
pub struct CloudDraw<'a> {
    /// The cloud.
    pub octree: &'a Octree,
    /// Its nodes; they must all have a place.
    pub cut: &'a Cut,
    /// Where a drawn node's words are.
    pub place: &'a dyn Fn(NodeId) -> NodePlace,
    /// What share of a drawn node's points has appeared, 0..=1; none: all of all nodes.
    pub appeared: Option<&'a dyn Fn(NodeId) -> f32>,
}

impl CloudDraw<'_> {
    /// What share of a drawn node's points is drawn.
    fn share(&self, row: &DrawnRow) -> f32 {
        let appeared = self.appeared.map_or(1.0, |appeared| appeared(row.node));
        appeared * self.cut.draw[row.draw as usize].share
    }
}

/// One draw: leading points of one node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DrawnNode {
    /// Row of the node in [`DrawTable::nodes`].
    pub slot: u32,
    /// Which cloud of the scene.
    pub cloud: usize,
    /// Which node of it.
    pub node: NodeId,
    /// Leading points; where only a share is drawn, places of points, a few of them empty.
    pub count: u32,
    /// Buffer of its words.
    pub shard: usize,
    /// No splat of the node is larger, pixels, before it is rounded up.
    pub largest_px: f32,
    /// Whether no splat of the node can exceed one pixel.
    pub single_pixels: bool,
    /// Whether only a share of the points is drawn.
    pub partly: bool,
    /// Which of the frame's alternatives it belongs to.
    pub part: DrawPart,
    /// Whether it is drawn only if culling finds that it shows.
    pub concealed: bool,
}

/// All drawn nodes of a scene. Lists are kept for the next frame's use.
#[derive(Debug, Default)]
pub struct DrawTable {
    /// One row per node, sorted by cloud and node id.
    pub nodes: Vec<GpuNode>,
    /// In drawing order.
    pub draws: Vec<DrawnNode>,
    /// Points drawn, but for concealed ones; those are not counted below either.
    pub points: u64,
    /// About how many pixels the splats have together, hidden ones included: each node's at the
    /// depth of its middle.
    pub splat_pixels: u64,
    /// No splat is larger, pixels, unless the settings allow less.
    pub largest_splat_px: f64,
    /// Bytes that drawing reads of points: all positions, and the colours if none is hidden.
    pub point_bytes: u64,
    /// When which alternative is drawn; without it there are none.
    pub checkpoint: Option<CheckpointPlan>,
}

/// What all nodes of a batch group have in common, so that one pipeline draws them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct BatchKind {
    /// Buffer of the words.
    pub shard: usize,
    /// Whether the nodes hold three coordinates per point, else Morton codes.
    pub wide: bool,
    /// Whether no splat of the nodes exceeds one pixel.
    pub single_pixels: bool,
    /// Whether only a share of the nodes' points is drawn.
    pub partly: bool,
    /// Which of the frame's alternatives they belong to.
    pub part: DrawPart,
}

/// Workgroup-sized pieces of the draws.
#[derive(Debug, Default)]
pub struct Batches {
    /// All pieces, with gaps between groups.
    pub list: Vec<GpuBatch>,
    /// The pieces of each kind that has any.
    pub groups: Vec<(BatchKind, Range<usize>)>,
}

impl DrawTable {
    /// Fills the table with the cuts of a scene.
    pub fn fill(&mut self, clouds: &[CloudDraw], view: &View, splat: &SplatSettings) {
        self.nodes.clear();
        self.draws.clear();
        self.splat_pixels = 0;
        self.checkpoint = None;
        self.largest_splat_px = 1.0;
        for (index, cloud) in clouds.iter().enumerate() {
            self.add_cloud(index, cloud, view, splat);
        }
        let points = |draw: &DrawnNode| Shown::points_of(&self.nodes[draw.slot as usize]);
        let shown = || self.draws.iter().filter(|draw| !draw.concealed);
        self.points = shown().map(points).sum();
        let bytes = |draw: &DrawnNode| {
            let local_bits = self.nodes[draw.slot as usize].local_bits;
            points(draw) * 4 * u64::from(position_words(local_bits) + 1)
        };
        self.point_bytes = shown().map(bytes).sum();
    }

    /// Cuts the draws into batches of at most `batch_points`, kind by kind; the start of each kind
    /// is a multiple of `align`. Concealed ones are left out.
    pub fn batches(&self, batch_points: u32, align: usize, batches: &mut Batches) {
        let shown: Vec<&DrawnNode> = self.draws.iter().filter(|draw| !draw.concealed).collect();
        self.batches_of(&shown, batch_points, align, batches);
    }

    /// As [`batches`](Self::batches), of some of the draws.
    pub fn batches_of(
        &self,
        draws: &[&DrawnNode],
        batch_points: u32,
        align: usize,
        batches: &mut Batches,
    ) {
        batches.list.clear();
        batches.groups.clear();
        let mut kinds: Vec<BatchKind> = draws.iter().map(|draw| self.kind(draw)).collect();
        kinds.sort_unstable();
        kinds.dedup();
        for kind in kinds {
            let start = batches.list.len().next_multiple_of(align);
            batches.list.resize(start, GpuBatch { node_slot: 0, first_point: 0, end_point: 0 });
            for draw in draws.iter().filter(|draw| self.kind(draw) == kind) {
                let starts = (0..draw.count).step_by(batch_points as usize);
                batches.list.extend(starts.map(|first_point| GpuBatch {
                    node_slot: draw.slot,
                    first_point,
                    end_point: draw.count.min(first_point.saturating_add(batch_points)),
                }));
            }
            batches.groups.push((kind, start..batches.list.len()));
        }
    }

    /// Points that a draw adds to the picture, hidden ones included.
    pub fn points_of(&self, draw: &DrawnNode) -> u64 {
        Shown::points_of(&self.nodes[draw.slot as usize])
    }

    /// What one pipeline must know to draw a node.
    pub fn kind(&self, draw: &DrawnNode) -> BatchKind {
        BatchKind {
            shard: draw.shard,
            wide: self.nodes[draw.slot as usize].local_bits > NARROW_BITS,
            single_pixels: draw.single_pixels,
            partly: draw.partly,
            part: draw.part,
        }
    }

    fn add_cloud(&mut self, index: usize, cloud: &CloudDraw, view: &View, splat: &SplatSettings) {
        let base = self.nodes.len() as u32;
        let first_draw = self.draws.len();
        let octree = cloud.octree;
        // Draws come in the cut's order, rows in node order: slots are filled in below.
        self.draws.extend(cloud.cut.draw.iter().map(|drawn| DrawnNode {
            slot: 0,
            cloud: index,
            node: drawn.node,
            count: drawn.count,
            shard: 0,
            largest_px: 1.0,
            single_pixels: false,
            partly: false,
            part: DrawPart::Always,
            concealed: drawn.concealed,
        }));
        let mut coarsest_edges = vec![f64::INFINITY; cloud.cut.table.len()];
        for ((index, row), slot) in cloud.cut.table.iter().enumerate().zip(base..) {
            let drawn = cloud.cut.draw[row.draw as usize];
            let place = (cloud.place)(row.node);
            let share = cloud.share(row);
            let shown = Shown::of(&octree.node(row.node).levels, drawn.count, share);
            let edge = match splat.takes_finest_around() {
                // Looking up a point's size relies on sizes that never grow on the way down. A node
                // that is not all there yet is not yet as fine as it will be.
                true => {
                    let above = coarsest_edges[index];
                    let own =
                        splat_edge(octree, cloud.cut, row, &|row| cloud.share(row)).min(above);
                    if share >= 1.0 {
                        own
                    } else if above.is_finite() {
                        own * (above / own).powf(f64::from(1.0 - share))
                    } else {
                        // Of a root whole levels come one after the other.
                        let levels = &octree.node(row.node).levels;
                        own * (1.0 - last_level_share(levels, drawn.count, share)).exp2()
                    }
                }
                false => octree.cell_size(drawn.splat_level).max_element(),
            };
            let first = row.first_drawn_child as usize;
            coarsest_edges[first..first + row.child_drawn_mask.count_ones() as usize].fill(edge);
            let edge = match splat.size {
                SplatSize::Attenuated { length } => length,
                _ => edge,
            };
            let splat_px_m = splat.multiplier * edge * view.focal_px();
            let (eye_cell, eye_fraction) = local_eye(octree, row.node, view);
            self.nodes.push(GpuNode {
                eye_cell,
                positions_at: place.positions_at,
                eye_fraction,
                colors_at: place.colors_at,
                scale: octree.lattice().scale.as_vec3().to_array(),
                splat_px_m: splat_px_m as f32,
                local_bits: octree.local_bits(row.node),
                drawn_count: shown.end,
                drawn_children: (base + row.first_drawn_child) << 8
                    | u32::from(row.child_drawn_mask),
                drawn_levels_below: 0,
                whole_count: shown.whole_count,
                kept_of_block: shown.kept_of_block,
                kept_inverse: shown.kept_inverse(),
                padding_0: 0,
            });
            let draw = &mut self.draws[first_draw + row.draw as usize];
            draw.slot = slot;
            draw.shard = place.shard;
            draw.count = shown.places();
            draw.partly = shown.whole_count < shown.end;
            let bounds = octree.tight_box(row.node);
            let fixed_px = match splat.size {
                SplatSize::Fixed { px } => Some(px * splat.multiplier),
                _ => None,
            };
            let nearest = HAIR * nearest_depth(&bounds, view);
            let largest_px = splat.max_px.max(1.0);
            let largest_here_px = fixed_px.unwrap_or(match nearest > 0.0 {
                true => (splat_px_m / nearest).min(largest_px),
                false => largest_px,
            });
            draw.single_pixels = largest_here_px <= 1.0;
            self.largest_splat_px = self.largest_splat_px.max(largest_here_px);
            let middle = (bounds.center() - view.camera.eye).dot(view.camera.forward);
            // Around the eye, points are about as far as the box is wide.
            let middle = middle.max(0.25 * bounds.diagonal());
            let typical_px = fixed_px
                .unwrap_or_else(|| (splat_px_m / middle.max(view.camera.near)).min(largest_px))
                .max(1.0);
            draw.largest_px = largest_here_px as f32;
            if !draw.concealed {
                self.splat_pixels += (f64::from(shown.places()) * typical_px * typical_px) as u64;
            }
        }
        // Children stand after their parents, so going backwards finds them done. Below a cell
        // whose splats are all single pixels there is nothing to look up.
        for (i, row) in cloud.cut.table.iter().enumerate().rev() {
            let slot = base as usize + i;
            let cell_depth = nearest_depth(&octree.cell_box(row.node), view);
            let first = base + row.first_drawn_child;
            let children = first..first + row.child_drawn_mask.count_ones();
            let below = |child| self.nodes[child as usize].drawn_levels_below + 1;
            self.nodes[slot].drawn_levels_below =
                match f64::from(self.nodes[slot].splat_px_m) <= HAIR * cell_depth {
                    true => 0,
                    false => children.map(below).max().unwrap_or(0),
                };
        }
    }
}

/// Share by which the splats of a node without finer points exceed their mean spacing, because
/// scans are not even.
const UNEVENNESS: f64 = 1.5;

/// World edge of the splats of a node's points that have no deeper drawn node around them. `share`
/// tells what share of a drawn node's points is drawn.
///
/// Where finer points exist but are not drawn, splats cover the cell whose representative they
/// are. Where all there is is drawn, cells say nothing: the points' own spacing counts, be it wider
/// (a wall seen from near) or narrower (a sparse node in a large cell). In between, as far as the
/// last child has come.
pub fn splat_edge(
    octree: &Octree,
    cut: &Cut,
    row: &DrawnRow,
    share: &dyn Fn(&DrawnRow) -> f32,
) -> f64 {
    let node = octree.node(row.node);
    let drawn = cut.draw[row.draw as usize];
    let cell_edge = octree.cell_size(drawn.splat_level).max_element();
    let is_all = drawn.count == node.point_count() && node.child_mask == row.child_drawn_mask;
    if !is_all {
        return cell_edge;
    }
    let node_edge = octree.cell_size(node.depth).max_element();
    let spacing = UNEVENNESS * node_edge * node.levels.surface_spacing();
    if node.child_mask == 0 {
        return spacing;
    }
    let children = &cut.table[row.first_drawn_child as usize..];
    let least = children[..row.child_drawn_mask.count_ones() as usize]
        .iter()
        .map(share)
        .fold(1.0, f32::min);
    cell_edge * (spacing.max(cell_edge) / cell_edge).powf(f64::from(least))
}

/// How much is drawn of the last level of `count` leading points of which a share is, 0..=1.
fn last_level_share(levels: &LevelIndex, count: u32, share: f32) -> f64 {
    let totals = levels.totals();
    let level = totals.partition_point(|&total| total < count);
    let coarse = level.checked_sub(1).map_or(0.0, |before| f64::from(totals[before]));
    let last = (f64::from(count) - coarse).max(1.0);
    ((f64::from(share) * f64::from(count) - coarse) / last).clamp(0.0, 1.0)
}

/// The eye in lattice steps of a node: integer part clamped into the cell, and the rest.
fn local_eye(octree: &Octree, node: NodeId, view: &View) -> ([u32; 3], [f32; 3]) {
    let eye = octree.lattice().lattice(view.camera.eye) - octree.cell_min(node).as_dvec3();
    let last = f64::from(octree.local_bits(node)).exp2() - 1.0;
    let cell = eye.to_array().map(|e| e.floor().clamp(0.0, last));
    let fraction = [0, 1, 2].map(|axis| (eye[axis] - cell[axis]) as f32);
    (cell.map(|c| c as u32), fraction)
}

/// Smallest distance along the viewing direction of a box.
fn nearest_depth(bounds: &Aabb, view: &View) -> f64 {
    let forward = view.camera.forward;
    (bounds.center() - view.camera.eye).dot(forward) - 0.5 * bounds.size().dot(forward.abs())
}

/// A hair of margin, because the GPU compares in f32.
const HAIR: f64 = 0.9999;
