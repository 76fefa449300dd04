//! How much disk a conversion will need: what rows come to once they are packed, by a sample.
//!
//! Rows wait in the order of the input within their chunk, so two things decide how short they get
//! (`packing`): attributes and indices differ little from one row to the next, and codes have in
//! common what all of a chunk have. The sample shows the first by short runs of the input, the
//! second by groups of neighbours as close as points of a chunk.
//!
//! Rows count once. Under caps so tight that nodes wait on disk as well more is written than this.

use crate::build::budget::Budget;
use crate::build::packing::{GROUP, Packer};
use crate::build::sources::Sources;
use crate::geometry::MortonKey;
use crate::input::BlockBuffer;
use crate::points::{COORDINATE_BYTES, record_coordinates};

/// Most groups of the sample; a chunk has about one.
const MOST_GROUPS: u64 = 1 << 10;
/// How far an estimate may be above what is needed in the end. Within this, a disk that may be too
/// small is tried.
const SAFETY: f64 = 0.75;

/// Bytes of disk that a conversion needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DiskNeed {
    /// The store, at the least.
    pub store: u64,
    /// Temporary files, by a sample of the input.
    pub temporary: u64,
}

impl DiskNeed {
    /// For sources whose counts are certain. A store has rarely less than an eighth of its records'
    /// bytes.
    pub fn of(sources: &Sources, budget: &Budget) -> DiskNeed {
        let certain = sources.scans().iter().filter(|source| source.scan.points_exact());
        let points: u64 = certain.map(|source| source.scan.points()).sum();
        let records = points.saturating_mul(u64::from(sources.schema().record_bytes));
        // What was decompressed waits on disk while it is sorted into chunks.
        let copies = if sources.are_compressed() { 2 } else { 1 };
        let spilled = records.saturating_sub(budget.slab_bytes) * copies;
        let temporary = match spilled {
            0 => 0,
            spilled => {
                let chunks = points / budget.chunk_points(points).max(1);
                let page_rows = 1 << budget.page_shift(sources.schema().record_bytes as usize);
                (spilled as f64 * packed_share(sources, chunks, page_rows)) as u64
            }
        };
        DiskNeed { store: records / 8, temporary }
    }

    /// Bytes of temporary files without which a conversion is not tried.
    pub fn least_temporary(&self) -> u64 {
        (self.temporary as f64 * SAFETY) as u64
    }
}

/// Bytes of packed rows, as a share of those of the rows. What is wrong with the input is told by
/// the conversion.
fn packed_share(sources: &Sources, chunks: u64, page_rows: usize) -> f64 {
    if page_rows < GROUP {
        return 1.0;
    }
    let wanted = chunks.clamp(8, MOST_GROUPS) * GROUP as u64;
    let sampled = sources.sampled(wanted);
    let record_bytes = sources.schema().record_bytes as usize;
    let (mut places, mut rests) = (Vec::new(), Vec::new());
    let mut buffer = BlockBuffer::default();
    let blocks = sampled.blocks();
    // Readers of whole blocks may hand out far more than was asked for.
    let every = sampled.expected_points().div_ceil(2 * wanted).max(1) as usize;
    for &(source, block) in blocks.iter().step_by(every) {
        let shift = sources.shift(source);
        let outcome = sampled.read_block(source, block, &mut buffer, &mut |records| {
            for record in records.chunks_exact(record_bytes) {
                let place = record_coordinates(record);
                places.push([0, 1, 2].map(|axis| i64::from(place[axis]) + shift[axis]));
                rests.extend_from_slice(&(places.len() as u32).to_le_bytes());
                rests.extend_from_slice(&record[COORDINATE_BYTES..]);
            }
            Ok(())
        });
        if outcome.is_err() {
            break;
        }
    }
    let stride = record_bytes - COORDINATE_BYTES + 4;
    let rows = places.len() * (stride + u64::BYTES);
    let rests = rests.chunks(page_rows * stride).map(|rows| packed_bytes(rows, stride));
    let packed = rests.sum::<usize>() + packed_codes(&places, page_rows / GROUP);
    packed as f64 / rows.max(1) as f64
}

/// Bytes of the points' codes, packed in groups of neighbours, of which so many are on a page.
fn packed_codes(places: &[[i64; 3]], page_groups: usize) -> usize {
    let least = |axis: usize| places.iter().map(|place| place[axis]).min().unwrap_or(0);
    let most = |axis: usize| places.iter().map(|place| place[axis]).max().unwrap_or(0);
    let least = [0, 1, 2].map(least);
    let extent = (0..3).map(|axis| most(axis) - least[axis]).max().unwrap_or(0);
    // Codes of wider clouds are longer; the lowest bits are packed alike.
    let shift = (i64::BITS - extent.leading_zeros()).saturating_sub(u64::MAX_BITS);
    let code = |place: &[i64; 3]| {
        u64::encode([0, 1, 2].map(|axis| ((place[axis] - least[axis]) >> shift) as u32))
    };
    let mut codes: Vec<(u64, usize)> = places.iter().map(code).zip(0..).collect();
    codes.sort_unstable();
    let groups = codes.chunks_exact_mut(GROUP).map(|group| {
        group.sort_unstable_by_key(|&(_, order)| order);
        let rows: Vec<u8> = group.iter().flat_map(|(code, _)| code.to_le_bytes()).collect();
        // Nothing is above the first group of a page; above others are neighbours.
        let first = packed_bytes(&rows, u64::BYTES);
        let other = packed_bytes(&rows.repeat(2), u64::BYTES).saturating_sub(first);
        (first + (page_groups - 1) * other) / page_groups
    });
    groups.sum()
}

fn packed_bytes(rows: &[u8], stride: usize) -> usize {
    let mut packer = Packer::default();
    if packer.pack(rows, stride) { packer.bytes.len() } else { rows.len() }
}
