//! New points into the nodes of a store: what each node keeps, what it passes on.
//!
//! Points count as inserted after all that are there, so no point of a node has to leave it for a
//! new one. A new point stays in the first node on its way whose finest cell for it is empty. Only
//! where so many points wait beyond one per finest cell that they make a child does one of the old
//! points move, into that child. So the work is that of the nodes where something changes, and of
//! looking at positions on the way to them.

use crate::build::BuildError;
use crate::build::encode::FinishedNode;
use crate::build::home::BEYOND;
use crate::build::node::{NodeBuilder, SortedPoints, TreeRules};
use crate::build::rows::{RowLayout, RowTable, copy_short};
use crate::geometry::MortonKey;
use crate::ids::NodeId;
use crate::points::COORDINATE_BYTES;
use crate::store::{NARROW_BITS, Store};

/// What all nodes work with.
pub struct Growth<'a> {
    /// The store.
    pub store: &'a Store,
    /// Its rules.
    pub rules: &'a TreeRules<'a>,
    /// Layout of rows.
    pub layout: RowLayout,
    /// Rows of the new points.
    pub arrivals: RowTable<'a>,
}

/// A new point: its Morton code and the slot of its row.
#[derive(Clone, Copy, Debug)]
pub struct Item<K> {
    /// Morton code over all bits of the root cube.
    pub key: K,
    /// Where the row is.
    pub slot: u32,
}

/// Points on their way into a cell.
pub struct Task<K> {
    /// Depth of the cell.
    pub depth: u32,
    /// Its code at that depth.
    pub code: K,
    /// The node of that cell, if there is one.
    pub node: Option<NodeId>,
    /// Rows of old points that come from the parent; only if there is no node.
    pub carried: Vec<u8>,
    /// New points, in Morton order, equal codes in order of arrival.
    pub items: Vec<Item<K>>,
}

/// A node written anew.
pub struct Grown {
    /// The node.
    pub finished: FinishedNode,
    /// Points beyond one per finest cell that it had before.
    pub old_overflow: u64,
    /// New points that it keeps.
    pub new_points: u64,
}

/// Takes what comes out of a cell.
pub trait Sink<K> {
    /// A node is done.
    fn grown(&mut self, node: Grown);
    /// A child is to be gone into: now, if the task comes back.
    fn child(&mut self, task: Task<K>) -> Option<Task<K>>;
}

/// A point on its way: code, order of arrival, and where its row is.
#[derive(Clone, Copy)]
struct Entry<K> {
    key: K,
    index: u64,
    row: RowPlace,
}

#[derive(Clone, Copy)]
enum RowPlace {
    /// Among the rows that came from the parent.
    Carried(u32),
    /// Among the new points.
    Arrived(u32),
}

/// The points that a node has already.
struct Own<K> {
    /// In stored order.
    keys: Vec<K>,
    /// Finest cells in rising order, each with the point that counts as its own.
    cells: Vec<(K, u32)>,
}

impl<K: MortonKey> Own<K> {
    fn read(growth: &Growth, node: Option<NodeId>, code: K) -> Result<Self, BuildError> {
        let mut own = Own { keys: Vec::new(), cells: Vec::new() };
        let Some(node) = node else { return Ok(own) };
        let bits = growth.store.octree().local_bits(node);
        let mut words = Vec::new();
        growth.store.read_positions(node, &mut words).map_err(|e| unreadable(growth, e))?;
        let base = code.first_within(bits).widen();
        own.keys = if bits <= NARROW_BITS {
            let local = |w: &[u32]| u128::from(w[0]) | u128::from(w[1]) << 32;
            words.chunks_exact(2).map(|w| K::narrow(base | local(w))).collect()
        } else {
            let local = |w: &[u32]| u128::encode([w[0], w[1], w[2]]);
            words.chunks_exact(3).map(|w| K::narrow(base | local(w))).collect()
        };
        let shift = bits - growth.rules.levels;
        own.cells = own.keys.iter().zip(0..).map(|(key, i)| (key.ancestor(shift), i)).collect();
        own.cells.sort_unstable();
        own.cells.dedup_by_key(|(cell, _)| *cell);
        Ok(own)
    }

    /// Points beyond one per finest cell.
    fn overflow(&self) -> u64 {
        (self.keys.len() - self.cells.len()) as u64
    }

    /// Which points are beyond one per finest cell.
    fn beyond(&self) -> Vec<bool> {
        let mut beyond = vec![true; self.keys.len()];
        self.cells.iter().for_each(|&(_, i)| beyond[i as usize] = false);
        beyond
    }
}

impl Growth<'_> {
    /// Brings points into a cell and all below it.
    pub fn grow<K: MortonKey>(
        &self,
        task: Task<K>,
        builder: &mut NodeBuilder<K>,
        sink: &mut dyn Sink<K>,
    ) -> Result<(), BuildError> {
        let Task { depth, code, node, carried, items } = task;
        let own = Own::read(self, node, code)?;
        let entries = self.entries(&carried, &items);
        drop(items);
        let (mut stay, down) = self.divide(depth, &own, entries);
        let mut children = Vec::new();
        let mut leaving = vec![false; own.keys.len()];
        let child_bits = self.rules.root_bits - depth - 1;
        // Rows of the node's own points, read when they are needed.
        let mut own_rows = Vec::new();
        let beyond = own.beyond();
        for group in down.chunk_by(|a, b| a.key.ancestor(child_bits) == b.key.ancestor(child_bits))
        {
            let child_code = group[0].key.ancestor(child_bits);
            let existing = node.and_then(|id| self.child(id, child_code));
            let mut carried_on = Vec::new();
            if existing.is_none() {
                let waits =
                    |i: &usize| beyond[*i] && own.keys[*i].ancestor(child_bits) == child_code;
                let waiting: Vec<usize> = (0..own.keys.len()).filter(waits).collect();
                if waiting.len() + group.len() < self.rules.threshold {
                    stay.extend(group.iter().map(|entry| (*entry, false)));
                    continue;
                }
                if !waiting.is_empty() && own_rows.is_empty() {
                    own_rows = self.own_rows(node, &own)?;
                }
                for i in waiting {
                    leaving[i] = true;
                    carried_on.extend_from_slice(self.row_of(&own_rows, i as u32));
                }
            }
            let mut arrived = Vec::with_capacity(group.len());
            for entry in group {
                match entry.row {
                    RowPlace::Carried(i) => carried_on.extend_from_slice(self.row_of(&carried, i)),
                    RowPlace::Arrived(slot) => arrived.push(Item { key: entry.key, slot }),
                }
            }
            children.push(Task {
                depth: depth + 1,
                code: child_code,
                node: existing,
                carried: carried_on,
                items: arrived,
            });
        }
        drop(down);
        if node.is_none() || !stay.is_empty() || leaving.contains(&true) {
            if own_rows.is_empty() {
                own_rows = self.own_rows(node, &own)?;
            }
            let is_new = |(entry, _): &&(Entry<K>, bool)| matches!(entry.row, RowPlace::Arrived(_));
            let new_points = stay.iter().filter(is_new).count() as u64;
            let finished =
                self.rebuild(depth, &own, own_rows, &beyond, &leaving, &carried, stay, builder);
            sink.grown(Grown { finished, old_overflow: own.overflow(), new_points });
        }
        drop((own, carried));
        for task in children {
            if let Some(task) = sink.child(task) {
                self.grow(task, builder, sink)?;
            }
        }
        Ok(())
    }

    /// All points on their way, by code, equal ones in order of arrival.
    fn entries<K: MortonKey>(&self, carried: &[u8], items: &[Item<K>]) -> Vec<Entry<K>> {
        let stride = self.layout.stride();
        let old = carried.chunks_exact(stride).zip(0..).map(|(row, i)| Entry {
            key: K::read(row),
            index: self.layout.index(row),
            row: RowPlace::Carried(i),
        });
        let new = items.iter().map(|item| Entry {
            key: item.key,
            index: self.layout.index(self.arrivals.row(item.slot)),
            row: RowPlace::Arrived(item.slot),
        });
        let mut entries: Vec<Entry<K>> = old.chain(new).collect();
        if !carried.is_empty() {
            entries.sort_by_key(|entry| (entry.key, entry.index));
        }
        entries
    }

    /// Those that a node at `depth` keeps, each with whether a cell takes it, and those that it
    /// passes on, in order.
    #[allow(clippy::type_complexity, reason = "two lists, used once")]
    fn divide<K: MortonKey>(
        &self,
        depth: u32,
        own: &Own<K>,
        entries: Vec<Entry<K>>,
    ) -> (Vec<(Entry<K>, bool)>, Vec<Entry<K>>) {
        let shift = self.rules.root_bits - depth - self.rules.levels;
        let is_deepest = depth == self.rules.max_depth();
        let (mut stay, mut down) = (Vec::new(), Vec::new());
        let mut taken = own.cells.iter().map(|(cell, _)| *cell).peekable();
        for cell in entries.chunk_by(|a, b| a.key.ancestor(shift) == b.key.ancestor(shift)) {
            let code = cell[0].key.ancestor(shift);
            while taken.next_if(|&other| other < code).is_some() {}
            let is_free = taken.peek() != Some(&code);
            let first = cell.iter().map(|entry| entry.index).min();
            for entry in cell {
                if is_free && Some(entry.index) == first {
                    stay.push((*entry, true));
                } else if is_deepest {
                    stay.push((*entry, false));
                } else {
                    down.push(*entry);
                }
            }
        }
        (stay, down)
    }

    fn child<K: MortonKey>(&self, node: NodeId, code: K) -> Option<NodeId> {
        let octree = self.store.octree();
        octree.node(node).children().find(|&child| octree.cell_code(child) == code.widen())
    }

    fn row_of<'r>(&self, rows: &'r [u8], index: u32) -> &'r [u8] {
        let stride = self.layout.stride();
        &rows[index as usize * stride..][..stride]
    }

    /// Rows of a node's points in stored order, which is their order of arrival here.
    fn own_rows<K: MortonKey>(
        &self,
        node: Option<NodeId>,
        own: &Own<K>,
    ) -> Result<Vec<u8>, BuildError> {
        let Some(node) = node else { return Ok(Vec::new()) };
        let mut records = Vec::new();
        let read = self.store.read_attribute_records(node, &mut records);
        read.map_err(|error| unreadable(self, error))?;
        let record_bytes = self.store.metadata().schema.record_bytes as usize;
        let stride = self.layout.stride();
        let mut rows = vec![0; own.keys.len() * stride];
        let records = records.chunks_exact(record_bytes);
        for (((row, record), &key), index) in
            rows.chunks_exact_mut(stride).zip(records).zip(&own.keys).zip(0..)
        {
            self.layout.write(row, key, index, &record[COORDINATE_BYTES..]);
        }
        Ok(rows)
    }

    #[allow(clippy::too_many_arguments, reason = "the parts of a node")]
    fn rebuild<K: MortonKey>(
        &self,
        depth: u32,
        own: &Own<K>,
        mut rows: Vec<u8>,
        beyond: &[bool],
        leaving: &[bool],
        carried: &[u8],
        stay: Vec<(Entry<K>, bool)>,
        builder: &mut NodeBuilder<K>,
    ) -> FinishedNode {
        let mut members: Vec<(K, u64, u32, bool)> = Vec::with_capacity(own.keys.len() + stay.len());
        for (i, &key) in own.keys.iter().enumerate().filter(|(i, _)| !leaving[*i]) {
            members.push((key, i as u64, i as u32, !beyond[i]));
        }
        for (slot, (entry, is_kept)) in (own.keys.len() as u32..).zip(stay) {
            rows.extend_from_slice(match entry.row {
                RowPlace::Carried(i) => self.row_of(carried, i),
                RowPlace::Arrived(slot) => self.arrivals.row(slot),
            });
            members.push((entry.key, entry.index, slot, is_kept));
        }
        members.sort_unstable();
        let stride = self.layout.stride();
        let mut sorted = vec![0; members.len() * stride];
        for (to, &(_, _, slot, _)) in sorted.chunks_exact_mut(stride).zip(&members) {
            copy_short(to, self.row_of(&rows, slot));
        }
        let keys: Vec<K> = members.iter().map(|&(key, ..)| key).collect();
        let home = |&(.., is_kept): &(K, u64, u32, bool)| {
            if is_kept { depth as u8 } else { depth as u8 | BEYOND }
        };
        let homes: Vec<u8> = members.iter().map(home).collect();
        let places: Vec<u32> = (0..keys.len() as u32).collect();
        let points =
            SortedPoints { keys: &keys, homes: &homes, rows: &sorted, layout: self.layout };
        builder.finish(self.rules, depth, &points, &places)
    }
}

fn unreadable(growth: &Growth, error: crate::store::NodeReadError) -> BuildError {
    BuildError::Append { reason: error.to_string(), path: growth.store.path().into() }
}
