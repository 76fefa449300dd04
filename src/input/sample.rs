//! Some of a scan's points, spread evenly over the file, at the cost of reading little more.
//!
//! Plain records are read in short runs. A LAZ chunk can only be read from its start, so its first
//! points are taken, and those of every so many chunks where few are wanted of each. Readers of
//! other formats hand out whole blocks, of which every so many are taken.

use super::scan::{Block, ScanFormat};
use super::scan_file::Scan;

/// Records of a run: about as many as a page of memory, below which a read costs the same.
pub const RUN_RECORDS: u64 = 64;
/// Fewest points for which a chunk is begun, if it has so many.
const LEAST_CHUNK_POINTS: u64 = 1000;

impl Scan {
    /// Blocks that hand out about that share of the scan's points, in the order of the file, at
    /// least one if there is any.
    pub fn sampled_blocks(&self, share: f64) -> Vec<Block> {
        let share = share.clamp(0.0, 1.0);
        match self.las().map(|scan| scan.facts()) {
            Some(facts) if facts.format == ScanFormat::Las => {
                runs(self.blocks(), u64::from(facts.record_bytes), share)
            }
            Some(_) => beginnings(self.blocks(), share),
            None => every_so_many(self.blocks(), share).cloned().collect(),
        }
    }
}

/// Whether one of many things in a row is taken, if that share of all is and the first in any case.
fn is_taken(index: usize, share: f64) -> bool {
    let taken_before = |count: usize| (count as f64 * share).ceil();
    index == 0 || taken_before(index + 1) > taken_before(index)
}

/// Short runs of plain records.
fn runs(blocks: &[Block], record_bytes: u64, share: f64) -> Vec<Block> {
    let starts = blocks.iter().flat_map(|block| {
        (0..block.points).step_by(RUN_RECORDS as usize).map(move |start| (block, start))
    });
    let taken = starts.enumerate().filter(|(i, _)| is_taken(*i, share)).map(|(_, start)| start);
    taken
        .map(|(block, start)| {
            let points = RUN_RECORDS.min(block.points - start);
            let from = block.bytes.start + start * record_bytes;
            Block::records(block.first_point + start, points, from..from + points * record_bytes)
        })
        .collect()
}

/// The first points of chunks.
fn beginnings(blocks: &[Block], share: f64) -> Vec<Block> {
    let all: u64 = blocks.iter().map(|block| block.points).sum();
    let mean = all as f64 / blocks.len().max(1) as f64;
    // That share of every chunk, or more of fewer chunks.
    let of_each = share.max(LEAST_CHUNK_POINTS as f64 / mean.max(1.0)).min(1.0);
    let begun = every_so_many(blocks, share / of_each);
    begun.map(|block| block.beginning((block.points as f64 * of_each).ceil() as u64)).collect()
}

fn every_so_many(blocks: &[Block], share: f64) -> impl Iterator<Item = &Block> {
    let numbered = blocks.iter().enumerate();
    numbered.filter(move |(i, _)| is_taken(*i, share)).map(|(_, block)| block)
}
