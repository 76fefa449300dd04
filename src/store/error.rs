//! What can be wrong with a store, as values.

use std::io;
use std::path::PathBuf;

use crate::ids::NodeId;
use crate::octree::OctreeError;

/// A store could not be opened, written or verified as a whole.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// The operating system refused.
    #[error("{path}: {action}: {source}", path = path.display())]
    Io {
        /// What was being done.
        action: &'static str,
        /// The system's reason.
        source: io::Error,
        /// The file.
        path: PathBuf,
    },
    /// The file does not begin as a store does.
    #[error("{path}: not an Esker store: {reason}", path = path.display())]
    NotAStore {
        /// What was found instead.
        reason: String,
        /// The file.
        path: PathBuf,
    },
    /// The store was written by a newer program.
    #[error("{path}: store version {found}, this program reads version {supported}", path = path.display())]
    Version {
        /// In the file.
        found: u32,
        /// The only version this program reads.
        supported: u32,
        /// The file.
        path: PathBuf,
    },
    /// A section that the whole store depends on is damaged.
    #[error("{path}: {section} (bytes {start}..{end}): {reason}", path = path.display())]
    Section {
        /// Its name: header, metadata, directory, appendix.
        section: &'static str,
        /// First byte.
        start: u64,
        /// One past the last byte.
        end: u64,
        /// What is wrong.
        reason: String,
        /// The file.
        path: PathBuf,
    },
    /// The directory's rows do not form an octree.
    #[error("{path}: directory: {source}", path = path.display())]
    Octree {
        /// What is wrong.
        source: OctreeError,
        /// The file.
        path: PathBuf,
    },
}

/// One section of one node could not be read; the rest of the store may still serve.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NodeReadError {
    /// The operating system refused, or the file has become shorter.
    #[error("node {node} (level {level}): {section}: {source}, bytes {start}..{end}")]
    Io {
        /// The node.
        node: NodeId,
        /// Its depth in the outer octree.
        level: u32,
        /// Which section.
        section: String,
        /// The system's reason.
        source: io::Error,
        /// First byte of the section.
        start: u64,
        /// One past its last byte.
        end: u64,
    },
    /// The bytes are not those that were written.
    #[error(
        "node {node} (level {level}): {section}: checksum {found:08x}, directory says {expected:08x}, bytes {start}..{end}"
    )]
    Checksum {
        /// The node.
        node: NodeId,
        /// Its depth in the outer octree.
        level: u32,
        /// Which section.
        section: String,
        /// Checksum of what was read.
        found: u32,
        /// Checksum in the directory.
        expected: u32,
        /// First byte of the section.
        start: u64,
        /// One past its last byte.
        end: u64,
    },
    /// The bytes are those that were written but do not decode to the expected size.
    #[error("node {node} (level {level}): {section}: {reason}, bytes {start}..{end}")]
    Decode {
        /// The node.
        node: NodeId,
        /// Its depth in the outer octree.
        level: u32,
        /// Which section.
        section: String,
        /// What is wrong.
        reason: String,
        /// First byte of the section.
        start: u64,
        /// One past its last byte.
        end: u64,
    },
    /// The store has no such column.
    #[error("the store has no {section}")]
    NoSuchSection {
        /// What was asked for.
        section: String,
    },
}

impl NodeReadError {
    /// Whether another try may succeed: a line or a disk that hesitates, not a file that is
    /// damaged, shorter or gone.
    pub fn is_transient(&self) -> bool {
        use io::ErrorKind::*;
        let NodeReadError::Io { source, .. } = self else { return false };
        let is_io_error = cfg!(unix) && source.raw_os_error() == Some(EIO);
        is_io_error
            || matches!(
                source.kind(),
                Interrupted
                    | TimedOut
                    | WouldBlock
                    | ConnectionReset
                    | ConnectionAborted
                    | ConnectionRefused
                    | NotConnected
                    | BrokenPipe
                    | HostUnreachable
                    | NetworkUnreachable
                    | NetworkDown
                    | ResourceBusy
            )
    }
}

/// What Unix says when a device does not answer.
const EIO: i32 = 5;
