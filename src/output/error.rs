//! Why a file could not be written.

use std::io;
use std::path::{Path, PathBuf};

/// A file that could not be written, and why.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteError {
    /// The operating system refused.
    #[error("cannot {action}: {source}: {}", path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// The system's answer.
        source: io::Error,
        /// The file.
        path: PathBuf,
    },
    /// Records of another size than the header's.
    #[error("records of {found} bytes, the header says {expected}: {}", path.display())]
    RecordBytes {
        /// Size of the records at hand.
        found: u32,
        /// Size that the header states.
        expected: u16,
        /// The file.
        path: PathBuf,
    },
    /// More points than the version's header can count.
    #[error("{points} points, LAS 1.{minor} counts up to 4294967295: {}", path.display())]
    TooManyPoints {
        /// Points written.
        points: u64,
        /// Minor version.
        minor: u8,
        /// The file.
        path: PathBuf,
    },
    /// More bytes before the points than the header can point over.
    #[error("{bytes} bytes of variable length records do not fit: {}", path.display())]
    TooManyRecords {
        /// Bytes between header and points.
        bytes: usize,
        /// The file.
        path: PathBuf,
    },
    /// Records that cannot be compressed.
    #[error("cannot compress: {reason}: {}", path.display())]
    Compress {
        /// What the compressor said.
        reason: String,
        /// The file.
        path: PathBuf,
    },
    /// An extended record that ends before its length.
    #[error("EVLR {index}: {reason}: {}", path.display())]
    Evlr {
        /// Counted from 1.
        index: u32,
        /// What is wrong.
        reason: String,
        /// The file.
        path: PathBuf,
    },
    /// Points or attributes that the format cannot take.
    #[error("{reason}: {}", path.display())]
    Unfit {
        /// What does not fit where.
        reason: String,
        /// The file.
        path: PathBuf,
    },
}

impl WriteError {
    pub(super) fn io(action: &'static str, source: io::Error, path: &Path) -> Self {
        WriteError::Io { action, source, path: path.to_path_buf() }
    }

    pub(super) fn unfit(reason: impl Into<String>, path: &Path) -> Self {
        WriteError::Unfit { reason: reason.into(), path: path.to_path_buf() }
    }
}
