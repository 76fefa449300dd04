//! What the loader did and holds.

use serde::Serialize;

/// Counters of a loader. Totals count since the scene was set; the others tell the present state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct StreamStats {
    /// Threads that were started; 0 if the scene fits the room for it.
    pub loader_threads: u32,
    /// Nodes on the list that are not being read yet.
    pub nodes_queued: u32,
    /// Nodes being read or unpacked.
    pub nodes_in_flight: u32,
    /// Most nodes that were being read or unpacked at once.
    pub most_nodes_in_flight: u32,
    /// Stored bytes of nodes being read or unpacked.
    pub in_flight_bytes: u64,
    /// Nodes in main memory.
    pub ram_nodes: u32,
    /// Bytes of these, and what is kept free for those under way.
    pub ram_bytes: u64,
    /// The most that these were.
    pub ram_peak_bytes: u64,
    /// Most that they may be.
    pub ram_limit_bytes: u64,
    /// Nodes handed to frames.
    pub nodes_delivered: u64,
    /// Of these, those that were in main memory when they were first wished for.
    pub ram_hits: u64,
    /// Nodes read.
    pub nodes_read: u64,
    /// Of these, those that had been read before and were dropped meanwhile.
    pub nodes_read_again: u64,
    /// Of these, those that were read ahead.
    pub nodes_read_ahead: u64,
    /// Reads that failed for a passing reason and were to be tried again.
    pub reads_retried: u64,
    /// Nodes that could not be read.
    pub nodes_unreadable: u64,
    /// Nodes dropped from main memory for others.
    pub ram_evicted: u64,
    /// Lists that were replaced.
    pub lists: u64,
    /// Times that a frame found the loader's lock taken and went on without an exchange.
    pub exchanges_skipped: u64,
}
