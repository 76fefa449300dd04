//! The public header block of a LAS file, checked.
//!
//! Parsing is the crate `las`'s; what a header may claim is judged here, from its bytes and the
//! length of the file alone. Counts and bounds are kept as claims.
//!
//! Source: ASPRS, "LAS Specification 1.4 - R15", table 3; earlier versions are prefixes of it.

use glam::DVec3;

use super::error::LasFault;
use super::point_format::PointFormat;
use crate::geometry::Aabb;
use crate::points::Lattice;

/// Size of the longest header that a version prescribes (1.4).
pub(super) const LONGEST_HEADER_BYTES: usize = 375;
const SHORTEST_HEADER_BYTES: usize = 227;

/// Byte places of the fields that writing changes.
pub mod place {
    /// u16, bits of global encoding.
    pub const GLOBAL_ENCODING: usize = 6;
    /// u8, minor version.
    pub const MINOR_VERSION: usize = 25;
    /// 32 bytes of text.
    pub const SYSTEM_IDENTIFIER: usize = 26;
    /// 32 bytes of text.
    pub const GENERATING_SOFTWARE: usize = 58;
    /// u16 day of the year, u16 year.
    pub const CREATION: usize = 90;
    /// u16.
    pub const HEADER_BYTES: usize = 94;
    /// u32.
    pub const POINT_DATA_OFFSET: usize = 96;
    /// u32.
    pub const VLR_COUNT: usize = 100;
    /// u8, the top bit set where records are compressed.
    pub const POINT_FORMAT: usize = 104;
    /// u16.
    pub const RECORD_BYTES: usize = 105;
    /// u32.
    pub const LEGACY_COUNT: usize = 107;
    /// 5 x u32.
    pub const LEGACY_RETURNS: usize = 111;
    /// 3 x f64.
    pub const SCALE: usize = 131;
    /// 3 x f64.
    pub const OFFSET: usize = 155;
    /// max x, min x, max y, min y, max z, min z, f64 each.
    pub const BOUNDS: usize = 179;
    /// u64, versions 1.3 and 1.4.
    pub const WAVEFORM_START: usize = 227;
    /// u64, version 1.4.
    pub const EVLR_START: usize = 235;
    /// u32, version 1.4.
    pub const EVLR_COUNT: usize = 243;
    /// u64, version 1.4.
    pub const COUNT: usize = 247;
    /// 15 x u64, version 1.4.
    pub const RETURNS: usize = 255;
}

/// Points by return number as headers count them: index 0 is the first return.
pub type ReturnCounts = [u64; 15];

/// A header whose claims about structure hold; counts and bounds are only claims.
#[derive(Clone, Debug)]
pub struct LasHeader {
    /// Minor version; the major one is 1.
    pub minor: u8,
    /// The point format of the records.
    pub point_format: PointFormat,
    /// Whether the records are compressed.
    pub compressed: bool,
    /// Size of one record when not compressed, bytes.
    pub record_bytes: u16,
    /// Length of the header.
    pub header_bytes: u16,
    /// Where points start.
    pub point_data_offset: u32,
    /// Number of variable length records before the points, as claimed.
    pub vlr_count: u32,
    /// First extended record and their number, as claimed (version 1.4).
    pub evlrs: Option<(u64, u32)>,
    /// Start of the waveform data record where it lies in this file, as claimed.
    pub waveform_start: Option<u64>,
    /// Number of points in the 32-bit field of all versions, as claimed.
    pub legacy_count: u64,
    /// Number of points in the 64-bit field of version 1.4, as claimed.
    pub extended_count: Option<u64>,
    /// Points by return of the 32-bit fields, as claimed.
    pub legacy_returns: [u64; 5],
    /// Points by return of the 64-bit fields, as claimed.
    pub extended_returns: Option<ReturnCounts>,
    /// The lattice of the coordinates.
    pub lattice: Lattice,
    /// The box, as claimed; may be inverted or not finite.
    pub bounds: Aabb,
    /// Who measured or what was done, as the header says.
    pub system_identifier: String,
    /// The program that wrote the file.
    pub generating_software: String,
    /// Day of the year and year of creation; 0 where unknown.
    pub creation: (u16, u16),
    /// The bits of global encoding.
    pub global_encoding: u16,
}

impl LasHeader {
    /// Reads a header from the first bytes of a file of `file_bytes` bytes.
    ///
    /// `bytes` holds the whole header, or the whole file where that is shorter.
    pub fn from_bytes(bytes: &[u8], file_bytes: u64) -> Result<Self, LasFault> {
        if !bytes.starts_with(b"LASF") {
            return Err(LasFault::NotAScan { found: printable(bytes) });
        }
        let truncated = |needed_bytes| LasFault::HeaderTruncated { file_bytes, needed_bytes };
        if bytes.len() < SHORTEST_HEADER_BYTES {
            return Err(truncated(SHORTEST_HEADER_BYTES as u64));
        }
        let [major, minor] = [bytes[24], bytes[25]];
        let least_bytes = match (major, minor) {
            // Version 1.3 added one pointer; headers of 1.3 without it are seen and read as 1.2.
            (1, 0..=3) => SHORTEST_HEADER_BYTES as u16,
            // Version 1.5 has 18 bytes more behind, which say nothing that reading needs.
            (1, 4 | 5) => LONGEST_HEADER_BYTES as u16,
            _ => return Err(LasFault::UnknownVersion { major, minor }),
        };
        let header_bytes = u16::from_le_bytes([bytes[94], bytes[95]]);
        if header_bytes < least_bytes {
            return Err(LasFault::HeaderSize { header_bytes, minor, least_bytes });
        }
        if bytes.len() < usize::from(header_bytes) {
            return Err(truncated(u64::from(header_bytes)));
        }

        // Missing trailing fields read as 0; bytes after the header never stand in for them.
        let mut padded = bytes[..usize::from(header_bytes)].to_vec();
        padded.resize(padded.len().max(LONGEST_HEADER_BYTES), 0);
        padded[place::MINOR_VERSION] = minor.min(4);
        let raw = las::raw::Header::read_from(&padded[..])
            .map_err(|_| truncated(LONGEST_HEADER_BYTES as u64))?;

        let format_byte = raw.point_data_record_format;
        let format = format_byte & 0x3f;
        let point_format =
            PointFormat::new(format).ok_or(LasFault::UnknownPointFormat { format })?;
        let record_bytes = raw.point_data_record_length;
        let least_bytes = point_format.base_bytes();
        if record_bytes < least_bytes {
            return Err(LasFault::RecordLength { record_bytes, format, least_bytes });
        }
        let offset = u64::from(raw.offset_to_point_data);
        if offset < u64::from(header_bytes) || offset > file_bytes {
            let header_bytes = u64::from(header_bytes);
            return Err(LasFault::PointDataOffset { offset, header_bytes, file_bytes });
        }

        let waveform_inside = raw.global_encoding & 4 == 0;
        Ok(LasHeader {
            minor,
            point_format,
            compressed: format_byte & 0x80 != 0,
            record_bytes,
            header_bytes,
            point_data_offset: raw.offset_to_point_data,
            vlr_count: raw.number_of_variable_length_records,
            evlrs: raw.evlr.map(|evlr| (evlr.start_of_first_evlr, evlr.number_of_evlrs)),
            waveform_start: raw
                .start_of_waveform_data_packet_record
                .filter(|_| waveform_inside && header_bytes >= 235),
            legacy_count: u64::from(raw.number_of_point_records),
            extended_count: raw.large_file.map(|large| large.number_of_point_records),
            legacy_returns: raw.number_of_points_by_return.map(u64::from),
            extended_returns: raw.large_file.map(|large| large.number_of_points_by_return),
            lattice: lattice(&raw)?,
            bounds: Aabb::new(
                DVec3::new(raw.min_x, raw.min_y, raw.min_z),
                DVec3::new(raw.max_x, raw.max_y, raw.max_z),
            ),
            system_identifier: text(&raw.system_identifier),
            generating_software: text(&raw.generating_software),
            creation: (raw.file_creation_day_of_year, raw.file_creation_year),
            global_encoding: raw.global_encoding,
        })
    }

    /// The number of points that the header claims: the 64-bit field where there is one and it
    /// says something, else the 32-bit one.
    pub fn claimed_count(&self) -> u64 {
        self.extended_count.filter(|&count| count > 0).unwrap_or(self.legacy_count)
    }

    /// Every number of points that some part of the header vouches for, best first.
    pub fn count_witnesses(&self) -> Vec<u64> {
        let mut witnesses = vec![self.claimed_count(), self.legacy_count];
        let sums = self.extended_returns.map(|returns| returns.to_vec());
        for returns in sums.into_iter().chain([self.legacy_returns.to_vec()]) {
            witnesses.extend(returns.iter().try_fold(0u64, |sum, &count| sum.checked_add(count)));
        }
        witnesses.retain(|&count| count > 0);
        witnesses
    }

    /// What is odd about the header's own statements, in words.
    pub fn oddities(&self) -> Vec<String> {
        let mut oddities = Vec::new();
        let claimed = self.claimed_count();
        if self.legacy_count != 0 && self.legacy_count != claimed {
            oddities.push(format!(
                "the header claims {} points (byte 107) and {claimed} points (byte 247)",
                self.legacy_count
            ));
        }
        let Aabb { min, max } = self.bounds;
        if claimed > 0 && !(min.is_finite() && max.is_finite() && min.cmple(max).all()) {
            oddities.push("the header's bounds are inverted or not finite (byte 179)".to_string());
        }
        oddities
    }
}

fn lattice(raw: &las::raw::Header) -> Result<Lattice, LasFault> {
    let scale = DVec3::new(raw.x_scale_factor, raw.y_scale_factor, raw.z_scale_factor);
    let offset = DVec3::new(raw.x_offset, raw.y_offset, raw.z_offset);
    for (i, axis) in ['x', 'y', 'z'].into_iter().enumerate() {
        let byte = |start: usize| (start + 8 * i) as u64;
        if !(scale[i].is_finite() && scale[i] > 0.0) {
            let byte = byte(place::SCALE);
            return Err(LasFault::Scale { axis, value: scale[i], byte });
        }
        if !offset[i].is_finite() {
            let byte = byte(place::OFFSET);
            return Err(LasFault::Offset { axis, value: offset[i], byte });
        }
        // A subnormal scale has no finite inverse.
        let reach = scale[i] * 2f64.powi(32) + offset[i].abs();
        if !reach.is_finite() || !scale[i].is_normal() {
            return Err(LasFault::Lattice { axis, scale: scale[i], offset: offset[i] });
        }
    }
    Ok(Lattice { scale, offset })
}

/// The text of a field that zeros fill up.
pub(super) fn text(field: &[u8]) -> String {
    let end = field.iter().position(|&byte| byte == 0).unwrap_or(field.len());
    String::from_utf8_lossy(&field[..end]).trim_end().to_string()
}

/// The first bytes of a file, fit for one line.
fn printable(bytes: &[u8]) -> String {
    let head = &bytes[..bytes.len().min(8)];
    format!("\"{}\"", head.escape_ascii())
}
