//! Nodes that reach over several chunks: put together when the last of their chunks is done.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::build::BuildError;
use crate::build::chunk::Contribution;
use crate::build::encode::FinishedNode;
use crate::build::home::BEYOND;
use crate::build::node::{NodeBuilder, SortedPoints, TreeRules};
use crate::build::pages::{DiskPlace, PageStore};
use crate::build::rows::{RowLayout, RowTable};
use crate::build::sort::{Item, SortScratch, sort_rows};
use crate::geometry::MortonKey;

/// A node whose chunks are not all done.
#[derive(Default)]
struct Pending {
    entering: u64,
    rows: Vec<u8>,
    kept: Vec<bool>,
}

/// A node in waiting, as it can be noted down: depth, code, points that entered, and where its rows
/// and marks are.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PendingState {
    depth: u32,
    code: [u64; 2],
    entering: u64,
    rows: Vec<DiskPlace>,
    kept: Vec<DiskPlace>,
}

/// A node whose points are all known.
pub struct ReadyNode {
    depth: u32,
    rows: Vec<u8>,
    kept: Vec<bool>,
}

/// All nodes that reach over several chunks. Chunks come in in any order and count in theirs.
pub struct Spanning<K> {
    root_bits: u32,
    threshold: u64,
    /// First code after each chunk.
    ends: Vec<Option<K>>,
    next: usize,
    early: BTreeMap<usize, Vec<Contribution<K>>>,
    pending: BTreeMap<(u32, K), Pending>,
}

impl<K: MortonKey> Spanning<K> {
    /// Waits for chunks with these ends.
    pub fn new(rules: &TreeRules, ends: Vec<Option<K>>) -> Self {
        Spanning {
            root_bits: rules.root_bits,
            threshold: rules.threshold as u64,
            ends,
            next: 0,
            early: BTreeMap::new(),
            pending: BTreeMap::new(),
        }
    }

    /// Brings all nodes in waiting to disk and tells where they are. All chunks up to the last one
    /// added must have been added.
    pub fn state(&self, pages: &PageStore) -> Result<Vec<PendingState>, BuildError> {
        assert!(self.early.is_empty(), "no chunk is missing");
        let states = self.pending.iter().map(|(&(depth, code), node)| {
            let kept: Vec<u8> = node.kept.iter().map(|&kept| u8::from(kept)).collect();
            let wide = code.widen();
            Ok(PendingState {
                depth,
                code: [wide as u64, (wide >> 64) as u64],
                entering: node.entering,
                rows: pages.write_pieces(&node.rows)?,
                kept: pages.write_pieces(&kept)?,
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
            let kept = pages.read_pieces(state.kept)?.into_iter().map(|mark| mark == 1).collect();
            let node =
                Pending { entering: state.entering, rows: pages.read_pieces(state.rows)?, kept };
            self.pending.insert((state.depth, code), node);
        }
        Ok(())
    }

    /// Takes what a chunk gives; returns the chunks that are now accounted for, with the nodes that
    /// end with each.
    pub fn add(
        &mut self,
        chunk: usize,
        contributions: Vec<Contribution<K>>,
    ) -> Vec<(usize, Vec<ReadyNode>)> {
        self.early.insert(chunk, contributions);
        let mut all = Vec::new();
        while let Some(contributions) = self.early.remove(&self.next) {
            for part in contributions {
                let pending = self.pending.entry((part.depth, part.code)).or_default();
                pending.entering += part.entering;
                if pending.rows.is_empty() {
                    (pending.rows, pending.kept) = (part.rows, part.kept);
                } else {
                    pending.rows.extend_from_slice(&part.rows);
                    pending.kept.extend_from_slice(&part.kept);
                }
            }
            let mut ready = Vec::new();
            self.close_before(self.ends[self.next], &mut ready);
            all.push((self.next, ready));
            self.next += 1;
        }
        all
    }

    /// Closes all nodes that do not reach beyond a code, deepest first.
    fn close_before(&mut self, end: Option<K>, ready: &mut Vec<ReadyNode>) {
        let reaches_beyond = |depth: u32, code: K| {
            let levels = self.root_bits - depth;
            end.is_some_and(|end| end.ancestor(levels) == code && end.local(levels) != K::default())
        };
        let closing: Vec<(u32, K)> =
            self.pending.keys().copied().filter(|&(d, code)| !reaches_beyond(d, code)).collect();
        for (depth, code) in closing.into_iter().rev() {
            let node = self.pending.remove(&(depth, code)).expect("it was listed");
            if depth == 0 || node.entering >= self.threshold {
                ready.push(ReadyNode { depth, rows: node.rows, kept: node.kept });
                continue;
            }
            // Too few entered: they stay in the parent, beyond one per finest cell.
            let parent = self.pending.entry((depth - 1, code.ancestor(1))).or_default();
            parent.rows.extend_from_slice(&node.rows);
            parent.kept.resize(parent.kept.len() + node.kept.len(), false);
        }
    }
}

impl ReadyNode {
    /// Orders, levels and encodes the node.
    pub fn finish<K: MortonKey>(
        self,
        rules: &TreeRules,
        layout: RowLayout,
        builder: &mut NodeBuilder<K>,
    ) -> FinishedNode {
        const PAGE_SHIFT: u32 = 16;
        let stride = layout.stride();
        let pages: Vec<&[u8]> = self.rows.chunks(stride << PAGE_SHIFT).collect();
        let rows = RowTable::new(&pages, PAGE_SHIFT, layout);
        let mut items: Vec<Item<K>> = Vec::new();
        sort_rows(rows, &mut items, &mut SortScratch::default());
        let home = |item: &Item<K>| match self.kept[item.slot as usize] {
            true => self.depth as u8,
            false => self.depth as u8 | BEYOND,
        };
        let homes: Vec<u8> = items.iter().map(home).collect();
        let members: Vec<u32> = (0..items.len() as u32).collect();
        let points = SortedPoints { items: &items, homes: &homes, rows };
        builder.finish(rules, self.depth, &points, &members)
    }
}
