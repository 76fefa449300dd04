//! Nodes that reach over several chunks: put together when the last of their chunks is done.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::build::BuildError;
use crate::build::chunk::{ContributedRows, Contribution};
use crate::build::home::BEYOND;
use crate::build::large::{LargeNode, SortedRows};
use crate::build::node::{NodeBuilder, SortedPoints, TreeRules};
use crate::build::ordered::DoneNode;
use crate::build::paged_rows::{PagedRows, marked_stride};
use crate::build::pages::{DiskPlace, PageStore};
use crate::build::rows::{RowLayout, copy_short};
use crate::geometry::MortonKey;

/// A node whose chunks are not all done.
#[derive(Default)]
struct Pending<'p> {
    entering: u64,
    /// In Morton order, because chunks come in it.
    rows: PagedRows<'p>,
    /// Marked rows of dissolved children: fewer than make a child, of each.
    between: Vec<u8>,
}

/// A node in waiting, as it can be noted down: depth, code, points that entered, and where its rows
/// and marks are.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PendingState {
    depth: u32,
    code: [u64; 2],
    entering: u64,
    rows: (Vec<DiskPlace>, u64),
    between: Vec<DiskPlace>,
}

/// A node whose points are all known.
pub struct ReadyNode<'p> {
    depth: u32,
    rows: PagedRows<'p>,
    between: Vec<u8>,
}

/// All nodes that reach over several chunks. Chunks come in in any order and count in theirs.
pub struct Spanning<'p, K> {
    root_bits: u32,
    layout: RowLayout,
    threshold: u64,
    /// First code after each chunk.
    ends: Vec<Option<K>>,
    next: usize,
    early: BTreeMap<usize, Vec<Contribution<'p, K>>>,
    pending: BTreeMap<(u32, K), Pending<'p>>,
}

impl<'p, K: MortonKey> Spanning<'p, K> {
    /// Waits for chunks with these ends.
    pub fn new(rules: &TreeRules, layout: RowLayout, ends: Vec<Option<K>>) -> Self {
        Spanning {
            root_bits: rules.root_bits,
            layout,
            threshold: rules.threshold as u64,
            ends,
            next: 0,
            early: BTreeMap::new(),
            pending: BTreeMap::new(),
        }
    }

    /// Brings all nodes in waiting to disk and tells where they are. All chunks up to the last one
    /// added must have been added.
    pub fn state(&mut self, pages: &PageStore<'p>) -> Result<Vec<PendingState>, BuildError> {
        assert!(self.early.is_empty(), "no chunk is missing");
        let states = self.pending.iter_mut().map(|(&(depth, code), node)| {
            let wide = code.widen();
            Ok(PendingState {
                depth,
                code: [wide as u64, (wide >> 64) as u64],
                entering: node.entering,
                rows: node.rows.state(pages)?,
                between: pages.write_pieces(&node.between)?,
            })
        });
        states.collect()
    }

    /// Goes on after the first `done` chunks.
    pub fn resume(
        &mut self,
        done: usize,
        states: Vec<PendingState>,
        pages: &PageStore,
    ) -> Result<(), BuildError> {
        self.next = done;
        for state in states {
            let code = K::narrow(u128::from(state.code[0]) | u128::from(state.code[1]) << 64);
            let rows = PagedRows::resume(state.rows);
            let between = pages.read_pieces(state.between)?;
            let node = Pending { entering: state.entering, rows, between };
            self.pending.insert((state.depth, code), node);
        }
        Ok(())
    }

    /// Takes what a chunk gives; returns the chunks that are now accounted for, with the nodes that
    /// end with each.
    pub fn add(
        &mut self,
        chunk: usize,
        contributions: Vec<Contribution<'p, K>>,
        pages: &PageStore<'p>,
    ) -> Result<Vec<(usize, Vec<ReadyNode<'p>>)>, BuildError> {
        let stride = marked_stride(self.layout);
        self.early.insert(chunk, contributions);
        let mut all = Vec::new();
        while let Some(contributions) = self.early.remove(&self.next) {
            for part in contributions {
                let pending = self.pending.entry((part.depth, part.code)).or_default();
                pending.entering += part.entering;
                match part.rows {
                    ContributedRows::Few(rows) => pending.rows.push_marked(pages, &rows, stride)?,
                    ContributedRows::Paged(rows) => pending.rows.append(pages, rows)?,
                }
            }
            let mut ready = Vec::new();
            self.close_before(self.ends[self.next], pages, &mut ready)?;
            all.push((self.next, ready));
            self.next += 1;
        }
        Ok(all)
    }

    /// Closes all nodes that do not reach beyond a code, deepest first.
    fn close_before(
        &mut self,
        end: Option<K>,
        pages: &PageStore<'p>,
        ready: &mut Vec<ReadyNode<'p>>,
    ) -> Result<(), BuildError> {
        let stride = marked_stride(self.layout);
        let reaches_beyond = |depth: u32, code: K| {
            let levels = self.root_bits - depth;
            end.is_some_and(|end| end.ancestor(levels) == code && end.local(levels) != K::default())
        };
        let closing: Vec<(u32, K)> =
            self.pending.keys().copied().filter(|&(d, code)| !reaches_beyond(d, code)).collect();
        for (depth, code) in closing.into_iter().rev() {
            let mut node = self.pending.remove(&(depth, code)).expect("it was listed");
            if depth == 0 || node.entering >= self.threshold {
                ready.push(ReadyNode { depth, rows: node.rows, between: node.between });
                continue;
            }
            // Too few entered: they stay in the parent, beyond one per finest cell.
            let parent = self.pending.entry((depth - 1, code.ancestor(1))).or_default();
            let start = parent.between.len();
            parent.between.append(&mut node.between);
            node.rows.visit(pages, &mut |rows| {
                parent.between.extend_from_slice(rows);
                Ok(())
            })?;
            node.rows.discard(pages)?;
            parent.between[start..].chunks_exact_mut(stride).for_each(|row| row[stride - 1] = 0);
        }
        Ok(())
    }
}

impl<'p> ReadyNode<'p> {
    /// Orders, levels and, unless it has more points than `most_points`, encodes the node.
    pub fn finish<K: MortonKey>(
        mut self,
        rules: &TreeRules,
        layout: RowLayout,
        pages: &PageStore<'p>,
        most_points: u64,
        builder: &mut NodeBuilder<K>,
    ) -> Result<DoneNode<'p>, BuildError> {
        let marked = marked_stride(layout);
        let main = self.rows.len();
        let points = main + (self.between.len() / marked) as u64;
        if points > most_points {
            let order = |row: &&[u8]| (K::read(row), layout.index(row));
            let mut between: Vec<&[u8]> = self.between.chunks_exact(marked).collect();
            between.sort_by_key(order);
            let rows = SortedRows { main: self.rows, between: between.concat() };
            return Ok(DoneNode::Large(LargeNode::new::<K>(
                rules, self.depth, rows, layout, pages,
            )?));
        }
        let stride = layout.stride();
        let mut rows = vec![0; points as usize * stride];
        let mut kept = Vec::with_capacity(points as usize);
        let mut free = rows.as_mut_slice();
        let mut take = |marked_rows: &[u8]| {
            let count = marked_rows.len() / marked;
            let (room, rest) = std::mem::take(&mut free).split_at_mut(count * stride);
            free = rest;
            for (to, row) in room.chunks_exact_mut(stride).zip(marked_rows.chunks_exact(marked)) {
                copy_short(to, &row[..stride]);
                kept.push(row[stride] == 1);
            }
            Ok(())
        };
        self.rows.visit(pages, &mut take)?;
        take(&self.between)?;
        self.rows.discard(pages)?;
        if main < points {
            // Those of dissolved children are few, the others in order: merged, not sorted.
            let row = |place: u32| &rows[place as usize * stride..][..stride];
            let rank = |place: u32| (K::read(row(place)), layout.index(row(place)));
            let mut order: Vec<u32> = (0..points as u32).collect();
            order[main as usize..].sort_unstable_by_key(|&place| rank(place));
            order.sort_by_key(|&place| rank(place));
            let mut sorted = vec![0; rows.len()];
            for (to, &place) in sorted.chunks_exact_mut(stride).zip(&order) {
                copy_short(to, row(place));
            }
            kept = order.iter().map(|&place| kept[place as usize]).collect();
            rows = sorted;
        }
        let keys: Vec<K> = rows.chunks_exact(stride).map(K::read).collect();
        let depth = self.depth as u8;
        let home = |is_kept: &bool| if *is_kept { depth } else { depth | BEYOND };
        let homes: Vec<u8> = kept.iter().map(home).collect();
        let members: Vec<u32> = (0..keys.len() as u32).collect();
        let points = SortedPoints { keys: &keys, homes: &homes, rows: &rows, layout };
        Ok(DoneNode::Finished(builder.finish(rules, self.depth, &points, &members)))
    }
}
