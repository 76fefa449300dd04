//! E57: all scans of a file, poses applied in f64.
//!
//! The crate `e57` reads the XML part (scans, fields, poses, images); points are decoded here.
//! Each field of a scan is a stream of bits cut into packets. Where every packet's part of each
//! stream stands is found once, so that any rows can be read on their own.
//!
//! Points whose coordinates are marked invalid (or as a direction only) are left out and counted;
//! other marks of invalid values stay columns. Images are counted.
//!
//! Source: ASTM E2807-11, "Standard Specification for 3D Imaging Data Exchange".

mod bits;
mod fields;
mod packets;
mod pages;

use std::io::{Read, Seek, SeekFrom};

use glam::{DQuat, DVec3};
use rayon::prelude::*;

use super::crs::Crs;
use super::detect::{ReadOptions, Signs};
use super::foreign::{
    CoordinateKind, ForeignFacts, ForeignFault, ForeignReader, MOST_BLOCK_ROWS, Pose, RowBlock,
    RowBuffer, ScanPart, Unread,
};
use super::guard::without_panic;
use super::positioned_file::PositionedFile;
use fields::{Columns, ScanFields};
use packets::Packets;
use pages::Pages;

/// Suffixes of such files.
pub(super) const SUFFIXES: &[&str] = &["e57"];

/// Whether a file begins as one.
pub(super) fn claims(signs: &Signs) -> bool {
    signs.head.starts_with(b"ASTM-E57")
}

/// Opens a file and looks through all its points.
pub(super) fn open(
    file: PositionedFile,
    options: &ReadOptions,
) -> Result<Box<dyn ForeignReader>, ForeignFault> {
    Ok(Box::new(E57Reader::open(file, options.salvage)?))
}

/// One scan of a file.
#[derive(Debug)]
struct E57Scan {
    packets: Packets,
    fields: ScanFields,
    pose: Option<Pose>,
    records: u64,
}

/// Pieces that are given up as a whole when something in them is damaged.
const LEAST_PIECE_RECORDS: u64 = 64;

/// Some rows of a scan.
#[derive(Clone, Copy, Debug)]
struct Piece {
    scan: usize,
    first_record: u64,
    records: u64,
}

/// An open E57 file.
#[derive(Debug)]
struct E57Reader {
    pages: Pages,
    scans: Vec<E57Scan>,
    pieces: Vec<Piece>,
    columns: Columns,
    facts: ForeignFacts,
}

/// What one look at a piece tells.
#[derive(Clone, Copy)]
struct Survey {
    kept: u64,
    low: DVec3,
    high: DVec3,
}

impl E57Reader {
    fn open(file: PositionedFile, salvage: bool) -> Result<Self, ForeignFault> {
        let description = describe(&file)?;
        let pages = Pages::new(file);
        let mut columns = Columns::default();
        let mut scans = Vec::with_capacity(description.clouds.len());
        let mut parts = Vec::new();
        for (index, cloud) in description.clouds.iter().enumerate() {
            let at = |fault: ForeignFault| {
                ForeignFault::at(format!("scan {index}, {}", fault.place), fault.reason)
            };
            let fields = ScanFields::new(&cloud.prototype, &mut columns).map_err(at)?;
            let widths = fields.widths();
            let packets = Packets::find(&pages, cloud.file_offset, cloud.records, &widths);
            let packets = packets.map_err(at)?;
            let pose = cloud.transform.as_ref().and_then(pose_of);
            parts.push(ScanPart { name: cloud.name.clone(), pose, points: cloud.records });
            scans.push(E57Scan { packets, fields, pose, records: cloud.records });
        }
        let pieces = pieces_of(&scans);
        let facts = ForeignFacts {
            format: "e57 1.0".into(),
            points: 0,
            dropped_points: 0,
            bounds: [DVec3::ZERO; 2],
            coordinates: kind_of(&scans),
            columns: columns.list.clone(),
            parts,
            blocks: Vec::new(),
            crs: description.crs,
            skipped: description.skipped,
            warnings: Vec::new(),
            unread: Vec::new(),
        };
        let mut reader = E57Reader { pages, scans, pieces, columns, facts };
        reader.look_through(salvage)?;
        Ok(reader)
    }

    fn look_through(&mut self, salvage: bool) -> Result<(), ForeignFault> {
        let survey = |rows: &mut RowBuffer, piece: &Piece| {
            let mut found = Vec::new();
            self.survey(*piece, salvage, rows, &mut found);
            found
        };
        let found: Vec<_> =
            self.pieces.par_iter().map_init(RowBuffer::default, survey).flatten_iter().collect();
        let mut unread = Vec::new();
        let mut surveys = Vec::with_capacity(found.len());
        self.pieces.clear();
        for (piece, survey) in found {
            match survey {
                Ok(survey) => {
                    self.pieces.push(piece);
                    surveys.push(survey);
                }
                Err(fault) if salvage => {
                    let (part, points) = (piece.scan as u32, piece.records);
                    unread.push(Unread { part, reason: ForeignFault::to_string(&fault), points });
                }
                Err(fault) => return Err(fault),
            }
        }
        let (mut points, mut total) = (0, 0);
        let mut bounds = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        let mut blocks = Vec::with_capacity(surveys.len());
        for (piece, survey) in self.pieces.iter().zip(&surveys) {
            let part = piece.scan as u32;
            blocks.push(RowBlock { first_point: points, points: survey.kept, part });
            points += survey.kept;
            total += piece.records;
            bounds = [bounds[0].min(survey.low), bounds[1].max(survey.high)];
        }
        let facts = &mut self.facts;
        facts.blocks = blocks;
        facts.points = points;
        facts.dropped_points = total - points;
        facts.unread = unread;
        if points > 0 {
            facts.bounds = bounds;
        }
        Ok(())
    }

    /// Looks at a piece; with `salvage`, at ever smaller parts of one that is damaged.
    fn survey(
        &self,
        piece: Piece,
        salvage: bool,
        rows: &mut RowBuffer,
        found: &mut Vec<(Piece, Result<Survey, ForeignFault>)>,
    ) {
        let outcome = self.read_piece(piece, rows).map(|()| {
            let bounds = rows.positions.iter();
            Survey {
                kept: rows.positions.len() as u64,
                low: bounds.clone().fold(DVec3::INFINITY, |low, &p| low.min(p)),
                high: bounds.fold(DVec3::NEG_INFINITY, |high, &p| high.max(p)),
            }
        });
        if outcome.is_ok() || !salvage || piece.records <= LEAST_PIECE_RECORDS {
            found.push((piece, outcome));
            return;
        }
        let half = piece.records / 2;
        let first = Piece { records: half, ..piece };
        let first_record = piece.first_record + half;
        let second = Piece { first_record, records: piece.records - half, ..piece };
        self.survey(first, salvage, rows, found);
        self.survey(second, salvage, rows, found);
    }

    fn read_piece(&self, piece: Piece, rows: &mut RowBuffer) -> Result<(), ForeignFault> {
        let scan = &self.scans[piece.scan];
        let range = piece.first_record..piece.first_record + piece.records;
        let streams = scan.packets.read(&self.pages, range, &mut rows.scratch);
        let decoded = streams.and_then(|streams| {
            scan.fields.decode(&streams, &self.columns, &mut rows.positions, &mut rows.attributes)
        });
        decoded.map_err(|fault| {
            ForeignFault::at(format!("scan {}, {}", piece.scan, fault.place), fault.reason)
        })?;
        if let Some(pose) = scan.pose {
            for position in &mut rows.positions {
                *position = pose.rotation * *position + pose.translation;
            }
        }
        if rows.positions.iter().any(|position| !position.is_finite()) {
            let place = format!("scan {}, record {}", piece.scan, piece.first_record);
            return Err(ForeignFault::at(place, "the pose leads beyond the range of numbers"));
        }
        Ok(())
    }
}

impl ForeignReader for E57Reader {
    fn facts(&self) -> &ForeignFacts {
        &self.facts
    }

    fn read_block(&self, block: usize, rows: &mut RowBuffer) -> Result<(), ForeignFault> {
        self.read_piece(self.pieces[block], rows)
    }
}

fn pieces_of(scans: &[E57Scan]) -> Vec<Piece> {
    let of_scan = |(scan, of): (usize, &E57Scan)| {
        let records = of.records;
        (0..records.div_ceil(MOST_BLOCK_ROWS)).map(move |index| {
            let first_record = index * MOST_BLOCK_ROWS;
            let records = MOST_BLOCK_ROWS.min(records - first_record);
            Piece { scan, first_record, records }
        })
    };
    scans.iter().enumerate().flat_map(of_scan).collect()
}

/// How the coordinates of all scans together are written.
fn kind_of(scans: &[E57Scan]) -> CoordinateKind {
    let kinds = scans.iter().filter(|scan| scan.records > 0).map(|scan| match scan.pose {
        Some(_) => CoordinateKind::Computed,
        None => scan.fields.coordinates(),
    });
    let joined = kinds.reduce(|a, b| match (a, b) {
        (a, b) if a == b => a,
        (CoordinateKind::Computed, _) | (_, CoordinateKind::Computed) => CoordinateKind::Computed,
        _ => CoordinateKind::F64,
    });
    joined.unwrap_or(CoordinateKind::F64)
}

/// The pose, unless it is the identity.
fn pose_of(transform: &::e57::Transform) -> Option<Pose> {
    let (r, t) = (&transform.rotation, &transform.translation);
    let translation = DVec3::new(t.x, t.y, t.z);
    let rotation = DQuat::from_xyzw(r.x, r.y, r.z, r.w);
    let length = rotation.length();
    // A quaternion of no length turns nothing.
    let usable = length.is_finite() && length > 0.0;
    let rotation = if usable { rotation / length } else { DQuat::IDENTITY };
    let is_identity = translation == DVec3::ZERO && rotation == DQuat::IDENTITY;
    (!is_identity).then_some(Pose { rotation, translation })
}

/// What the XML part says.
struct Description {
    clouds: Vec<::e57::PointCloud>,
    crs: Crs,
    skipped: Vec<(String, u64)>,
}

/// Longest XML part that is accepted.
const MOST_XML_BYTES: u64 = 32 << 20;

fn describe(file: &PositionedFile) -> Result<Description, ForeignFault> {
    let mut head = [0; 48];
    if file.bytes() < head.len() as u64 {
        let reason = format!("the file ends at byte {}, its header at 48", file.bytes());
        return Err(ForeignFault::at_byte(file.bytes(), reason));
    }
    file.read_exact_at(&mut head, 0)?;
    let word =
        |at: usize| u64::from_le_bytes(head[at..at + 8].try_into().expect("the slice has 8 bytes"));
    // Asked before the crate allocates what the header claims.
    let (xml_bytes, page_bytes) = (word(32), word(40));
    if xml_bytes > file.bytes().min(MOST_XML_BYTES) {
        let reason = format!("{xml_bytes} bytes of XML, the file has {}", file.bytes());
        return Err(ForeignFault::at_byte(32, reason));
    }
    if page_bytes != pages::PAGE_BYTES {
        let reason = format!("pages of {page_bytes} bytes, expected {}", pages::PAGE_BYTES);
        return Err(ForeignFault::at_byte(40, reason));
    }
    let cursor = Cursor { file, at: 0 };
    let read = without_panic(|| ::e57::E57Reader::new(std::io::BufReader::new(cursor)));
    let read = read.and_then(|outcome| outcome.map_err(|error| causes(&error)));
    let reader = read.map_err(|reason| ForeignFault::at("XML part", reason))?;
    let mut crs = Crs::default();
    if let Some(wkt) = reader.coordinate_metadata().filter(|text| !text.trim().is_empty()) {
        crs.wkt = Some(wkt.to_string());
        crs.find_epsg();
    }
    let images = reader.images().len() as u64;
    let skipped = if images > 0 { vec![("image".to_string(), images)] } else { Vec::new() };
    Ok(Description { clouds: reader.pointclouds(), crs, skipped })
}

/// An error and what led to it, in one line.
fn causes(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}

/// A file as the crate wants it.
struct Cursor<'a> {
    file: &'a PositionedFile,
    at: u64,
}

impl Read for Cursor<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.file.read_at(buffer, self.at)?;
        self.at += count as u64;
        Ok(count)
    }
}

impl Seek for Cursor<'_> {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
            SeekFrom::End(by) => self.file.bytes().checked_add_signed(by),
        };
        self.at = at.ok_or(std::io::ErrorKind::InvalidInput)?;
        Ok(self.at)
    }
}
