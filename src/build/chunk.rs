//! One chunk: from its rows to finished nodes, and what it gives to nodes that reach beyond it.
//!
//! The points are sorted, each finds the depth it is at home at (`home`), and one sweep in Morton
//! order collects the points of the node open at each depth. A node is finished when the sweep
//! leaves its cell; one that fewer than `threshold` points entered is dissolved: its points stay
//! in its parent beyond one per finest cell.

use std::collections::HashMap;

use crate::build::encode::FinishedNode;
use crate::build::home::{BEYOND, Homes, Waiting};
use crate::build::levels::grow;
use crate::build::node::{NodeBuilder, SortedPoints, TreeRules};
use crate::build::paged_rows::{PagedRows, marked_stride};
use crate::build::plan::Chunk;
use crate::build::progress::Progress;
use crate::build::rows::{RowLayout, RowTable, copy_short};
use crate::build::sort::{SortScratch, sort_rows};
use crate::geometry::MortonKey;

/// Points of a chunk that belong to a node reaching beyond the chunk, or to one of its dissolved
/// children.
#[derive(Debug)]
pub struct Contribution<'p, K> {
    /// Depth of the node.
    pub depth: u32,
    /// Its code at that depth.
    pub code: K,
    /// Points of the chunk that entered the node.
    pub entering: u64,
    /// Rows of the points, in Morton order.
    pub rows: ContributedRows<'p>,
}

/// Rows, each marked with whether a cell of the node takes it.
#[derive(Debug)]
pub enum ContributedRows<'p> {
    /// A few.
    Few(Vec<u8>),
    /// Any number.
    Paged(PagedRows<'p>),
}

/// A point taken by a cell that several chunks share: its input index and its depth.
pub type Taken = (u64, u32);

/// Memory of one worker.
#[derive(Default)]
pub struct ChunkScratch<K> {
    sort: SortScratch,
    sorted: Sorted<K>,
    waiting: Waiting,
    homes: Vec<u8>,
    open: Vec<OpenNode>,
    pub(super) nodes: NodeBuilder<K>,
}

/// The points of a chunk in Morton order, equal codes in input order. Lists may be longer than
/// there are points.
#[derive(Default)]
struct Sorted<K> {
    keys: Vec<K>,
    rows: Vec<u8>,
    /// Order of arrival: rises with the input index.
    orders: Vec<u32>,
    /// Levels of cells that a point shares with the one before it, plus one; 0 for the first.
    shared: Vec<u8>,
}

/// The node that the sweep is in, at one depth.
#[derive(Default)]
struct OpenNode {
    /// Its points' places; in Morton order if none came from dissolved children.
    members: Vec<u32>,
    /// Members from dissolved children.
    dissolved: u64,
    /// Points that entered nodes below it.
    below: u64,
}

/// Where a chunk's results go.
pub struct ChunkSink<'a, 'p, K> {
    /// Nodes that lie within the chunk.
    pub finished: Vec<FinishedNode>,
    /// Hears of the points of each.
    pub progress: &'a dyn Progress,
    /// Collects what belongs to nodes that do not.
    pub contributions: Vec<Contribution<'p, K>>,
}

impl<'a, K> ChunkSink<'a, '_, K> {
    /// Nothing yet.
    pub fn new(progress: &'a dyn Progress) -> Self {
        ChunkSink { finished: Vec::new(), progress, contributions: Vec::new() }
    }
}

/// Builds what a chunk can decide alone.
pub fn build_chunk<K: MortonKey>(
    rules: &TreeRules,
    chunk: &Chunk<K>,
    rows: RowTable,
    taken: &[Taken],
    scratch: &mut ChunkScratch<K>,
    sink: &mut ChunkSink<'_, '_, K>,
) {
    let (layout, count) = (rows.layout(), rows.len());
    let mut sorted = std::mem::take(&mut scratch.sorted);
    sort(rules, chunk, rows, &mut scratch.sort, &mut sorted);
    let rows = &sorted.rows[..count * layout.stride()];
    let cells = Homes { root_bits: rules.root_bits, levels: rules.levels };
    find_homes(&cells, chunk, layout, taken, scratch, rows, &sorted);
    let homes = std::mem::take(&mut scratch.homes);
    let keys = &sorted.keys[..count];
    let points = SortedPoints { keys, homes: &homes[..count], rows, layout };
    sweep(rules, chunk, points, &sorted.shared[..count], scratch, sink);
    (scratch.sorted, scratch.homes) = (sorted, homes);
}

/// Brings rows into Morton order: once out of order, so that all that comes later is a walk over
/// memory nearly in order.
fn sort<K: MortonKey>(
    rules: &TreeRules,
    chunk: &Chunk<K>,
    rows: RowTable,
    scratch: &mut SortScratch,
    sorted: &mut Sorted<K>,
) {
    let (layout, count) = (rows.layout(), rows.len());
    let stride = layout.stride();
    grow(&mut sorted.keys, count);
    grow(&mut sorted.rows, count * stride);
    grow(&mut sorted.orders, count);
    grow(&mut sorted.shared, count);
    let mut to = sorted.rows[..count * stride].chunks_exact_mut(stride);
    let mut keys = sorted.keys[..count].iter_mut();
    let mut shared = sorted.shared[..count].iter_mut();
    let mut orders = sorted.orders[..count].iter_mut();
    let mut previous = None;
    sort_rows(rows, chunk.start, scratch, |key: K, slot| {
        let (Some(to), Some(to_key), Some(shared), Some(order)) =
            (to.next(), keys.next(), shared.next(), orders.next())
        else {
            return;
        };
        let row = rows.row(slot);
        copy_short(to, row);
        *to_key = key;
        *shared = previous.map_or(0, |p| key.shared_levels(p, rules.root_bits) as u8 + 1);
        *order = layout.index(row) as u32;
        previous = Some(key);
    });
    if !layout.has_short_indices() {
        let rows = sorted.rows[..count * stride].chunks_exact(stride);
        rank(rows.map(|row| layout.index(row)), &mut sorted.orders);
    }
}

/// Replaces indices that do not fit 32 bits by their ranks: only their order counts.
fn rank(indices: impl Iterator<Item = u64>, orders: &mut [u32]) {
    let mut sorted: Vec<(u64, u32)> = indices.zip(0..).collect();
    sorted.sort_unstable();
    for ((_, place), rank) in sorted.into_iter().zip(0..) {
        orders[place as usize] = rank;
    }
}

/// Fills `homes`, one per point.
fn find_homes<K: MortonKey>(
    homes: &Homes,
    chunk: &Chunk<K>,
    layout: RowLayout,
    taken: &[Taken],
    scratch: &mut ChunkScratch<K>,
    rows: &[u8],
    sorted: &Sorted<K>,
) {
    let ChunkScratch { waiting, homes: out, .. } = scratch;
    let count = rows.len() / layout.stride();
    grow(out, count);
    waiting.clear();
    let all = sorted.orders[..count].iter().zip(&sorted.shared).zip(0u32..);
    if taken.is_empty() {
        all.for_each(|((&order, &shared), place)| waiting.push(order, place, shared));
    } else {
        let taken: HashMap<u64, u32> = taken.iter().copied().collect();
        let mut gap = u8::MAX;
        for (((&order, &shared), place), row) in all.zip(rows.chunks_exact(layout.stride())) {
            gap = gap.min(shared);
            match taken.get(&layout.index(row)) {
                Some(depth) => out[place as usize] = *depth as u8,
                None => waiting.push(order, place, std::mem::replace(&mut gap, u8::MAX)),
            }
        }
    }
    homes.assign(waiting, chunk.level - homes.levels, out);
}

/// Whether a node has cells outside of a chunk.
fn reaches_beyond<K: MortonKey>(chunk: &Chunk<K>, depth: u32, key: K, root_bits: u32) -> bool {
    let levels = root_bits - depth;
    let code = key.ancestor(levels);
    let starts_before = code.first_within(levels) < chunk.start;
    // The end is inside if it is in the same cell but not its first code.
    let ends_after = chunk
        .end
        .is_some_and(|end| end.ancestor(levels) == code && end.local(levels) != K::default());
    starts_before || ends_after
}

fn sweep<K: MortonKey>(
    rules: &TreeRules,
    chunk: &Chunk<K>,
    points: SortedPoints<K>,
    shared: &[u8],
    scratch: &mut ChunkScratch<K>,
    sink: &mut ChunkSink<'_, '_, K>,
) {
    let ChunkScratch { open, nodes, .. } = scratch;
    let Some(&last) = points.keys.last() else { return };
    let depths = rules.max_depth() as usize + 1;
    open.resize_with(depths, OpenNode::default);
    let (keys, homes) = (points.keys, points.homes);
    let mut sweep = Sweep { rules, chunk, points, open, nodes, sink };
    let mut deepest = 0;
    for ((place, &shared), &home) in (0u32..).zip(shared).zip(homes) {
        // Nodes at this depth and above contain both points.
        let shared = u32::from(shared).saturating_sub(1);
        if shared < deepest {
            sweep.close_below(shared, deepest, keys[place as usize - 1]);
            deepest = shared;
        }
        let home = u32::from(home & !BEYOND);
        deepest = deepest.max(home);
        sweep.open[home as usize].members.push(place);
    }
    sweep.close_below(0, deepest, last);
    sweep.close(0, last);
}

struct Sweep<'a, 's, 'p, K> {
    rules: &'a TreeRules<'a>,
    chunk: &'a Chunk<K>,
    points: SortedPoints<'a, K>,
    open: &'a mut [OpenNode],
    nodes: &'a mut NodeBuilder<K>,
    sink: &'a mut ChunkSink<'s, 'p, K>,
}

impl<K: MortonKey> Sweep<'_, '_, '_, K> {
    /// Closes the open nodes deeper than `shared`, deepest first; `key` is of a point in them.
    fn close_below(&mut self, shared: u32, deepest: u32, key: K) {
        (shared + 1..=deepest).rev().for_each(|depth| self.close(depth, key));
    }

    fn close(&mut self, depth: u32, key: K) {
        let mut node = std::mem::take(&mut self.open[depth as usize]);
        let entering = node.members.len() as u64 - node.dissolved + node.below;
        if entering == 0 {
            return;
        }
        if node.dissolved > 0 {
            // Runs of rising places: merged rather than sorted.
            node.members.sort();
        }
        if reaches_beyond(self.chunk, depth, key, self.rules.root_bits) {
            self.contribute(depth, key, entering, &node.members);
        } else if depth == 0 || entering >= self.rules.threshold as u64 {
            let finished = self.nodes.finish(self.rules, depth, &self.points, &node.members);
            self.sink.progress.advance(finished.points());
            self.sink.finished.push(finished);
        } else {
            let parent = &mut self.open[depth as usize - 1];
            parent.dissolved += node.members.len() as u64;
            parent.members.extend_from_slice(&node.members);
        }
        if depth > 0 {
            self.open[depth as usize - 1].below += entering;
        }
        node.members.clear();
        self.open[depth as usize] = OpenNode { members: node.members, ..OpenNode::default() };
    }

    fn contribute(&mut self, depth: u32, key: K, entering: u64, members: &[u32]) {
        let stride = self.points.layout.stride();
        let marked = marked_stride(self.points.layout);
        let mut rows = vec![0; members.len() * marked];
        for (row, &place) in rows.chunks_exact_mut(marked).zip(members) {
            copy_short(&mut row[..stride], self.points.row(place));
            row[stride] = u8::from(self.points.is_kept(place, depth));
        }
        let code = key.ancestor(self.rules.root_bits - depth);
        let rows = ContributedRows::Few(rows);
        self.sink.contributions.push(Contribution { depth, code, entering, rows });
    }
}
