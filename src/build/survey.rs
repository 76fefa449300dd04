//! The first pass: every record once, for true bounds and counts (headers are not trusted).
//!
//! Records of compressed inputs are kept as they were decoded, in pages; others are read again.
//! Plain records need no first pass where headers tell bounds (`claims`): what these claim is
//! compared with what is seen while the records are sorted.

use serde::{Deserialize, Serialize};

use crate::build::BuildError;
use crate::build::pages::{Page, PageBuffer, PageStore};
use crate::build::progress::Progress;
use crate::build::rows::color_offset;
use crate::build::seen::Seen;
use crate::build::sources::Sources;
use crate::input::{Block, BlockBuffer};
use crate::points::{COORDINATE_BYTES, Schema, record_coordinates};

/// Decoded records of one block that were put away.
#[derive(Debug)]
pub struct HeldPage<'p> {
    /// Which block.
    pub block: usize,
    /// Place of the first record within the block.
    pub first: u64,
    /// The records.
    pub page: Page<'p>,
}

/// What one pass over all points tells.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Survey {
    /// All points.
    pub all: Seen,
    /// If `all` is what headers claim: what has been seen of it so far.
    pub verified: Option<Seen>,
    /// Points of each block.
    pub block_points: Vec<u64>,
    /// Coordinates of every so many points, on the store's lattice.
    pub sample: Vec<[i64; 3]>,
    /// How many points each of the sample stands for.
    pub sample_weight: u64,
    /// Whole records of every so many points, if they are wanted: by block.
    #[serde(skip)]
    pub records: Vec<(usize, Vec<u8>)>,
    /// How many points each of the records stands for; 0 if none are wanted.
    #[serde(skip)]
    pub record_weight: u64,
}

/// Most coordinates in the sample.
const SAMPLE_POINTS: u64 = 1 << 16;

/// One worker's part of the survey.
pub struct Part<'p> {
    seen: Seen,
    sample: Vec<[i64; 3]>,
    held: Vec<HeldPage<'p>>,
    block_points: Vec<(usize, u64)>,
    records: Vec<(usize, Vec<u8>)>,
    buffer: BlockBuffer,
    page: Option<PageBuffer<'p>>,
}

impl<'p> Part<'p> {
    /// Nothing yet.
    pub fn new() -> Self {
        Part {
            seen: Seen::default(),
            sample: Vec::new(),
            held: Vec::new(),
            block_points: Vec::new(),
            records: Vec::new(),
            buffer: BlockBuffer::default(),
            page: None,
        }
    }

    /// Looks at records, the first of which is the `first`-th of its block.
    fn look(&mut self, records: &[u8], schema: &Schema, shift: [i64; 3], first: u64, weight: u64) {
        self.seen.look(records, schema, shift);
        let shifted = |v: [i32; 3]| [0, 1, 2].map(|axis| i64::from(v[axis]) + shift[axis]);
        let next = first.next_multiple_of(weight) - first;
        let sampled = records.chunks_exact(schema.record_bytes as usize).skip(next as usize);
        self.sample.extend(
            sampled.step_by(weight as usize).map(|record| shifted(record_coordinates(record))),
        );
    }

    /// Keeps records of a block, the first of which is its `first`-th.
    fn hold(
        &mut self,
        pages: &PageStore<'p>,
        block: usize,
        mut first: u64,
        records: &[u8],
        record_bytes: usize,
    ) -> Result<(), BuildError> {
        let page_bytes = pages.page_bytes() / record_bytes * record_bytes;
        for part in records.chunks(page_bytes) {
            let mut page = self.page.take().unwrap_or_else(|| pages.buffer());
            page.room()[..part.len()].copy_from_slice(part);
            page.set_used(part.len(), record_bytes);
            let page = if part.len() == page_bytes {
                let (page, next) = pages.keep(page)?;
                self.page = Some(next);
                page
            } else {
                pages.keep_last(page)?
            };
            self.held.push(HeldPage { block, first, page });
            first += (part.len() / record_bytes) as u64;
        }
        Ok(())
    }
}

impl Survey {
    /// Of nothing yet, for an input of so many blocks with about so many points.
    pub fn new(blocks: usize, expected_points: u64) -> Self {
        Survey {
            all: Seen::default(),
            verified: None,
            block_points: vec![0; blocks],
            sample: Vec::new(),
            // Not a power of two, so that it keeps no step with the scanner.
            sample_weight: (expected_points / SAMPLE_POINTS).max(4) | 1,
            records: Vec::new(),
            record_weight: 0,
        }
    }

    /// Takes whole records, too, so many of about so many points.
    pub fn want_records(&mut self, wanted: u64, expected_points: u64) {
        self.record_weight = expected_points.checked_div(wanted).map_or(0, |w| w.max(1) | 1);
    }

    /// The records that were wanted, in the order of the input.
    pub fn take_records(&mut self) -> Vec<u8> {
        let mut records = std::mem::take(&mut self.records);
        records.sort_by_key(|(block, _)| *block);
        records.into_iter().flat_map(|(_, records)| records).collect()
    }

    /// Reads a block into a worker's part. With `hold` its records are kept in pages.
    pub fn read_block<'p>(
        &self,
        sources: &Sources,
        (source, block): (usize, &Block),
        number: usize,
        hold: Option<&PageStore<'p>>,
        part: &mut Part<'p>,
        progress: &dyn Progress,
    ) -> Result<(), BuildError> {
        let schema = sources.schema();
        let record_bytes = schema.record_bytes as usize;
        let shift = sources.shift(source);
        let mut buffer = std::mem::take(&mut part.buffer);
        let mut found = 0;
        let mut wanted = Vec::new();
        let outcome = sources.read_block(source, block, &mut buffer, &mut |records| {
            part.look(records, schema, shift, found, self.sample_weight);
            if self.record_weight > 0 {
                let next = found.next_multiple_of(self.record_weight) - found;
                let records = records.chunks_exact(record_bytes).skip(next as usize);
                for record in records.step_by(self.record_weight as usize) {
                    push_shifted(record, shift, &mut wanted);
                }
            }
            if let Some(pages) = hold {
                part.hold(pages, number, found, records, record_bytes)?;
            }
            let count = (records.len() / record_bytes) as u64;
            found += count;
            progress.advance(count);
            Ok(())
        });
        part.buffer = buffer;
        part.block_points.push((number, found));
        if !wanted.is_empty() {
            part.records.push((number, wanted));
        }
        outcome
    }

    /// Takes over what a worker found; its part is empty afterwards.
    pub fn join<'p>(
        &mut self,
        part: &mut Part<'p>,
        held: &mut Vec<HeldPage<'p>>,
        pages: &PageStore<'p>,
    ) {
        let empty = Part { buffer: std::mem::take(&mut part.buffer), ..Part::new() };
        let part = std::mem::replace(part, empty);
        self.all.join(&part.seen);
        self.sample.extend(part.sample);
        self.records.extend(part.records);
        held.extend(part.held);
        part.block_points.iter().for_each(|&(block, points)| self.block_points[block] = points);
        if let Some(page) = part.page {
            pages.give_back(page);
        }
    }

    /// Puts what was seen of the points in place of what headers claimed. False, and nothing, if
    /// that changes the octree's root.
    pub fn settle(&mut self, depth: u32) -> bool {
        let Some(seen) = self.verified else { return true };
        let has_same_root = seen.points == self.all.points
            && seen.min == self.all.min
            && seen.root_bits(depth) == self.all.root_bits(depth);
        if has_same_root {
            (self.all, self.verified) = (seen, None);
        }
        has_same_root
    }

    /// Bits of a colour's channels, if the points have one.
    pub fn color_bits(&self, schema: &Schema) -> Option<u8> {
        color_offset(schema).map(|_| if self.all.color_union > 0xff { 16 } else { 8 })
    }

    /// Input index of each block's first point.
    pub fn first_indices(&self) -> Vec<u64> {
        let starts = self.block_points.iter().scan(0, |next, points| {
            let first = *next;
            *next += points;
            Some(first)
        });
        starts.collect()
    }
}

/// Appends a record with its coordinates on the store's lattice, if they fit.
fn push_shifted(record: &[u8], shift: [i64; 3], records: &mut Vec<u8>) {
    let position = record_coordinates(record);
    let shifted = [0, 1, 2].map(|axis| i32::try_from(i64::from(position[axis]) + shift[axis]));
    if let [Ok(x), Ok(y), Ok(z)] = shifted {
        [x, y, z].iter().for_each(|steps| records.extend_from_slice(&steps.to_le_bytes()));
        records.extend_from_slice(&record[COORDINATE_BYTES..]);
    }
}
