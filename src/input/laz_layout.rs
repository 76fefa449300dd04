//! Where the compressed chunks of a LAZ file stand, and how many points each holds.
//!
//! The record that describes the compression and the chunk table are judged against the point
//! format and the length of the file before anything is allocated. Files without a chunk table
//! (its writer could not seek back, or the oldest compressor) are one block, read in sequence.
//!
//! Source: Isenburg, "LASzip", 2013; the layout of the table as in LASzip's `lasreadpoint.cpp`.

use laz::decoders::ArithmeticDecoder;
use laz::decompressors::IntegerDecompressorBuilder;
use laz::{LazItem, LazItemType, LazVlr};

use super::error::LasFault;
use super::guard::without_panic;
use super::header::LasHeader;
use super::las_layout::Layout;
use super::laz_decode::{ChunkReader, LayerHeader, measure_chunk};
use super::positioned_file::PositionedFile;
use super::scan::{Block, BlockBuffer};

/// Most extra bytes of a compressed record: the decoder keeps about 2.3 KiB of model for each, four
/// times over, whatever the file holds.
const MOST_EXTRA_BYTES: u16 = 4096;
/// Last chunks above this size are not decoded when a file is opened.
const MOST_MEASURED_BYTES: u64 = 8 << 20;

/// How the records of a file are compressed.
#[derive(Clone, Debug)]
pub(super) struct LazCoding {
    /// The fields of a record, in order.
    pub items: Vec<LazItem>,
    /// Whether each field's values stand apart within a chunk.
    pub layered: bool,
    /// Number of such layers.
    pub layers: usize,
    /// How points are divided into chunks.
    pub chunks: ChunkRule,
    /// Size of a record, bytes.
    pub record_bytes: u16,
}

/// How points are divided into chunks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ChunkRule {
    /// All points in one run, and no table.
    None,
    /// As many points each, except the last.
    Fixed(u32),
    /// As the table says.
    Variable,
}

impl LazCoding {
    /// Reads the data of the record that describes the compression.
    pub fn from_vlr(data: &[u8], header: &LasHeader) -> Result<Self, LasFault> {
        let fault = |reason: String| LasFault::Laszip { reason };
        let vlr = LazVlr::from_buffer(data).map_err(|error| fault(error.to_string()))?;
        let compressor = u16::from_le_bytes([data[0], data[1]]);
        let coder = u16::from_le_bytes([data[2], data[3]]);
        if coder != 0 {
            return Err(fault(format!("unknown coder {coder}, expected 0")));
        }
        let format = header.point_format;
        let extra = header.record_bytes - format.base_bytes();
        if extra > MOST_EXTRA_BYTES {
            return Err(fault(format!(
                "{extra} extra bytes a record, more than the {MOST_EXTRA_BYTES} that this reader \
                 decodes"
            )));
        }
        let found: Vec<LazItemType> = vlr.items().iter().map(LazItem::item_type).collect();
        let expected = expected_items(header);
        if found != expected {
            return Err(fault(format!(
                "fields {found:?} are not those of point format {} with records of {} bytes",
                format.number(),
                header.record_bytes
            )));
        }
        let layered = vlr.items().iter().any(|item| item.version() >= 3);
        let chunks = match (compressor, layered) {
            (1, false) => ChunkRule::None,
            (2, false) | (3, true) if vlr.uses_variable_size_chunks() => ChunkRule::Variable,
            (2, false) | (3, true) => ChunkRule::Fixed(vlr.chunk_size()),
            _ => {
                let layers = if layered { "layered" } else { "pointwise" };
                return Err(fault(format!("compressor {compressor} for {layers} fields")));
            }
        };
        let items = vlr.items().clone();
        let layers = items.iter().map(|item| layer_count(item.item_type())).sum();
        Ok(LazCoding { items, layered, layers, chunks, record_bytes: header.record_bytes })
    }
}

fn expected_items(header: &LasHeader) -> Vec<LazItemType> {
    use LazItemType::*;
    let format = header.point_format;
    let extra = header.record_bytes - format.base_bytes();
    let items = if format.is_extended() {
        [
            (true, Point14),
            (format.has_rgb() && !format.has_nir(), RGB14),
            (format.has_nir(), RGBNIR14),
            (format.has_wave_packet(), WavePacket14),
            (extra > 0, Byte14(extra)),
        ]
    } else {
        [
            (true, Point10),
            (format.has_gps_time(), GpsTime),
            (format.has_rgb(), RGB12),
            (format.has_wave_packet(), WavePacket13),
            (extra > 0, Byte(extra)),
        ]
    };
    items.into_iter().filter(|(present, _)| *present).map(|(_, item)| item).collect()
}

fn layer_count(item: LazItemType) -> usize {
    match item {
        LazItemType::Point14 => 9,
        LazItemType::RGB14 | LazItemType::WavePacket14 => 1,
        LazItemType::RGBNIR14 => 2,
        LazItemType::Byte14(count) => usize::from(count),
        _ => 0,
    }
}

/// One row of the chunk table; `points` only where chunks vary.
#[derive(Clone, Copy)]
struct Entry {
    points: u32,
    bytes: u32,
}

/// Lays out the chunks between the start of points and `end`.
pub(super) fn laz_layout(
    file: &PositionedFile,
    header: &LasHeader,
    coding: &LazCoding,
    end: u64,
    salvage: bool,
) -> Result<Layout, LasFault> {
    let outcome = laid_out(file, header, coding, end);
    let data_start = u64::from(header.point_data_offset) + 8;
    // Without its table, a file of chunks of equal size can be read from the start.
    let is_equal = matches!(coding.chunks, ChunkRule::Fixed(_)) || coding.layered;
    match outcome {
        Err(fault @ (LasFault::ChunkTable { .. } | LasFault::Chunk { .. }))
            if salvage && is_equal && data_start < end =>
        {
            let mut layout = sequence(data_start, end, header.claimed_count());
            layout.warnings.push(format!("{fault}; the points are read in sequence"));
            Ok(layout)
        }
        outcome => outcome,
    }
}

fn laid_out(
    file: &PositionedFile,
    header: &LasHeader,
    coding: &LazCoding,
    end: u64,
) -> Result<Layout, LasFault> {
    let start = u64::from(header.point_data_offset);
    let claimed = header.claimed_count();
    if coding.chunks == ChunkRule::None {
        return Ok(sequence(start, end, claimed));
    }
    let data_start = start + 8;
    if data_start > end {
        if claimed == 0 {
            return Ok(Layout { points_exact: true, ..Layout::default() });
        }
        let reason = format!("{claimed} points claimed, but the points end at byte {end}");
        return Err(LasFault::ChunkTable { byte: start, reason });
    }
    match table_place(file, start, end)? {
        Some(table) => {
            let entries = read_table(file, data_start, table, coding)?;
            chunk_blocks(file, header, coding, data_start, &entries)
        }
        None if claimed == 0 => Ok(Layout { points_exact: true, ..Layout::default() }),
        None if coding.chunks == ChunkRule::Variable && !coding.layered => {
            let reason = "is missing, and chunks of varying size cannot be read without".into();
            Err(LasFault::ChunkTable { byte: start, reason })
        }
        None => {
            let mut layout = sequence(data_start, end, claimed);
            layout.warnings.push("no chunk table: the points are read in sequence".to_string());
            Ok(layout)
        }
    }
}

/// One block over everything.
fn sequence(start: u64, end: u64, claimed: u64) -> Layout {
    let blocks = if claimed > 0 { vec![Block::sequence(claimed, start..end)] } else { vec![] };
    Layout { blocks, points: claimed, points_exact: claimed == 0, ..Layout::default() }
}

/// Where the chunk table starts; `None` if its writer left no pointer.
fn table_place(file: &PositionedFile, start: u64, end: u64) -> Result<Option<u64>, LasFault> {
    let pointer = |byte: u64| -> Result<i64, LasFault> {
        let mut bytes = [0; 8];
        file.read_exact_at(&mut bytes, byte)?;
        Ok(i64::from_le_bytes(bytes))
    };
    let told = pointer(start)?;
    // A writer that could not seek back put the pointer at the very end of the file.
    let (byte, place) = match u64::try_from(told) {
        Ok(place) if place > start => (start, place),
        _ => match u64::try_from(pointer(file.bytes() - 8)?) {
            Ok(place) if place >= start + 8 && place <= file.bytes() - 16 => {
                (file.bytes() - 8, place)
            }
            _ => return Ok(None),
        },
    };
    if place < start + 8 || place.checked_add(8).is_none_or(|needed| needed > end) {
        let reason = format!(
            "points to byte {place}, but the compressed points lie between bytes {} and {end} \
             (truncated?)",
            start + 8
        );
        return Err(LasFault::ChunkTable { byte, reason });
    }
    Ok(Some(place))
}

/// Reads the table at `place`; the chunks lie between `data_start` and there.
fn read_table(
    file: &PositionedFile,
    data_start: u64,
    place: u64,
    coding: &LazCoding,
) -> Result<Vec<Entry>, LasFault> {
    let fault = |reason: String| LasFault::ChunkTable { byte: place, reason };
    let mut head = [0; 8];
    file.read_exact_at(&mut head, place)?;
    let [version, count] =
        [0, 4].map(|at| u32::from_le_bytes(head[at..at + 4].try_into().expect("4 bytes")));
    if version != 0 {
        return Err(fault(format!("unknown version {version}, expected 0")));
    }
    let data_bytes = place - data_start;
    // Each chunk starts with a whole record; writers may close with an empty chunk.
    let most = data_bytes / u64::from(coding.record_bytes) + 1;
    if u64::from(count) > most {
        return Err(fault(format!("{count} chunks in {data_bytes} bytes, at most {most} fit")));
    }
    if count == 0 {
        return Ok(Vec::new());
    }
    let variable = coding.chunks == ChunkRule::Variable;
    let mut buffer = BlockBuffer::default();
    let reader = ChunkReader::new(file, &mut buffer.window, place + 8..file.bytes());
    let entries = without_panic(|| decode_table(reader, count, variable))
        .map_err(|panic| fault(format!("damaged ({panic})")))?
        .map_err(|error| fault(format!("damaged ({error})")))?;
    let total: u64 = entries.iter().map(|entry| u64::from(entry.bytes)).sum();
    if total > data_bytes {
        return Err(fault(format!(
            "its chunks take {total} bytes, but only {data_bytes} stand before it"
        )));
    }
    Ok(entries)
}

fn decode_table(reader: ChunkReader, count: u32, variable: bool) -> std::io::Result<Vec<Entry>> {
    let mut integers = IntegerDecompressorBuilder::new().bits(32).contexts(2).build_initialized();
    let mut decoder = ArithmeticDecoder::new(reader);
    decoder.read_init_bytes()?;
    let mut entries = Vec::new();
    let mut last = Entry { points: 0, bytes: 0 };
    for _ in 0..count {
        if variable {
            last.points = integers.decompress(&mut decoder, last.points as i32, 0)? as u32;
        }
        last.bytes = integers.decompress(&mut decoder, last.bytes as i32, 1)? as u32;
        entries.push(last);
    }
    Ok(entries)
}

/// Blocks of the chunks that follow each other from `data_start`.
fn chunk_blocks(
    file: &PositionedFile,
    header: &LasHeader,
    coding: &LazCoding,
    data_start: u64,
    entries: &[Entry],
) -> Result<Layout, LasFault> {
    let mut layout = Layout { points_exact: true, ..Layout::default() };
    let mut byte = data_start;
    for (index, entry) in entries.iter().enumerate() {
        let bytes = byte..byte + u64::from(entry.bytes);
        byte = bytes.end;
        let last = index + 1 == entries.len();
        let points = match coding.chunks {
            ChunkRule::Fixed(size) if !last => u64::from(size),
            ChunkRule::Fixed(size) => {
                let block =
                    Block::chunk(index as u64, layout.points, u64::from(size), bytes.clone());
                last_chunk_points(file, header, coding, &block, &mut layout)?
            }
            _ => u64::from(entry.points),
        };
        if points == 0 && bytes.is_empty() {
            continue;
        }
        if points == 0 || bytes.end - bytes.start < u64::from(coding.record_bytes) {
            let reason = format!("{points} points in {} bytes", bytes.end - bytes.start);
            let (chunk, point) = (index as u64, layout.points);
            return Err(LasFault::Chunk { chunk, bytes, point, reason });
        }
        layout.blocks.push(Block::chunk(index as u64, layout.points, points, bytes));
        layout.points += points;
    }
    let claimed = header.claimed_count();
    if claimed != layout.points {
        let held = layout.points;
        layout.warnings.push(format!("the header claims {claimed} points, the chunks hold {held}"));
    }
    Ok(layout)
}

/// Points of the last of equally sized chunks, which the table does not tell.
///
/// Layered chunks say it themselves. Pointwise ones do not, so the chunk is decoded: the number at
/// which its bytes are used up is known to within the few points that cost no byte, and within
/// that the header is believed.
fn last_chunk_points(
    file: &PositionedFile,
    header: &LasHeader,
    coding: &LazCoding,
    block: &Block,
    layout: &mut Layout,
) -> Result<u64, LasFault> {
    if coding.layered {
        return Ok(LayerHeader::read(file, coding, block)?.points);
    }
    let rest = |count: &u64| count.checked_sub(block.first_point).filter(|&n| n > 0);
    let claimed = rest(&header.claimed_count()).filter(|&points| points <= block.points);
    if block.bytes.end - block.bytes.start > MOST_MEASURED_BYTES {
        layout.points_exact = claimed.is_some();
        return Ok(claimed.unwrap_or(block.points));
    }
    // A damaged chunk is reported when it is read, not here: its size is still wanted.
    let Some(measured) = measure_chunk(file, coding, block) else {
        return Ok(claimed.unwrap_or(block.points));
    };
    if let Some(points) = claimed.filter(|points| measured.contains(points)) {
        return Ok(points);
    }
    let mut witnesses = header.count_witnesses();
    witnesses.retain(|count| rest(count).is_some_and(|points| measured.contains(&points)));
    let points = witnesses.first().and_then(rest).unwrap_or(*measured.start());
    if witnesses.is_empty() && measured.start() != measured.end() {
        layout.warnings.push(format!(
            "the last chunk holds {} to {} points, which nothing in the file tells closer",
            measured.start(),
            measured.end()
        ));
    }
    Ok(points)
}
