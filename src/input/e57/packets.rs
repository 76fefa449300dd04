//! Where the bits of each field of a scan stand.
//!
//! A scan's section is a list of packets; each data packet holds a piece of every field's stream.
//! Pieces of a stream follow each other without gaps, however its numbers are cut.

use std::ops::Range;

use super::pages::{Pages, physical};
use crate::input::foreign::ForeignFault;

/// A field's bits for some records.
#[derive(Debug, Default)]
pub struct Stream {
    /// Bytes that hold them, and some zeros behind.
    pub bytes: Vec<u8>,
    /// Where they start in the first byte.
    pub first_bit: u32,
    /// Records.
    pub records: usize,
}

/// Bytes behind a stream's own, so that numbers can be read as whole words.
pub const PADDING_BYTES: usize = 16;

/// The packets of a scan.
#[derive(Debug)]
pub struct Packets {
    /// Bits of a record, per stream.
    widths: Vec<u32>,
    /// Per packet: logical place of its first stream's piece.
    places: Vec<u64>,
    /// Per packet and stream, and once more at the end: bytes of the stream before it.
    before: Vec<u64>,
}

/// Most bytes that the pieces of a block span before they are read one by one.
const MOST_SPAN_BYTES: u64 = 16 << 20;

impl Packets {
    /// Goes through the packets of the section at a physical place until they hold all records.
    pub fn find(
        pages: &Pages,
        section: u64,
        records: u64,
        widths: &[u32],
    ) -> Result<Self, ForeignFault> {
        let streams = widths.len();
        let mut packets =
            Packets { widths: widths.to_vec(), places: Vec::new(), before: vec![0; streams] };
        if records == 0 {
            return Ok(packets);
        }
        // Fields with one possible value take no bits; without any other nothing bounds the count.
        if widths.iter().all(|&width| width == 0) && records > pages.file_bytes() {
            let reason = format!("{records} records without a single bit");
            return Err(ForeignFault::at_byte(section, reason));
        }
        let needed: Vec<u128> = widths
            .iter()
            .map(|&width| (u128::from(records) * u128::from(width)).div_ceil(8))
            .collect();
        let start = pages.logical(section)?;
        let mut head = Vec::new();
        pages.read(start, 32, &mut head)?;
        let word = |at: usize| {
            u64::from_le_bytes(head[at..at + 8].try_into().expect("the slice has 8 bytes"))
        };
        if head[0] != 1 {
            let reason = format!("section of kind {}, expected 1 for points", head[0]);
            return Err(ForeignFault::at_byte(section, reason));
        }
        let mut at = pages.logical(word(16))?;
        let end = start.saturating_add(word(8)).min(pages.logical_bytes());
        let most_entries = (pages.file_bytes() / 16).max(4 << 20) as usize;
        let holds_all = |before: &[u64]| {
            let last = &before[before.len() - streams..];
            last.iter().zip(&needed).all(|(&have, &need)| u128::from(have) >= need)
        };
        while !holds_all(&packets.before) {
            if at + 4 > end {
                return Err(packets.truncated(records, at));
            }
            at = packets.take_packet(pages, at, end)?;
            if packets.before.len() > most_entries {
                let reason = "its packets are too small to be worth a file of this length";
                return Err(ForeignFault::at_byte(physical(at), reason));
            }
        }
        Ok(packets)
    }

    /// Takes in the packet at a logical place; returns the place behind it.
    fn take_packet(&mut self, pages: &Pages, at: u64, end: u64) -> Result<u64, ForeignFault> {
        let fault = |reason: String| Err(ForeignFault::at_byte(physical(at), reason));
        let mut head = Vec::new();
        pages.read(at, 4, &mut head)?;
        let length = u64::from(u16::from_le_bytes([head[2], head[3]])) + 1;
        if at + length > end {
            return fault(format!("a packet of {length} bytes leaves its section"));
        }
        match head[0] {
            // Index packets and padding.
            0 | 2 => return Ok(at + length.next_multiple_of(4)),
            1 => {}
            kind => return fault(format!("packet of unknown kind {kind}")),
        }
        let streams = self.widths.len();
        let table_bytes = 6 + 2 * streams;
        if length < table_bytes as u64 {
            return fault(format!("a packet of {length} bytes with {streams} streams"));
        }
        pages.read(at + 4, table_bytes - 4, &mut head)?;
        let count = usize::from(u16::from_le_bytes([head[4], head[5]]));
        if count != streams {
            return fault(format!("a packet of {count} streams, points have {streams} fields"));
        }
        let sizes = head[6..].chunks_exact(2);
        let sizes = sizes.map(|size| u64::from(u16::from_le_bytes([size[0], size[1]])));
        let total: u64 = sizes.clone().sum();
        if table_bytes as u64 + total > length {
            return fault(format!("streams of {total} bytes in a packet of {length}"));
        }
        if total > 0 {
            self.places.push(at + table_bytes as u64);
            let last = self.before.len() - streams;
            for (stream, size) in sizes.enumerate() {
                self.before.push(self.before[last + stream] + size);
            }
        }
        Ok(at + length.next_multiple_of(4))
    }

    fn truncated(&self, records: u64, at: u64) -> ForeignFault {
        let last = &self.before[self.before.len() - self.widths.len()..];
        let whole = last.iter().zip(&self.widths).filter(|(_, width)| **width > 0);
        let whole = whole.map(|(&bytes, &width)| bytes.saturating_mul(8) / u64::from(width));
        let whole = whole.min().unwrap_or(0);
        let reason = format!("the points end after record {whole} of {records}");
        ForeignFault::at_byte(physical(at), reason)
    }

    /// Bytes of a stream before a packet.
    fn start(&self, packet: usize, stream: usize) -> u64 {
        self.before[packet * self.widths.len() + stream]
    }

    /// The packet with a byte of a stream.
    fn packet_with(&self, stream: usize, byte: u64) -> usize {
        let (mut low, mut high) = (0, self.places.len());
        // The last packet that starts at or before the byte.
        while high - low > 1 {
            let middle = low.midpoint(high);
            if self.start(middle, stream) <= byte {
                low = middle;
            } else {
                high = middle;
            }
        }
        low
    }

    /// The streams of some records of the scan; `window` is memory for reading.
    pub fn read(
        &self,
        pages: &Pages,
        records: Range<u64>,
        window: &mut Vec<u8>,
    ) -> Result<Vec<Stream>, ForeignFault> {
        let count = (records.end - records.start) as usize;
        let bytes_of = |width: u32| {
            let bits = |record: u64| u128::from(record) * u128::from(width);
            let start = (bits(records.start) / 8) as u64;
            (start..bits(records.end).div_ceil(8) as u64, (bits(records.start) % 8) as u32)
        };
        let used = || self.widths.iter().enumerate().filter(|(_, width)| **width > 0);
        let firsts = used().map(|(s, &width)| self.packet_with(s, bytes_of(width).0.start));
        let lasts = used().map(|(s, &width)| self.packet_with(s, bytes_of(width).0.end - 1));
        let (first, last) = (firsts.min().unwrap_or(0), lasts.max().unwrap_or(0));
        window.clear();
        let mut span = None;
        if let (Some(&from), Some(&to)) = (self.places.get(first), self.places.get(last)) {
            let to = to + self.packet_bytes(last);
            if to - from <= MOST_SPAN_BYTES {
                pages.read(from, (to - from) as usize, window)?;
                span = Some(from);
            }
        }
        let mut streams = Vec::with_capacity(self.widths.len());
        for (index, &width) in self.widths.iter().enumerate() {
            let (wanted, first_bit) = bytes_of(width);
            let mut bytes =
                Vec::with_capacity((wanted.end - wanted.start) as usize + PADDING_BYTES);
            let mut at = wanted.start;
            let mut packet = if width > 0 { self.packet_with(index, at) } else { 0 };
            while at < wanted.end {
                let (start, end) = (self.start(packet, index), self.start(packet + 1, index));
                let part = at..wanted.end.min(end);
                if part.start < part.end {
                    let place = self.piece_place(packet, index) + (part.start - start);
                    let length = (part.end - part.start) as usize;
                    match span {
                        Some(from) => {
                            let inside = (place - from) as usize;
                            bytes.extend_from_slice(&window[inside..inside + length]);
                        }
                        None => pages.read(place, length, &mut bytes)?,
                    }
                    at = part.end;
                }
                packet += 1;
            }
            bytes.resize(bytes.len() + PADDING_BYTES, 0);
            streams.push(Stream { bytes, first_bit, records: count });
        }
        Ok(streams)
    }

    /// Logical place of a packet's piece of a stream.
    fn piece_place(&self, packet: usize, stream: usize) -> u64 {
        let sizes = (0..stream).map(|s| self.start(packet + 1, s) - self.start(packet, s));
        self.places[packet] + sizes.sum::<u64>()
    }

    /// Bytes of all pieces of a packet.
    fn packet_bytes(&self, packet: usize) -> u64 {
        let streams = 0..self.widths.len();
        streams.map(|s| self.start(packet + 1, s) - self.start(packet, s)).sum()
    }
}
