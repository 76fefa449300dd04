//! Real scans that stand beside the checkout; tests that want them say so and pass where they are
//! absent.

#![allow(dead_code, reason = "each test binary uses a part")]

use std::path::{Path, PathBuf};

fn folder() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    if folder.is_dir() {
        return Some(folder);
    }
    eprintln!("skipped: no ../shared/data beside this checkout");
    None
}

/// One file by name.
pub fn file(name: &str) -> Option<PathBuf> {
    let path = folder()?.join(name);
    if path.exists() {
        return Some(path);
    }
    eprintln!("skipped: no {name} in ../shared/data");
    None
}

/// All LAS and LAZ files, by name.
pub fn scans() -> Option<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder()?).expect("the folder lists");
    let mut files: Vec<PathBuf> = entries
        .map(|entry| entry.expect("an entry reads").path())
        .filter(|path| path.extension().is_some_and(|s| s == "las" || s == "laz"))
        .collect();
    files.sort();
    Some(files)
}
