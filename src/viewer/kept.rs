//! Where the store of a scan is kept.
//!
//! Beside the scan as `NAME.esker`, so that the next look at it needs no conversion; that of a
//! folder's scans beside the folder. A store that is there and was made from these files, after
//! their last change, is opened instead. Into a temporary folder if another file has that name, if
//! nothing can be written there, or on demand; it is removed when the scan is closed.

use std::fs;
use std::path::{Path, PathBuf};

use crate::frame::FIRST_PICTURE_BYTES;
use crate::input::{FileKind, detect};
use crate::store::{Store, is_store};

/// The name of the store for a scan or a folder of scans; none for a folder without a name.
pub fn store_beside(path: &Path) -> Option<PathBuf> {
    if !path.is_dir() {
        return Some(path.with_extension("esker"));
    }
    let folder = fs::canonicalize(path).ok()?;
    let mut name = folder.file_name()?.to_owned();
    name.push(".esker");
    Some(folder.with_file_name(name))
}

/// The store, if it was made from just these scans since their last change.
pub fn made_from(store_path: &Path, scans: &[PathBuf]) -> Option<Store> {
    let changed = |path: &Path| fs::metadata(path).and_then(|facts| facts.modified()).ok();
    let made = changed(store_path)?;
    for scan in scans {
        if made < changed(scan)? {
            return None;
        }
    }
    if !is_store(store_path) {
        return None;
    }
    let store = Store::open_with_coarse(store_path, FIRST_PICTURE_BYTES).ok()?;
    let names: Option<Vec<&str>> = scans.iter().map(|scan| scan.file_name()?.to_str()).collect();
    let mut names = names?;
    names.dedup();
    // A file of several scans stands there once for each.
    let sources = &store.metadata().sources;
    let mut known: Vec<&str> = sources.iter().map(|source| source.name.as_str()).collect();
    known.dedup();
    (names == known).then_some(store)
}

/// Whether a file can be made in the folder of that file.
pub fn can_write_beside(file: &Path) -> bool {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
    tempfile::tempfile_in(folder.unwrap_or(Path::new("."))).is_ok()
}

/// Whether a file is one of the LAS family, which is opened without reading all of it.
pub fn is_las(file: &Path) -> bool {
    matches!(detect(file), Ok(FileKind::Las | FileKind::Laz))
}
