//! Decoding of LAZ chunks, straight from the file into records.
//!
//! The record decompressors are the crate `laz`'s; chunks, ends and lengths are checked here,
//! because those decompressors trust them: they allocate what a layer claims, and panic on some
//! damage. Memory is one window of the file and one batch of records, plus, for layered chunks,
//! the compressed layers of one chunk, which are checked to be in the file.

use std::io::{self, Read, Seek, SeekFrom};
use std::ops::{Range, RangeInclusive};

use laz::LazItemType;
use laz::record::{
    LayeredPointRecordDecompressor, RecordDecompressor, SequentialPointRecordDecompressor,
};

use super::error::LasFault;
use super::guard::without_panic;
use super::las_layout::batch_records;
use super::laz_layout::{ChunkRule, LazCoding};
use super::laz_point14::Point14;
use super::laz_times::PointwiseTimes;
use super::positioned_file::PositionedFile;
use super::scan::{Block, BlockBuffer, RecordSink};

const WINDOW_BYTES: usize = 256 << 10;

/// Reads a range of a file through a window; ends where the range ends.
pub(super) struct ChunkReader<'a> {
    file: &'a PositionedFile,
    window: &'a mut Vec<u8>,
    /// Unread part of the window.
    unread: Range<usize>,
    /// Place in the file of the window's end.
    window_end: u64,
    range: Range<u64>,
}

impl<'a> ChunkReader<'a> {
    /// A reader at the start of `range`, which uses `window` as its memory.
    pub fn new(file: &'a PositionedFile, window: &'a mut Vec<u8>, range: Range<u64>) -> Self {
        window.resize(WINDOW_BYTES, 0);
        ChunkReader { file, window, unread: 0..0, window_end: range.start, range }
    }

    /// Place in the file of the next byte.
    pub fn position(&self) -> u64 {
        self.window_end - self.unread.len() as u64
    }

    #[cold]
    fn refill(&mut self) -> io::Result<()> {
        let left = self.range.end - self.window_end;
        let wanted = (self.window.len() as u64).min(left) as usize;
        let count = self.file.read_at(&mut self.window[..wanted], self.window_end)?;
        if count == 0 && wanted > 0 {
            return Err(io::Error::other("the file became shorter"));
        }
        self.unread = 0..count;
        self.window_end += count as u64;
        Ok(())
    }
}

impl Read for ChunkReader<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.unread.is_empty() {
            self.refill()?;
        }
        let count = self.unread.len().min(buffer.len());
        let from = self.unread.start;
        buffer[..count].copy_from_slice(&self.window[from..from + count]);
        self.unread.start += count;
        Ok(count)
    }

    #[inline]
    fn read_exact(&mut self, mut buffer: &mut [u8]) -> io::Result<()> {
        // Decoders take single bytes: this must stay a compare and a copy.
        if let Some(bytes) = self.window[self.unread.clone()].get(..buffer.len()) {
            buffer.copy_from_slice(bytes);
            self.unread.start += buffer.len();
            return Ok(());
        }
        while !buffer.is_empty() {
            let count = self.read(buffer)?;
            if count == 0 {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
            buffer = &mut buffer[count..];
        }
        Ok(())
    }
}

impl Seek for ChunkReader<'_> {
    /// Seeks within the range; places count from the start of the file.
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let place = match to {
            SeekFrom::Start(place) => Some(place),
            SeekFrom::Current(by) => self.position().checked_add_signed(by),
            SeekFrom::End(by) => self.range.end.checked_add_signed(by),
        };
        let place = place.filter(|place| (self.range.start..=self.range.end).contains(place));
        self.window_end = place.ok_or(io::ErrorKind::InvalidInput)?;
        self.unread = 0..0;
        Ok(self.window_end)
    }
}

/// What stands before the layers of a layered chunk.
pub(super) struct LayerHeader {
    /// Points of the chunk.
    pub points: u64,
    /// Where its layers end.
    pub end: u64,
}

impl LayerHeader {
    /// Reads it, and checks that the layers lie within the block's bytes.
    pub fn read(
        file: &PositionedFile,
        coding: &LazCoding,
        block: &Block,
    ) -> Result<Self, LasFault> {
        let fault = |reason: String| block.fault(block.first_point, reason);
        let record_bytes = u64::from(coding.record_bytes);
        let start = block.bytes.start + record_bytes;
        let layers_start = start + 4 + 4 * coding.layers as u64;
        if layers_start > block.bytes.end {
            return Err(fault("ends before its layers start".to_string()));
        }
        let head = file.read_range(start..layers_start)?;
        let words = head
            .chunks_exact(4)
            .map(|word| u64::from(u32::from_le_bytes(word.try_into().expect("chunks of 4 bytes"))));
        let words: Vec<u64> = words.collect();
        let (points, layers) = words.split_first().expect("the count stands before the layers");
        let points = *points;
        let end = layers_start + layers.iter().sum::<u64>();
        if end > block.bytes.end {
            return Err(fault(format!("its layers end at byte {end}")));
        }
        if points == 0 {
            return Err(fault("says that it holds no point".to_string()));
        }
        Ok(LayerHeader { points, end })
    }
}

type Decompressor<'a> = Box<dyn RecordDecompressor<ChunkReader<'a>> + 'a>;

/// A decompressor for one chunk. `coding` was checked, so the fields are known.
///
/// All fields but those with GPS times are left to `laz`.
fn decompressor<'a>(coding: &LazCoding, reader: ChunkReader<'a>) -> laz::Result<Decompressor<'a>> {
    if coding.layered {
        let mut layered = LayeredPointRecordDecompressor::new(reader);
        for item in &coding.items {
            match item.item_type() {
                LazItemType::Point14 => {
                    layered.add_field_decompressor(Point14::new(item.version()))
                }
                _ => layered.set_fields_from(&vec![*item])?,
            }
        }
        return Ok(Box::new(layered));
    }
    let mut pointwise = SequentialPointRecordDecompressor::new(reader);
    for item in &coding.items {
        match (item.item_type(), item.version()) {
            (LazItemType::GpsTime, 2) => pointwise.add_field_decompressor(PointwiseTimes::new()),
            _ => pointwise.set_fields_from(&vec![*item])?,
        }
    }
    Ok(Box::new(pointwise))
}

/// Decodes a block and hands out its records in batches; returns the number of points.
pub(super) fn decode_block<E: From<LasFault>>(
    file: &PositionedFile,
    coding: &LazCoding,
    block: &Block,
    buffer: &mut BlockBuffer,
    sink: &mut RecordSink<'_, E>,
) -> Result<u64, E> {
    let mut run = Run { file, coding, records: &mut buffer.records, window: &mut buffer.window };
    if !block.is_sequence {
        return run.chunk(block, Some(block.points), sink).map(|(points, _)| points);
    }
    let mut part = block.clone();
    let mut done = 0;
    while done < block.expected_points() {
        part.first_point = block.first_point + done;
        part.wanted = block.wanted.saturating_sub(done);
        part.points = match coding.chunks {
            ChunkRule::Fixed(size) => u64::from(size).min(block.points - done),
            ChunkRule::Variable | ChunkRule::None => block.points - done,
        };
        let expected = (coding.chunks != ChunkRule::Variable).then_some(part.points);
        let (points, end) = run.chunk(&part, expected, sink)?;
        done += points;
        part.chunk += 1;
        part.bytes.start = end;
    }
    Ok(done)
}

struct Run<'a> {
    file: &'a PositionedFile,
    coding: &'a LazCoding,
    records: &'a mut Vec<u8>,
    window: &'a mut Vec<u8>,
}

impl Run<'_> {
    /// Decodes one chunk that starts where the block starts; returns its points and its end.
    ///
    /// `expected` is the number of points where something outside the chunk tells it.
    fn chunk<E: From<LasFault>>(
        &mut self,
        block: &Block,
        expected: Option<u64>,
        sink: &mut RecordSink<'_, E>,
    ) -> Result<(u64, u64), E> {
        let mut points = block.points;
        let mut bytes = block.bytes.clone();
        if self.coding.layered {
            let layers = LayerHeader::read(self.file, self.coding, block)?;
            if expected.is_some_and(|expected| expected != layers.points) {
                let reason = format!("says that it holds {} points, not {points}", layers.points);
                return Err(block.fault(block.first_point, reason).into());
            }
            points = layers.points;
            bytes.end = layers.end;
        }
        let reader = ChunkReader::new(self.file, self.window, bytes.clone());
        let mut decompressor = decompressor(self.coding, reader)
            .map_err(|error| LasFault::Laszip { reason: error.to_string() })?;
        let wants_all = block.wanted >= points;
        points = points.min(block.wanted);
        let record_bytes = usize::from(self.coding.record_bytes);
        let batch = batch_records(self.coding.record_bytes);
        let mut done = 0;
        // The oldest compressor's run has no table: bytes that are left after the claimed points
        // are points that the header does not know.
        let open_ended = block.is_sequence && self.coding.chunks == ChunkRule::None && wants_all;
        loop {
            let wanted = if done < points {
                batch.min(points - done)
            } else if open_ended && decompressor.get().position() < bytes.end {
                batch
            } else {
                break;
            };
            let wanted_bytes = wanted as usize * record_bytes;
            if self.records.len() < wanted_bytes {
                self.records.resize(wanted_bytes, 0);
            }
            let records = &mut self.records[..wanted_bytes];
            let to_end = (done >= points).then_some(bytes.end);
            let (count, failure) = decode_batch(&mut decompressor, records, record_bytes, to_end);
            if count > 0 {
                let decoded = &self.records[..count * record_bytes];
                sink(block.first_point + done, decoded)?;
                done += count as u64;
            }
            match failure {
                Some(_) if done >= points => break,
                Some(reason) => {
                    return Err(block.fault(block.first_point + done, reason).into());
                }
                None if (count as u64) < wanted => break,
                None => {}
            }
        }
        let end = if self.coding.layered { bytes.end } else { decompressor.get().position() };
        Ok((done, end))
    }
}

/// Decodes records until the slice is full or, with `to_end`, until the bytes up to there are used
/// up; returns how many are whole, and what went wrong after those.
fn decode_batch(
    decompressor: &mut Decompressor,
    records: &mut [u8],
    record_bytes: usize,
    to_end: Option<u64>,
) -> (usize, Option<String>) {
    let mut count = 0;
    let outcome = without_panic(|| -> io::Result<()> {
        for record in records.chunks_exact_mut(record_bytes) {
            decompressor.decompress_next(record)?;
            count += 1;
            if to_end.is_some_and(|end| decompressor.get().position() >= end) {
                break;
            }
        }
        Ok(())
    });
    let failure = match outcome {
        Ok(Ok(())) => None,
        Ok(Err(error)) if error.kind() == io::ErrorKind::UnexpectedEof => {
            Some("its bytes end before its points".to_string())
        }
        Ok(Err(error)) => Some(error.to_string()),
        Err(panic) => Some(format!("damaged ({panic})")),
    };
    (count, failure)
}

/// The numbers of points that a pointwise chunk may hold: from where its bytes are used up to
/// where one more point would need a further byte, at most the block's points. `None` if it is
/// damaged or does not use up its bytes.
pub(super) fn measure_chunk(
    file: &PositionedFile,
    coding: &LazCoding,
    block: &Block,
) -> Option<RangeInclusive<u64>> {
    let mut window = Vec::new();
    let reader = ChunkReader::new(file, &mut window, block.bytes.clone());
    let mut decompressor = decompressor(coding, reader).ok()?;
    let mut record = vec![0; usize::from(coding.record_bytes)];
    let (mut least, mut most) = (None, 0);
    // How the decoding ended does not matter here: whatever is wrong shows when the chunk is read.
    let _ = without_panic(|| -> io::Result<()> {
        while most < block.points {
            decompressor.decompress_next(&mut record)?;
            most += 1;
            if decompressor.get().position() == block.bytes.end {
                least.get_or_insert(most);
            }
        }
        Ok(())
    });
    least.map(|least| least..=most)
}
