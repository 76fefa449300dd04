//! The input files as one sequence of records of one layout on one lattice.
//!
//! Files of one layout and one lattice hand out their records as they are. Others are adapted
//! while they are read: `layout` joins their attributes, `common_lattice` their coordinates,
//! `adapt` does the work. With several sources (files, or scans within a file) each record tells
//! its own in the attribute `source`.

mod adapt;
mod common_lattice;
mod describe;
mod layout;
mod source;
mod survey;

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DVec3, I64Vec3};
use rayon::prelude::*;

use crate::build::BuildError;
use crate::build::rows::Rows;
use crate::input::{Block, BlockBuffer, ReadOptions, Scan, ScanError};
use crate::points::{Attribute, Lattice, Scalar, Schema, names, record_coordinates};
use adapt::{Adapter, Coordinates};
use common_lattice::{Fit, Wish, common_lattice, shared_lattice};
use layout::union_layout;
pub use source::Source;
pub use survey::Survey;

/// Records decoded together, all of one file.
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

/// Input files in a common record layout, on a common lattice.
pub struct Sources {
    scans: Vec<Source>,
    schema: Schema,
    lattice: Lattice,
}

/// Blocks that claim more points than this are streamed instead of decoded side by side.
const STREAMED_POINTS: u64 = 1 << 18;

impl Sources {
    /// Opens all files and finds what they have in common.
    pub fn open(paths: &[PathBuf], options: &ReadOptions) -> Result<Self, BuildError> {
        let scans = paths.iter().map(|path| Scan::open(path, options));
        let scans = scans.collect::<Result<Vec<_>, ScanError>>()?;
        let first = scans.first().ok_or(BuildError::NoInput)?;
        let source_count: usize = scans.iter().map(source_count).sum();
        if source_count > 1 {
            return Sources::join(scans, source_count);
        }
        let (schema, lattice) = (first.schema().clone(), first.lattice());
        let untouched = |scan| Source {
            scan,
            adapter: None,
            first_source: 0,
            shift: [0; 3],
            own_attributes: None,
            warnings: Vec::new(),
        };
        Ok(Sources { scans: scans.into_iter().map(untouched).collect(), schema, lattice })
    }

    fn join(mut scans: Vec<Scan>, sources: usize) -> Result<Self, BuildError> {
        let mut wishes: Vec<Wish> = scans.iter().map(Wish::of).collect();
        let common = match shared_lattice(&wishes) {
            Some(shared) => shared,
            None => {
                for (wish, scan) in wishes.iter_mut().zip(&scans) {
                    if wish.bounds.is_none() {
                        wish.bounds = true_bounds(scan)?;
                    }
                }
                common_lattice(&wishes)
            }
        };
        for (scan, fit) in scans.iter_mut().zip(&common.fits) {
            if let Fit::Place(placing) = fit {
                scan.place(*placing);
            }
        }
        let union = union_layout(&scans);
        let schema = with_source(union.schema, sources);
        let source_place = schema.attributes.last().map(|a| (a.record_offset as usize, a.scalar));
        let lattice = common.lattice;
        let mut next_source = 0;
        let parts = scans.into_iter().zip(common.fits).zip(union.moves).zip(union.own);
        let scans = parts.zip(union.warnings).map(|((((scan, fit), moves), own), mut warnings)| {
            let (coordinates, shift) = match fit {
                Fit::Shift(shift) => (Coordinates::Keep, shift),
                Fit::Place(_) => (Coordinates::Keep, [0; 3]),
                Fit::Change(coordinates) => (coordinates, [0; 3]),
            };
            if let Coordinates::Round { from, to } = coordinates {
                warnings.push(format!(
                    "coordinates are rounded from steps of {} to steps of {}, which the inputs \
                     share",
                    from.scale, to.scale
                ));
            }
            let adapter = Adapter {
                source_bytes: scan.schema().record_bytes as usize,
                store_bytes: schema.record_bytes as usize,
                coordinates,
                moves,
                source_place,
            };
            let first_source = next_source;
            next_source += source_count(&scan) as u32;
            let all = own.len() + 1 == schema.attributes.len();
            let own_attributes = (!all).then_some(own);
            let adapter = Some(adapter);
            Source { scan, adapter, first_source, shift, own_attributes, warnings }
        });
        Ok(Sources { scans: scans.collect(), schema, lattice })
    }

    /// The files.
    pub fn scans(&self) -> &[Source] {
        &self.scans
    }

    /// Their common record layout.
    pub fn schema(&self) -> &Schema {
        &self.schema
    }

    /// The store's lattice.
    pub fn lattice(&self) -> Lattice {
        self.lattice
    }

    /// Shift of a file's coordinates to the store's lattice.
    pub fn shift(&self, source: usize) -> [i64; 3] {
        self.scans[source].shift
    }

    /// About how many points to be ready for: exact where the files tell, generous where they
    /// only claim.
    pub fn expected_points(&self) -> u64 {
        let expected = |Source { scan, .. }: &Source| match scan.points_exact() {
            true => scan.points(),
            false => scan.points().max(scan.file_bytes() / 2),
        };
        self.scans.iter().map(expected).fold(0, u64::saturating_add)
    }

    /// Whether reading means decompressing.
    pub fn are_compressed(&self) -> bool {
        self.scans.iter().any(|source| source.scan.is_compressed())
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
                        Ok::<(), ScanError>(())
                    })?;
                    Ok::<(), ScanError>(())
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
        Batch { rows, shift: self.scans[source].shift, records, source }
    }
}

/// Number of sources that a file brings: its scans.
fn source_count(scan: &Scan) -> usize {
    scan.parts().len().max(1)
}

/// The layout with the attribute `source` behind it.
fn with_source(mut schema: Schema, sources: usize) -> Schema {
    let scalar = if sources <= usize::from(u16::MAX) { Scalar::U16 } else { Scalar::U32 };
    schema.attributes.push(Attribute {
        name: names::SOURCE.into(),
        scalar,
        components: 1,
        record_offset: schema.record_bytes,
    });
    schema.record_bytes += scalar.bytes() as u32;
    schema
}

/// The box of all points of a file, found by reading it.
fn true_bounds(scan: &Scan) -> Result<Option<[DVec3; 2]>, BuildError> {
    let record_bytes = scan.schema().record_bytes as usize;
    let none = ([i32::MAX; 3], [i32::MIN; 3]);
    let join = |a: ([i32; 3], [i32; 3]), b: ([i32; 3], [i32; 3])| {
        let axes = [0, 1, 2];
        (axes.map(|i| a.0[i].min(b.0[i])), axes.map(|i| a.1[i].max(b.1[i])))
    };
    let of_block = |buffer: &mut BlockBuffer, block: &Block| -> Result<_, ScanError> {
        let mut found = none;
        scan.read_block(block, buffer, &mut |_, records| {
            for record in records.chunks_exact(record_bytes) {
                let position = record_coordinates(record);
                found = join(found, (position, position));
            }
            Ok::<(), ScanError>(())
        })?;
        Ok(found)
    };
    let boxes = scan.blocks().par_iter().map_init(BlockBuffer::default, of_block);
    let (low, high) = boxes.try_reduce(|| none, |a, b| Ok(join(a, b)))?;
    let world = |steps: [i32; 3]| scan.lattice().world(steps.map(i64::from).into());
    Ok((low[0] <= high[0]).then(|| [world(low), world(high)]))
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
