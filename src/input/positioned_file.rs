//! A file that many threads read at once, each at places of its own.
//!
//! No cursor and no memory map: a map turns a file that shrinks under it into a signal, a
//! positioned read into an error.

use std::fmt;
use std::fs::File;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use super::error::LasFault;

/// Most files that are kept open. Systems allow a process a few hundred; a folder of 10,000 tiles
/// has more, and those beyond are opened for each read.
const MOST_HELD_FILES: usize = 128;

static HELD_FILES: AtomicUsize = AtomicUsize::new(0);

/// A wish to stop reading, which any thread may set.
///
/// It is no part of how a file is read: all are equal, and look the same when printed.
#[derive(Clone, Default)]
pub struct Cancel(Option<Arc<AtomicBool>>);

impl Cancel {
    /// Reading ends soon after the flag is set, with an error.
    pub fn when(flag: &Arc<AtomicBool>) -> Self {
        Cancel(Some(Arc::clone(flag)))
    }

    /// Whether it is set.
    pub fn is_set(&self) -> bool {
        self.0.as_ref().is_some_and(|flag| flag.load(Ordering::Relaxed))
    }
}

impl fmt::Debug for Cancel {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("Cancel")
    }
}

impl PartialEq for Cancel {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl Eq for Cancel {}

/// An open file and its length when it was opened.
#[derive(Debug)]
pub struct PositionedFile {
    access: Access,
    bytes: u64,
    cancel: Cancel,
}

#[derive(Debug)]
enum Access {
    Held(Handle),
    ByPath(PathBuf),
    Memory(Vec<u8>),
}

#[cfg(any(unix, windows))]
type Handle = File;
#[cfg(not(any(unix, windows)))]
type Handle = std::sync::Mutex<File>;

impl PositionedFile {
    /// Takes an open file whose length is known.
    pub fn new(file: File, bytes: u64) -> Self {
        HELD_FILES.fetch_add(1, Ordering::Relaxed);
        PositionedFile { access: Access::Held(handle(file)), bytes, cancel: Cancel::default() }
    }

    /// The same for a file that can be opened again by its path, should too many be open.
    pub fn at_path(file: File, path: &Path, bytes: u64) -> Self {
        if HELD_FILES.load(Ordering::Relaxed) < MOST_HELD_FILES {
            return PositionedFile::new(file, bytes);
        }
        let access = Access::ByPath(path.to_path_buf());
        PositionedFile { access, bytes, cancel: Cancel::default() }
    }

    /// Bytes that are no file, read as if they were one.
    pub fn in_memory(bytes: Vec<u8>) -> Self {
        let length = bytes.len() as u64;
        PositionedFile { access: Access::Memory(bytes), bytes: length, cancel: Cancel::default() }
    }

    /// The same file, of which nothing can be read any more once reading is cancelled. Readers that
    /// look through a whole file when they open it end that way.
    pub fn until(mut self, cancel: &Cancel) -> Self {
        self.cancel = cancel.clone();
        self
    }

    /// Length when it was opened.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Reads some bytes at a place; 0 at the end of the file.
    pub fn read_at(&self, buffer: &mut [u8], byte: u64) -> io::Result<usize> {
        if self.cancel.is_set() {
            return Err(io::Error::other("cancelled"));
        }
        match &self.access {
            Access::Held(file) => read_at(file, buffer, byte),
            Access::ByPath(path) => read_at(&handle(File::open(path)?), buffer, byte),
            Access::Memory(bytes) => {
                let start = usize::try_from(byte).map_or(bytes.len(), |b| b.min(bytes.len()));
                let count = buffer.len().min(bytes.len() - start);
                buffer[..count].copy_from_slice(&bytes[start..start + count]);
                Ok(count)
            }
        }
    }

    /// Fills the buffer from a place.
    pub fn read_exact_at(&self, buffer: &mut [u8], byte: u64) -> Result<(), LasFault> {
        let mut filled = 0;
        while filled < buffer.len() {
            let at = byte + filled as u64;
            match self.read_at(&mut buffer[filled..], at) {
                Ok(0) => {
                    let wanted = byte..byte + buffer.len() as u64;
                    return Err(LasFault::Shrunk { byte: at, wanted });
                }
                Ok(count) => filled += count,
                Err(source) => return Err(LasFault::Io { action: "read", source }),
            }
        }
        Ok(())
    }

    /// The bytes of a range that the caller has checked to lie in the file and to be small.
    pub fn read_range(&self, range: Range<u64>) -> Result<Vec<u8>, LasFault> {
        debug_assert!(range.end <= self.bytes, "{range:?} was not checked");
        let mut bytes = vec![0; (range.end - range.start) as usize];
        self.read_exact_at(&mut bytes, range.start)?;
        Ok(bytes)
    }
}

impl Drop for PositionedFile {
    fn drop(&mut self) {
        if matches!(self.access, Access::Held(_)) {
            HELD_FILES.fetch_sub(1, Ordering::Relaxed);
        }
    }
}

#[cfg(any(unix, windows))]
fn handle(file: File) -> Handle {
    file
}

#[cfg(not(any(unix, windows)))]
fn handle(file: File) -> Handle {
    std::sync::Mutex::new(file)
}

fn read_at(file: &Handle, buffer: &mut [u8], byte: u64) -> io::Result<usize> {
    loop {
        match read_once(file, buffer, byte) {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            answer => return answer,
        }
    }
}

#[cfg(unix)]
fn read_once(file: &Handle, buffer: &mut [u8], byte: u64) -> io::Result<usize> {
    std::os::unix::fs::FileExt::read_at(file, buffer, byte)
}

#[cfg(windows)]
fn read_once(file: &Handle, buffer: &mut [u8], byte: u64) -> io::Result<usize> {
    std::os::windows::fs::FileExt::seek_read(file, buffer, byte)
}

#[cfg(not(any(unix, windows)))]
fn read_once(file: &Handle, buffer: &mut [u8], byte: u64) -> io::Result<usize> {
    use std::io::{Read, Seek, SeekFrom};
    let mut file = file.lock().map_err(|_| io::Error::other("a reader panicked"))?;
    file.seek(SeekFrom::Start(byte))?;
    file.read(buffer)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_read_once_reading_is_cancelled() {
        let flag = Arc::new(AtomicBool::new(false));
        let file = PositionedFile::in_memory(vec![7; 100]).until(&Cancel::when(&flag));
        assert_eq!(file.read_range(0..100).expect("nobody cancelled").len(), 100);
        flag.store(true, Ordering::Relaxed);
        let error = file.read_range(0..1).expect_err("it is cancelled");
        assert!(error.to_string().contains("cancelled"), "{error}");
    }
}
