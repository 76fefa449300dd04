//! A scan file without its points: header and variable length records, byte for byte.
//!
//! A store keeps it so that an export can give back what the scan said about itself.

use serde::{Deserialize, Serialize};

use super::error::LasFault;
use super::header::LasHeader;
use super::vlr::{self, Vlr};

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
