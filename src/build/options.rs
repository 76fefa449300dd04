//! What a conversion can be told, and what it takes by default.

use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

use crate::build::Representative;
use crate::build::machine::available_memory;
use crate::build::work::BeforeWrite;
use crate::input::ReadOptions;
use crate::points::Schema;

/// Settings of a conversion.
#[derive(Clone)]
pub struct ConvertOptions {
    /// Most memory to use, bytes. More makes fewer passes over temporary files; the output is the
    /// same. Default: half of what the machine or its control group has.
    pub memory_bytes: u64,
    /// Worker threads; 0 takes one per core. The output is the same for any number.
    pub threads: usize,
    /// Folder of temporary files; default: the output's.
    pub temp_dir: Option<PathBuf>,
    /// Replace an existing output.
    pub overwrite: bool,
    /// Levels within a node beyond its coarsest, 2..=8 (the paper's D). Fewer make more, smaller
    /// nodes. 0, the default, takes 7, and less where records are so long that nodes would become
    /// too large to be read one by one.
    pub depth: u32,
    /// Fewest points that make a child, at least 1. Fewer make more nodes; more leave more points
    /// without a level of their own. Default 1000.
    pub threshold: u32,
    /// How representatives are chosen.
    pub representative: Representative,
    /// How inputs are to be read where they do not tell.
    pub read: ReadOptions,
    /// Time between two notes of how far the work is, from which a killed run goes on. Each brings
    /// to disk what is in memory. Default half a minute: what takes less starts anew.
    pub checkpoint_every: Duration,
    /// Take the bounds in the headers of plain LAS files at their word until the points are sorted,
    /// and begin again where they were wrong. Saves a pass over the input; the output is the same.
    pub trust_headers: bool,
    /// Share of a store's bytes, 0 to 1, above which those that it no longer uses after an addition
    /// make it be written anew without them. Default a half: that costs no more than all additions
    /// before.
    pub compact_above: f64,
    /// Called before every write to disk; its error is the write's. For tests.
    pub before_write: Option<BeforeWrite>,
}

impl fmt::Debug for ConvertOptions {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.debug_struct("ConvertOptions")
            .field("memory_bytes", &self.memory_bytes)
            .field("threads", &self.threads)
            .field("temp_dir", &self.temp_dir)
            .field("overwrite", &self.overwrite)
            .field("depth", &self.depth)
            .field("threshold", &self.threshold)
            .field("representative", &self.representative)
            .field("read", &self.read)
            .field("checkpoint_every", &self.checkpoint_every)
            .field("trust_headers", &self.trust_headers)
            .field("compact_above", &self.compact_above)
            .finish_non_exhaustive()
    }
}

impl Default for ConvertOptions {
    fn default() -> Self {
        ConvertOptions {
            memory_bytes: available_memory() / 2,
            threads: 0,
            temp_dir: None,
            overwrite: false,
            depth: 0,
            threshold: 1000,
            representative: Representative::Color,
            read: ReadOptions::default(),
            checkpoint_every: Duration::from_secs(30),
            trust_headers: true,
            compact_above: 0.5,
            before_write: None,
        }
    }
}

impl ConvertOptions {
    /// The levels of nodes for records of a schema.
    pub fn depth_for(&self, schema: &Schema) -> u32 {
        match (self.depth, schema.record_bytes) {
            (0, ..=128) => 7,
            (0, ..=512) => 6,
            (0, ..=2048) => 5,
            (0, _) => 4,
            (depth, _) => depth,
        }
    }
}

/// Levels within a node that conversion accepts.
pub const DEPTH_RANGE: std::ops::RangeInclusive<u32> = 2..=8;
