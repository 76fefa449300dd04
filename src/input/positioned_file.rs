//! A file that many threads read at once, each at places of its own.
//!
//! No cursor and no memory map: a map turns a file that shrinks under it into a signal, a
//! positioned read into an error.

use std::fs::File;
use std::io;
use std::ops::Range;

use super::error::LasFault;

/// An open file and its length when it was opened.
#[derive(Debug)]
pub struct PositionedFile {
    #[cfg(any(unix, windows))]
    file: File,
    #[cfg(not(any(unix, windows)))]
    file: std::sync::Mutex<File>,
    bytes: u64,
}

impl PositionedFile {
    /// Takes an open file whose length is known.
    pub fn new(file: File, bytes: u64) -> Self {
        #[cfg(not(any(unix, windows)))]
        let file = std::sync::Mutex::new(file);
        PositionedFile { file, bytes }
    }

    /// Length when it was opened.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Reads some bytes at a place; 0 at the end of the file.
    pub fn read_at(&self, buffer: &mut [u8], byte: u64) -> io::Result<usize> {
        loop {
            match self.read_once(buffer, byte) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                answer => return answer,
            }
        }
    }

    #[cfg(unix)]
    fn read_once(&self, buffer: &mut [u8], byte: u64) -> io::Result<usize> {
        std::os::unix::fs::FileExt::read_at(&self.file, buffer, byte)
    }

    #[cfg(windows)]
    fn read_once(&self, buffer: &mut [u8], byte: u64) -> io::Result<usize> {
        std::os::windows::fs::FileExt::seek_read(&self.file, buffer, byte)
    }

    #[cfg(not(any(unix, windows)))]
    fn read_once(&self, buffer: &mut [u8], byte: u64) -> io::Result<usize> {
        use std::io::{Read, Seek, SeekFrom};
        let mut file = self.file.lock().map_err(|_| io::Error::other("a reader panicked"))?;
        file.seek(SeekFrom::Start(byte))?;
        file.read(buffer)
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
