//! One chunk: from its rows to finished nodes, and what it gives to nodes that reach beyond it.
//!
//! The points are sorted, each finds the depth it is at home at (`home`), and one sweep in Morton
//! order collects the points of the node open at each depth. A node is finished when the sweep
//! leaves its cell; one that fewer than `threshold` points entered is dissolved: its points stay
//! in its parent beyond one per finest cell.

use std::collections::HashMap;

use crate::build::encode::FinishedNode;
use crate::build::home::{BEYOND, Homes, Waiting};
use crate::build::node::{NodeBuilder, SortedPoints, TreeRules};
use crate::build::paged_rows::{PagedRows, marked_stride};
use crate::build::plan::Chunk;
use crate::build::progress::Progress;
use crate::build::rows::{RowTable, copy_short};
use crate::build::sort::{Item, SortScratch, sort_rows};
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
    items: Vec<Item<K>>,
    sort: SortScratch<K>,
    /// The rows in the order of the items.
    sorted: Vec<u8>,
    waiting: Vec<Waiting<K>>,
    homes: Vec<u8>,
    open: Vec<OpenNode>,
    pub(super) nodes: NodeBuilder<K>,
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
    sort_rows(rows, &mut scratch.items, &mut scratch.sort);
    let mut sorted = std::mem::take(&mut scratch.sorted);
    gather(rows, &mut scratch.items, &mut sorted);
    let pages: Vec<&[u8]> = sorted.chunks(rows.layout().stride() << SORTED_PAGE_SHIFT).collect();
    let rows = RowTable::new(&pages, SORTED_PAGE_SHIFT, rows.layout());
    let homes = Homes { root_bits: rules.root_bits, levels: rules.levels };
    find_homes(&homes, chunk, rows, taken, scratch);
    sweep(rules, chunk, rows, scratch, sink);
    scratch.sorted = sorted;
}

/// Rows of a page of sorted rows, as a power of two.
const SORTED_PAGE_SHIFT: u32 = 16;

/// Brings rows into the order of their items: once out of order, so that all that comes later is a
/// walk over memory nearly in order.
fn gather<K: MortonKey>(rows: RowTable, items: &mut [Item<K>], sorted: &mut Vec<u8>) {
    let stride = rows.layout().stride();
    sorted.resize(items.len() * stride, 0);
    for ((row, item), slot) in sorted.chunks_exact_mut(stride).zip(items).zip(0..) {
        copy_short(row, rows.row(item.slot));
        item.slot = slot;
    }
}

/// Fills `homes`, one per item.
fn find_homes<K: MortonKey>(
    homes: &Homes,
    chunk: &Chunk<K>,
    rows: RowTable,
    taken: &[Taken],
    scratch: &mut ChunkScratch<K>,
) {
    let ChunkScratch { items, sort, waiting, homes: out, .. } = scratch;
    out.clear();
    out.resize(items.len(), 0);
    waiting.clear();
    let all = items.iter().zip(sort.orders()).zip(0..);
    let wait =
        |((item, &index), place): ((&Item<K>, &u32), u32)| Waiting { key: item.key, index, place };
    if taken.is_empty() {
        waiting.extend(all.map(wait));
    } else {
        let layout = rows.layout();
        let taken: HashMap<u64, u32> = taken.iter().copied().collect();
        for point in all {
            match taken.get(&layout.index(rows.row(point.0.0.slot))) {
                Some(depth) => out[point.1 as usize] = *depth as u8,
                None => waiting.push(wait(point)),
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
    rows: RowTable,
    scratch: &mut ChunkScratch<K>,
    sink: &mut ChunkSink<'_, '_, K>,
) {
    let ChunkScratch { items, homes, open, nodes, .. } = scratch;
    let Some(first) = items.first() else { return };
    let depths = rules.max_depth() as usize + 1;
    open.resize_with(depths, OpenNode::default);
    let points = SortedPoints { items, homes, rows };
    let mut sweep = Sweep { rules, chunk, points, open, nodes, sink };
    let mut key = first.key;
    let mut deepest = 0;
    for (place, item) in items.iter().enumerate() {
        let differing = item.key.differing_bits(key).div_ceil(3);
        // Nodes at this depth and above contain both points.
        let shared = rules.root_bits - differing;
        if shared < deepest {
            sweep.close_below(shared, deepest, key);
            deepest = shared;
        }
        let home = u32::from(homes[place] & !BEYOND);
        deepest = deepest.max(home);
        sweep.open[home as usize].members.push(place as u32);
        key = item.key;
    }
    sweep.close_below(0, deepest, key);
    sweep.close(0, key);
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
        let stride = self.points.rows.layout().stride();
        let marked = marked_stride(self.points.rows.layout());
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
