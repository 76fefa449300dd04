//! Finished nodes, from the order in which they are done to the order in which they are written.
//!
//! A node is written where a sweep over all points in Morton order would be done with it: after
//! the nodes within its cell, before those behind. Chunks are ranges of that order, so what a chunk
//! and the spanning nodes that end with it have finished is sorted among itself and follows what
//! the chunks before have. The order depends on the nodes alone, not on the chunks.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard};
use std::time::Duration;

use crate::build::BuildError;
use crate::build::encode::{FinishedNode, join_ranges};
use crate::build::large::LargeNode;
use crate::build::node::TreeRules;
use crate::build::pages::PageStore;
use crate::geometry::MortonKey;
use crate::store::{NodeRow, StoreWriter, ValueRange};

/// A node whose turn will come.
pub enum DoneNode<'p> {
    /// Encoded.
    Finished(FinishedNode),
    /// To be encoded into the file.
    Large(LargeNode<'p>),
}

impl DoneNode<'_> {
    fn row(&self) -> &NodeRow {
        match self {
            DoneNode::Finished(finished) => &finished.node.row,
            DoneNode::Large(large) => &large.row,
        }
    }

    /// Points of the node.
    pub fn points(&self) -> u64 {
        u64::from(self.row().levels.point_count())
    }

    /// Bytes that wait in memory.
    fn bytes(&self) -> u64 {
        match self {
            DoneNode::Finished(finished) => finished.node.bytes.len() as u64,
            DoneNode::Large(_) => 0,
        }
    }
}

/// What building leaves for writing.
pub struct Built<'a> {
    /// Takes the nodes.
    pub writer: StoreWriter<'a>,
    /// Per attribute of the schema, per component.
    pub ranges: Vec<Vec<ValueRange>>,
    /// Points beyond one per finest cell.
    pub overflow_points: u64,
}

impl<'a> Built<'a> {
    /// No nodes yet.
    pub fn new(writer: StoreWriter<'a>) -> Self {
        Built { writer, ranges: Vec::new(), overflow_points: 0 }
    }

    fn add<'p, K: MortonKey>(
        &mut self,
        node: DoneNode<'p>,
        rules: &TreeRules,
        pages: &PageStore<'p>,
    ) -> Result<(), BuildError> {
        match node {
            DoneNode::Finished(finished) => {
                join_ranges(&mut self.ranges, &finished.ranges);
                self.overflow_points += finished.overflow_points;
                Ok(self.writer.add(finished.node)?)
            }
            DoneNode::Large(large) => {
                self.overflow_points += large.overflow_points;
                let ranges = large.write::<K>(rules, pages, &mut self.writer)?;
                join_ranges(&mut self.ranges, &ranges);
                Ok(())
            }
        }
    }
}

/// Nodes of chunks on their way to the writer.
pub struct OrderedNodes<'a, 'w, 'p> {
    rules: &'a TreeRules<'a>,
    pages: &'a PageStore<'p>,
    most_waiting_bytes: u64,
    cancelled: &'a AtomicBool,
    inner: Mutex<Inner<'w, 'p>>,
    written: Condvar,
}

struct Inner<'a, 'p> {
    built: Built<'a>,
    /// The chunk whose nodes are written next.
    next: usize,
    waiting: BTreeMap<usize, Batch<'p>>,
    waiting_bytes: u64,
    has_failed: bool,
}

/// What is there of a chunk: its own nodes and the spanning ones that end with it come apart.
#[derive(Default)]
struct Batch<'p> {
    parts: u32,
    nodes: Vec<DoneNode<'p>>,
}

const PARTS: u32 = 2;

impl<'a, 'w, 'p> OrderedNodes<'a, 'w, 'p> {
    /// Writes from the chunk `next` on. Chunks that are done before their turn wait in at most so
    /// many bytes, and those being worked on.
    pub fn new(
        built: Built<'w>,
        next: usize,
        rules: &'a TreeRules<'a>,
        pages: &'a PageStore<'p>,
        most_waiting_bytes: u64,
        cancelled: &'a AtomicBool,
    ) -> Self {
        let (waiting, waiting_bytes) = (BTreeMap::new(), 0);
        let inner = Inner { built, next, waiting, waiting_bytes, has_failed: false };
        let (inner, written) = (Mutex::new(inner), Condvar::new());
        OrderedNodes { rules, pages, most_waiting_bytes, cancelled, inner, written }
    }

    fn inner(&self) -> MutexGuard<'_, Inner<'w, 'p>> {
        self.inner.lock().expect("no holder of the lock panics")
    }

    /// Returns when there is room for the nodes of a chunk; at once if it is the next one. Chunks
    /// must be begun in order, each by a thread that does not wait for another.
    pub fn wait_for_room(&self, chunk: usize) -> Result<(), BuildError> {
        let mut inner = self.inner();
        while inner.next < chunk && inner.waiting_bytes > self.most_waiting_bytes {
            if inner.has_failed || self.cancelled.load(Ordering::Relaxed) {
                return Err(BuildError::Interrupted);
            }
            // Cancelling wakes no one.
            let wait = self.written.wait_timeout(inner, Duration::from_millis(50));
            inner = wait.expect("no holder of the lock panics").0;
        }
        Ok(())
    }

    /// Takes one of the two parts of a chunk's nodes; writes what is due.
    pub fn add<K: MortonKey>(
        &self,
        chunk: usize,
        nodes: Vec<DoneNode<'p>>,
    ) -> Result<(), BuildError> {
        let mut inner = self.inner();
        inner.waiting_bytes += bytes_of(&nodes);
        let batch = inner.waiting.entry(chunk).or_default();
        batch.parts += 1;
        batch.nodes.extend(nodes);
        let outcome = inner.write_due::<K>(self.rules, self.pages);
        inner.has_failed |= outcome.is_err();
        self.written.notify_all();
        outcome
    }

    /// Lets no one wait for a chunk that will not come.
    pub fn give_up(&self) {
        self.inner().has_failed = true;
        self.written.notify_all();
    }

    /// What has been built so far; no chunk may be waiting.
    pub fn built(&mut self) -> &mut Built<'w> {
        let inner = self.inner.get_mut().expect("no holder of the lock panics");
        assert!(inner.waiting.is_empty(), "all chunks that were begun are done");
        &mut inner.built
    }

    /// What has been built.
    pub fn into_built(mut self) -> Built<'w> {
        self.built();
        self.inner.into_inner().expect("no holder of the lock panics").built
    }
}

impl<'p> Inner<'_, 'p> {
    fn write_due<K: MortonKey>(
        &mut self,
        rules: &TreeRules,
        pages: &PageStore<'p>,
    ) -> Result<(), BuildError> {
        while let Some(batch) = self.waiting.get_mut(&self.next)
            && batch.parts == PARTS
        {
            let mut nodes = std::mem::take(&mut batch.nodes);
            self.waiting.remove(&self.next);
            self.waiting_bytes -= bytes_of(&nodes);
            nodes.sort_by_key(|node| place(node.row(), rules.root_bits));
            nodes.into_iter().try_for_each(|node| self.built.add::<K>(node, rules, pages))?;
            self.next += 1;
        }
        Ok(())
    }
}

fn bytes_of(nodes: &[DoneNode]) -> u64 {
    nodes.iter().map(DoneNode::bytes).sum()
}

/// When a sweep is done with a node: the first code behind its cell, deeper nodes first.
fn place(row: &NodeRow, root_bits: u32) -> (u128, std::cmp::Reverse<u32>) {
    let end = (u128::encode(row.cell.to_array()) + 1) << (3 * (root_bits - row.depth));
    (end, std::cmp::Reverse(row.depth))
}
