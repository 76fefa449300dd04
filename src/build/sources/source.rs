//! One input file, its records in the layout of the store.

use std::path::Path;
use std::sync::OnceLock;

use crate::build::sources::adapt::{Adapter, Coordinates};
use crate::build::sources::stored::Stored;
use crate::input::{Block, BlockBuffer, ForeignFault, RecordSink, Scan, ScanError};

/// An input file and what its records need to become those of the store.
#[derive(Debug)]
pub struct Source {
    pub(in crate::build) scan: Scan,
    /// Nothing where records are the store's as they are.
    pub(super) adapter: Option<Adapter>,
    /// Place of its first scan among the store's sources.
    pub(super) first_source: u32,
    /// What to add to its coordinates to come to the store's lattice.
    pub(super) shift: [i64; 3],
    /// Attributes of the store that it has of its own; all of them without a list.
    pub(super) own_attributes: Option<Vec<String>>,
    /// What joining it with others changed, in words.
    pub(super) warnings: Vec<String>,
    /// The first thing that could not be read, if that is no reason to stop.
    pub(super) fault: OnceLock<String>,
    /// What it says of its own sources, if it is a store.
    pub(super) stored: Option<Stored>,
}

impl Source {
    /// Why some of it could not be read, if damaged parts are left out.
    pub(super) fn fault(&self) -> Option<&String> {
        self.fault.get()
    }

    /// Whether its coordinates are the store's, up to a shift.
    pub fn keeps_coordinates(&self) -> bool {
        let adapter = self.adapter.as_ref();
        adapter.is_none_or(|adapter| matches!(adapter.coordinates, Coordinates::Keep))
    }

    /// The file.
    pub fn path(&self) -> &Path {
        self.scan.path()
    }

    /// The parts that can be read independently, in the order of the file.
    pub fn blocks(&self) -> &[Block] {
        self.scan.blocks()
    }

    /// Reads the records of a block in the store's layout and hands them out in order, at most
    /// 65,536 at a time; see [`Scan::read_block`].
    pub fn read_block<E: From<ScanError>>(
        &self,
        block: &Block,
        buffer: &mut BlockBuffer,
        sink: &mut RecordSink<'_, E>,
    ) -> Result<u64, E> {
        let Some(adapter) = &self.adapter else {
            return self.scan.read_block(block, buffer, sink);
        };
        let source = self.first_source + self.scan.part_of(block) as u32;
        let mut adapted = std::mem::take(&mut buffer.adapted);
        let outcome = self.scan.read_block(block, buffer, &mut |first, records| {
            adapter.apply(records, source, &mut adapted).map_err(|row| {
                let place = format!("point {}", first + row.0 as u64);
                let reason = "lies outside the reach of the lattice that was chosen by the bounds \
                              in the headers of all inputs";
                ScanError::foreign(self.path(), ForeignFault::at(place, reason))
            })?;
            sink(first, &adapted)
        });
        buffer.adapted = adapted;
        outcome
    }
}
