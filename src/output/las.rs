//! LAS and LAZ files from raw records.
//!
//! What the scan said about itself is written back byte for byte; counts, counts by return and
//! bounds are those of the points that were written. LAZ chunks hold 50,000 points and are
//! compressed in parallel; their bytes do not depend on the number of threads. The file stands
//! under a temporary name beside its target until it is complete.
//!
//! Source: ASPRS, "LAS Specification 1.4 - R15"; Isenburg, "LASzip", 2013.

use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use laz::laszip::{ChunkTable, ChunkTableEntry};
use laz::record::{
    LayeredPointRecordCompressor, RecordCompressor, SequentialPointRecordCompressor,
};
use laz::{LazItem, LazItemRecordBuilder, LazVlr, LazVlrBuilder};
use rayon::prelude::*;
use tempfile::NamedTempFile;

use crate::input::{
    EVLR_HEADER_BYTES, LasHeader, LasTemplate, VLR_HEADER_BYTES, evlr_header, place, without_panic,
};
use crate::points::{Schema, record_coordinates};

const CHUNK_POINTS: usize = 50_000;
const BUFFER_BYTES: usize = 1 << 20;

/// How points are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Compression {
    /// Plain records: LAS.
    None,
    /// Chunks of compressed records: LAZ.
    Laz,
}

/// A file that could not be written, and why.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LasWriteError {
    /// The operating system refused.
    #[error("cannot {action}: {source}: {}", path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// The system's answer.
        source: io::Error,
        /// The file.
        path: PathBuf,
    },
    /// Records of another size than the header's.
    #[error("records of {found} bytes, the header says {expected}: {}", path.display())]
    RecordBytes {
        /// Size of the records at hand.
        found: u32,
        /// Size that the header states.
        expected: u16,
        /// The file.
        path: PathBuf,
    },
    /// More points than the version's header can count.
    #[error("{points} points, LAS 1.{minor} counts up to 4294967295: {}", path.display())]
    TooManyPoints {
        /// Points written.
        points: u64,
        /// Minor version.
        minor: u8,
        /// The file.
        path: PathBuf,
    },
    /// More bytes before the points than the header can point over.
    #[error("{bytes} bytes of variable length records do not fit: {}", path.display())]
    TooManyRecords {
        /// Bytes between header and points.
        bytes: usize,
        /// The file.
        path: PathBuf,
    },
    /// Records that cannot be compressed.
    #[error("cannot compress: {reason}: {}", path.display())]
    Compress {
        /// What the compressor said.
        reason: String,
        /// The file.
        path: PathBuf,
    },
    /// An extended record that ends before its length.
    #[error("EVLR {index}: {reason}: {}", path.display())]
    Evlr {
        /// Counted from 1.
        index: u32,
        /// What is wrong.
        reason: String,
        /// The file.
        path: PathBuf,
    },
}

/// What was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WriteReport {
    /// Points.
    pub points: u64,
    /// Length of the file.
    pub bytes: u64,
}

/// Writes one LAS or LAZ file. Dropped before [`finish`](Self::finish), it leaves nothing behind.
pub struct LasWriter {
    path: PathBuf,
    file: BufWriter<NamedTempFile>,
    template: LasHeader,
    header: Vec<u8>,
    tally: Tally,
    laz: Option<LazChunks>,
}

impl LasWriter {
    /// Starts a file of the template's version and point format, for records of that schema.
    pub fn create(
        path: &Path,
        template: &LasTemplate,
        schema: &Schema,
        compression: Compression,
    ) -> Result<Self, LasWriteError> {
        let parsed = template.header();
        let expected = parsed.record_bytes;
        if schema.record_bytes != u32::from(expected) {
            let (found, path) = (schema.record_bytes, path.to_path_buf());
            return Err(LasWriteError::RecordBytes { found, expected, path });
        }
        let laz =
            match compression {
                Compression::None => None,
                Compression::Laz => Some(LazChunks::new(&parsed).map_err(|reason| {
                    LasWriteError::Compress { reason, path: path.to_path_buf() }
                })?),
            };
        let (region, count) = vlr_region(template, laz.as_ref().map(|laz| &laz.vlr));
        let points_start = u32::try_from(template.header_bytes().len() + region.len());
        let points_start = points_start.map_err(|_| LasWriteError::TooManyRecords {
            bytes: region.len(),
            path: path.to_path_buf(),
        })?;

        let mut header = template.header_bytes().to_vec();
        put(&mut header, place::POINT_DATA_OFFSET, &points_start.to_le_bytes());
        put(&mut header, place::VLR_COUNT, &count.to_le_bytes());
        let compressed_bit = if laz.is_some() { 0x80 } else { 0 };
        header[place::POINT_FORMAT] = parsed.point_format.number() | compressed_bit;

        let file = temporary_beside(path);
        let file = file.map_err(|source| io_error("create", source, path))?;
        let mut writer = LasWriter {
            path: path.to_path_buf(),
            file: BufWriter::with_capacity(BUFFER_BYTES, file),
            tally: Tally::NONE,
            template: parsed,
            header,
            laz,
        };
        // Counts are still the template's; the finished header takes this one's place.
        let opening = [&writer.header[..], &region[..]].concat();
        writer.put_out(&opening)?;
        if writer.laz.is_some() {
            writer.put_out(&NO_CHUNK_TABLE.to_le_bytes())?;
        }
        Ok(writer)
    }

    /// Appends whole records.
    pub fn write(&mut self, records: &[u8]) -> Result<(), LasWriteError> {
        let record_bytes = usize::from(self.template.record_bytes);
        assert!(records.len().is_multiple_of(record_bytes), "records are written whole");
        self.tally.add(records, &self.template);
        if self.laz.is_none() {
            return self.put_out(records);
        }
        let mut rest = records;
        while !rest.is_empty() {
            let laz = self.laz.as_mut().expect("compression was asked for");
            rest = laz.fill(rest);
            if laz.is_full() {
                self.compress()?;
            }
        }
        Ok(())
    }

    /// Ends the points, appends the extended records that `evlrs` gives (whole, one after the
    /// other; `io::empty()` for none), and puts the file under its name.
    pub fn finish(mut self, evlrs: &mut dyn Read) -> Result<WriteReport, LasWriteError> {
        self.finish_points()?;
        self.append_evlrs(evlrs)?;
        self.tally.put_into(&mut self.header, &self.template, &self.path)?;
        let bytes = self.position()?;
        self.at(SeekFrom::Start(0))?;
        let header = std::mem::take(&mut self.header);
        self.put_out(&header)?;

        let LasWriter { path, file, tally, .. } = self;
        let write_error = |source| io_error("write", source, &path);
        let file = file.into_inner().map_err(|error| write_error(error.into_error()))?;
        file.as_file().sync_all().map_err(write_error)?;
        file.persist(&path).map_err(|error| io_error("rename to", error.error, &path))?;
        Ok(WriteReport { points: tally.points, bytes })
    }

    fn finish_points(&mut self) -> Result<(), LasWriteError> {
        if self.laz.is_none() {
            return Ok(());
        }
        self.compress()?;
        let table_start = self.position()?;
        let laz = self.laz.as_ref().expect("compression was asked for");
        let mut table = Vec::new();
        let written = laz.table.write_to(&mut table, &laz.vlr);
        written.map_err(|source| io_error("write", source, &self.path))?;
        self.put_out(&table)?;
        let end = self.position()?;
        let points_start = read_u32(&self.header, place::POINT_DATA_OFFSET);
        self.at(SeekFrom::Start(u64::from(points_start)))?;
        self.put_out(&table_start.to_le_bytes())?;
        self.at(SeekFrom::Start(end))
    }

    /// Compresses the chunks at hand and writes them.
    fn compress(&mut self) -> Result<(), LasWriteError> {
        let laz = self.laz.as_mut().expect("compression was asked for");
        let chunks = laz
            .compress()
            .map_err(|reason| LasWriteError::Compress { reason, path: self.path.clone() })?;
        for chunk in chunks {
            let written = self.file.write_all(chunk);
            written.map_err(|source| io_error("write", source, &self.path))?;
        }
        Ok(())
    }

    fn append_evlrs(&mut self, evlrs: &mut dyn Read) -> Result<(), LasWriteError> {
        let first = self.position()?;
        let (mut found, mut written, mut waveforms) = (0, 0u32, 0);
        loop {
            let mut header = [0; EVLR_HEADER_BYTES];
            let got = read_fully(evlrs, &mut header);
            let got = got.map_err(|source| io_error("read EVLRs for", source, &self.path))?;
            if got == 0 {
                break;
            }
            found += 1;
            let fault = |reason: String| LasWriteError::Evlr {
                index: found,
                reason,
                path: self.path.clone(),
            };
            let evlr = (got == header.len()).then(|| evlr_header(&header, 0)).flatten();
            let evlr = evlr.ok_or_else(|| fault(format!("header of {got} bytes")))?;
            let mut data = evlrs.take(evlr.data.end);
            let copied = if evlr.is_copc() {
                io::copy(&mut data, &mut io::sink())
            } else {
                if evlr.is_waveform_data() {
                    waveforms = self.position()?;
                }
                self.put_out(&header)?;
                written += 1;
                io::copy(&mut data, &mut self.file)
            };
            let copied = copied.map_err(|source| io_error("write", source, &self.path))?;
            if copied != evlr.data.end {
                let reason = format!("{copied} bytes of data, its header says {}", evlr.data.end);
                return Err(LasWriteError::Evlr { index: found, reason, path: self.path.clone() });
            }
        }
        if self.template.minor >= 4 {
            let start = if written > 0 { first } else { 0 };
            put(&mut self.header, place::EVLR_START, &start.to_le_bytes());
            put(&mut self.header, place::EVLR_COUNT, &written.to_le_bytes());
        }
        if self.template.waveform_start.is_some() {
            put(&mut self.header, place::WAVEFORM_START, &waveforms.to_le_bytes());
        }
        Ok(())
    }

    fn put_out(&mut self, bytes: &[u8]) -> Result<(), LasWriteError> {
        self.file.write_all(bytes).map_err(|source| io_error("write", source, &self.path))
    }

    fn position(&mut self) -> Result<u64, LasWriteError> {
        self.file.stream_position().map_err(|source| io_error("write", source, &self.path))
    }

    fn at(&mut self, place: SeekFrom) -> Result<(), LasWriteError> {
        let moved = self.file.seek(place);
        moved.map(|_| ()).map_err(|source| io_error("write", source, &self.path))
    }
}

/// What a LAZ file holds where its chunk table's place is not known yet.
const NO_CHUNK_TABLE: i64 = -1;

/// Points that wait for compression, and the chunks that were written.
struct LazChunks {
    vlr: LazVlr,
    record_bytes: usize,
    table: ChunkTable,
    waiting: Vec<u8>,
    most_waiting_bytes: usize,
    compressed: Vec<Vec<u8>>,
}

impl LazChunks {
    fn new(header: &LasHeader) -> Result<Self, String> {
        let format = header.point_format;
        let extra = header.record_bytes - format.base_bytes();
        let items = LazItemRecordBuilder::default_for_point_format_id(format.number(), extra)
            .map_err(|error| error.to_string())?;
        let vlr = LazVlrBuilder::new(items).with_fixed_chunk_size(CHUNK_POINTS as u32).build();
        let vlr = with_known_versions(&vlr).map_err(|error| error.to_string())?;
        let record_bytes = usize::from(header.record_bytes);
        let most_chunks = 2 * rayon::current_num_threads();
        Ok(LazChunks {
            vlr,
            record_bytes,
            table: ChunkTable::default(),
            waiting: Vec::new(),
            most_waiting_bytes: most_chunks * CHUNK_POINTS * record_bytes,
            compressed: Vec::new(),
        })
    }

    /// Takes what there is room for; returns the rest.
    fn fill<'a>(&mut self, records: &'a [u8]) -> &'a [u8] {
        let room = self.most_waiting_bytes - self.waiting.len();
        let (taken, rest) = records.split_at(room.min(records.len()));
        self.waiting.extend_from_slice(taken);
        rest
    }

    fn is_full(&self) -> bool {
        self.waiting.len() == self.most_waiting_bytes
    }

    /// Compresses everything that waits; the last chunk may be a short one, so only the end of the
    /// points may call this when not full.
    fn compress(&mut self) -> Result<impl Iterator<Item = &[u8]>, String> {
        let chunk_bytes = CHUNK_POINTS * self.record_bytes;
        let count = self.waiting.len().div_ceil(chunk_bytes);
        self.compressed.resize_with(self.compressed.len().max(count), Vec::new);
        let items = self.vlr.items();
        let chunks = self.waiting.par_chunks(chunk_bytes);
        let compressed = self.compressed.par_iter_mut().zip(chunks);
        compressed.try_for_each(|(output, records)| -> Result<(), String> {
            let memory = std::mem::take(output);
            let outcome = without_panic(|| compress_chunk(items, records, memory));
            *output = outcome?.map_err(|error| error.to_string())?;
            Ok(())
        })?;
        for (chunk, records) in self.compressed.iter().zip(self.waiting.chunks(chunk_bytes)) {
            self.table.push(ChunkTableEntry {
                point_count: (records.len() / self.record_bytes) as u64,
                byte_count: chunk.len() as u64,
            });
        }
        self.waiting.clear();
        Ok(self.compressed[..count].iter().map(Vec::as_slice))
    }
}

/// One chunk's bytes, in the given memory.
fn compress_chunk(
    items: &Vec<LazItem>,
    records: &[u8],
    mut memory: Vec<u8>,
) -> laz::Result<Vec<u8>> {
    memory.clear();
    let layered = items.iter().any(|item| item.version() >= 3);
    let mut compressor: Box<dyn RecordCompressor<Vec<u8>>> = if layered {
        Box::new(LayeredPointRecordCompressor::new(memory))
    } else {
        Box::new(SequentialPointRecordCompressor::new(memory))
    };
    compressor.set_fields_from(items)?;
    compressor.compress_many(records)?;
    compressor.done()?;
    Ok(compressor.box_into_inner())
}

/// The same description with the versions of fields that LASzip knows: the crate `laz` calls the
/// one coding of wave packets that there is for formats 4 and 5 version 2, LASzip version 1.
fn with_known_versions(vlr: &LazVlr) -> laz::Result<LazVlr> {
    const ITEMS: usize = 34;
    const WAVE_PACKET_13: [u8; 2] = 9u16.to_le_bytes();
    let mut bytes = Vec::new();
    vlr.write_to(&mut bytes)?;
    for item in bytes[ITEMS..].chunks_exact_mut(6).filter(|item| item[..2] == WAVE_PACKET_13) {
        item[4..].copy_from_slice(&1u16.to_le_bytes());
    }
    LazVlr::from_buffer(bytes)
}

/// The bytes between header and points, and the number of records in them: the template's, without
/// those that no longer hold, and with the description of the compression if there is one.
fn vlr_region(template: &LasTemplate, laszip: Option<&LazVlr>) -> (Vec<u8>, u32) {
    let bytes = template.vlr_bytes();
    let laszip = laszip.map(laszip_record);
    let (mut region, mut count) = (Vec::new(), 0);
    let mut waiting = laszip.as_deref();
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

fn laszip_record(vlr: &LazVlr) -> Vec<u8> {
    let mut data = Vec::new();
    vlr.write_to(&mut data).expect("memory takes every write");
    let mut record = vec![0; VLR_HEADER_BYTES];
    put(&mut record, 2, LazVlr::USER_ID.as_bytes());
    put(&mut record, 18, &LazVlr::RECORD_ID.to_le_bytes());
    put(&mut record, 20, &(data.len() as u16).to_le_bytes());
    put(&mut record, 22, LazVlr::DESCRIPTION.as_bytes());
    record.extend(data);
    record
}

/// What the header tells about the points that were written.
struct Tally {
    points: u64,
    returns: [u64; 16],
    min: [i32; 3],
    max: [i32; 3],
}

impl Tally {
    const NONE: Tally =
        Tally { points: 0, returns: [0; 16], min: [i32::MAX; 3], max: [i32::MIN; 3] };

    fn add(&mut self, records: &[u8], header: &LasHeader) {
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

    fn put_into(
        &self,
        header: &mut [u8],
        template: &LasHeader,
        path: &Path,
    ) -> Result<(), LasWriteError> {
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
                return Err(LasWriteError::TooManyPoints { points, minor, path: path.into() });
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

fn put(bytes: &mut [u8], at: usize, value: &[u8]) {
    bytes[at..at + value.len()].copy_from_slice(value);
}

fn read_u32(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().expect("the slice has 4 bytes"))
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

/// A file under a temporary name in the target's folder, with the permissions of a plain new file.
fn temporary_beside(path: &Path) -> io::Result<NamedTempFile> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let name = path.file_name().ok_or(io::ErrorKind::InvalidInput)?;
    let prefix = format!(".{}.", name.to_string_lossy());
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(".tmp");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder.unwrap_or(Path::new(".")))
}

fn io_error(action: &'static str, source: io::Error, path: &Path) -> LasWriteError {
    LasWriteError::Io { action, source, path: path.to_path_buf() }
}
