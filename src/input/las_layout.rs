//! Where the records of an uncompressed file stand, and how many there really are.
//!
//! The length of the file decides, not the header: a count that is too low loses no record, one
//! that is too high is a truncated file unless something else in the header vouches for the end.

use super::error::LasFault;
use super::foreign::Unread;
use super::header::LasHeader;
use super::positioned_file::PositionedFile;
use super::scan::Block;

/// Most records handed out at once.
pub(super) const MOST_BATCH_RECORDS: u64 = 65_536;
const MOST_BATCH_BYTES: u64 = 4 << 20;

/// Records that are handed out at once, at least 1.
pub(super) fn batch_records(record_bytes: u16) -> u64 {
    (MOST_BATCH_BYTES / u64::from(record_bytes)).clamp(1, MOST_BATCH_RECORDS)
}

/// What a file holds: its blocks, its points, and what was odd.
#[derive(Debug, Default)]
pub(super) struct Layout {
    pub blocks: Vec<Block>,
    pub points: u64,
    pub points_exact: bool,
    pub warnings: Vec<String>,
    pub unread: Vec<Unread>,
}

/// Lays out plain records between the start of points and `end`, which is the end of the file
/// unless `end_is_known` (extended records start there).
pub(super) fn las_layout(
    file: &PositionedFile,
    header: &LasHeader,
    end: u64,
    end_is_known: bool,
    salvage: bool,
) -> Result<Layout, LasFault> {
    let start = u64::from(header.point_data_offset);
    let record_bytes = u64::from(header.record_bytes);
    let claimed = header.claimed_count();
    let available = (end - start) / record_bytes;
    let rest = (end - start) % record_bytes;
    let (mut warnings, mut unread) = (Vec::new(), Vec::new());
    let mut points = available;
    if available < claimed {
        let vouched = end_is_known || rest == 0 && header.count_witnesses().contains(&available);
        if !vouched && salvage {
            let points = claimed - available;
            unread.push(Unread { part: 0, reason: "the file ends before them".into(), points });
        } else if !vouched {
            let record_end =
                u128::from(start) + u128::from(available + 1) * u128::from(record_bytes);
            let record = available + 1;
            return Err(LasFault::Truncated { record, count: claimed, end_byte: end, record_end });
        }
        warnings.push(format!("the header claims {claimed} points, the file holds {available}"));
    } else if available > claimed {
        if is_padding(file, start + claimed * record_bytes, record_bytes)? {
            points = claimed;
            let bytes = end - start - claimed * record_bytes;
            warnings.push(format!("{bytes} bytes of zeros after the last record are left out"));
        } else if rest > 0 {
            // What does not end on a record is more likely something else than more points.
            points = claimed;
            let bytes = end - start - claimed * record_bytes;
            warnings.push(format!("{bytes} bytes after the last record are left out"));
        } else {
            let more = available - claimed;
            warnings.push(format!(
                "the header claims {claimed} points, the file holds {more} more, which are read"
            ));
        }
    }
    if points == available && rest > 0 {
        warnings.push(format!("{rest} bytes after the last whole record are left out"));
    }
    let batch = batch_records(header.record_bytes);
    let blocks = (0..points.div_ceil(batch)).map(|index| {
        let first_point = index * batch;
        let count = batch.min(points - first_point);
        let from = start + first_point * record_bytes;
        Block::records(first_point, count, from..from + count * record_bytes)
    });
    Ok(Layout { blocks: blocks.collect(), points, points_exact: true, warnings, unread })
}

/// Whether a record's place holds only zeros, as in files that were allocated ahead.
fn is_padding(file: &PositionedFile, byte: u64, record_bytes: u64) -> Result<bool, LasFault> {
    let record = file.read_range(byte..byte + record_bytes)?;
    Ok(record.iter().all(|&byte| byte == 0))
}
