//! What can be wrong with a scan file, as values.

use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

use super::foreign::ForeignFault;

/// A scan file of any format that cannot be read, and why.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScanError {
    /// A file of the LAS family.
    #[error(transparent)]
    Las(#[from] LasError),
    /// A file of another format, or of none that is known.
    #[error("{fault}: {}", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// The place and the reason.
        #[source]
        fault: ForeignFault,
    },
}

impl ScanError {
    /// A fault in a file that is not of the LAS family.
    pub fn foreign(path: &Path, fault: ForeignFault) -> Self {
        ScanError::Foreign { path: path.to_path_buf(), fault }
    }

    /// The file.
    pub fn path(&self) -> &Path {
        match self {
            ScanError::Las(error) => &error.path,
            ScanError::Foreign { path, .. } => path,
        }
    }
}

/// A scan file that cannot be read, and why.
#[derive(Debug, thiserror::Error)]
#[error("{fault}: {}", path.display())]
pub struct LasError {
    /// The file.
    pub path: PathBuf,
    /// The place and the reason.
    #[source]
    pub fault: LasFault,
}

impl LasError {
    /// The fault, in this file.
    pub fn new(path: &Path, fault: LasFault) -> Self {
        LasError { path: path.to_path_buf(), fault }
    }
}

/// Place and reason, without the file. Byte places count from the start of the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LasFault {
    /// The operating system refused.
    #[error("cannot {action}: {source}")]
    Io {
        /// What was tried.
        action: &'static str,
        /// The system's answer.
        source: io::Error,
    },
    /// A directory, a pipe, a device.
    #[error("not a regular file but {found}")]
    NotAFile {
        /// What stands there.
        found: &'static str,
    },
    /// No byte at all.
    #[error("the file is empty")]
    Empty,
    /// The signature is another one.
    #[error("not a LAS or LAZ scan: begins with {found}, expected \"LASF\"")]
    NotAScan {
        /// The first bytes, printable.
        found: String,
    },
    /// The file ends inside its header.
    #[error("header truncated: the file has {file_bytes} bytes, the header needs {needed_bytes}")]
    HeaderTruncated {
        /// Length of the file.
        file_bytes: u64,
        /// Bytes that the header takes.
        needed_bytes: u64,
    },
    /// A version that this reader does not know.
    #[error("unknown LAS version {major}.{minor} (byte 24), expected 1.0 to 1.5")]
    UnknownVersion {
        /// Major version.
        major: u8,
        /// Minor version.
        minor: u8,
    },
    /// A point format that this reader does not know.
    #[error("unknown point format {format} (byte 104), expected 0 to 10")]
    UnknownPointFormat {
        /// The format, without the compression bits.
        format: u8,
    },
    /// The header says that it is shorter than its version demands.
    #[error("header size {header_bytes} (byte 94), version 1.{minor} needs {least_bytes}")]
    HeaderSize {
        /// What it says.
        header_bytes: u16,
        /// Minor version.
        minor: u8,
        /// What its version demands.
        least_bytes: u16,
    },
    /// A record shorter than its point format.
    #[error(
        "record length {record_bytes} (byte 105), point format {format} needs {least_bytes} or more"
    )]
    RecordLength {
        /// What it says.
        record_bytes: u16,
        /// The point format.
        format: u8,
        /// What the format demands.
        least_bytes: u16,
    },
    /// The points start inside the header or after the end of the file.
    #[error(
        "offset to point data {offset} (byte 96) lies outside the file: header ends at byte \
         {header_bytes}, file at {file_bytes}"
    )]
    PointDataOffset {
        /// What it says.
        offset: u64,
        /// End of the header.
        header_bytes: u64,
        /// Length of the file.
        file_bytes: u64,
    },
    /// A scale of coordinates that names no lattice.
    #[error("{axis} scale factor is {value} (byte {byte}), expected a finite number above 0")]
    Scale {
        /// `x`, `y` or `z`.
        axis: char,
        /// What it says.
        value: f64,
        /// Where.
        byte: u64,
    },
    /// An offset of coordinates that names no place.
    #[error("{axis} offset is {value} (byte {byte}), expected a finite number")]
    Offset {
        /// `x`, `y` or `z`.
        axis: char,
        /// What it says.
        value: f64,
        /// Where.
        byte: u64,
    },
    /// Scale and offset together leave the range of numbers.
    #[error("{axis} scale {scale} and offset {offset} give coordinates that are not finite")]
    Lattice {
        /// `x`, `y` or `z`.
        axis: char,
        /// The scale.
        scale: f64,
        /// The offset.
        offset: f64,
    },
    /// A variable length record that does not fit where it stands.
    #[error("{kind} {index} of {count} at byte {byte}: {reason}")]
    Record {
        /// `VLR` or `EVLR`.
        kind: &'static str,
        /// Counted from 1.
        index: u64,
        /// How many the header claims.
        count: u64,
        /// Where it starts.
        byte: u64,
        /// What is wrong.
        reason: String,
    },
    /// Too many bytes or records before or after the points to be a scan's.
    #[error("{what} at byte {byte}: {amount}, more than the {limit} that this reader accepts")]
    Limit {
        /// What there is too much of.
        what: &'static str,
        /// Where it starts.
        byte: u64,
        /// How much.
        amount: u64,
        /// The limit.
        limit: u64,
    },
    /// The file ends before its last record.
    #[error(
        "truncated in record {record} of {count}: the file ends at byte {end_byte}, the record at \
         byte {record_end}"
    )]
    Truncated {
        /// The first record that is not whole, counted from 1.
        record: u64,
        /// Records that the header claims.
        count: u64,
        /// Where the points end.
        end_byte: u64,
        /// Where that record would end.
        record_end: u128,
    },
    /// The description of the LAZ compression is missing or makes no sense.
    #[error("LAZ compression record: {reason}")]
    Laszip {
        /// What is wrong.
        reason: String,
    },
    /// The table of LAZ chunks makes no sense.
    #[error("LAZ chunk table at byte {byte}: {reason}")]
    ChunkTable {
        /// Where the table, or the pointer to it, stands.
        byte: u64,
        /// What is wrong.
        reason: String,
    },
    /// A LAZ chunk that does not decode.
    #[error("LAZ chunk {chunk} (bytes {}..{}), point {point}: {reason}", bytes.start, bytes.end)]
    Chunk {
        /// Which chunk, counted from 0.
        chunk: u64,
        /// Where it stands.
        bytes: Range<u64>,
        /// The first point of the file that could not be read, counted from 0.
        point: u64,
        /// What is wrong.
        reason: String,
    },
    /// The file became shorter after it was opened.
    #[error("the file ended at byte {byte} while bytes {}..{} were read", wanted.start, wanted.end)]
    Shrunk {
        /// Where it ended.
        byte: u64,
        /// What was wanted.
        wanted: Range<u64>,
    },
}
