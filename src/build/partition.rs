//! Records into the rows of their chunks.

use std::collections::BinaryHeap;
use std::sync::Mutex;

use serde::{Deserialize, Serialize};

use crate::build::BuildError;
use crate::build::chunk::Taken;
use crate::build::pages::{DiskPlace, Page, PageBuffer, PageStore};
use crate::build::plan::{Chunk, Plan};
use crate::build::rows::RowLayout;
use crate::geometry::MortonKey;
use crate::points::{COORDINATE_BYTES, record_coordinates};

/// What has been put into one chunk, as it can be noted down.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ChunkRowsState {
    pages: Vec<DiskPlace>,
    points: u64,
    smallest: Vec<u64>,
}

/// What has been put into one chunk.
#[derive(Debug, Default)]
pub struct ChunkRows<'p> {
    /// Its rows.
    pub pages: Vec<Page<'p>>,
    /// Number of rows.
    pub points: u64,
    /// Smallest input indices, as many as cells that it shares with other chunks may take.
    smallest: BinaryHeap<u64>,
}

impl<'p> ChunkRows<'p> {
    /// Brings all rows to disk and tells where they are.
    pub fn state(&mut self, pages: &PageStore<'p>) -> Result<ChunkRowsState, BuildError> {
        let places = self.pages.iter_mut().map(|page| pages.to_disk(page));
        Ok(ChunkRowsState {
            pages: places.collect::<Result<_, _>>()?,
            points: self.points,
            smallest: self.smallest.iter().copied().collect(),
        })
    }

    /// The rows of a state.
    pub fn resume(state: ChunkRowsState) -> Self {
        ChunkRows {
            pages: state.pages.into_iter().map(Page::Disk).collect(),
            points: state.points,
            smallest: state.smallest.into(),
        }
    }
}

/// What is the same for all chunks.
#[derive(Clone, Copy, Debug)]
pub struct PartitionShape {
    /// Layout of rows.
    pub layout: RowLayout,
    /// Pages hold `1 << page_shift` rows.
    pub page_shift: u32,
    /// Bits per axis of the root cube.
    pub root_bits: u32,
    /// Levels of a node.
    pub levels: u32,
}

/// All chunks being filled.
pub struct Partition<'a, 'p, K> {
    plan: &'a Plan<K>,
    shape: PartitionShape,
    pages: &'a PageStore<'p>,
    page_bytes: usize,
    chunks: Vec<Mutex<ChunkRows<'p>>>,
}

/// Records whose codes are made together.
const KEYS: usize = 128;

/// One worker's open pages.
pub struct OpenPages<'p> {
    /// Per chunk its page, the bytes of it that hold rows, and how many cells it shares.
    pages: Vec<(Option<PageBuffer<'p>>, usize, u32)>,
    smallest: Vec<BinaryHeap<u64>>,
}

impl<'a, 'p, K: MortonKey> Partition<'a, 'p, K> {
    /// Empty chunks.
    pub fn new(plan: &'a Plan<K>, shape: PartitionShape, pages: &'a PageStore<'p>) -> Self {
        let page_bytes = shape.layout.stride() << shape.page_shift;
        assert!(page_bytes <= pages.page_bytes(), "rows fill no more than a page");
        let chunks = plan.chunks().iter().map(|_| Mutex::default()).collect();
        Partition { plan, shape, pages, page_bytes, chunks }
    }

    /// Goes on with chunks filled so far.
    pub fn resume(mut self, chunks: Vec<ChunkRows<'p>>) -> Self {
        assert_eq!(chunks.len(), self.chunks.len(), "the chunks are those of the plan");
        self.chunks = chunks.into_iter().map(Mutex::new).collect();
        self
    }

    /// Brings all rows put away to disk and tells where they are. Open pages must be closed.
    pub fn state(&mut self) -> Result<Vec<ChunkRowsState>, BuildError> {
        let chunks = self.chunks.iter_mut();
        chunks
            .map(|c| c.get_mut().expect("no holder of the lock panics").state(self.pages))
            .collect()
    }

    /// Memory of a worker.
    pub fn open(&self) -> OpenPages<'p> {
        let chunks = self.chunks.len();
        let shared = |chunk: &Chunk<K>| chunk.level - self.shape.levels;
        let page = |chunk| (None, self.page_bytes, shared(chunk));
        let pages = self.plan.chunks().iter().map(page).collect();
        OpenPages { pages, smallest: vec![BinaryHeap::new(); chunks] }
    }

    /// Puts whole records into their chunks; the first has that input index. `origin` is what to
    /// subtract from coordinates to get those within the root cube.
    pub fn add_records(
        &self,
        open: &mut OpenPages<'p>,
        records: &[u8],
        record_bytes: usize,
        first_index: u64,
        origin: [i64; 3],
    ) -> Result<(), BuildError> {
        let outside = u32::MAX.checked_shl(self.shape.root_bits).unwrap_or(0);
        let origin = origin.map(|o| o as u32);
        let mut keys = [K::default(); KEYS];
        let mut first_index = first_index;
        // Codes of a few at a time, which a processor makes side by side.
        for records in records.chunks(KEYS * record_bytes) {
            let mut union = 0;
            for (key, record) in keys.iter_mut().zip(records.chunks_exact(record_bytes)) {
                let [x, y, z] = record_coordinates(record);
                let cell = [
                    (x as u32).wrapping_sub(origin[0]),
                    (y as u32).wrapping_sub(origin[1]),
                    (z as u32).wrapping_sub(origin[2]),
                ];
                union |= cell[0] | cell[1] | cell[2];
                *key = K::encode(cell);
            }
            if union & outside != 0 {
                return Err(BuildError::Changed);
            }
            let rows = keys.iter().zip(records.chunks_exact(record_bytes));
            for (index, (&key, record)) in (first_index..).zip(rows) {
                self.add(open, key, index, &record[COORDINATE_BYTES..])?;
            }
            first_index += KEYS as u64;
        }
        Ok(())
    }

    /// Puts rows of another partition into their chunks.
    pub fn add_rows(&self, open: &mut OpenPages<'p>, rows: &[u8]) -> Result<(), BuildError> {
        let layout = self.shape.layout;
        rows.chunks_exact(layout.stride()).try_for_each(|row| {
            self.add(open, K::read(row), layout.index(row), layout.attributes(row))
        })
    }

    #[inline(always)]
    fn add(
        &self,
        open: &mut OpenPages<'p>,
        key: K,
        index: u64,
        attributes: &[u8],
    ) -> Result<(), BuildError> {
        let chunk = self.plan.chunk_of(key);
        let stride = self.shape.layout.stride();
        let (page, used, shared) = &mut open.pages[chunk];
        if *used + stride > self.page_bytes {
            self.next_page(chunk, page, used)?;
        }
        let page = page.as_mut().expect("a page was begun");
        self.shape.layout.write(&mut page.room()[*used..*used + stride], key, index, attributes);
        *used += stride;
        if *shared > 0 {
            keep_smallest(&mut open.smallest[chunk], index, *shared as usize);
        }
        Ok(())
    }

    /// Puts a full page away, if there is one, and begins the next.
    #[cold]
    fn next_page(
        &self,
        chunk: usize,
        page: &mut Option<PageBuffer<'p>>,
        used: &mut usize,
    ) -> Result<(), BuildError> {
        let next = match page.take() {
            None => self.pages.buffer(),
            Some(mut full) => {
                full.set_used(*used, self.shape.layout.stride());
                let (full, next) = self.pages.keep(full)?;
                let mut rows = self.chunks[chunk].lock().expect("no holder of the lock panics");
                rows.pages.push(full);
                rows.points += (*used / self.shape.layout.stride()) as u64;
                next
            }
        };
        *page = Some(next);
        *used = 0;
        Ok(())
    }

    /// Puts a worker's last pages away.
    pub fn close(&self, open: OpenPages<'p>) -> Result<(), BuildError> {
        for (i, ((page, used, shared), smallest)) in
            open.pages.into_iter().zip(open.smallest).enumerate()
        {
            let Some(mut page) = page else { continue };
            let points = (used / self.shape.layout.stride()) as u64;
            page.set_used(used, self.shape.layout.stride());
            let page = self.pages.keep_last(page)?;
            let mut rows = self.chunks[i].lock().expect("no holder of the lock panics");
            smallest
                .into_iter()
                .for_each(|index| keep_smallest(&mut rows.smallest, index, shared as usize));
            rows.pages.push(page);
            rows.points += points;
        }
        Ok(())
    }

    /// Gives all memory back, with the rows in it.
    pub fn abandon(self, open: impl Iterator<Item = OpenPages<'p>>) {
        let open = open.flat_map(|open| open.pages).filter_map(|(page, ..)| page);
        let pages = self.pages;
        open.for_each(|page| pages.give_back(page));
        for page in self.into_chunks().into_iter().flat_map(|rows| rows.pages) {
            if let Page::Memory(page) = page {
                pages.give_back(page);
            }
        }
    }

    /// The chunks' rows, in order.
    pub fn into_chunks(self) -> Vec<ChunkRows<'p>> {
        let rows = self.chunks.into_iter();
        rows.map(|rows| rows.into_inner().expect("no holder of the lock panics")).collect()
    }
}

/// Divides a chunk that holds more points than planned into chunks of about `target` points, or of
/// single lattice steps. Its rows are taken.
pub fn split<'p, K: MortonKey>(
    chunk: &Chunk<K>,
    rows: ChunkRows<'p>,
    target: u64,
    shape: PartitionShape,
    pages: &PageStore<'p>,
) -> Result<(Vec<Chunk<K>>, Vec<ChunkRows<'p>>), BuildError> {
    let stride = shape.layout.stride();
    let weight = (rows.points >> 16).max(1);
    let mut sample = Vec::new();
    let mut stored = Vec::with_capacity(rows.pages.len());
    for page in rows.pages {
        let on_disk = match page {
            Page::Disk(place) => Some(place),
            Page::Memory(_) => None,
        };
        let loaded = pages.load(page)?;
        sample.extend(loaded.chunks_exact(stride).step_by(weight as usize).map(K::read));
        stored.push(match on_disk {
            Some(place) => {
                pages.give_back(loaded);
                Page::Disk(place)
            }
            None => Page::Memory(loaded),
        });
    }
    sample.sort_unstable();
    let plan = Plan::new(&sample, weight, target, shape.root_bits, shape.levels);
    drop(sample);
    let partition = Partition::new(&plan, shape, pages);
    let mut open = partition.open();
    for page in stored {
        let loaded = pages.load(page)?;
        partition.add_rows(&mut open, &loaded)?;
        pages.give_back(loaded);
    }
    partition.close(open)?;
    let starts_inside = |other: &Chunk<K>| chunk.end.is_none_or(|end| other.start < end);
    let ends_inside = |other: &Chunk<K>| other.end.is_none_or(|end| end > chunk.start);
    let all = plan.chunks().iter().copied().zip(partition.into_chunks());
    let mut parts: Vec<(Chunk<K>, ChunkRows<'p>)> =
        all.filter(|(part, _)| starts_inside(part) && ends_inside(part)).collect();
    // Those at the ends may reach into the neighbours, where no points are.
    if let Some((first, _)) = parts.first_mut() {
        first.start = chunk.start.max(first.start);
    }
    if let Some((last, _)) = parts.last_mut() {
        last.end = chunk.end;
    }
    Ok(parts.into_iter().unzip())
}

fn keep_smallest(smallest: &mut BinaryHeap<u64>, index: u64, count: usize) {
    if smallest.len() < count {
        smallest.push(index);
    } else if smallest.peek().is_some_and(|largest| index < *largest) {
        smallest.pop();
        smallest.push(index);
    }
}

/// What cells shared by several chunks take from each of them.
///
/// A chunk of cells smaller than a root's finest shares the cells above with others; each takes
/// the first arrival that no cell above it took.
pub fn taken_by_shared_cells<K: MortonKey>(
    chunks: &[Chunk<K>],
    rows: &[ChunkRows<'_>],
    root_bits: u32,
    levels: u32,
) -> Vec<Vec<Taken>> {
    let mut heads: Vec<Vec<u64>> = rows
        .iter()
        .map(|rows| {
            // Smallest last, where taking is cheap.
            let mut sorted = rows.smallest.clone().into_sorted_vec();
            sorted.reverse();
            sorted
        })
        .collect();
    let mut taken = vec![Vec::new(); chunks.len()];
    let mut start = 0;
    while start < chunks.len() {
        let cell = |chunk: &Chunk<K>| chunk.start.ancestor(root_bits - levels);
        let same = chunks[start..].iter().take_while(|c| cell(c) == cell(&chunks[start])).count();
        take_level(chunks, start..start + same, levels, levels, root_bits, &mut heads, &mut taken);
        start += same;
    }
    taken
}

/// The cell at `level` that these chunks lie in takes one, then its subcells.
fn take_level<K: MortonKey>(
    chunks: &[Chunk<K>],
    range: std::ops::Range<usize>,
    level: u32,
    levels: u32,
    root_bits: u32,
    heads: &mut [Vec<u64>],
    taken: &mut [Vec<Taken>],
) {
    // Chunks of cells of this level or wider share nothing here.
    if chunks[range.start].level <= level {
        return;
    }
    let first =
        range.clone().filter_map(|chunk| heads[chunk].last().map(|index| (*index, chunk))).min();
    let Some((index, chunk)) = first else { return };
    heads[chunk].pop();
    taken[chunk].push((index, level - levels));
    let cell = |chunk: usize| chunks[chunk].start.ancestor(root_bits - level - 1);
    let mut start = range.start;
    while start < range.end {
        let end = (start..range.end).find(|&i| cell(i) != cell(start)).unwrap_or(range.end);
        take_level(chunks, start..end, level + 1, levels, root_bits, heads, taken);
        start = end;
    }
}
