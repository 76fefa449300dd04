//! Rows in pages of equal size: in memory as long as the budget lasts, on disk beyond it.
//!
//! Pages on disk stand in one file of the work folder, each written once, packed (`packing`) where
//! that helps: a disk is slower than all else. Buffers are handed round and used again, because
//! touching fresh memory costs more than the work on it.

use std::fs::File;
use std::io;
use std::ops::Deref;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, OnceLock};

use memmap2::MmapMut;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::build::BuildError;
use crate::build::packing::Packer;
use crate::build::work::Work;
use crate::store::StoreBytes;

/// Memory for pages: reserved as a whole, touched only as far as it is used.
///
/// Not backed by huge pages: they saved little where memory was warm and cost far more where a
/// virtual machine had to get it from its host (`docs/measurements/conversion.md`).
pub struct Slab(Vec<MmapMut>);

/// Bytes that are reserved together, about; and got from the system together, which takes half as
/// long as getting them one fault at a time.
const RESERVATION: usize = 1 << 20;

impl Slab {
    /// Room for `bytes` in pages of `page_bytes`; less if the system refuses.
    pub fn reserve(bytes: u64, page_bytes: usize) -> Self {
        let mut pages = usize::try_from(bytes).unwrap_or(usize::MAX) / page_bytes;
        let most = (RESERVATION / page_bytes).max(1);
        let mut parts = Vec::new();
        while pages > 0 {
            let Ok(part) = MmapMut::map_anon(pages.min(most) * page_bytes) else { break };
            pages -= pages.min(most);
            parts.push(part);
        }
        Slab(parts)
    }

    /// Gives the memory back, which takes the system a while, on all threads.
    pub fn release(self) {
        self.0.into_par_iter().for_each(drop);
    }
}

/// Room for a page and the rows in it.
#[derive(Debug)]
pub struct PageBuffer<'a> {
    room: Room<'a>,
    used: usize,
    stride: usize,
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

    /// Says how much of the room, from its start, holds rows, and how long a row is.
    pub fn set_used(&mut self, bytes: usize, stride: usize) {
        (self.used, self.stride) = (bytes, stride);
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
    Disk(DiskPlace),
}

/// Where rows or other bytes are on disk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiskPlace {
    /// First byte in the file.
    offset: u64,
    /// Length in the file.
    stored: u32,
    /// Length in memory; packed, if that is another.
    bytes: u32,
}

/// Room for pages that nobody uses.
struct Free<'a> {
    /// Used before: touching it again costs nothing.
    buffers: Vec<PageBuffer<'a>>,
    /// Not touched yet.
    fresh: std::slice::IterMut<'a, MmapMut>,
}

/// All pages of a conversion.
pub struct PageStore<'a> {
    page_bytes: usize,
    free: Mutex<Free<'a>>,
    work: &'a Work,
    file: OnceLock<File>,
    creation: Mutex<()>,
    end: AtomicU64,
    packers: Mutex<Vec<Packer>>,
}

impl<'a> PageStore<'a> {
    /// Pages of `page_bytes` in a slab; those that find no room go to a file of the work folder,
    /// from byte `end` on.
    pub fn new(work: &'a Work, page_bytes: usize, slab: &'a mut Slab, end: u64) -> Self {
        let free = Free { buffers: Vec::new(), fresh: slab.0.iter_mut() };
        PageStore {
            page_bytes,
            free: Mutex::new(free),
            work,
            file: OnceLock::new(),
            creation: Mutex::new(()),
            end: AtomicU64::new(end),
            packers: Mutex::default(),
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

    fn free(&self) -> MutexGuard<'_, Free<'a>> {
        self.free.lock().expect("no holder of the lock panics")
    }

    fn take_free(&self) -> Option<PageBuffer<'a>> {
        let part = {
            let mut free = self.free();
            // What was used last comes first.
            if let Some(buffer) = free.buffers.pop() {
                return Some(buffer);
            }
            free.fresh.next()?
        };
        touch(part);
        let rooms = part.chunks_exact_mut(self.page_bytes);
        let mut buffers =
            rooms.map(|room| PageBuffer { room: Room::Slab(room), used: 0, stride: 0 });
        let first = buffers.next();
        self.free().buffers.extend(buffers);
        first
    }

    /// An empty buffer with room for a page; beyond the slab where that is full.
    pub fn buffer(&self) -> PageBuffer<'a> {
        let room = || Room::Heap(vec![0; self.page_bytes]);
        self.take_free().unwrap_or_else(|| PageBuffer { room: room(), used: 0, stride: 0 })
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
        let is_full = {
            let free = self.free();
            free.buffers.is_empty() && free.fresh.len() == 0
        };
        if is_full {
            let page = self.write(&rows)?;
            self.give_back(rows);
            Ok(page)
        } else if 2 * rows.len() < self.page_bytes {
            let room = Room::Heap(rows.to_vec());
            let copy = PageBuffer { room, used: rows.len(), stride: rows.stride };
            self.give_back(rows);
            Ok(Page::Memory(copy))
        } else {
            Ok(Page::Memory(rows))
        }
    }

    fn write(&self, rows: &PageBuffer) -> Result<Page<'a>, BuildError> {
        self.write_rows(rows).map(Page::Disk)
    }

    fn write_rows(&self, rows: &PageBuffer) -> Result<DiskPlace, BuildError> {
        self.with_packer(|packer| match packer.pack(rows, rows.stride) {
            true => {
                let place = self.write_bytes(&packer.bytes)?;
                Ok(DiskPlace { bytes: rows.len() as u32, ..place })
            }
            false => self.write_bytes(rows),
        })
    }

    fn with_packer<R>(&self, work: impl FnOnce(&mut Packer) -> R) -> R {
        let packers = || self.packers.lock().expect("no holder of the lock panics");
        let mut packer = packers().pop().unwrap_or_default();
        let result = work(&mut packer);
        packers().push(packer);
        result
    }

    /// Writes bytes of any length and tells where they are.
    pub fn write_bytes(&self, bytes: &[u8]) -> Result<DiskPlace, BuildError> {
        let file = self.file().map_err(|e| self.work.error("cannot create a temporary file", e))?;
        let offset = self.end.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        let written = self.work.before_write().and_then(|()| write_all_at(file, bytes, offset));
        written.map_err(|e| self.work.error("cannot write", e))?;
        let length = bytes.len() as u32;
        Ok(DiskPlace { offset, stored: length, bytes: length })
    }

    /// Reads bytes back.
    fn read_bytes(&self, place: DiskPlace) -> Result<Vec<u8>, BuildError> {
        let mut read = vec![0; place.bytes as usize];
        self.read_into(place, &mut read)?;
        Ok(read)
    }

    fn read_into(&self, place: DiskPlace, bytes: &mut [u8]) -> Result<(), BuildError> {
        let file = self.file().map_err(|e| self.work.error("cannot open", e))?;
        let read = |bytes: &mut [u8]| file.read_exact_at(bytes, place.offset);
        let outcome = if place.stored == place.bytes {
            read(bytes)
        } else {
            self.with_packer(|packer| {
                let mut stored = std::mem::take(&mut packer.bytes);
                stored.resize(place.stored as usize, 0);
                let outcome = read(&mut stored).and_then(|()| {
                    let is_whole = packer.unpack(&stored, bytes);
                    is_whole.then_some(()).ok_or(io::ErrorKind::InvalidData.into())
                });
                packer.bytes = stored;
                outcome
            })
        };
        outcome.map_err(|e| self.work.error("cannot read back", e))
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
            Page::Disk(place) => Ok(*place),
            Page::Memory(rows) => {
                let place = self.write_rows(rows)?;
                if let Page::Memory(rows) = std::mem::replace(page, Page::Disk(place)) {
                    self.give_back(rows);
                }
                Ok(place)
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
            Page::Disk(place) => {
                let mut rows = self.buffer();
                rows.set_used(place.bytes as usize, 0);
                self.read_into(place, &mut rows.room()[..place.bytes as usize])?;
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
            Page::Disk(place) => {
                let rows = self.load(Page::Disk(*place))?;
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
            self.free().buffers.push(buffer);
        }
    }
}

/// Gets memory from the system at once, where it knows how to; else it comes fault by fault.
#[cfg(target_os = "linux")]
fn touch(part: &MmapMut) {
    let _ = part.advise(memmap2::Advice::PopulateWrite);
}

#[cfg(not(target_os = "linux"))]
fn touch(_: &MmapMut) {}

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
            let mut slab = Slab::reserve(memory, 100);
            let work = Work::new(folder.path(), Path::new("out"), None);
            let store = PageStore::new(&work, 100, &mut slab, 0);
            let mut pages = Vec::new();
            let mut buffer = store.buffer();
            for i in 0..20u8 {
                let used = 100 - usize::from(i % 3);
                buffer.room()[..used].fill(i);
                buffer.set_used(used, 1);
                let (page, next) = store.keep(buffer).expect("keeps");
                assert!(next.is_empty());
                pages.push(page);
                buffer = next;
            }
            buffer.room()[..7].fill(99);
            buffer.set_used(7, 7);
            pages.push(store.keep_last(buffer).expect("keeps"));
            let on_disk = pages.iter().filter(|page| matches!(page, Page::Disk(_))).count();
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
