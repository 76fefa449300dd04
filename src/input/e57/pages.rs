//! The pages of an E57 file: 1020 bytes and their checksum.
//!
//! Places without checksums are called logical here, places in the file physical.

use crate::input::foreign::ForeignFault;
use crate::input::positioned_file::PositionedFile;

/// Size of a page.
pub const PAGE_BYTES: u64 = 1024;
const PAYLOAD_BYTES: u64 = PAGE_BYTES - 4;

/// A file without its checksums, which are compared on every read.
#[derive(Debug)]
pub struct Pages {
    file: PositionedFile,
}

impl Pages {
    /// Takes an open file.
    pub fn new(file: PositionedFile) -> Self {
        Pages { file }
    }

    /// Length of the file.
    pub fn file_bytes(&self) -> u64 {
        self.file.bytes()
    }

    /// Length without checksums, of whole pages.
    pub fn logical_bytes(&self) -> u64 {
        self.file.bytes() / PAGE_BYTES * PAYLOAD_BYTES
    }

    /// Logical place of a physical one.
    pub fn logical(&self, physical: u64) -> Result<u64, ForeignFault> {
        let (page, inside) = (physical / PAGE_BYTES, physical % PAGE_BYTES);
        let logical = page * PAYLOAD_BYTES + inside;
        if inside >= PAYLOAD_BYTES || logical >= self.logical_bytes() {
            let reason = format!("lies outside the pages of a file of {} bytes", self.file.bytes());
            return Err(ForeignFault::at_byte(physical, reason));
        }
        Ok(logical)
    }

    /// Appends logical bytes. The caller has checked that there are not too many.
    pub fn read(&self, start: u64, bytes: usize, into: &mut Vec<u8>) -> Result<(), ForeignFault> {
        let end = start + bytes as u64;
        if end > self.logical_bytes() {
            let reason = format!("the file ends before {bytes} bytes that should stand here");
            return Err(ForeignFault::at_byte(physical(start), reason));
        }
        if bytes == 0 {
            return Ok(());
        }
        let (first, last) = (start / PAYLOAD_BYTES, (end - 1) / PAYLOAD_BYTES);
        // Some pages at a time, so that memory is what was asked for and little more.
        const PAGES_AT_ONCE: u64 = 256;
        let mut raw = Vec::new();
        let mut page = first;
        while page <= last {
            let count = PAGES_AT_ONCE.min(last + 1 - page);
            raw.resize((count * PAGE_BYTES) as usize, 0);
            self.file.read_exact_at(&mut raw, page * PAGE_BYTES)?;
            for (index, bytes) in (page..).zip(raw.chunks_exact(PAGE_BYTES as usize)) {
                let (payload, checksum) = bytes.split_at(PAYLOAD_BYTES as usize);
                let found = crc32c::crc32c(payload);
                // Big-endian, unlike every other number of the format.
                let stated = u32::from_be_bytes(checksum.try_into().expect("4 bytes are left"));
                if found != stated {
                    let reason = format!("checksum {found:08x}, the page says {stated:08x}");
                    return Err(ForeignFault::at_byte(index * PAGE_BYTES, reason));
                }
                let page_start = index * PAYLOAD_BYTES;
                let from = start.saturating_sub(page_start) as usize;
                let to = (end - page_start).min(PAYLOAD_BYTES) as usize;
                into.extend_from_slice(&payload[from..to]);
            }
            page += count;
        }
        Ok(())
    }
}

/// Physical place of a logical one, for messages.
pub fn physical(logical: u64) -> u64 {
    logical / PAYLOAD_BYTES * PAGE_BYTES + logical % PAYLOAD_BYTES
}
