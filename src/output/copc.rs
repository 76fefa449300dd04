//! COPC files: LAZ files whose chunks are the nodes of an octree.
//!
//! Chunks are compressed in parallel and stand children before parents; memory is a few subtrees.
//!
//! Source: "Cloud Optimized Point Cloud Specification 1.0", copc.io.

use std::io::Read;
use std::path::Path;

use glam::I64Vec3;
use laz::laszip::{ChunkTable, ChunkTableEntry};

use super::copc_hierarchy::{Hierarchy, Place};
use super::copc_tree::{Chunk, Grid, Growth, ReadNode, subtree_points};
use super::error::WriteError;
use super::file::OutputFile;
use super::las::{WriteReport, compress_error};
use super::las_frame::{Tally, copy_evlrs, put, vlr_region};
use super::laz_coding::{ChunkSize, LazCoding, NO_CHUNK_TABLE};
use crate::input::{
    EVLR_HEADER_BYTES, LasTemplate, VLR_HEADER_BYTES, describes_extra_bytes, place,
};
use crate::octree::Octree;

/// Size of the data of the record that leads to the hierarchy.
const INFO_BYTES: usize = 160;
const USER_ID: &[u8] = b"copc";
const INFO_ID: u16 = 1;
const HIERARCHY_ID: u16 = 1000;
/// Most points that are held in memory where the lattice has a scale of its own along each axis.
const MOST_HELD_POINTS: u64 = 16_000_000;

/// Writes the points of an octree as a COPC file.
///
/// `template` has point format 6, 7 or 8. `read` gives a node's points as its records; `low` are
/// the coordinates that the root's lowest corner has in them. `evlrs` gives extended records to
/// keep, whole, one after the other. Nothing stands under `path` unless all succeeded.
pub fn write_copc<E: From<WriteError> + Send>(
    path: &Path,
    template: &LasTemplate,
    octree: &Octree,
    low: I64Vec3,
    read: &ReadNode<E>,
    evlrs: &mut dyn Read,
) -> Result<WriteReport, E> {
    let parsed = template.header();
    assert!((6..=8).contains(&parsed.point_format.number()), "COPC has formats 6 to 8");
    let coding = LazCoding::new(parsed.point_format, parsed.record_bytes, ChunkSize::Variable);
    let coding = coding.map_err(|reason| compress_error(reason, path))?;
    let grid = Grid::new(octree, parsed.lattice, low);
    let spacing = grid.edge * (-f64::from(octree.depth())).exp2();
    let growth = Growth {
        octree,
        grid,
        header: &parsed,
        coding: &coding,
        read,
        subtree_points: subtree_points(octree),
        path,
    };
    let mut writer = CopcWriter::create(path, template, &coding)?;
    let root = if grid.is_octree() {
        growth.root()
    } else if octree.point_count() <= MOST_HELD_POINTS {
        growth.root_with_all()?
    } else {
        let reason = format!(
            "COPC has cubes; with another scale along each axis ({}) at most {MOST_HELD_POINTS} \
             points can be sorted into them, here are {}",
            parsed.lattice.scale,
            octree.point_count()
        );
        return Err(WriteError::unfit(reason, path).into());
    };
    growth.grow(root, &mut |chunk| Ok(writer.add(chunk)?))?;
    Ok(writer.finish(&coding, &grid, spacing, evlrs)?)
}

struct CopcWriter<'a> {
    template: &'a LasTemplate,
    file: OutputFile,
    header: Vec<u8>,
    points_start: u64,
    tally: Tally,
    times: [f64; 2],
    table: ChunkTable,
    hierarchy: Hierarchy,
}

impl<'a> CopcWriter<'a> {
    fn create(
        path: &Path,
        template: &'a LasTemplate,
        coding: &LazCoding,
    ) -> Result<Self, WriteError> {
        let (region, count) = vlr_region(template, Some(&coding.record()));
        // The specification wants this record directly behind the header.
        let info = [&info_header()[..], &[0; INFO_BYTES]].concat();
        let mut header = template.header_bytes().to_vec();
        let points_start = header.len() + info.len() + region.len();
        let start = u32::try_from(points_start).map_err(|_| WriteError::TooManyRecords {
            bytes: region.len(),
            path: path.to_path_buf(),
        })?;
        put(&mut header, place::POINT_DATA_OFFSET, &start.to_le_bytes());
        put(&mut header, place::VLR_COUNT, &(count + 1).to_le_bytes());
        header[place::POINT_FORMAT] |= 0x80;
        let mut file = OutputFile::create(path)?;
        for part in [&header[..], &info, &region, &NO_CHUNK_TABLE.to_le_bytes()] {
            file.put(part)?;
        }
        Ok(CopcWriter {
            template,
            file,
            header,
            points_start: u64::from(start),
            tally: Tally::NONE,
            times: [f64::INFINITY, f64::NEG_INFINITY],
            table: ChunkTable::default(),
            hierarchy: Hierarchy::default(),
        })
    }

    fn add(&mut self, chunk: Chunk) -> Result<(), WriteError> {
        let points = chunk.tally.points;
        if points == 0 {
            self.hierarchy.add(chunk.key, Place::default());
            return Ok(());
        }
        let place = (i32::try_from(chunk.bytes.len()), i32::try_from(points));
        let (Ok(bytes), Ok(count)) = place else {
            let reason = format!("a chunk of {points} points cannot be told in a hierarchy");
            return Err(WriteError::unfit(reason, self.file.path()));
        };
        let place = Place { offset: self.file.end(), bytes: bytes as u32, points: count as u32 };
        self.hierarchy.add(chunk.key, place);
        self.table
            .push(ChunkTableEntry { point_count: points, byte_count: chunk.bytes.len() as u64 });
        self.tally.join(&chunk.tally);
        self.times = [self.times[0].min(chunk.times[0]), self.times[1].max(chunk.times[1])];
        self.file.put(&chunk.bytes)
    }

    fn finish(
        mut self,
        coding: &LazCoding,
        grid: &Grid,
        spacing: f64,
        evlrs: &mut dyn Read,
    ) -> Result<WriteReport, WriteError> {
        let table_start = self.file.end();
        self.file.put(&coding.table_bytes(&self.table))?;
        self.file.put_at(self.points_start, &table_start.to_le_bytes())?;

        let first_record = self.file.end();
        let pages_start = first_record + EVLR_HEADER_BYTES as u64;
        let (pages, root) = self.hierarchy.pages(pages_start);
        self.file.put(&hierarchy_header(pages.len()))?;
        self.file.put(&pages)?;
        let describes = self.template.vlrs().iter().any(describes_extra_bytes);
        let copied = copy_evlrs(&mut self.file, evlrs, describes)?;
        put(&mut self.header, place::EVLR_START, &first_record.to_le_bytes());
        put(&mut self.header, place::EVLR_COUNT, &(copied.count + 1).to_le_bytes());

        let half = 0.5 * grid.edge;
        let center = grid.min + half;
        let has_times = self.times[0] <= self.times[1];
        let times = if has_times { self.times } else { [0.0; 2] };
        let mut info = Vec::with_capacity(INFO_BYTES);
        for number in [center.x, center.y, center.z, half, spacing] {
            info.extend_from_slice(&number.to_le_bytes());
        }
        info.extend_from_slice(&(pages_start + root as u64).to_le_bytes());
        info.extend_from_slice(&((pages.len() - root) as u64).to_le_bytes());
        times.iter().for_each(|time| info.extend_from_slice(&time.to_le_bytes()));
        info.resize(INFO_BYTES, 0);
        let info_start = self.header.len() + VLR_HEADER_BYTES;
        self.file.put_at(info_start as u64, &info)?;

        self.tally.put_into(&mut self.header, &self.template.header(), self.file.path())?;
        self.file.put_at(0, &self.header)?;
        let report = WriteReport { points: self.tally.points, bytes: self.file.end() };
        self.file.finish()?;
        Ok(report)
    }
}

fn info_header() -> [u8; VLR_HEADER_BYTES] {
    let mut header = [0; VLR_HEADER_BYTES];
    put(&mut header, 2, USER_ID);
    put(&mut header, 18, &INFO_ID.to_le_bytes());
    put(&mut header, 20, &(INFO_BYTES as u16).to_le_bytes());
    put(&mut header, 22, b"COPC info");
    header
}

fn hierarchy_header(bytes: usize) -> [u8; EVLR_HEADER_BYTES] {
    let mut header = [0; EVLR_HEADER_BYTES];
    put(&mut header, 2, USER_ID);
    put(&mut header, 18, &HIERARCHY_ID.to_le_bytes());
    put(&mut header, 20, &(bytes as u64).to_le_bytes());
    put(&mut header, 28, b"COPC hierarchy");
    header
}
