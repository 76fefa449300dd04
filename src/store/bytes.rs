//! Where a store's bytes come from: a file, or anything else that reads by position.

use std::fmt::Debug;
use std::fs::File;
use std::io;

/// Bytes that are read by position, from any thread.
pub trait StoreBytes: Debug + Send + Sync {
    /// How many there are now.
    fn byte_count(&self) -> io::Result<u64>;

    /// Fills `buffer` with the bytes from `offset` on; an error if there are fewer.
    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()>;
}

impl StoreBytes for File {
    fn byte_count(&self) -> io::Result<u64> {
        self.metadata().map(|facts| facts.len())
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        #[cfg(unix)]
        {
            std::os::unix::fs::FileExt::read_exact_at(self, buffer, offset)
        }
        #[cfg(windows)]
        {
            let (mut buffer, mut offset) = (buffer, offset);
            while !buffer.is_empty() {
                match std::os::windows::fs::FileExt::seek_read(self, buffer, offset)? {
                    0 => return Err(io::ErrorKind::UnexpectedEof.into()),
                    read => {
                        buffer = &mut buffer[read..];
                        offset += read as u64;
                    }
                }
            }
            Ok(())
        }
    }
}
