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
use crate::geometry::MortonKey;
use crate::store::{NodeRow, StoreWriter, ValueRange};

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

    fn add(&mut self, finished: FinishedNode) -> Result<(), BuildError> {
        join_ranges(&mut self.ranges, &finished.ranges);
        self.overflow_points += finished.overflow_points;
        Ok(self.writer.add(finished.node)?)
    }
}

/// Nodes of chunks on their way to the writer.
pub struct OrderedNodes<'a> {
    root_bits: u32,
    most_waiting_bytes: u64,
    cancelled: &'a AtomicBool,
    inner: Mutex<Inner<'a>>,
    written: Condvar,
}

struct Inner<'a> {
    built: Built<'a>,
    /// The chunk whose nodes are written next.
    next: usize,
    waiting: BTreeMap<usize, Batch>,
    waiting_bytes: u64,
    has_failed: bool,
}

/// What is there of a chunk: its own nodes and the spanning ones that end with it come apart.
#[derive(Default)]
struct Batch {
    parts: u32,
    nodes: Vec<FinishedNode>,
}

const PARTS: u32 = 2;

impl<'a> OrderedNodes<'a> {
    /// Writes from the chunk `next` on. Chunks that are done before their turn wait in at most so
    /// many bytes, and those being worked on.
    pub fn new(
        built: Built<'a>,
        next: usize,
        root_bits: u32,
        most_waiting_bytes: u64,
        cancelled: &'a AtomicBool,
    ) -> Self {
        let (waiting, waiting_bytes) = (BTreeMap::new(), 0);
        let inner = Inner { built, next, waiting, waiting_bytes, has_failed: false };
        let (inner, written) = (Mutex::new(inner), Condvar::new());
        OrderedNodes { root_bits, most_waiting_bytes, cancelled, inner, written }
    }

    fn inner(&self) -> MutexGuard<'_, Inner<'a>> {
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
    pub fn add(&self, chunk: usize, nodes: Vec<FinishedNode>) -> Result<(), BuildError> {
        let mut inner = self.inner();
        inner.waiting_bytes += bytes_of(&nodes);
        let batch = inner.waiting.entry(chunk).or_default();
        batch.parts += 1;
        batch.nodes.extend(nodes);
        let outcome = inner.write_due(self.root_bits);
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
    pub fn built(&mut self) -> &mut Built<'a> {
        let inner = self.inner.get_mut().expect("no holder of the lock panics");
        assert!(inner.waiting.is_empty(), "all chunks that were begun are done");
        &mut inner.built
    }

    /// What has been built.
    pub fn into_built(mut self) -> Built<'a> {
        self.built();
        self.inner.into_inner().expect("no holder of the lock panics").built
    }
}

impl Inner<'_> {
    fn write_due(&mut self, root_bits: u32) -> Result<(), BuildError> {
        while let Some(batch) = self.waiting.get_mut(&self.next)
            && batch.parts == PARTS
        {
            let mut nodes = std::mem::take(&mut batch.nodes);
            self.waiting.remove(&self.next);
            self.waiting_bytes -= bytes_of(&nodes);
            nodes.sort_by_key(|finished| place(&finished.node.row, root_bits));
            nodes.into_iter().try_for_each(|node| self.built.add(node))?;
            self.next += 1;
        }
        Ok(())
    }
}

fn bytes_of(nodes: &[FinishedNode]) -> u64 {
    nodes.iter().map(|finished| finished.node.bytes.len() as u64).sum()
}

/// When a sweep is done with a node: the first code behind its cell, deeper nodes first.
fn place(row: &NodeRow, root_bits: u32) -> (u128, std::cmp::Reverse<u32>) {
    let end = (u128::encode(row.cell.to_array()) + 1) << (3 * (root_bits - row.depth));
    (end, std::cmp::Reverse(row.depth))
}
