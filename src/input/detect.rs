//! What a file is, from its first bytes; names are not asked.

use std::fs::File;
use std::path::Path;

use super::error::{LasError, LasFault};
use super::positioned_file::PositionedFile;

/// What a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A LAS file with plain records.
    Las,
    /// A LAS file with compressed records (COPC included).
    Laz,
    /// Something else.
    Other,
}

/// Says what a file is; an error if it cannot be read or is no file.
pub fn detect(path: &Path) -> Result<FileKind, LasError> {
    let in_file = |fault| LasError::new(path, fault);
    let file = open_regular(path).map_err(in_file)?;
    let mut head = [0; 105];
    let length = (file.bytes() as usize).min(head.len());
    file.read_exact_at(&mut head[..length], 0).map_err(in_file)?;
    Ok(match (&head[..4], head[104] & 0x80) {
        (b"LASF", 0) => FileKind::Las,
        (b"LASF", _) => FileKind::Laz,
        _ => FileKind::Other,
    })
}

/// Opens what stands at the path if it is a file with at least one byte.
pub(super) fn open_regular(path: &Path) -> Result<PositionedFile, LasFault> {
    let io = |source| LasFault::Io { action: "open", source };
    // Asked before opening: opening a pipe would wait for its other end.
    let kind = std::fs::metadata(path).map_err(io)?;
    if !kind.is_file() {
        let found = if kind.is_dir() { "a directory" } else { "a pipe or device" };
        return Err(LasFault::NotAFile { found });
    }
    let file = File::open(path).map_err(io)?;
    let bytes = file.metadata().map_err(io)?.len();
    if bytes == 0 {
        return Err(LasFault::Empty);
    }
    Ok(PositionedFile::new(file, bytes))
}
