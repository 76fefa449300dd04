//! What stands around the points of a LAS file: header, records before and records after them.

use std::io::{self, Read};
use std::path::Path;

use super::error::WriteError;
use super::file::OutputFile;
use crate::input::{
    EVLR_HEADER_BYTES, LasHeader, LasTemplate, describes_extra_bytes, evlr_header, place,
};
use crate::points::record_coordinates;

/// The bytes between header and points, and the number of records in them: the template's, without
/// those that no longer hold, and with the description of the compression if there is one.
pub(super) fn vlr_region(template: &LasTemplate, laszip: Option<&[u8]>) -> (Vec<u8>, u32) {
    let bytes = template.vlr_bytes();
    let (mut region, mut count) = (Vec::new(), 0);
    let mut waiting = laszip;
    let mut end = 0;
    for vlr in template.vlrs() {
        let whole = vlr.whole();
        end = whole.end as usize;
        let kept = if vlr.is_laszip() {
            waiting.take()
        } else {
            // Points are not in the order that these records describe.
            (!vlr.is_copc()).then_some(&bytes[whole.start as usize..end])
        };
        region.extend_from_slice(kept.unwrap_or_default());
        count += u32::from(kept.is_some());
    }
    if let Some(record) = waiting {
        region.extend_from_slice(record);
        count += 1;
    }
    region.extend_from_slice(&bytes[end..]);
    (region, count)
}

/// Extended records that were copied behind the points.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CopiedRecords {
    /// How many.
    pub count: u32,
    /// Where the waveforms stand, 0 without any.
    pub waveforms: u64,
}

/// Copies the extended records that `evlrs` gives, whole, one after the other, except those that
/// describe an order of points, and those that describe extra bytes if the template does.
pub(super) fn copy_evlrs(
    file: &mut OutputFile,
    evlrs: &mut dyn Read,
    template_describes: bool,
) -> Result<CopiedRecords, WriteError> {
    let mut copied = CopiedRecords::default();
    for index in 1.. {
        let mut header = [0; EVLR_HEADER_BYTES];
        let got = read_fully(evlrs, &mut header);
        let got = got.map_err(|source| WriteError::io("read EVLRs for", source, file.path()))?;
        if got == 0 {
            break;
        }
        let path = file.path().to_path_buf();
        let fault = |reason: String| WriteError::Evlr { index, reason, path: path.clone() };
        let evlr = (got == header.len()).then(|| evlr_header(&header, 0)).flatten();
        let evlr = evlr.ok_or_else(|| fault(format!("header of {got} bytes")))?;
        let mut data = evlrs.take(evlr.data.end);
        let is_left_out = evlr.is_copc() || describes_extra_bytes(&evlr) && template_describes;
        let bytes = if is_left_out {
            io::copy(&mut data, &mut io::sink())
                .map_err(|source| WriteError::io("read EVLRs for", source, file.path()))?
        } else {
            if evlr.is_waveform_data() {
                copied.waveforms = file.end();
            }
            file.put(&header)?;
            copied.count += 1;
            file.put_all_of(&mut data)?
        };
        if bytes != evlr.data.end {
            return Err(fault(format!("{bytes} bytes of data, its header says {}", evlr.data.end)));
        }
    }
    Ok(copied)
}

/// What the header tells about the points that were written.
#[derive(Clone, Debug)]
pub(super) struct Tally {
    /// Number of points.
    pub points: u64,
    returns: [u64; 16],
    min: [i32; 3],
    max: [i32; 3],
}

impl Tally {
    /// Of no point.
    pub const NONE: Tally =
        Tally { points: 0, returns: [0; 16], min: [i32::MAX; 3], max: [i32::MIN; 3] };

    /// Takes in records of a header's format.
    pub fn add(&mut self, records: &[u8], header: &LasHeader) {
        let format = header.point_format;
        for record in records.chunks_exact(usize::from(header.record_bytes)) {
            self.points += 1;
            self.returns[usize::from(format.return_number(record))] += 1;
            for (axis, coordinate) in record_coordinates(record).into_iter().enumerate() {
                self.min[axis] = self.min[axis].min(coordinate);
                self.max[axis] = self.max[axis].max(coordinate);
            }
        }
    }

    /// Takes in what another tally saw.
    pub fn join(&mut self, other: &Tally) {
        self.points += other.points;
        for (count, more) in self.returns.iter_mut().zip(other.returns) {
            *count += more;
        }
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(other.min[axis]);
            self.max[axis] = self.max[axis].max(other.max[axis]);
        }
    }

    /// Writes counts and bounds into a header's bytes.
    pub fn put_into(
        &self,
        header: &mut [u8],
        template: &LasHeader,
        path: &Path,
    ) -> Result<(), WriteError> {
        let count_fits = u32::try_from(self.points);
        let large = template.minor >= 4;
        let legacy = match count_fits {
            // The 32-bit fields of version 1.4 stay 0 for the formats that older readers do not
            // know, unless the scan's writer thought otherwise.
            Ok(_) if large && template.point_format.is_extended() && template.legacy_count == 0 => {
                None
            }
            Ok(count) => Some(count),
            Err(_) if large => None,
            Err(_) => {
                let (points, minor) = (self.points, template.minor);
                return Err(WriteError::TooManyPoints { points, minor, path: path.into() });
            }
        };
        put(header, place::LEGACY_COUNT, &legacy.unwrap_or(0).to_le_bytes());
        for (i, &count) in self.returns[1..=5].iter().enumerate() {
            let count = if legacy.is_some() { count as u32 } else { 0 };
            put(header, place::LEGACY_RETURNS + 4 * i, &count.to_le_bytes());
        }
        if large {
            put(header, place::COUNT, &self.points.to_le_bytes());
            for (i, &count) in self.returns[1..].iter().enumerate() {
                put(header, place::RETURNS + 8 * i, &count.to_le_bytes());
            }
        }
        for axis in 0..3 {
            let world = |integers: [i32; 3]| {
                let integers = integers.map(i64::from).into();
                if self.points > 0 { template.lattice.world(integers)[axis] } else { 0.0 }
            };
            put(header, place::BOUNDS + 16 * axis, &world(self.max).to_le_bytes());
            put(header, place::BOUNDS + 16 * axis + 8, &world(self.min).to_le_bytes());
        }
        Ok(())
    }
}

/// Replaces bytes.
pub(super) fn put(bytes: &mut [u8], at: usize, value: &[u8]) {
    bytes[at..at + value.len()].copy_from_slice(value);
}

/// Fills the buffer as far as the source goes.
fn read_fully(source: &mut dyn Read, buffer: &mut [u8]) -> io::Result<usize> {
    let mut filled = 0;
    while filled < buffer.len() {
        match source.read(&mut buffer[filled..]) {
            Ok(0) => break,
            Ok(count) => filled += count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(filled)
}
