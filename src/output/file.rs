//! A file that gets its name only when it is complete.

use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use super::error::WriteError;

const BUFFER_BYTES: usize = 1 << 20;

/// A file under a temporary name beside its target. Dropped before [`finish`](Self::finish), it
/// leaves nothing behind.
pub(super) struct OutputFile {
    path: PathBuf,
    file: BufWriter<NamedTempFile>,
    /// Bytes written, since everything is appended.
    end: u64,
}

impl OutputFile {
    /// Starts a file that will stand under `path`.
    pub fn create(path: &Path) -> Result<Self, WriteError> {
        let file = temporary_beside(path);
        let file = file.map_err(|source| WriteError::io("create", source, path))?;
        let file = BufWriter::with_capacity(BUFFER_BYTES, file);
        Ok(OutputFile { path: path.to_path_buf(), file, end: 0 })
    }

    /// The name that the file will have.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Appends bytes.
    pub fn put(&mut self, bytes: &[u8]) -> Result<(), WriteError> {
        self.end += bytes.len() as u64;
        self.file.write_all(bytes).map_err(|source| WriteError::io("write", source, &self.path))
    }

    /// Appends what `source` gives; tells how much.
    pub fn put_all_of(&mut self, source: &mut dyn Read) -> Result<u64, WriteError> {
        let copied = io::copy(source, &mut self.file);
        let copied = copied.map_err(|source| WriteError::io("write", source, &self.path))?;
        self.end += copied;
        Ok(copied)
    }

    /// Bytes so far.
    pub fn end(&self) -> u64 {
        self.end
    }

    /// Replaces bytes that were written before.
    pub fn put_at(&mut self, at: u64, bytes: &[u8]) -> Result<(), WriteError> {
        assert!(at + bytes.len() as u64 <= self.end, "these bytes were written before");
        let end = SeekFrom::Start(self.end);
        let written = self.file.seek(SeekFrom::Start(at)).and_then(|_| self.file.write_all(bytes));
        let back = written.and_then(|()| self.file.seek(end));
        back.map(|_| ()).map_err(|source| WriteError::io("write", source, &self.path))
    }

    /// Puts the complete file under its name.
    pub fn finish(self) -> Result<(), WriteError> {
        let OutputFile { path, file, .. } = self;
        let write_error = |source| WriteError::io("write", source, &path);
        let file = file.into_inner().map_err(|error| write_error(error.into_error()))?;
        file.as_file().sync_all().map_err(write_error)?;
        file.persist(&path).map_err(|error| WriteError::io("rename to", error.error, &path))?;
        Ok(())
    }
}

/// A file under a temporary name in the target's folder, with the permissions of a plain new file.
fn temporary_beside(path: &Path) -> io::Result<NamedTempFile> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let name = path.file_name().ok_or(io::ErrorKind::InvalidInput)?;
    let prefix = format!(".{}.", name.to_string_lossy());
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(".tmp");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder.unwrap_or(Path::new(".")))
}
