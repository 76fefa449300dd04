//! What a file is: from its first bytes, and by its suffix where bytes cannot tell (text).
//!
//! Formats outside the LAS family stand in [`FORMATS`]. **A new format is one more entry there**: a
//! [`FileKind`], the suffixes that folders contribute, a function that recognises the first bytes,
//! and one that opens the file as a [`ForeignReader`]. The order is that of asking: formats with a
//! signature stand before those that are guessed.

use std::fs::File;
use std::path::{Path, PathBuf};

use super::error::{LasError, LasFault};
use super::foreign::{ForeignFault, ForeignReader};
use super::positioned_file::{Cancel, PositionedFile};
use super::{e57, pcd, ply, text};

/// What a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum FileKind {
    /// A LAS file with plain records.
    Las,
    /// A LAS file with compressed records (COPC included).
    Laz,
    /// A Stanford polygon file.
    Ply,
    /// A file of the Point Cloud Library.
    Pcd,
    /// An ASTM E57 file.
    E57,
    /// PTS text.
    Pts,
    /// PTX text.
    Ptx,
    /// Rows of numbers: XYZ, CSV and their kin.
    Text,
    /// Something else.
    Other,
}

/// How files are to be read where they do not tell, or are damaged.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ReadOptions {
    /// Names of the columns of text files, separated by commas, where they are not to be guessed.
    pub columns: Option<String>,
    /// Take what can be read of a damaged file, and count the rest, instead of refusing it.
    pub salvage: bool,
    /// Where points wait that must be decompressed as a whole and are many; the system's folder for
    /// temporary files if not set.
    pub temp_dir: Option<PathBuf>,
    /// What ends reading early; also while a file is being opened, which for texts means reading
    /// all of it.
    pub cancel: Cancel,
}

/// The first bytes of a file and the end of its name.
pub(super) struct Signs<'a> {
    /// At most [`HEAD_BYTES`] bytes; fewer only if the file is that short.
    pub head: &'a [u8],
    /// Suffix in lower case; empty without one.
    pub suffix: &'a str,
}

/// Opens a file as one of a format.
pub(super) type OpenReader =
    fn(PositionedFile, &ReadOptions) -> Result<Box<dyn ForeignReader>, ForeignFault>;

/// A format outside the LAS family.
pub(super) struct Format {
    pub kind: FileKind,
    /// Suffixes, in lower case, of the files that a folder contributes.
    pub suffixes: &'static [&'static str],
    /// Whether a file with these signs is one.
    pub claims: fn(&Signs) -> bool,
    pub open: OpenReader,
}

/// All formats outside the LAS family, in the order in which they are asked.
pub(super) const FORMATS: &[Format] = &[
    Format { kind: FileKind::Ply, suffixes: ply::SUFFIXES, claims: ply::claims, open: ply::open },
    Format { kind: FileKind::Pcd, suffixes: pcd::SUFFIXES, claims: pcd::claims, open: pcd::open },
    Format { kind: FileKind::E57, suffixes: e57::SUFFIXES, claims: e57::claims, open: e57::open },
    Format { kind: FileKind::Pts, suffixes: &["pts"], claims: text::claims_pts, open: text::open },
    Format { kind: FileKind::Ptx, suffixes: &["ptx"], claims: text::claims_ptx, open: text::open },
    // Last, because what remains is claimed by name, too.
    Format {
        kind: FileKind::Text,
        suffixes: text::TABLE_SUFFIXES,
        claims: text::claims_table,
        open: text::open,
    },
];

/// Most bytes that decide what a file is.
pub(super) const HEAD_BYTES: usize = 4096;

const LAS_SUFFIXES: &[&str] = &["las", "laz"];

/// Suffixes, in lower case, of the files that are taken for scans when they are not named one by
/// one.
pub fn scan_suffixes() -> impl Iterator<Item = &'static str> {
    let foreign = FORMATS.iter().flat_map(|format| format.suffixes);
    LAS_SUFFIXES.iter().chain(foreign).copied()
}

/// Says what a file is; an error if it cannot be read or is no file.
pub fn detect(path: &Path) -> Result<FileKind, LasError> {
    let in_file = |fault| LasError::new(path, fault);
    let head = open_regular(path).and_then(|file| read_head(&file)).map_err(in_file)?;
    let foreign = || format_of(path, &head).map_or(FileKind::Other, |format| format.kind);
    Ok(las_kind(&head).unwrap_or_else(foreign))
}

/// Whether the first bytes are those of the LAS family, and of which member.
pub(super) fn las_kind(head: &[u8]) -> Option<FileKind> {
    let compressed = head.get(104).is_some_and(|byte| byte & 0x80 != 0);
    head.starts_with(b"LASF").then_some(if compressed { FileKind::Laz } else { FileKind::Las })
}

/// The format outside the LAS family that claims a file.
pub(super) fn format_of(path: &Path, head: &[u8]) -> Option<&'static Format> {
    let suffix = path.extension().map(|suffix| suffix.to_string_lossy().to_ascii_lowercase());
    let signs = Signs { head, suffix: suffix.as_deref().unwrap_or_default() };
    FORMATS.iter().find(|format| (format.claims)(&signs))
}

/// The bytes that decide a file's format.
pub(super) fn read_head(file: &PositionedFile) -> Result<Vec<u8>, LasFault> {
    file.read_range(0..file.bytes().min(HEAD_BYTES as u64))
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
    Ok(PositionedFile::at_path(file, path, bytes))
}
