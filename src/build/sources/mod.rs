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
mod onto;
mod source;
mod stored;

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use glam::{DVec3, I64Vec3};
use rayon::prelude::*;

use crate::build::BuildError;
use crate::input::{Block, BlockBuffer, ReadOptions, Scan, ScanError};
use crate::points::{Attribute, Lattice, Scalar, Schema, names, record_coordinates};
use adapt::{Adapter, Coordinates};
use common_lattice::{Fit, Wish, common_lattice, shared_lattice};
use layout::{UnionLayout, union_layout};
pub use source::Source;

/// Input files in a common record layout, on a common lattice.
pub struct Sources {
    scans: Arc<[Source]>,
    schema: Schema,
    lattice: Lattice,
    /// The blocks that are read, each with its file, if not all are.
    sample: Option<Vec<(usize, Block)>>,
    /// How they are read.
    read: ReadOptions,
}

impl Sources {
    /// Opens all files and finds what they have in common.
    pub fn open(paths: &[PathBuf], options: &ReadOptions) -> Result<Self, BuildError> {
        let scans = open_scans(paths, options)?;
        let first = &scans[0];
        let source_count: usize = scans.iter().map(source_count).sum();
        if source_count > 1 {
            return Sources::join(scans, source_count, options);
        }
        let (schema, lattice) = (first.schema().clone(), first.lattice());
        let untouched = |scan| Source {
            scan,
            adapter: None,
            first_source: 0,
            shift: [0; 3],
            own_attributes: None,
            warnings: Vec::new(),
            fault: OnceLock::new(),
            stored: None,
        };
        let scans = scans.into_iter().map(untouched).collect();
        Ok(Sources { scans, schema, lattice, sample: None, read: options.clone() })
    }

    fn join(
        mut scans: Vec<Scan>,
        sources: usize,
        options: &ReadOptions,
    ) -> Result<Self, BuildError> {
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
        let mut layout = union_layout(&scans);
        layout.schema = with_source(layout.schema, sources);
        let source = layout.schema.attributes.last();
        let source_place = source.map(|a| (a.record_offset as usize, a.scalar));
        let schema = layout.schema.clone();
        let scans = assemble(scans, common.fits, layout, source_place, 0);
        Ok(Sources {
            scans: scans.into(),
            schema,
            lattice: common.lattice,
            sample: None,
            read: options.clone(),
        })
    }

    /// The same files, of which only about so many points are read, spread evenly over all.
    ///
    /// Made for a first look: a block that is damaged ends where the damage is, and that is all.
    pub fn sampled(&self, points: u64) -> Self {
        let all: u64 = self.scans.iter().map(|source| source.scan.points()).sum();
        let share = points as f64 / all.max(1) as f64;
        let files = self.scans.iter().enumerate();
        let sample = files.flat_map(|(i, source)| {
            source.scan.sampled_blocks(share).into_iter().map(move |block| (i, block))
        });
        let (scans, schema) = (Arc::clone(&self.scans), self.schema.clone());
        let (lattice, read) = (self.lattice, self.read.clone());
        Sources { scans, schema, lattice, sample: Some(sample.collect()), read }
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
        if let Some(sample) = &self.sample {
            return sample.iter().map(|(_, block)| block.expected_points()).sum();
        }
        let expected = |Source { scan, .. }: &Source| match scan.points_exact() {
            true => scan.points(),
            false => scan.points().max(scan.file_bytes() / 2),
        };
        self.scans.iter().map(expected).fold(0, u64::saturating_add)
    }

    /// Whether only some of the points are read.
    pub fn is_sampled(&self) -> bool {
        self.sample.is_some()
    }

    /// Whether what cannot be read is left out.
    pub fn salvages(&self) -> bool {
        self.read.salvage
    }

    /// Whether reading means decompressing.
    pub fn are_compressed(&self) -> bool {
        self.scans.iter().any(|source| source.scan.is_compressed())
    }

    /// All blocks that are read, in input order, each with its file.
    pub fn blocks(&self) -> Vec<(usize, &Block)> {
        if let Some(sample) = &self.sample {
            return sample.iter().map(|(i, block)| (*i, block)).collect();
        }
        let scans = self.scans.iter().enumerate();
        scans.flat_map(|(i, scan)| scan.blocks().iter().map(move |block| (i, block))).collect()
    }

    /// Hands out the records of a block in order, some at a time.
    pub fn read_block(
        &self,
        source: usize,
        block: &Block,
        buffer: &mut BlockBuffer,
        take: &mut dyn FnMut(&[u8]) -> Result<(), BuildError>,
    ) -> Result<(), BuildError> {
        let outcome = self.scans[source].read_block(block, buffer, &mut |_, records| take(records));
        match outcome {
            Err(BuildError::Input(_)) if self.sample.is_some() => Ok(()),
            Err(BuildError::Input(error)) if self.read.salvage && !self.read.cancel.is_set() => {
                self.scans[source].fault.get_or_init(|| error.to_string());
                Ok(())
            }
            outcome => outcome.map(|_| ()),
        }
    }
}

/// Opens all files.
fn open_scans(paths: &[PathBuf], options: &ReadOptions) -> Result<Vec<Scan>, BuildError> {
    // Side by side, because some formats are looked through when they are opened; the first error
    // in the order of the files counts, not in that of the threads.
    let scans: Vec<_> = paths.par_iter().map(|path| Scan::open(path, options)).collect();
    let scans = scans.into_iter().collect::<Result<Vec<_>, ScanError>>()?;
    if scans.is_empty() { Err(BuildError::NoInput) } else { Ok(scans) }
}

/// Scans with what each does to come into the layout and onto the lattice of all.
fn assemble(
    scans: Vec<Scan>,
    fits: Vec<Fit>,
    layout: UnionLayout,
    source_place: Option<(usize, Scalar)>,
    first_source: u32,
) -> Vec<Source> {
    let schema = layout.schema;
    let mut next_source = first_source;
    let parts = scans.into_iter().zip(fits).zip(layout.moves).zip(layout.own);
    let scans = parts.zip(layout.warnings).map(|((((scan, fit), moves), own), mut warnings)| {
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
        let all = own.len() + usize::from(source_place.is_some()) == schema.attributes.len();
        let own_attributes = (!all).then_some(own);
        let adapter = Some(adapter);
        Source {
            scan,
            adapter,
            first_source,
            shift,
            own_attributes,
            warnings,
            fault: OnceLock::new(),
            stored: None,
        }
    });
    scans.collect()
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
