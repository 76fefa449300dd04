//! A file of a format outside the LAS family as records on a lattice.
//!
//! A record is x, y, z as 32-bit integers, the reader's columns, and the residual of the
//! coordinates where the lattice alone does not give the exact floats back.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use super::error::ScanError;
use super::foreign::{CoordinateKind, ForeignFacts, ForeignFault, ForeignReader, RowBuffer};
use super::las_layout::MOST_BATCH_RECORDS;
use super::placing::{self, Placing};
use super::point_format::unique;
use super::scan::{Block, BlockBuffer, RecordSink};
use crate::points::{Attribute, COORDINATE_BYTES, Lattice, Scalar, Schema, names, write_residual};

/// Largest record that is accepted; a block of such records takes 1 GiB and more.
const MOST_RECORD_BYTES: usize = 16 << 10;

/// An open file outside the LAS family.
#[derive(Debug)]
pub struct ForeignScan {
    path: PathBuf,
    file_bytes: u64,
    reader: Box<dyn ForeignReader>,
    placing: Placing,
    schema: Schema,
    blocks: Vec<Block>,
    warnings: Vec<String>,
}

impl ForeignScan {
    /// Takes an open reader and chooses the lattice on which its coordinates are exact.
    pub fn new(
        path: &Path,
        file_bytes: u64,
        reader: Box<dyn ForeignReader>,
    ) -> Result<Self, ScanError> {
        let fault = |fault| ScanError::foreign(path, fault);
        let facts = reader.facts();
        let (points, blocks) = blocks_of(facts);
        assert_eq!(points, facts.points, "a reader's blocks add up to its points");
        let columns = columns_of(facts).map_err(fault)?;
        let placing = placing::choose(&*reader).map_err(fault)?;
        let schema = Schema { record_bytes: 0, attributes: columns };
        let path = path.to_path_buf();
        let mut scan =
            ForeignScan { path, file_bytes, reader, placing, schema, blocks, warnings: Vec::new() };
        scan.lay_out();
        Ok(scan)
    }

    /// Puts the points on another lattice. Without a residual, coordinates are rounded to it.
    pub fn place(&mut self, placing: Placing) {
        self.placing = placing;
        self.lay_out();
    }

    /// The lattice and the kind of residual.
    pub fn placing(&self) -> Placing {
        self.placing
    }

    /// Whether the coordinates are on the lattice only up to half a step.
    pub fn is_rounded(&self) -> bool {
        self.facts().coordinates == CoordinateKind::Computed && self.facts().points > 0
    }

    /// What the reader found.
    pub fn facts(&self) -> &ForeignFacts {
        self.reader.facts()
    }

    /// Whether the coordinates have the poses of their scans applied.
    pub fn applies_poses(&self) -> bool {
        self.reader.applies_poses()
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Length of the file.
    pub fn file_bytes(&self) -> u64 {
        self.file_bytes
    }

    /// The columns of its records.
    pub fn schema(&self) -> &Schema {
        &self.schema
    }

    /// The lattice of its records.
    pub fn lattice(&self) -> Lattice {
        self.placing.lattice
    }

    /// The parts that can be read independently.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    /// What is odd about the file, and how its coordinates were changed.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Reads a block as records; see [`Scan::read_block`](super::Scan::read_block).
    pub(super) fn read_block<E: From<ScanError>>(
        &self,
        block: &Block,
        buffer: &mut BlockBuffer,
        sink: &mut RecordSink<'_, E>,
    ) -> Result<u64, E> {
        let fault = |fault| E::from(ScanError::foreign(&self.path, fault));
        if block.points == 0 {
            // Perhaps because it cannot be read.
            return Ok(0);
        }
        self.reader.read_block(block.chunk as usize, &mut buffer.rows).map_err(fault)?;
        let found = buffer.rows.positions.len() as u64;
        if found != block.points {
            let reason = format!("{found} points, {} when the file was opened", block.points);
            return Err(fault(ForeignFault::at(format!("block {}", block.chunk), reason)));
        }
        self.fill_records(block, &buffer.rows, &mut buffer.records).map_err(fault)?;
        let part_bytes = MOST_BATCH_RECORDS as usize * self.schema.record_bytes as usize;
        let firsts = (block.first_point..).step_by(MOST_BATCH_RECORDS as usize);
        for (first, part) in firsts.zip(buffer.records.chunks(part_bytes)) {
            sink(first, part)?;
        }
        Ok(found)
    }

    fn fill_records(
        &self,
        block: &Block,
        rows: &RowBuffer,
        records: &mut Vec<u8>,
    ) -> Result<(), ForeignFault> {
        let Placing { lattice, residual } = self.placing;
        let record_bytes = self.schema.record_bytes as usize;
        let residual_bytes = residual.map_or(0, |scalar| 3 * scalar.bytes());
        let column_bytes = record_bytes - COORDINATE_BYTES - residual_bytes;
        assert_eq!(rows.attributes.len(), rows.positions.len() * column_bytes, "rows are packed");
        records.clear();
        records.resize(rows.positions.len() * record_bytes, 0);
        let filled = records.chunks_exact_mut(record_bytes).zip(&rows.positions);
        for (row, (record, &position)) in filled.enumerate() {
            let steps = lattice.lattice(position).round();
            // Written so that a coordinate that is no number is refused, too.
            if !steps.abs().cmple(glam::DVec3::splat(f64::from(i32::MAX))).all() {
                let place = format!("point {}", block.first_point + row as u64);
                let reason = "lies outside the bounds that were found when the file was opened";
                return Err(ForeignFault::at(place, reason));
            }
            let steps = steps.as_ivec3();
            for axis in 0..3 {
                record[4 * axis..4 * axis + 4].copy_from_slice(&steps[axis].to_le_bytes());
            }
            let (columns, rest) = record[COORDINATE_BYTES..].split_at_mut(column_bytes);
            columns.copy_from_slice(&rows.attributes[row * column_bytes..(row + 1) * column_bytes]);
            if let Some(scalar) = residual {
                write_residual(scalar, position, lattice.world(steps.as_i64vec3()), rest);
            }
        }
        Ok(())
    }

    /// Places of the columns in a record, and what the lattice costs.
    fn lay_out(&mut self) {
        self.warnings.clone_from(&self.reader.facts().warnings);
        if self.is_rounded() {
            let step = self.placing.lattice.scale.max_element();
            self.warnings
                .push(format!("coordinates are computed and rounded to steps of {step:e}"));
        }
        let attributes = &mut self.schema.attributes;
        attributes.retain(|attribute| attribute.name != names::COORDINATE_RESIDUAL);
        if let Some(scalar) = self.placing.residual {
            let name = names::COORDINATE_RESIDUAL.to_string();
            attributes.push(Attribute { name, scalar, components: 3, record_offset: 0 });
        }
        let mut at = COORDINATE_BYTES;
        for attribute in attributes {
            attribute.record_offset = at as u32;
            at += attribute.bytes();
        }
        self.schema.record_bytes = at as u32;
    }
}

fn blocks_of(facts: &ForeignFacts) -> (u64, Vec<Block>) {
    let blocks = facts.blocks.iter().enumerate();
    let blocks = blocks.map(|(i, block)| Block::rows(i as u64, block.first_point, block.points));
    (facts.blocks.iter().map(|block| block.points).sum(), blocks.collect())
}

/// The columns with unique names; their places are not theirs yet.
fn columns_of(facts: &ForeignFacts) -> Result<Vec<Attribute>, ForeignFault> {
    let mut taken: HashSet<String> =
        [names::COORDINATE_RESIDUAL, names::SOURCE].map(String::from).into();
    let mut attributes = Vec::with_capacity(facts.columns.len());
    let mut bytes = COORDINATE_BYTES + 3 * Scalar::I64.bytes();
    for column in &facts.columns {
        let name = if column.name.is_empty() { "column" } else { &column.name };
        let (name, scalar) = (unique(name, &mut taken), column.scalar);
        let attribute = Attribute { name, scalar, components: column.components, record_offset: 0 };
        bytes += attribute.bytes();
        if bytes > MOST_RECORD_BYTES {
            let reason = format!("its columns take more than {MOST_RECORD_BYTES} bytes a point");
            return Err(ForeignFault::at(format!("column \"{}\"", column.name), reason));
        }
        attributes.push(attribute);
    }
    Ok(attributes)
}
