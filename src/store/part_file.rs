//! The file that a store is while it is being written: beside its destination, locked, and found
//! again if its writer dies.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::store::header::HEADER_BYTES;

/// Locks a file, or says that another process has it.
pub fn lock_at_once(file: &File) -> io::Result<()> {
    file.try_lock().map_err(|error| match error {
        TryLockError::WouldBlock => {
            io::Error::new(io::ErrorKind::ResourceBusy, "another process is using it")
        }
        TryLockError::Error(error) => error,
    })
}

/// Removes what a killed run may have left beside a destination.
pub fn remove_dead_part(destination: &Path) {
    if let Some(path) = part_path(destination) {
        // If someone is writing it, it is not dead.
        let _ = PartFile::remove_dead(&path);
    }
}

pub(super) fn part_path(destination: &Path) -> Option<PathBuf> {
    let name = destination.file_name()?.to_string_lossy();
    Some(destination.with_file_name(format!(".{name}.part")))
}

/// Brings the name of a file to disk, which its folder holds: else the power may go after a store was
/// said to be done, and the store with it. Systems that cannot do that for folders have no need to.
fn sync_folder_of(path: &Path) {
    if cfg!(unix) {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        let _ = File::open(folder.unwrap_or(Path::new("."))).and_then(|folder| folder.sync_all());
    }
}

/// A file being written beside its destination. Its name follows from the destination's, so that
/// what a killed run left is found, to go on with or to remove; a lock keeps two runs apart.
pub(super) struct PartFile {
    /// Being written.
    pub file: File,
    path: PathBuf,
}

impl PartFile {
    pub fn create(destination: &Path) -> io::Result<Self> {
        let path = part_path(destination).ok_or(io::ErrorKind::InvalidInput)?;
        // What a killed run left may be a second name of the destination: never written to.
        PartFile::remove_dead(&path)?;
        let mut file = OpenOptions::new().create_new(true).read(true).write(true).open(&path)?;
        file.lock()?;
        file.write_all(&[0; HEADER_BYTES])?;
        Ok(PartFile { file, path })
    }

    /// The file that a killed run left, cut to what is known to be right.
    pub fn resume(destination: &Path, bytes: u64) -> io::Result<Self> {
        let path = part_path(destination).ok_or(io::ErrorKind::InvalidInput)?;
        let mut file = OpenOptions::new().read(true).write(true).open(&path)?;
        lock_at_once(&file)?;
        if file.metadata()?.len() < bytes {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        file.set_len(bytes)?;
        file.seek(SeekFrom::Start(bytes))?;
        Ok(PartFile { file, path })
    }

    /// Removes a file that no living process is writing.
    fn remove_dead(path: &Path) -> io::Result<()> {
        let file = match OpenOptions::new().write(true).open(path) {
            Ok(file) => file,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            Err(error) => return Err(error),
        };
        // A process that is being started somewhere in this program has all its files for a moment.
        let mut tries = (1..20).map(|_| std::thread::sleep(Duration::from_millis(5)));
        while let Err(error) = lock_at_once(&file) {
            if tries.next().is_none() {
                return Err(error);
            }
        }
        std::fs::remove_file(path)
    }

    /// Gives the file its name, which nothing else may have unless `overwrite`.
    pub fn rename(self, destination: &Path, overwrite: bool) -> io::Result<()> {
        self.give_name(destination, overwrite)?;
        sync_folder_of(destination);
        Ok(())
    }

    fn give_name(&self, destination: &Path, overwrite: bool) -> io::Result<()> {
        if overwrite {
            return std::fs::rename(&self.path, destination);
        }
        match std::fs::hard_link(&self.path, destination) {
            Ok(()) => std::fs::remove_file(&self.path),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Err(error),
            // Not every file system has links.
            Err(_) if destination.exists() => Err(io::ErrorKind::AlreadyExists.into()),
            Err(_) => std::fs::rename(&self.path, destination),
        }
    }
}
