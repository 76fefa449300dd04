//! Rows in pages of equal size: in memory as long as the budget lasts, on disk beyond it.
//!
//! Pages on disk stand in one file of the work folder, each written once. Buffers are
//! handed round and used again, because touching fresh memory costs more than the work on it.

use std::fs::File;
use std::io;
use std::ops::Deref;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock};

use memmap2::MmapMut;

use crate::build::BuildError;
use crate::build::work::Work;
use crate::store::StoreBytes;

/// Memory for pages: reserved as a whole, touched only as far as it is used.
///
/// Not backed by huge pages: they saved little where memory was warm and cost far more where a
/// virtual machine had to get it from its host (`docs/measurements/conversion.md`).
pub struct Slab(Option<MmapMut>);

impl Slab {
    /// Room for `bytes`; none if the system refuses.
    pub fn reserve(bytes: u64) -> Self {
        let bytes = usize::try_from(bytes).unwrap_or(usize::MAX);
        Slab(if bytes > 0 { MmapMut::map_anon(bytes).ok() } else { None })
    }
}

/// Room for a page and the rows in it.
#[derive(Debug)]
pub struct PageBuffer<'a> {
    room: Room<'a>,
    used: usize,
}

#[derive(Debug)]
enum Room<'a> {
    Slab(&'a mut [u8]),
    Heap(Vec<u8>),
}

impl PageBuffer<'_> {
    /// All of its room.
    pub fn room(&mut self) -> &mut [u8] {
        match &mut self.room {
            Room::Slab(bytes) => bytes,
            Room::Heap(bytes) => bytes,
        }
    }

    /// Says how much of the room, from its start, holds rows.
    pub fn set_used(&mut self, bytes: usize) {
        self.used = bytes;
    }
}

impl Deref for PageBuffer<'_> {
    type Target = [u8];

    /// The rows.
    fn deref(&self) -> &[u8] {
        match &self.room {
            Room::Slab(bytes) => &bytes[..self.used],
            Room::Heap(bytes) => &bytes[..self.used],
        }
    }
}

/// Rows that were put away.
#[derive(Debug)]
pub enum Page<'a> {
    /// At hand.
    Memory(PageBuffer<'a>),
    /// In the temporary file.
    Disk {
        /// First byte.
        offset: u64,
        /// Length in bytes.
        bytes: u32,
    },
}

/// All pages of a conversion.
pub struct PageStore<'a> {
    page_bytes: usize,
    free: Mutex<Vec<PageBuffer<'a>>>,
    work: &'a Work,
    file: OnceLock<File>,
    creation: Mutex<()>,
    end: AtomicU64,
}

/// Where rows are on disk: first byte and length.
pub type DiskPlace = (u64, u32);

impl<'a> PageStore<'a> {
    /// Pages of `page_bytes` in a slab; those that find no room go to a file of the work folder,
    /// from byte `end` on.
    pub fn new(work: &'a Work, page_bytes: usize, slab: &'a mut Slab, end: u64) -> Self {
        let bytes: &'a mut [u8] = slab.0.as_deref_mut().unwrap_or_default();
        let mut free: Vec<PageBuffer> = bytes
            .chunks_exact_mut(page_bytes)
            .map(|room| PageBuffer { room: Room::Slab(room), used: 0 })
            .collect();
        // Taken from the end: what was used last comes first.
        free.reverse();
        PageStore {
            page_bytes,
            free: Mutex::new(free),
            work,
            file: OnceLock::new(),
            creation: Mutex::new(()),
            end: AtomicU64::new(end),
        }
    }

    /// Bytes of a full page.
    pub fn page_bytes(&self) -> usize {
        self.page_bytes
    }

    /// Bytes written to disk so far.
    pub fn written_bytes(&self) -> u64 {
        self.end.load(Ordering::Relaxed)
    }

    fn take_free(&self) -> Option<PageBuffer<'a>> {
        self.free.lock().expect("no holder of the lock panics").pop()
    }

    /// An empty buffer with room for a page; beyond the slab where that is full.
    pub fn buffer(&self) -> PageBuffer<'a> {
        let room = || Room::Heap(vec![0; self.page_bytes]);
        self.take_free().unwrap_or_else(|| PageBuffer { room: room(), used: 0 })
    }

    /// Puts a page away and hands out an empty buffer for the next one.
    pub fn keep(&self, rows: PageBuffer<'a>) -> Result<(Page<'a>, PageBuffer<'a>), BuildError> {
        if let Some(next) = self.take_free() {
            return Ok((Page::Memory(rows), next));
        }
        let page = self.write(&rows)?;
        Ok((page, PageBuffer { used: 0, ..rows }))
    }

    /// Puts the last page of a stream away, in no more memory than it needs.
    pub fn keep_last(&self, rows: PageBuffer<'a>) -> Result<Page<'a>, BuildError> {
        let is_full = self.free.lock().expect("no holder of the lock panics").is_empty();
        if is_full {
            let page = self.write(&rows)?;
            self.give_back(rows);
            Ok(page)
        } else if 2 * rows.len() < self.page_bytes {
            let copy = PageBuffer { room: Room::Heap(rows.to_vec()), used: rows.len() };
            self.give_back(rows);
            Ok(Page::Memory(copy))
        } else {
            Ok(Page::Memory(rows))
        }
    }

    fn write(&self, rows: &[u8]) -> Result<Page<'a>, BuildError> {
        let (offset, bytes) = self.write_bytes(rows)?;
        Ok(Page::Disk { offset, bytes })
    }

    /// Writes bytes of any length and tells where they are.
    pub fn write_bytes(&self, bytes: &[u8]) -> Result<DiskPlace, BuildError> {
        let file = self.file().map_err(|e| self.work.error("cannot create a temporary file", e))?;
        let offset = self.end.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        let written = self.work.before_write().and_then(|()| write_all_at(file, bytes, offset));
        written.map_err(|e| self.work.error("cannot write", e))?;
        Ok((offset, bytes.len() as u32))
    }

    /// Reads bytes back.
    pub fn read_bytes(&self, (offset, bytes): DiskPlace) -> Result<Vec<u8>, BuildError> {
        let mut read = vec![0; bytes as usize];
        let file = self.file().map_err(|e| self.work.error("cannot open", e))?;
        file.read_exact_at(&mut read, offset)
            .map_err(|e| self.work.error("cannot read back", e))?;
        Ok(read)
    }

    /// Writes bytes piece by piece: the lengths of places have 32 bits.
    pub fn write_pieces(&self, bytes: &[u8]) -> Result<Vec<DiskPlace>, BuildError> {
        const MOST_PIECE_BYTES: usize = 1 << 30;
        bytes.chunks(MOST_PIECE_BYTES).map(|piece| self.write_bytes(piece)).collect()
    }

    /// Reads all pieces back.
    pub fn read_pieces(&self, places: Vec<DiskPlace>) -> Result<Vec<u8>, BuildError> {
        let pieces = places.into_iter().map(|place| self.read_bytes(place));
        Ok(pieces.collect::<Result<Vec<_>, _>>()?.concat())
    }

    /// Brings a page to disk, if it is not there, and tells where it is.
    pub fn to_disk(&self, page: &mut Page<'a>) -> Result<DiskPlace, BuildError> {
        match page {
            Page::Disk { offset, bytes } => Ok((*offset, *bytes)),
            Page::Memory(rows) => {
                let (offset, bytes) = self.write_bytes(rows)?;
                let kept = std::mem::replace(page, Page::Disk { offset, bytes });
                if let Page::Memory(rows) = kept {
                    self.give_back(rows);
                }
                Ok((offset, bytes))
            }
        }
    }

    /// Waits until everything written is on disk.
    pub fn sync(&self) -> Result<(), BuildError> {
        let synced = self.file.get().map_or(Ok(()), File::sync_data);
        synced.map_err(|e| self.work.error("cannot write", e))
    }

    fn file(&self) -> io::Result<&File> {
        if let Some(file) = self.file.get() {
            return Ok(file);
        }
        let _one_creates = self.creation.lock().expect("no holder of the lock panics");
        if self.file.get().is_none() {
            let file = self.work.file("pages")?;
            self.file.set(file).expect("only the holder of the lock sets it");
        }
        Ok(self.file.get().expect("it was set"))
    }

    /// The rows of a page.
    pub fn load(&self, page: Page<'a>) -> Result<PageBuffer<'a>, BuildError> {
        match page {
            Page::Memory(rows) => Ok(rows),
            Page::Disk { offset, bytes } => {
                let mut rows = self.buffer();
                rows.set_used(bytes as usize);
                let file = self.file().map_err(|e| self.work.error("cannot open", e))?;
                file.read_exact_at(&mut rows.room()[..bytes as usize], offset)
                    .map_err(|e| self.work.error("cannot read back", e))?;
                Ok(rows)
            }
        }
    }

    /// Shows the rows of a page, which stays where it is.
    pub fn look<R>(
        &self,
        page: &Page<'a>,
        look: impl FnOnce(&[u8]) -> Result<R, BuildError>,
    ) -> Result<R, BuildError> {
        match page {
            Page::Memory(rows) => look(rows),
            Page::Disk { offset, bytes } => {
                let rows = self.load(Page::Disk { offset: *offset, bytes: *bytes })?;
                let outcome = look(&rows);
                self.give_back(rows);
                outcome
            }
        }
    }

    /// Takes a buffer back to use it again.
    pub fn give_back(&self, mut buffer: PageBuffer<'a>) {
        if matches!(buffer.room, Room::Slab(_)) {
            buffer.used = 0;
            self.free.lock().expect("no holder of the lock panics").push(buffer);
        }
    }
}

#[cfg(unix)]
fn write_all_at(file: &File, bytes: &[u8], offset: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, offset)
}

#[cfg(windows)]
fn write_all_at(file: &File, mut bytes: &[u8], mut offset: u64) -> io::Result<()> {
    use std::os::windows::fs::FileExt;
    while !bytes.is_empty() {
        let written = file.seek_write(bytes, offset)?;
        bytes = &bytes[written..];
        offset += written as u64;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn pages_come_back_from_memory_and_from_disk() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for (memory, expected_on_disk) in [(0, 21), (300, 19), (1 << 20, 0)] {
            let mut slab = Slab::reserve(memory);
            let work = Work::new(folder.path(), Path::new("out"), None);
            let store = PageStore::new(&work, 100, &mut slab, 0);
            let mut pages = Vec::new();
            let mut buffer = store.buffer();
            for i in 0..20u8 {
                let used = 100 - usize::from(i % 3);
                buffer.room()[..used].fill(i);
                buffer.set_used(used);
                let (page, next) = store.keep(buffer).expect("keeps");
                assert!(next.is_empty());
                pages.push(page);
                buffer = next;
            }
            buffer.room()[..7].fill(99);
            buffer.set_used(7);
            pages.push(store.keep_last(buffer).expect("keeps"));
            let on_disk = pages.iter().filter(|page| matches!(page, Page::Disk { .. })).count();
            assert_eq!(on_disk, expected_on_disk);
            for (i, page) in pages.into_iter().enumerate() {
                let rows = store.load(page).expect("loads");
                assert_eq!(rows.len(), if i < 20 { 100 - i % 3 } else { 7 });
                assert!(rows.iter().all(|&b| usize::from(b) == if i < 20 { i } else { 99 }));
                store.give_back(rows);
            }
            work.remove();
            assert_eq!(std::fs::read_dir(folder.path()).expect("it lists").count(), 0);
        }
    }
}
