//! All nodes below one cell, from its points in memory.
//!
//! Points are sorted once by Morton code. A node takes the first arrival of each of its finest
//! cells and compacts the others in place; each octant with enough of them becomes a child, which
//! works on its own part of the same memory, in parallel.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rayon::prelude::*;

use crate::build::BuildError;
use crate::build::encode::{Encoding, FinishedNode, encode_node};
use crate::build::point_tree::{Entry, NodeGrid, Representative, assign_levels};
use crate::build::rows::Rows;
use crate::geometry::MortonKey;

/// What is the same for all nodes of a build.
pub struct TreeRules<'a> {
    /// Bits per axis of the root cube.
    pub root_bits: u32,
    /// The paper's D.
    pub levels: u32,
    /// Fewest rejected points that make a child.
    pub threshold: usize,
    /// How representatives are chosen.
    pub representative: Representative,
    /// How nodes are encoded.
    pub encoding: Encoding<'a>,
    /// Set when the user wants to stop.
    pub cancelled: &'a AtomicBool,
}

impl TreeRules<'_> {
    /// Cells of a node at an outer depth.
    pub fn grid(&self, depth: u32) -> NodeGrid {
        NodeGrid { root_bits: self.root_bits, depth, levels: self.levels }
    }

    /// Deepest outer depth whose finest cells are still at least one lattice step.
    pub fn max_depth(&self) -> u32 {
        self.root_bits - self.levels
    }
}

/// Takes finished nodes, from several threads, in any order.
pub type NodeSink<'a> = &'a (dyn Fn(FinishedNode) -> Result<(), BuildError> + Sync);

/// A subtree being built from rows in memory.
pub struct Subtree<'a> {
    /// The rules.
    pub rules: &'a TreeRules<'a>,
    /// The points.
    pub rows: Rows<'a>,
    /// Where nodes go.
    pub sink: NodeSink<'a>,
    /// Counts points beyond one per finest cell.
    pub overflow: &'a AtomicU64,
}

/// Subtrees of fewer points are built on the thread that found them.
const PARALLEL_POINTS: usize = 1 << 14;

impl Subtree<'_> {
    /// Sorts entries by (key, row), as [`grow`](Self::grow) wants them.
    pub fn sort<K: MortonKey>(entries: &mut [Entry<K>]) {
        entries.par_sort_unstable();
    }

    /// Builds the node at `depth` that these sorted entries enter, and all below it.
    ///
    /// All entries lie in one cell of that depth. Their order afterwards is undefined.
    pub fn grow<K: MortonKey>(
        &self,
        depth: u32,
        entries: &mut [Entry<K>],
    ) -> Result<(), BuildError> {
        if entries.is_empty() {
            return Ok(());
        }
        let failure = Mutex::new(None);
        rayon::scope(|scope| self.grow_node(scope, depth, entries, &failure));
        match failure.into_inner().expect("no holder of the lock panics") {
            Some(error) => Err(error),
            None => Ok(()),
        }
    }

    fn grow_node<'scope, K: MortonKey>(
        &'scope self,
        scope: &rayon::Scope<'scope>,
        depth: u32,
        entries: &'scope mut [Entry<K>],
        failure: &'scope Mutex<Option<BuildError>>,
    ) {
        let fail = |error| {
            *failure.lock().expect("no holder of the lock panics") = Some(error);
        };
        if self.rules.cancelled.load(Ordering::Relaxed) {
            return fail(BuildError::Interrupted);
        }
        if failure.lock().expect("no holder of the lock panics").is_some() {
            return;
        }
        let (node, kept, octants) = self.split(depth, entries);
        if let Err(error) = self.finish_node(depth, node, kept) {
            return fail(error);
        }
        let mut rest = entries;
        for rejects in octants {
            let (child, tail) = rest.split_at_mut(rejects);
            rest = tail;
            if child.len() >= PARALLEL_POINTS {
                scope.spawn(move |scope| self.grow_node(scope, depth + 1, child, failure));
            } else if !child.is_empty() {
                self.grow_node(scope, depth + 1, child, failure);
            }
        }
    }

    /// Takes a node's points out of `entries` and compacts the rest to the front, octant by
    /// octant. Returns the points in Morton order, which of them are first arrivals, and the
    /// number of points left for each child.
    fn split<K: MortonKey>(
        &self,
        depth: u32,
        entries: &mut [Entry<K>],
    ) -> (Vec<Entry<K>>, Vec<bool>, [usize; 8]) {
        let grid = self.rules.grid(depth);
        let cell_shift = grid.shift(self.rules.levels);
        let octant_of = |key: K| key.octant(self.rules.root_bits - depth - 1);
        let mut rejects = [0usize; 8];
        let mut cells = 0;
        for cell in
            entries.chunk_by(|a, b| a.key.ancestor(cell_shift) == b.key.ancestor(cell_shift))
        {
            rejects[octant_of(cell[0].key)] += cell.len() - 1;
            cells += 1;
        }
        let can_descend = depth < self.rules.max_depth();
        let has_child = rejects.map(|n| can_descend && n > 0 && n >= self.rules.threshold);
        let added: usize = (0..8).filter(|&o| !has_child[o]).map(|o| rejects[o]).sum();
        self.overflow.fetch_add(added as u64, Ordering::Relaxed);

        let mut node = Vec::with_capacity(cells + added);
        let mut kept = Vec::with_capacity(cells + added);
        let mut end = 0;
        let mut start = 0;
        while start < entries.len() {
            let cell_code = entries[start].key.ancestor(cell_shift);
            let same_cell = |e: &&Entry<K>| e.key.ancestor(cell_shift) == cell_code;
            let stop = start + entries[start..].iter().take_while(same_cell).count();
            let first = (start..stop).min_by_key(|&i| entries[i].row).expect("a cell has an entry");
            let descend = has_child[octant_of(entries[start].key)];
            for i in start..stop {
                let entry = entries[i];
                if i == first || !descend {
                    node.push(entry);
                    kept.push(i == first);
                } else {
                    entries[end] = entry;
                    end += 1;
                }
            }
            start = stop;
        }
        let octants = std::array::from_fn(|o| if has_child[o] { rejects[o] } else { 0 });
        (node, kept, octants)
    }

    /// Levels, final order and encoding of a node whose points are given in Morton order.
    pub fn finish_node<K: MortonKey>(
        &self,
        depth: u32,
        node: Vec<Entry<K>>,
        kept: Vec<bool>,
    ) -> Result<(), BuildError> {
        let grid = self.rules.grid(depth);
        let chosen: Vec<Entry<K>> =
            node.iter().zip(&kept).filter(|(_, kept)| **kept).map(|(entry, _)| *entry).collect();
        let mut chosen_levels = Vec::new();
        assign_levels(&chosen, grid, self.rules.representative, &self.rows, &mut chosen_levels);
        let mut next = chosen_levels.iter();
        let levels: Vec<u8> = kept
            .iter()
            .map(|kept| match kept {
                true => *next.next().expect("every kept point has a level"),
                false => self.rules.levels as u8,
            })
            .collect();
        let mut totals = vec![0u32; self.rules.levels as usize + 1];
        levels.iter().for_each(|&level| totals[usize::from(level)] += 1);
        for level in 1..totals.len() {
            totals[level] += totals[level - 1];
        }
        let mut places: Vec<u32> =
            std::iter::once(0).chain(totals.iter().copied()).take(totals.len()).collect();
        let mut ordered = vec![Entry::default(); node.len()];
        for (entry, level) in node.iter().zip(levels) {
            let place = &mut places[usize::from(level)];
            ordered[*place as usize] = *entry;
            *place += 1;
        }
        drop((node, kept, chosen));
        (self.sink)(encode_node(grid, &ordered, totals, &self.rows, &self.rules.encoding))
    }
}
