//! Files, folders and patterns from the command line into a list of scan files, and of models where
//! these are taken.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};

use crate::input::{model_suffixes, scan_suffixes};

/// The scan files that arguments name, in the order given; those of a folder or a pattern sorted
/// by name. A folder counts with all folders in it; only its scan files count.
pub fn expand(arguments: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    expand_by(arguments, expand_folder)
}

/// The same, and the models of folders besides.
pub fn expand_with_models(arguments: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    expand_by(arguments, expand_folder_with_models)
}

fn expand_by(
    arguments: &[PathBuf],
    list: fn(&Path) -> anyhow::Result<Vec<PathBuf>>,
) -> anyhow::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for path in expand_files(arguments)? {
        match path.is_dir() {
            true => files.extend(list(&path)?),
            false => files.push(path),
        }
    }
    Ok(files)
}

/// The same, but folders are left as they are.
pub fn expand_files(arguments: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    for argument in arguments {
        match argument.exists() {
            true => paths.push(argument.clone()),
            false => paths.extend(expand_pattern(argument)?),
        }
    }
    Ok(paths)
}

/// The scan files of a folder and of all folders in it, sorted by name.
pub fn expand_folder(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    list_folder(folder, "scan file", &scan_suffixes().collect::<Vec<_>>())
}

/// The scan files and models of a folder and of all folders in it, sorted by name.
pub fn expand_folder_with_models(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let suffixes: Vec<_> = scan_suffixes().chain(model_suffixes()).collect();
    list_folder(folder, "scan or model", &suffixes)
}

fn list_folder(folder: &Path, what: &str, suffixes: &[&str]) -> anyhow::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    collect_folder(folder, suffixes, &mut files)
        .with_context(|| format!("{}: cannot list the folder", folder.display()))?;
    if files.is_empty() {
        let known: Vec<String> = suffixes.iter().map(|suffix| format!(".{suffix}")).collect();
        let known = known.join(", ");
        bail!("{}: no {what} ({known}) in this folder", folder.display());
    }
    files.sort();
    Ok(files)
}

fn collect_folder(
    folder: &Path,
    suffixes: &[&str],
    files: &mut Vec<PathBuf>,
) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let path = entry.path();
        // Links are not followed into folders, so a circle of links ends.
        if entry.file_type()?.is_dir() {
            collect_folder(&path, suffixes, files)?;
        } else if has_suffix(&path, suffixes) {
            files.push(path);
        }
    }
    Ok(())
}

fn expand_pattern(pattern: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let text = pattern.to_string_lossy();
    let is_pattern = text.contains(['*', '?', '[']);
    let matches: Vec<PathBuf> = match glob::glob(&text) {
        Ok(paths) if is_pattern => paths.flatten().filter(|path| path.is_file()).collect(),
        _ => Vec::new(),
    };
    if matches.is_empty() {
        let what = if is_pattern { "no file matches" } else { "no such file or folder" };
        bail!("{}: {what}", pattern.display());
    }
    Ok(matches)
}

/// Whether a file's name says that it is a scan this program converts.
pub fn is_scan(path: &Path) -> bool {
    has_suffix(path, &scan_suffixes().collect::<Vec<_>>())
}

fn has_suffix(path: &Path, suffixes: &[&str]) -> bool {
    let suffix = path.extension().and_then(|suffix| suffix.to_str()).map(str::to_ascii_lowercase);
    suffix.is_some_and(|suffix| suffixes.contains(&suffix.as_str()))
}
