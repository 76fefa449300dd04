//! The `.esker` file: the only room that knows its bytes.
//!
//! Header, metadata, node directory, node data, appendix (`FORMAT.md`). Each node's positions,
//! colours and further attributes are separate, separately compressed and checksummed sections.

mod account;
mod check;
mod codec;
mod directory;
mod error;
mod header;
mod metadata;
mod reader;
mod records;
mod writer;

pub use check::{CheckReport, Finding, check};
pub use codec::{CodecScratch, ElementShape, Filter, encode as encode_section};
pub use directory::SectionExtent;
pub use error::{NodeReadError, StoreError};
pub use header::{HEADER_BYTES, Header, MAGIC, PartExtent, VERSION};
pub use metadata::{
    CrsInfo, DroppedPoints, Metadata, NARROW_BITS, PoseInfo, Section, SectionContent, SkippedItems,
    SourceInfo, ValueRange, position_shape, sections_for,
};
pub use reader::{Store, is_store};
pub use records::RecordError;
pub use writer::{
    AppendixPart, EncodedNode, Scratch, StagedState, StoreWriter, lock_at_once, remove_dead_part,
};
