//! Why a conversion stopped.

use std::io;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::input::ScanError;
use crate::store::StoreError;

/// A conversion failed; nothing is left under the output's name.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BuildError {
    /// An input file is bad.
    #[error(transparent)]
    Input(#[from] ScanError),
    /// The store could not be written.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Nothing to convert.
    #[error("no scan files among the inputs")]
    NoInput,
    /// Points lie too far apart for 32 bits per axis on their lattice.
    #[error("{path}: points span {steps} lattice steps along one axis, at most 4294967296 fit", path = path.display())]
    TooWide {
        /// Extent of all points.
        steps: i128,
        /// The file with which it was exceeded.
        path: PathBuf,
    },
    /// Temporary files could not be written or read back.
    #[error("{path}: {action}: {source}", path = path.display())]
    Temporary {
        /// What was being done.
        action: &'static str,
        /// The system's reason.
        source: io::Error,
        /// The folder of temporary files.
        path: PathBuf,
    },
    /// The memory cap leaves no room to work.
    #[error("a memory cap of {cap} bytes is too small; {needed} bytes are needed at least")]
    MemoryCap {
        /// What was asked for.
        cap: u64,
        /// The least that works for these points.
        needed: u64,
    },
    /// The disk cannot hold what the conversion will write.
    #[error(
        "{path}: about {needed} bytes are needed on this disk, {free} are free",
        path = path.display()
    )]
    DiskRoom {
        /// The least that it takes.
        needed: u64,
        /// What is there.
        free: u64,
        /// The folder of the output or of temporary files.
        path: PathBuf,
    },
    /// The output exists and may not be replaced.
    #[error("{path}: exists already (--overwrite replaces it)", path = path.display())]
    Exists {
        /// The output.
        path: PathBuf,
    },
    /// A scan cannot join a store as it is.
    #[error("{path}: cannot be appended: {reason}", path = path.display())]
    Append {
        /// What stands against it.
        reason: String,
        /// The scan, or the store.
        path: PathBuf,
    },
    /// The points of a scan need a larger cube, or more bits of colour, than a store has.
    #[error("{path}: does not fit the store as it is: {reason}", path = path.display())]
    Outgrown {
        /// In what way.
        reason: String,
        /// The scan.
        path: PathBuf,
    },
    /// Points of a later pass are not those of the first.
    #[error("an input file changed while it was being read")]
    Changed,
    /// The user stopped it.
    #[error("interrupted")]
    Interrupted,
}

impl BuildError {
    /// What reading fails with once it is cancelled is no fault of the input.
    pub(super) fn unless_cancelled(self, cancelled: &AtomicBool) -> Self {
        match self {
            BuildError::Input(_) if cancelled.load(Ordering::Relaxed) => BuildError::Interrupted,
            error => error,
        }
    }
}
