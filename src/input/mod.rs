//! Foreign scan files in: LAS and LAZ, as blocks of raw point records.
//!
//! [`LasScan`] opens a file, tells what it claims and what it holds, and hands out its points as
//! the records that stand in the file, block by block, from as many threads as ask. No byte of a
//! file is trusted: lengths are checked before arithmetic and before allocation, and whatever is
//! wrong becomes a [`LasError`] that names the file, the place and the reason. Nothing here knows
//! the store or converts a coordinate.
//!
//! Source: ASPRS, "LAS Specification 1.4 - R15", 2019; Isenburg, "LASzip", 2013, whose decoder the
//! crate `laz` provides. How a reader here goes beyond that crate stands in `laz_layout` and
//! `laz_decode`.

mod crs;
mod detect;
mod error;
mod foreign;
mod guard;
mod header;
mod las_layout;
mod laz_decode;
mod laz_layout;
mod point_format;
mod positioned_file;
mod scan;
mod template;
mod vlr;

pub use crs::Crs;
pub use detect::{FileKind, detect};
pub use error::{LasError, LasFault};
pub use foreign::{
    Column, CoordinateKind, ForeignFacts, ForeignFault, ForeignReader, Pose, RowBlock, RowBuffer,
    ScanPart,
};
pub use guard::without_panic;
pub use header::{LasHeader, ReturnCounts, place};
pub use point_format::{ExtraBytes, PointFormat};
pub use scan::{
    Block, BlockBuffer, BoundsFacts, LasScan, RecordSink, ScanFacts, ScanFormat, VlrFacts,
};
pub use template::{ByteRange, LasTemplate, NewScan};
pub use vlr::{EVLR_HEADER_BYTES, VLR_HEADER_BYTES, Vlr, evlr_header};
