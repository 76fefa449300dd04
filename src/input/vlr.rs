//! Variable length records, before the points (VLR) and after them (EVLR): where they stand.
//!
//! Only headers of records are read here; data stays in the file until someone wants it.
//!
//! Source: ASPRS, "LAS Specification 1.4 - R15", sections 2.5 and 2.7.

use std::ops::Range;

use super::error::LasFault;
use super::header::text;
use super::positioned_file::PositionedFile;

/// Size of the header of a VLR.
pub const VLR_HEADER_BYTES: usize = 54;
/// Size of the header of an EVLR.
pub const EVLR_HEADER_BYTES: usize = 60;
/// Most records of either kind that are accepted.
const MOST_RECORDS: u64 = 65_536;
/// Most bytes between header and points that are accepted.
pub(super) const MOST_VLR_BYTES: u64 = 256 << 20;

/// One variable length record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Vlr {
    /// Who defined it.
    pub user_id: String,
    /// What it is, within that user's.
    pub record_id: u16,
    /// Free text.
    pub description: String,
    /// Where its data stands: in the file for EVLRs, in the region of VLRs for those.
    pub data: Range<u64>,
    /// Whether it stands after the points.
    pub extended: bool,
}

impl Vlr {
    /// Where the whole record stands, its header included.
    pub fn whole(&self) -> Range<u64> {
        let header = if self.extended { EVLR_HEADER_BYTES } else { VLR_HEADER_BYTES };
        self.data.start - header as u64..self.data.end
    }

    /// Whether it is one that the layout of COPC needs (order of points, hierarchy).
    pub fn is_copc(&self) -> bool {
        self.user_id == "copc"
    }

    /// Whether it describes the LAZ compression.
    pub fn is_laszip(&self) -> bool {
        self.user_id == laz::LazVlr::USER_ID && self.record_id == laz::LazVlr::RECORD_ID
    }

    /// Whether it holds the waveforms. Some scanners' software spells the user id without F.
    pub fn is_waveform_data(&self) -> bool {
        ["LASF_Spec", "LAS_Spec"].contains(&self.user_id.as_str()) && self.record_id == 65_535
    }
}

/// The records in the bytes between header and points; places count from the region's start.
///
/// `region_byte` is the region's place in the file, for messages.
pub fn vlrs(region: &[u8], count: u32, region_byte: u64) -> Result<Vec<Vlr>, LasFault> {
    let count = u64::from(count);
    limit("number of VLRs", region_byte, count, MOST_RECORDS)?;
    let mut found = Vec::new();
    let mut at = 0;
    for index in 0..count {
        let fault = |reason: String| LasFault::Record {
            kind: "VLR",
            index: index + 1,
            count,
            byte: region_byte + at as u64,
            reason,
        };
        let Some(header) = region.get(at..at + VLR_HEADER_BYTES) else {
            return Err(fault(format!(
                "its header ends after the start of the points at byte {}",
                region_byte + region.len() as u64
            )));
        };
        let length = usize::from(u16::from_le_bytes([header[20], header[21]]));
        let data = at + VLR_HEADER_BYTES..at + VLR_HEADER_BYTES + length;
        if data.end > region.len() {
            return Err(fault(format!(
                "its {length} bytes end after the start of the points at byte {}",
                region_byte + region.len() as u64
            )));
        }
        found.push(Vlr {
            user_id: text(&header[2..18]),
            record_id: u16::from_le_bytes([header[18], header[19]]),
            description: text(&header[22..54]),
            data: data.start as u64..data.end as u64,
            extended: false,
        });
        at = data.end;
    }
    Ok(found)
}

/// The `count` extended records from byte `start` on; places count from the file's start.
pub(super) fn evlrs(file: &PositionedFile, start: u64, count: u32) -> Result<Vec<Vlr>, LasFault> {
    let count = u64::from(count);
    limit("number of EVLRs", start, count, MOST_RECORDS)?;
    let mut found = Vec::new();
    let mut at = start;
    for index in 0..count {
        let fault = |reason: String| LasFault::Record {
            kind: "EVLR",
            index: index + 1,
            count,
            byte: at,
            reason,
        };
        let file_bytes = file.bytes();
        let header_end = at.checked_add(EVLR_HEADER_BYTES as u64);
        let Some(data_start) = header_end.filter(|&end| end <= file_bytes) else {
            return Err(fault(format!("its header ends after the file, at byte {file_bytes}")));
        };
        let mut header = [0; EVLR_HEADER_BYTES];
        file.read_exact_at(&mut header, at)?;
        let evlr = evlr_header(&header, data_start);
        match evlr {
            Some(evlr) if evlr.data.end <= file_bytes => {
                at = evlr.data.end;
                found.push(evlr);
            }
            _ => {
                let length = evlr_length(&header);
                return Err(fault(format!(
                    "its {length} bytes end after the file, at byte {file_bytes}"
                )));
            }
        }
    }
    Ok(found)
}

/// The record of an EVLR header whose data starts at `data_start`; `None` where it has no end.
pub fn evlr_header(header: &[u8; EVLR_HEADER_BYTES], data_start: u64) -> Option<Vlr> {
    Some(Vlr {
        user_id: text(&header[2..18]),
        record_id: u16::from_le_bytes([header[18], header[19]]),
        description: text(&header[28..60]),
        data: data_start..data_start.checked_add(evlr_length(header))?,
        extended: true,
    })
}

fn evlr_length(header: &[u8; EVLR_HEADER_BYTES]) -> u64 {
    u64::from_le_bytes(header[20..28].try_into().expect("the slice has 8 bytes"))
}

pub(super) fn limit(
    what: &'static str,
    byte: u64,
    amount: u64,
    limit: u64,
) -> Result<(), LasFault> {
    if amount > limit { Err(LasFault::Limit { what, byte, amount, limit }) } else { Ok(()) }
}
