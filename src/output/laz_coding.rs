//! Chunks of records, compressed as LASzip does.
//!
//! The compressor is the crate `laz`'s; chunks are compressed side by side and their bytes do not
//! depend on the number of threads.
//!
//! Source: Isenburg, "LASzip: lossless compression of LiDAR data", 2013.

use laz::laszip::{ChunkTable, ChunkTableEntry};
use laz::record::{
    LayeredPointRecordCompressor, RecordCompressor, SequentialPointRecordCompressor,
};
use laz::{LazItem, LazItemRecordBuilder, LazVlr, LazVlrBuilder};
use rayon::prelude::*;

use crate::input::{PointFormat, VLR_HEADER_BYTES, without_panic};

/// Points of a chunk where all chunks have the same number.
pub(super) const CHUNK_POINTS: usize = 50_000;
/// What a LAZ file holds where its chunk table's place is not known yet.
pub(super) const NO_CHUNK_TABLE: i64 = -1;

/// How many points a chunk has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ChunkSize {
    /// [`CHUNK_POINTS`], but for the last one.
    Fixed,
    /// Each as many as it has.
    Variable,
}

/// How records of one layout are compressed.
pub(super) struct LazCoding {
    vlr: LazVlr,
    record_bytes: usize,
}

impl LazCoding {
    /// For records of `record_bytes` bytes, those after the point format's own being extra bytes.
    pub fn new(format: PointFormat, record_bytes: u16, size: ChunkSize) -> Result<Self, String> {
        let extra = record_bytes - format.base_bytes();
        let items = LazItemRecordBuilder::default_for_point_format_id(format.number(), extra)
            .map_err(|error| error.to_string())?;
        let builder = LazVlrBuilder::new(items);
        let vlr = match size {
            ChunkSize::Fixed => builder.with_fixed_chunk_size(CHUNK_POINTS as u32),
            ChunkSize::Variable => builder.with_variable_chunk_size(),
        };
        let vlr = with_known_versions(&vlr.build()).map_err(|error| error.to_string())?;
        Ok(LazCoding { vlr, record_bytes: usize::from(record_bytes) })
    }

    /// The description of the compression, as a whole VLR.
    pub fn record(&self) -> Vec<u8> {
        let mut data = Vec::new();
        self.vlr.write_to(&mut data).expect("memory takes every write");
        let mut record = vec![0; VLR_HEADER_BYTES];
        let mut put = |at: usize, value: &[u8]| record[at..at + value.len()].copy_from_slice(value);
        put(2, LazVlr::USER_ID.as_bytes());
        put(18, &LazVlr::RECORD_ID.to_le_bytes());
        put(20, &(data.len() as u16).to_le_bytes());
        put(22, LazVlr::DESCRIPTION.as_bytes());
        record.extend(data);
        record
    }

    /// One chunk's bytes, in the given memory.
    pub fn compress(&self, records: &[u8], memory: Vec<u8>) -> Result<Vec<u8>, String> {
        let outcome = without_panic(|| compress_chunk(self.vlr.items(), records, memory));
        outcome?.map_err(|error| error.to_string())
    }

    /// The bytes of the table of all chunks.
    pub fn table_bytes(&self, table: &ChunkTable) -> Vec<u8> {
        let mut bytes = Vec::new();
        table.write_to(&mut bytes, &self.vlr).expect("memory takes every write");
        bytes
    }
}

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

/// Points that wait for compression into chunks of the same size, and the table of those done.
pub(super) struct FixedChunks {
    coding: LazCoding,
    table: ChunkTable,
    waiting: Vec<u8>,
    most_waiting_bytes: usize,
    compressed: Vec<Vec<u8>>,
}

impl FixedChunks {
    /// Chunks of such a coding.
    pub fn new(coding: LazCoding) -> Self {
        let most_chunks = 2 * rayon::current_num_threads();
        FixedChunks {
            table: ChunkTable::default(),
            waiting: Vec::new(),
            most_waiting_bytes: most_chunks * CHUNK_POINTS * coding.record_bytes,
            compressed: Vec::new(),
            coding,
        }
    }

    /// How the chunks are compressed.
    pub fn coding(&self) -> &LazCoding {
        &self.coding
    }

    /// The bytes of the table of all chunks.
    pub fn table_bytes(&self) -> Vec<u8> {
        self.coding.table_bytes(&self.table)
    }

    /// Takes what there is room for; returns the rest.
    pub fn fill<'a>(&mut self, records: &'a [u8]) -> &'a [u8] {
        let room = self.most_waiting_bytes - self.waiting.len();
        let (taken, rest) = records.split_at(room.min(records.len()));
        self.waiting.extend_from_slice(taken);
        rest
    }

    /// Whether it is time to compress.
    pub fn is_full(&self) -> bool {
        self.waiting.len() == self.most_waiting_bytes
    }

    /// Compresses everything that waits; the last chunk may be a short one, so only the end of the
    /// points may call this when not full.
    pub fn compress(&mut self) -> Result<impl Iterator<Item = &[u8]>, String> {
        let record_bytes = self.coding.record_bytes;
        let chunk_bytes = CHUNK_POINTS * record_bytes;
        let count = self.waiting.len().div_ceil(chunk_bytes);
        self.compressed.resize_with(self.compressed.len().max(count), Vec::new);
        let coding = &self.coding;
        let chunks = self.waiting.par_chunks(chunk_bytes);
        let compressed = self.compressed.par_iter_mut().zip(chunks);
        compressed.try_for_each(|(output, records)| -> Result<(), String> {
            *output = coding.compress(records, std::mem::take(output))?;
            Ok(())
        })?;
        for (chunk, records) in self.compressed.iter().zip(self.waiting.chunks(chunk_bytes)) {
            self.table.push(ChunkTableEntry {
                point_count: (records.len() / record_bytes) as u64,
                byte_count: chunk.len() as u64,
            });
        }
        self.waiting.clear();
        Ok(self.compressed[..count].iter().map(Vec::as_slice))
    }
}
