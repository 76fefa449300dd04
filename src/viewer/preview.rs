//! A first look at scans before they are converted: a store made of some of their points.
//!
//! Previews are small stores in a folder of their own, in memory where the system has such a
//! folder. Where an open file may lose its name the folder is gone as soon as the store is open,
//! so that nothing can stay behind.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use tempfile::TempDir;

use crate::build::{ConvertOptions, Progress, Sources, available_memory, convert_sources};
use crate::store::Store;

/// Points of the first preview where nothing else is said: enough to fill a window, and made in a
/// few tens of milliseconds.
pub const FIRST_PREVIEW_POINTS: u64 = 250_000;
/// Largest part of all points that a first preview has.
const FIRST_PREVIEW_PART: u64 = 12;
/// All previews together may cost a fifth of the conversion. A preview costs about what converting
/// as many points does, and where processors draw as much again; the last one is that part of all.
const LAST_PREVIEW_PART: u64 = 24;
/// More points than this make no finer picture of the whole.
const MOST_PREVIEW_POINTS: u64 = 4_000_000;
/// How many times more points each preview has.
const GROWTH: u64 = 4;
/// Largest preview in a folder that is memory; such folders may be as small as 64 MiB.
const MOST_BYTES_IN_MEMORY: u64 = 48 << 20;

/// Sizes of the previews of so many points, in the order they are made, the first of about `first`
/// points; none where the conversion is about as quick.
pub fn preview_sizes(points: u64, first: u64) -> Vec<u64> {
    let mut sizes = Vec::new();
    if first > 0 && points >= 2 * first {
        let first = first.min(points / FIRST_PREVIEW_PART).max(1);
        let mut size = (points / LAST_PREVIEW_PART).min(MOST_PREVIEW_POINTS.max(first));
        // One that is hardly finer than the one before is none.
        while size > first + first / 2 {
            sizes.push(size);
            size = (size / GROWTH).max(first);
        }
        sizes.push(first);
    }
    sizes.reverse();
    sizes
}

/// Makes a store of about so many points of the sources. The folder, if it is still needed, has to
/// live as long as the store.
pub fn make_preview(
    sources: &Sources,
    points: u64,
    folder: Option<&Path>,
    progress: &dyn Progress,
    cancelled: &AtomicBool,
) -> anyhow::Result<(Store, Option<TempDir>)> {
    preview_of(&sources.sampled(points), folder, progress, cancelled)
}

/// Makes a store of all points of the sources, as a preview.
pub fn preview_of(
    sample: &Sources,
    folder: Option<&Path>,
    progress: &dyn Progress,
    cancelled: &AtomicBool,
) -> anyhow::Result<(Store, Option<TempDir>)> {
    let bytes = sample.expected_points() * u64::from(sample.schema().record_bytes);
    let folder = folder.map_or_else(|| preview_folder(bytes), Path::to_path_buf);
    let folder = tempfile::Builder::new()
        .prefix("esker-preview-")
        .tempdir_in(&folder)
        .with_context(|| format!("{}: cannot make a temporary folder", folder.display()))?;
    let output = folder.path().join("preview.esker");
    let options =
        ConvertOptions { memory_bytes: available_memory() / 4, ..ConvertOptions::default() };
    convert_sources(sample, &output, &options, progress, cancelled)?;
    let store = Store::open(&output)?;
    if cfg!(unix) {
        drop(folder);
        return Ok((store, None));
    }
    Ok((store, Some(folder)))
}

fn preview_folder(bytes: u64) -> PathBuf {
    let memory = Path::new("/dev/shm");
    match bytes <= MOST_BYTES_IN_MEMORY && memory.is_dir() {
        true => memory.to_path_buf(),
        false => std::env::temp_dir(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn previews_grow_and_cost_little() {
        assert_eq!(preview_sizes(10_653_336, 250_000), [250_000, 443_889]);
        assert_eq!(preview_sizes(200_000_000, 250_000), [250_000, 1_000_000, 4_000_000]);
        assert_eq!(preview_sizes(2_000_000, 250_000), [166_666]);
        assert_eq!(preview_sizes(499_999, 250_000), [0; 0]);
        assert_eq!(preview_sizes(10_000_000, 0), [0; 0]);
        for points in (0..60).map(|i| 1u64 << i) {
            let sizes = preview_sizes(points, 250_000);
            assert!(sizes.is_sorted_by(|a, b| a < b), "{points}: {sizes:?}");
            assert!(sizes.iter().sum::<u64>() <= points / 8, "{points}: {sizes:?}");
        }
    }
}
