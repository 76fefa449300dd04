//! The `.esker` file: the only room that knows its bytes.
//!
//! Header, node data, metadata, node directory, appendix (`FORMAT.md`). Each node's positions,
//! colours and further attributes are separate, separately compressed and checksummed sections.

mod account;
mod append;
mod blocks;
mod bytes;
mod check;
mod codec;
mod compact;
mod directory;
mod early_sync;
mod ending;
mod error;
mod fetched;
mod header;
mod metadata;
mod part_file;
mod places;
mod reader;
mod records;
mod sections;
mod writer;

pub use append::StoreAppender;
pub use blocks::encode_section;
pub use bytes::StoreBytes;
pub use check::{CheckReport, Finding, check};
pub use codec::{CodecScratch, ElementShape, Filter};
pub use compact::compact;
pub use directory::SectionExtent;
pub use error::{NodeReadError, StoreError};
pub use fetched::FetchedNode;
pub use header::{
    FULL_VERSION, FoundHeader, HEADER_BYTES, Header, MAGIC, PartExtent, SLOT_BYTES, VERSION,
};
pub use metadata::{
    CrsInfo, DroppedPoints, Metadata, NARROW_BITS, PoseInfo, Section, SectionContent, SkippedItems,
    SourceInfo, ValueRange, position_shape, sections_for,
};
pub use part_file::{lock_at_once, remove_dead_part};
pub use reader::{Store, is_store};
pub use records::RecordError;
pub use writer::{AppendixPart, EncodedNode, NodeRow, StoreWriter, WriteHook, WriterState};
