//! What bounds a conversion on this machine: each step that no conversion can do without, alone,
//! on the points of the scan at hand.
//!
//! Times are those of one core for one point: where all cores work side by side, wall time times
//! cores. From them the limit follows as if everything overlapped perfectly:
//! `max(sum of steps / cores, bytes in / read rate + bytes out / write rate)`, both per point.
//! The page cache is warm, so the read rate is that of memory; the write rate ends with a flush.

use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;
use std::time::Instant;

use anyhow::Context;
use rayon::prelude::*;

use crate::geometry::MortonKey;
use crate::input::{BlockBuffer, ReadOptions, Scan, ScanError};
use crate::points::{Schema, names, record_coordinates};
use crate::store::{CodecScratch, NARROW_BITS, SectionContent, encode_section, sections_for};

/// One step of the limit.
#[derive(Clone, Debug)]
pub struct Step {
    /// What is done.
    pub name: &'static str,
    /// Nanoseconds of one core for one point.
    pub core_ns: f64,
}

/// What was measured about one scan.
#[derive(Clone, Debug)]
pub struct Limits {
    /// Steps of the processor, in the order of a conversion.
    pub steps: Vec<Step>,
    /// Bytes a point in and what a core reads of them, bytes a second.
    pub input_bytes: f64,
    /// See `input_bytes`.
    pub read_rate: f64,
    /// Bytes a second written and flushed.
    pub write_rate: f64,
    /// Bytes a point of the compressed columns.
    pub column_bytes: f64,
    /// Bytes of a record.
    pub record_bytes: u32,
    /// Cores.
    pub cores: usize,
}

impl Limits {
    /// Nanoseconds of wall time for one point: processor and disk.
    pub fn parts_ns(&self, output_bytes: f64, temporary_bytes: f64) -> (f64, f64) {
        let steps: f64 = self.steps.iter().map(|step| step.core_ns).sum();
        let read = self.input_bytes / self.read_rate;
        let written = (output_bytes + 2.0 * temporary_bytes) / self.write_rate;
        (steps / self.cores as f64, (read + written) * 1e9)
    }

    /// The limit: nanoseconds of wall time for one point.
    pub fn limit_ns(&self, output_bytes: f64, temporary_bytes: f64) -> f64 {
        let (processor, disk) = self.parts_ns(output_bytes, temporary_bytes);
        processor.max(disk)
    }
}

/// Points that are sorted and compressed; more would only take memory.
const SAMPLE_POINTS: u64 = 10_000_000;
/// Points of a block of columns, about a node's.
const BLOCK_POINTS: usize = 1 << 14;
/// Choosing a level for each point, one pass over sorted keys: a guess, as no conversion is known
/// that does only this.
const LEVEL_NS: f64 = 10.0;
/// Times that each step is done; the fastest counts.
const REPEATS: usize = 3;
const PIECE_BYTES: usize = 4 << 20;

/// Measures all steps. Temporary files go to `folder`.
pub fn measure(path: &Path, folder: &Path) -> anyhow::Result<Limits> {
    let scan = Scan::open(path, &ReadOptions::default())?;
    let schema = scan.schema().clone();
    let (points, sample) = read_sample(&scan)?;
    let cores = rayon::current_num_threads();
    let per_point = |seconds: f64, cores: usize, points: u64| {
        seconds * cores as f64 * 1e9 / points.max(1) as f64
    };
    let mut steps = Vec::new();
    let mut step = |name, core_ns| steps.push(Step { name, core_ns });

    let read_seconds = fastest(|| read_whole(path))?;
    step("read", per_point(read_seconds, 1, points));
    if scan.is_compressed() || scan.foreign().is_some() {
        let seconds = fastest(|| decode_all(&scan))?;
        step("decode", per_point(seconds, cores, points));
    }
    let record_bytes = schema.record_bytes as usize;
    let count = (sample.len() / record_bytes) as u64;
    // Memory is touched before it is measured: conversions use theirs again.
    let mut entries = vec![Entry { key: 1, row: 1 }; sample.len() / record_bytes];
    let seconds = fastest(|| {
        fill_keys(&sample, record_bytes, &mut entries);
        Ok(())
    })?;
    step("keys", per_point(seconds, cores, count));
    let (unsorted, mut other) = (entries.clone(), entries.clone());
    let seconds = fastest_of(|| {
        entries.copy_from_slice(&unsorted);
        let began = Instant::now();
        sort_parts(&mut entries, &mut other, cores);
        Ok(began.elapsed().as_secs_f64())
    })?;
    step("sort", per_point(seconds, cores, count));
    drop((unsorted, other));
    let mut gathered = sample.clone();
    let seconds = fastest(|| {
        gather(&sample, &entries, &mut gathered, record_bytes);
        Ok(())
    })?;
    step("gather", per_point(seconds, cores, count));
    step("levels (a guess)", LEVEL_NS);
    drop(sample);
    let mut columns = Vec::new();
    let mut compress_seconds = f64::INFINITY;
    for _ in 0..REPEATS {
        let seconds;
        (columns, seconds) = compress(&gathered, &entries, &schema);
        compress_seconds = compress_seconds.min(seconds);
    }
    step("compress", compress_seconds * 1e9 / count.max(1) as f64);
    drop(gathered);
    let (copy_seconds, flush_seconds) = write_columns(&columns, folder)?;
    step("write", per_point(copy_seconds, 1, count));
    let written: usize = columns.iter().map(Vec::len).sum();
    let input_bytes = scan.file_bytes() as f64 / points.max(1) as f64;
    Ok(Limits {
        steps,
        input_bytes,
        read_rate: scan.file_bytes() as f64 / read_seconds.max(1e-9),
        write_rate: written as f64 / flush_seconds.max(1e-9),
        column_bytes: written as f64 / count.max(1) as f64,
        record_bytes: schema.record_bytes,
        cores,
    })
}

/// Seconds of the fastest of some runs.
fn fastest(mut run: impl FnMut() -> anyhow::Result<()>) -> anyhow::Result<f64> {
    fastest_of(|| {
        let began = Instant::now();
        run()?;
        Ok(began.elapsed().as_secs_f64())
    })
}

fn fastest_of(mut run: impl FnMut() -> anyhow::Result<f64>) -> anyhow::Result<f64> {
    (0..REPEATS).try_fold(f64::INFINITY, |least, _| Ok(least.min(run()?)))
}

/// Reads a file once, piece by piece into the same memory.
fn read_whole(path: &Path) -> anyhow::Result<()> {
    let shown = || path.display().to_string();
    let mut file = File::open(path).with_context(shown)?;
    let mut piece = vec![0; PIECE_BYTES];
    while file.read(&mut piece).with_context(shown)? > 0 {}
    Ok(())
}

/// Decodes every block on all cores.
fn decode_all(scan: &Scan) -> anyhow::Result<()> {
    let blocks = scan.blocks().par_iter();
    let work = blocks.map_init(BlockBuffer::default, |buffer, block| {
        scan.read_block::<ScanError>(block, buffer, &mut |_, _| Ok(()))
    });
    work.try_for_each(|outcome| outcome.map(|_| ()))?;
    Ok(())
}

/// Number of points, and the records of the first ones.
fn read_sample(scan: &Scan) -> anyhow::Result<(u64, Vec<u8>)> {
    let record_bytes = scan.schema().record_bytes as usize;
    let (mut points, mut sample) = (0, Vec::new());
    let mut buffer = BlockBuffer::default();
    for block in scan.blocks() {
        if points >= SAMPLE_POINTS && scan.points_exact() {
            return Ok((scan.points(), sample));
        }
        points += scan.read_block::<ScanError>(block, &mut buffer, &mut |_, records| {
            if ((sample.len() / record_bytes) as u64) < SAMPLE_POINTS {
                sample.extend_from_slice(records);
            }
            Ok(())
        })?;
    }
    Ok((points, sample))
}

/// A point's place on the curve, and its row.
#[derive(Clone, Copy, Debug, Default)]
struct Entry {
    key: u64,
    row: u32,
}

impl Entry {
    fn byte(&self, place: u32) -> usize {
        (self.key >> (8 * place)) as usize & 0xff
    }
}

/// Morton codes of all records on 21 bits per axis.
fn fill_keys(records: &[u8], record_bytes: usize, entries: &mut [Entry]) {
    let parts = records.par_chunks(record_bytes << 15);
    let (low, high) = parts
        .map(|part| {
            let start = ([i32::MAX; 3], [i32::MIN; 3]);
            part.chunks_exact(record_bytes).map(record_coordinates).fold(start, |(low, high), p| {
                ([0, 1, 2].map(|i| low[i].min(p[i])), [0, 1, 2].map(|i| high[i].max(p[i])))
            })
        })
        .reduce(
            || ([i32::MAX; 3], [i32::MIN; 3]),
            |a, b| ([0, 1, 2].map(|i| a.0[i].min(b.0[i])), [0, 1, 2].map(|i| a.1[i].max(b.1[i]))),
        );
    let extent = (0..3).map(|i| (i64::from(high[i]) - i64::from(low[i])).max(0)).max().unwrap_or(0);
    let shift = (64 - extent.leading_zeros()).saturating_sub(u64::MAX_BITS);
    entries.par_iter_mut().enumerate().for_each(|(row, entry)| {
        let place = record_coordinates(&records[row * record_bytes..]);
        let cell = [0, 1, 2].map(|i| (place[i].wrapping_sub(low[i]) as u32) >> shift);
        *entry = Entry { key: u64::encode(cell), row: row as u32 };
    });
}

/// Sorts as many equal parts as there are cores, each by itself: what sorting the whole costs a
/// core at the least.
fn sort_parts(entries: &mut [Entry], other: &mut [Entry], cores: usize) {
    let length = entries.len().div_ceil(cores).max(1);
    entries.par_chunks_mut(length).zip(other.par_chunks_mut(length)).for_each(|(part, other)| {
        let (mut from, mut to) = (part, other);
        // Keys of 63 bits: eight passes, after which the result stands in the first again.
        for pass in 0..8 {
            let mut starts = [0usize; 256];
            from.iter().for_each(|entry| starts[entry.byte(pass)] += 1);
            let mut at = 0;
            for start in &mut starts {
                at += std::mem::replace(start, at);
            }
            for entry in from.iter() {
                let place = &mut starts[entry.byte(pass)];
                to[*place] = *entry;
                *place += 1;
            }
            std::mem::swap(&mut from, &mut to);
        }
    });
}

/// Copies whole records into the order of the entries.
fn gather(records: &[u8], entries: &[Entry], gathered: &mut [u8], record_bytes: usize) {
    let pairs = gathered.par_chunks_mut(record_bytes << 12).zip(entries.par_chunks(1 << 12));
    pairs.for_each(|(out, entries)| {
        for (out, entry) in out.chunks_exact_mut(record_bytes).zip(entries) {
            let start = entry.row as usize * record_bytes;
            out.copy_from_slice(&records[start..start + record_bytes]);
        }
    });
}

/// The columns of all blocks as a store keeps them, compressed; and the seconds of one core that
/// compressing alone took.
fn compress(records: &[u8], entries: &[Entry], schema: &Schema) -> (Vec<Vec<u8>>, f64) {
    let record_bytes = schema.record_bytes as usize;
    let color = schema.find(names::RGB).map(|(_, attribute)| attribute.record_offset as usize);
    let is_wide = color.is_some_and(|at| {
        let channels = |record: &[u8]| [1, 3, 5].iter().any(|byte| record[at + byte] != 0);
        records.par_chunks_exact(record_bytes).any(channels)
    });
    let sections = sections_for(schema, color.map(|_| if is_wide { 16 } else { 8 }));
    let blocks = records.par_chunks(BLOCK_POINTS * record_bytes);
    let blocks = blocks.zip(entries.par_chunks(BLOCK_POINTS));
    let done: Vec<(Vec<u8>, f64)> = blocks
        .map_init(CodecScratch::default, |scratch, (records, entries)| {
            let (mut out, mut seconds) = (Vec::new(), 0.0);
            for section in &sections {
                let column = column_of(section.content, records, entries, schema, color);
                let began = Instant::now();
                encode_section(section.shape, &column, scratch, &mut out);
                seconds += began.elapsed().as_secs_f64();
            }
            (out, seconds)
        })
        .collect();
    let seconds = done.iter().map(|(_, seconds)| seconds).sum();
    (done.into_iter().map(|(out, _)| out).collect(), seconds)
}

/// One column of a block.
fn column_of(
    content: SectionContent,
    records: &[u8],
    entries: &[Entry],
    schema: &Schema,
    color: Option<usize>,
) -> Vec<u8> {
    let rows = records.chunks_exact(schema.record_bytes as usize);
    let color = color.unwrap_or(0);
    match content {
        SectionContent::Positions => {
            debug_assert_eq!(NARROW_BITS, u64::MAX_BITS, "keys are what narrow nodes store");
            entries.iter().flat_map(|entry| entry.key.to_le_bytes()).collect()
        }
        SectionContent::Color => {
            rows.flat_map(|row| [row[color], row[color + 2], row[color + 4], 255]).collect()
        }
        SectionContent::ColorLow => {
            let channel = |row: &[u8], i: usize| row[color + 2 * i] ^ row[color + 2 * i + 1];
            rows.flat_map(|row| [0, 1, 2].map(|i| channel(row, i))).collect()
        }
        SectionContent::Attribute(index) => {
            let attribute = &schema.attributes[index as usize];
            let (start, bytes) = (attribute.record_offset as usize, attribute.bytes());
            rows.flat_map(|row| row[start..start + bytes].iter().copied()).collect()
        }
    }
}

/// Seconds of handing the columns to the system, and until they are on the disk.
fn write_columns(columns: &[Vec<u8>], folder: &Path) -> anyhow::Result<(f64, f64)> {
    let (mut copy, mut flush) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..REPEATS {
        let mut file = tempfile::tempfile_in(folder)?;
        let began = Instant::now();
        columns.iter().try_for_each(|column| file.write_all(column))?;
        copy = copy.min(began.elapsed().as_secs_f64());
        file.sync_all()?;
        flush = flush.min(began.elapsed().as_secs_f64());
    }
    Ok((copy, flush))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_sorted_and_keep_their_rows() {
        let key = |row: u32| u64::from(row).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 3;
        let mut entries: Vec<Entry> = (0..1000).map(|row| Entry { key: key(row), row }).collect();
        let mut other = entries.clone();
        sort_parts(&mut entries, &mut other, 3);
        for part in entries.chunks(334) {
            assert!(part.is_sorted_by_key(|entry| entry.key));
            assert!(part.iter().all(|entry| entry.key == key(entry.row)));
        }
        sort_parts(&mut [], &mut [], 2);
    }

    #[test]
    fn the_limit_is_the_larger_of_processor_and_disk() {
        let step = |core_ns| Step { name: "", core_ns };
        let limits = Limits {
            steps: vec![step(30.0), step(10.0)],
            input_bytes: 20.0,
            read_rate: 2e9,
            write_rate: 1e9,
            column_bytes: 8.0,
            record_bytes: 20,
            cores: 2,
        };
        let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
        let (processor, disk) = limits.parts_ns(8.0, 0.0);
        assert!(near(processor, 20.0) && near(disk, 18.0), "{processor} {disk}");
        assert!(near(limits.limit_ns(8.0, 0.0), 20.0));
        assert!(near(limits.limit_ns(8.0, 5.0), 28.0));
    }
}
