//! A scan file without its points: header and variable length records, byte for byte.
//!
//! A store keeps it so that an export can give back what the scan said about itself.

use serde::{Deserialize, Serialize};

use super::error::LasFault;
use super::header::{LasHeader, place};
use super::point_format::PointFormat;
use super::vlr::{self, Vlr};
use crate::points::Lattice;

/// A range of bytes in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ByteRange {
    /// First byte.
    pub start: u64,
    /// Byte after the last.
    pub end: u64,
}

/// The parts of a scan file that are not points.
///
/// Invariants, checked by [`new`](Self::new): the header parses, and the region of VLRs is as long
/// as the header says and holds as many records as it says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LasTemplate {
    header: Vec<u8>,
    vlrs: Vec<u8>,
    evlrs: Vec<ByteRange>,
}

impl LasTemplate {
    /// A template from the header's bytes, all bytes between header and points, and the places of
    /// whole extended records (their headers included) in the file they come from.
    pub fn new(header: Vec<u8>, vlrs: Vec<u8>, evlrs: Vec<ByteRange>) -> Result<Self, LasFault> {
        let template = LasTemplate { header, vlrs, evlrs };
        let parsed = LasHeader::from_bytes(&template.header, u64::MAX)?;
        let points = u64::from(parsed.point_data_offset);
        let header_bytes = u64::from(parsed.header_bytes);
        let found = header_bytes + template.vlrs.len() as u64;
        if usize::from(parsed.header_bytes) != template.header.len() || found != points {
            return Err(LasFault::PointDataOffset {
                offset: points,
                header_bytes: template.header.len() as u64,
                file_bytes: found,
            });
        }
        vlr::vlrs(&template.vlrs, parsed.vlr_count, header_bytes)?;
        Ok(template)
    }

    /// The header's bytes.
    pub fn header_bytes(&self) -> &[u8] {
        &self.header
    }

    /// All bytes between header and points: the VLRs and whatever stands after them.
    pub fn vlr_bytes(&self) -> &[u8] {
        &self.vlrs
    }

    /// Places of whole extended records in the file that the template comes from.
    pub fn evlrs(&self) -> &[ByteRange] {
        &self.evlrs
    }

    /// The header.
    pub fn header(&self) -> LasHeader {
        LasHeader::from_bytes(&self.header, u64::MAX).expect("the header was checked")
    }

    /// The VLRs; places count from the start of [`vlr_bytes`](Self::vlr_bytes).
    pub fn vlrs(&self) -> Vec<Vlr> {
        let header = self.header();
        vlr::vlrs(&self.vlrs, header.vlr_count, u64::from(header.header_bytes))
            .expect("the region was checked")
    }
}

/// What a header says besides counts and bounds, for files that no scanner wrote.
#[derive(Clone, Copy, Debug)]
pub struct NewScan<'a> {
    /// Minor version, 0 to 4; at least what the point format needs.
    pub minor: u8,
    /// The point format.
    pub point_format: PointFormat,
    /// Bytes of each record after the point format's own.
    pub extra_bytes: u16,
    /// The lattice of the coordinates.
    pub lattice: Lattice,
    /// What was done, at most 32 bytes.
    pub system_identifier: &'a str,
    /// The program, at most 32 bytes.
    pub generating_software: &'a str,
    /// Day of the year and year of creation; zeros where the file must not depend on the day.
    pub creation: (u16, u16),
}

impl LasTemplate {
    /// The template of a file without variable length records.
    ///
    /// GPS times count as adjusted standard time; where the point format demands it, the reference
    /// system counts as well-known text.
    pub fn for_new_scan(scan: &NewScan) -> Self {
        let header_bytes: u16 = match scan.minor {
            0..=2 => 227,
            3 => 235,
            _ => 375,
        };
        let mut header = vec![0; usize::from(header_bytes)];
        let mut put = |at: usize, value: &[u8]| {
            header[at..at + value.len()].copy_from_slice(value);
        };
        let adjusted_time = u16::from(scan.minor >= 2);
        let well_known_text = u16::from(scan.point_format.is_extended()) << 4;
        let record_bytes = scan.point_format.base_bytes() + scan.extra_bytes;
        let field = |text: &str| {
            let mut field = [0; 32];
            let length = text.len().min(32);
            field[..length].copy_from_slice(&text.as_bytes()[..length]);
            field
        };
        put(0, b"LASF");
        put(place::GLOBAL_ENCODING, &(adjusted_time | well_known_text).to_le_bytes());
        put(place::MINOR_VERSION - 1, &[1, scan.minor]);
        put(place::SYSTEM_IDENTIFIER, &field(scan.system_identifier));
        put(place::GENERATING_SOFTWARE, &field(scan.generating_software));
        put(place::CREATION, &scan.creation.0.to_le_bytes());
        put(place::CREATION + 2, &scan.creation.1.to_le_bytes());
        put(place::HEADER_BYTES, &header_bytes.to_le_bytes());
        put(place::POINT_DATA_OFFSET, &u32::from(header_bytes).to_le_bytes());
        put(place::POINT_FORMAT, &[scan.point_format.number()]);
        put(place::RECORD_BYTES, &record_bytes.to_le_bytes());
        for axis in 0..3 {
            put(place::SCALE + 8 * axis, &scan.lattice.scale[axis].to_le_bytes());
            put(place::OFFSET + 8 * axis, &scan.lattice.offset[axis].to_le_bytes());
        }
        LasTemplate { header, vlrs: Vec::new(), evlrs: Vec::new() }
    }

    /// The same file with one more VLR at the end of its region.
    pub fn with_vlr(
        mut self,
        user_id: &str,
        record_id: u16,
        data: &[u8],
    ) -> Result<Self, LasFault> {
        let header = self.header();
        let mut record = vec![0; vlr::VLR_HEADER_BYTES];
        let user_id = &user_id.as_bytes()[..user_id.len().min(16)];
        record[2..2 + user_id.len()].copy_from_slice(user_id);
        record[18..20].copy_from_slice(&record_id.to_le_bytes());
        let length = u16::try_from(data.len()).map_err(|_| LasFault::Limit {
            what: "bytes of a VLR",
            byte: u64::from(header.point_data_offset),
            amount: data.len() as u64,
            limit: u64::from(u16::MAX),
        })?;
        record[20..22].copy_from_slice(&length.to_le_bytes());
        record.extend_from_slice(data);
        let after_last = self.vlrs().last().map_or(0, |last| last.whole().end as usize);
        let points_start = header.point_data_offset + record.len() as u32;
        self.vlrs.splice(after_last..after_last, record);
        let mut put = |at: usize, value: u32| {
            self.header[at..at + 4].copy_from_slice(&value.to_le_bytes());
        };
        put(place::POINT_DATA_OFFSET, points_start);
        put(place::VLR_COUNT, header.vlr_count + 1);
        Ok(self)
    }
}
