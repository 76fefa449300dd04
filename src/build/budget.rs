//! How the memory cap is shared out.

use crate::build::BuildError;
use crate::build::options::ConvertOptions;
use crate::points::Schema;

/// Bytes that the parts of a conversion may take.
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    /// Threads that there is memory for.
    pub workers: usize,
    /// Size of a page.
    pub page_bytes: usize,
    /// Pages in memory, open ones included; what is left over goes to disk.
    pub slab_bytes: u64,
    /// Encoded nodes waiting for their turn to be written.
    pub node_bytes: u64,
    /// Most points of a chunk, if they can be divided.
    pub most_chunk_points: u64,
    /// Memory of a worker for a node that reaches over several chunks.
    spanning_bytes: u64,
}

/// Memory for the program itself and for blocks being read, whatever the cap.
const FIXED_BYTES: u64 = 40 << 20;
/// Rows of a page where memory is no concern.
const MOST_PAGE_SHIFT: u32 = 11;
const LEAST_PAGE_SHIFT: u32 = 1;
/// Chunks this large stay near the cache.
const CHUNK_POINTS: u64 = 1 << 15;
/// Chunks of an input where memory allows so few.
const MOST_CHUNKS: u64 = 1 << 10;
/// Nodes that wait for an earlier chunk need not be many.
const MOST_NODE_BYTES: u64 = 64 << 20;
/// Fewest points of a chunk.
const LEAST_CHUNK_POINTS: u64 = 8;

impl Budget {
    /// Shares out the cap for records of a schema.
    pub fn new(
        options: &ConvertOptions,
        schema: &Schema,
        expected_points: u64,
    ) -> Result<Self, BuildError> {
        let cap = options.memory_bytes;
        let threads = rayon::current_num_threads();
        let fit = |cap: u64| {
            let workers = (1..=threads).rev();
            workers.into_iter().find_map(|n| Budget::fit(cap, n, schema, expected_points))
        };
        fit(cap).ok_or_else(|| {
            let larger = std::iter::successors(Some(cap.max(1 << 16)), |cap| Some(cap + cap / 16));
            let needed = larger.into_iter().find(|&cap| fit(cap).is_some());
            BuildError::MemoryCap { cap, needed: needed.unwrap_or(u64::MAX) }
        })
    }

    /// The shares for so many workers, if they get enough to work with.
    fn fit(cap: u64, workers: usize, schema: &Schema, expected_points: u64) -> Option<Self> {
        // Caps below what the program itself takes cannot be held; they still mean "very little".
        let usable = cap.saturating_sub(FIXED_BYTES).max(cap / 4);
        // A row is as long as its record, but for wide codes and indices.
        let row = u64::from(schema.record_bytes);
        // Sorting, the rows in order, the sweep, and the columns and bytes of nodes.
        let work = workers as u64 * (96 + 5 * row);
        let chunk_points = usable * 2 / 5 / work;
        if chunk_points < LEAST_CHUNK_POINTS {
            return None;
        }
        let chunks = expected_points / CHUNK_POINTS.min(chunk_points * 2 / 3).max(1) + 8;
        let open = |shift: u32| workers as u64 * chunks.min(MOST_CHUNKS) * (row << shift);
        let shifts = LEAST_PAGE_SHIFT..=MOST_PAGE_SHIFT;
        let page_shift = shifts.rev().find(|shift| open(*shift) <= usable / 4)?;
        // Chunks of large inputs, and those that turn out larger than planned.
        let work_bytes = work * chunk_points.min(4 * CHUNK_POINTS);
        let node_bytes = (usable / 20).min(MOST_NODE_BYTES);
        let spanning_bytes = usable / 10;
        Some(Budget {
            workers,
            page_bytes: (row << page_shift) as usize,
            slab_bytes: usable
                .saturating_sub(work_bytes + node_bytes + spanning_bytes)
                .min((2 * row).saturating_mul(expected_points) + 2 * open(page_shift)),
            node_bytes,
            most_chunk_points: chunk_points,
            spanning_bytes: spanning_bytes / workers as u64,
        })
    }

    /// Most points of a node that is put together in memory: rows, their order, columns and bytes.
    pub fn most_node_points(&self, stride: usize) -> u64 {
        self.spanning_bytes / (3 * stride as u64 + 80)
    }

    /// Rows of that length on a page, as the power of two.
    pub fn page_shift(&self, stride: usize) -> u32 {
        (self.page_bytes / stride).max(1).ilog2()
    }

    /// Points that chunks of an input of so many should have.
    pub fn chunk_points(&self, points: u64) -> u64 {
        CHUNK_POINTS.max(points / MOST_CHUNKS).min(self.most_chunk_points * 2 / 3).max(1)
    }
}
