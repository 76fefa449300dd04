//! The input files as one sequence of records, decoded in parallel and handed out in order.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DVec3, I64Vec3};
use rayon::prelude::*;

use crate::build::BuildError;
use crate::build::rows::{Rows, color_offset, read_color};
use crate::input::{Block, BlockBuffer, LasError, LasScan, ScanFormat};
use crate::points::{Lattice, Schema, record_coordinates};

/// Records decoded together, all of one source.
pub struct Batch<'a> {
    /// The records with their places in the whole input.
    pub rows: Rows<'a>,
    /// What to add to their coordinates to come to the store's lattice.
    pub shift: [i64; 3],
    /// The records as bytes.
    pub records: &'a [u8],
    /// Index of their file.
    pub source: usize,
}

/// Input files that share a record layout and a lattice.
pub struct Sources {
    scans: Vec<LasScan>,
    shifts: Vec<[i64; 3]>,
}

/// Blocks that claim more points than this are streamed instead of decoded side by side.
const STREAMED_POINTS: u64 = 1 << 18;

impl Sources {
    /// Opens all files and checks that they fit together.
    pub fn open(paths: &[PathBuf]) -> Result<Self, BuildError> {
        let scans = paths.iter().map(|p| LasScan::open(p)).collect::<Result<Vec<_>, LasError>>()?;
        let first = scans.first().ok_or(BuildError::NoInput)?;
        let mut shifts = Vec::with_capacity(scans.len());
        for scan in &scans {
            let mixed = |reason| BuildError::Mixed { reason, path: scan.path().to_path_buf() };
            if scan.schema() != first.schema()
                || scan.facts().point_format != first.facts().point_format
            {
                let name = first.path().display();
                return Err(mixed(format!(
                    "its point records are laid out unlike those of {name}"
                )));
            }
            let shift = lattice_shift(&first.lattice(), &scan.lattice()).ok_or_else(|| {
                let name = first.path().display();
                mixed(format!("its coordinates do not lie on the lattice of {name}"))
            })?;
            shifts.push(shift.to_array());
        }
        Ok(Sources { scans, shifts })
    }

    /// The files.
    pub fn scans(&self) -> &[LasScan] {
        &self.scans
    }

    /// Their common record layout.
    pub fn schema(&self) -> &Schema {
        self.scans[0].schema()
    }

    /// The store's lattice: that of the first file.
    pub fn lattice(&self) -> Lattice {
        self.scans[0].lattice()
    }

    /// Shift of a file's coordinates to the store's lattice.
    pub fn shift(&self, source: usize) -> [i64; 3] {
        self.shifts[source]
    }

    /// About how many points to be ready for: exact where the files tell, generous where they
    /// only claim.
    pub fn expected_points(&self) -> u64 {
        let expected = |scan: &LasScan| {
            let facts = scan.facts();
            if facts.points_exact { facts.points } else { facts.points.max(facts.file_bytes / 2) }
        };
        self.scans.iter().map(expected).fold(0, u64::saturating_add)
    }

    /// Whether reading means decompressing.
    pub fn are_compressed(&self) -> bool {
        self.scans.iter().any(|scan| scan.facts().format == ScanFormat::Laz)
    }

    /// Calls `take` with all records in input order, some batches at a time.
    pub fn for_each_group(
        &self,
        cancelled: &AtomicBool,
        take: &mut dyn FnMut(&[Batch]) -> Result<(), BuildError>,
    ) -> Result<(), BuildError> {
        let group_blocks = 2 * rayon::current_num_threads();
        let mut buffers: Vec<(BlockBuffer, Vec<u8>)> = Vec::new();
        buffers.resize_with(group_blocks, Default::default);
        let mut next_index = 0u64;
        for (source, scan) in self.scans.iter().enumerate() {
            let is_streamed = |block: &Block| block.points > STREAMED_POINTS;
            let mut blocks = scan.blocks();
            while let Some(first) = blocks.first() {
                if cancelled.load(Ordering::Relaxed) {
                    return Err(BuildError::Interrupted);
                }
                if is_streamed(first) {
                    self.stream_block(source, first, &mut buffers[0].0, &mut next_index, take)?;
                    blocks = &blocks[1..];
                    continue;
                }
                let length =
                    blocks.iter().take(group_blocks).take_while(|b| !is_streamed(b)).count();
                let (group, rest) = blocks.split_at(length);
                blocks = rest;
                group.par_iter().zip(&mut buffers).try_for_each(|(block, (buffer, records))| {
                    records.clear();
                    scan.read_block(block, buffer, &mut |_, part| {
                        records.extend_from_slice(part);
                        Ok::<(), LasError>(())
                    })?;
                    Ok::<(), LasError>(())
                })?;
                let mut batches = Vec::with_capacity(length);
                for (_, records) in &buffers[..length] {
                    let batch = self.batch(source, records, next_index);
                    next_index += batch.rows.len() as u64;
                    batches.push(batch);
                }
                take(&batches)?;
            }
        }
        Ok(())
    }

    fn stream_block(
        &self,
        source: usize,
        block: &Block,
        buffer: &mut BlockBuffer,
        next_index: &mut u64,
        take: &mut dyn FnMut(&[Batch]) -> Result<(), BuildError>,
    ) -> Result<(), BuildError> {
        self.scans[source].read_block(block, buffer, &mut |_, records| {
            let batch = self.batch(source, records, *next_index);
            *next_index += batch.rows.len() as u64;
            take(&[batch])
        })?;
        Ok(())
    }

    /// Wraps records of a source that begin at a place in the input.
    pub fn batch<'a>(&self, source: usize, records: &'a [u8], first_index: u64) -> Batch<'a> {
        let rows = Rows::consecutive(records, self.schema(), first_index);
        Batch { rows, shift: self.shifts[source], records, source }
    }
}

/// Steps that bring coordinates of `other` onto `base`: none if the lattices do not coincide.
fn lattice_shift(base: &Lattice, other: &Lattice) -> Option<I64Vec3> {
    if base.scale != other.scale {
        return None;
    }
    let steps = (other.offset - base.offset) / base.scale;
    let whole = steps.round();
    // Offsets are decimal numbers that f64 rounds; a ten-thousandth of a step is no other lattice.
    let coincide = (steps - whole).abs().cmple(DVec3::splat(1e-4)).all();
    (coincide && whole.abs().cmple(DVec3::splat(1e15)).all()).then(|| whole.as_i64vec3())
}

/// What one pass over all points tells.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Survey {
    /// Points seen.
    pub points: u64,
    /// Smallest coordinates on the store's lattice.
    pub min: [i64; 3],
    /// Largest coordinates on the store's lattice.
    pub max: [i64; 3],
    /// All colour channels or-ed: above 255 in 16-bit files.
    pub color_union: u16,
}

impl Survey {
    /// Of nothing.
    pub fn empty() -> Self {
        Survey { points: 0, min: [i64::MAX; 3], max: [i64::MIN; 3], color_union: 0 }
    }

    /// Of one batch.
    pub fn of(batch: &Batch, schema: &Schema) -> Self {
        let (mut low, mut high) = ([i32::MAX; 3], [i32::MIN; 3]);
        let mut color_union = 0;
        let color = color_offset(schema);
        for record in batch.records.chunks_exact(schema.record_bytes as usize) {
            let position = record_coordinates(record);
            for axis in 0..3 {
                low[axis] = low[axis].min(position[axis]);
                high[axis] = high[axis].max(position[axis]);
            }
            if let Some(offset) = color {
                let [r, g, b] = read_color(&record[offset..]);
                color_union |= r | g | b;
            }
        }
        if batch.rows.len() == 0 {
            return Survey::empty();
        }
        let shifted = |v: [i32; 3]| [0, 1, 2].map(|axis| i64::from(v[axis]) + batch.shift[axis]);
        Survey {
            points: batch.rows.len() as u64,
            min: shifted(low),
            max: shifted(high),
            color_union,
        }
    }

    /// Of both.
    pub fn join(self, other: &Survey) -> Survey {
        Survey {
            points: self.points + other.points,
            min: [0, 1, 2].map(|axis| self.min[axis].min(other.min[axis])),
            max: [0, 1, 2].map(|axis| self.max[axis].max(other.max[axis])),
            color_union: self.color_union | other.color_union,
        }
    }

    /// Bits per axis of a cube that holds all points and has at least `depth + 1` levels.
    pub fn root_bits(&self, depth: u32) -> u32 {
        let extent = (0..3)
            .map(|axis| i128::from(self.max[axis]) - i128::from(self.min[axis]))
            .max()
            .unwrap_or(0)
            .max(0);
        (128 - extent.leading_zeros()).max(depth + 1)
    }
}
