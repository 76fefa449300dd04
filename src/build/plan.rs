//! How the points are cut into chunks that are built side by side.
//!
//! A chunk is a range of Morton codes, planned from a sample of the points so that each holds about
//! the same number. The plan decides who works when, never what comes out.

use crate::geometry::MortonKey;

/// A range of Morton codes, up to where the next chunk starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chunk<K> {
    /// First code.
    pub start: K,
    /// First code of the next chunk; none for the last.
    pub end: Option<K>,
    /// Octree level of the cells that the chunk is made of: at least that of a root's finest
    /// cells. In a chunk of deeper cells all have the same parent.
    pub level: u32,
}

/// All chunks, in Morton order, and a quick way to find a point's.
#[derive(Debug)]
pub struct Plan<K> {
    chunks: Vec<Chunk<K>>,
    /// Per cell of a coarse grid the chunk of its first code, marked if others start within.
    first_of_cell: Vec<u32>,
    grid_shift: u32,
}

/// Levels of the grid for finding chunks: 2^18 cells.
const GRID_LEVELS: u32 = 6;
/// Marks cells in which a chunk starts.
const SEVERAL: u32 = 1 << 31;

impl<K: MortonKey> Plan<K> {
    /// Plans chunks of about `target` points. `sample` holds the codes of some points, sorted, each
    /// standing for `weight` points; `levels` is that of a root's finest cells.
    pub fn new(sample: &[K], weight: u64, target: u64, root_bits: u32, levels: u32) -> Self {
        let most = (target / weight.max(1)).max(1) as usize;
        let mut cut = Cut { chunks: Vec::new(), root_bits, levels, most, run: None };
        cut.pieces(sample, K::default(), 0);
        Plan::of_starts(cut.chunks, root_bits)
    }

    /// One chunk for everything from a code on.
    pub fn of_starts(mut chunks: Vec<Chunk<K>>, root_bits: u32) -> Self {
        for i in 1..chunks.len() {
            chunks[i - 1].end = Some(chunks[i].start);
        }
        let grid_levels = GRID_LEVELS.min(root_bits);
        let grid_shift = root_bits - grid_levels;
        let mut first_of_cell = vec![0u32; 1 << (3 * grid_levels)];
        let mut next = 1;
        for (cell, first) in first_of_cell.iter_mut().enumerate() {
            let cell_of = |chunk: &Chunk<K>| chunk.start.ancestor(grid_shift).low_u64() as usize;
            while next < chunks.len()
                && cell_of(&chunks[next]) == cell
                && chunks[next].start.local(grid_shift) == K::default()
            {
                next += 1;
            }
            *first = next as u32 - 1;
            while next < chunks.len() && cell_of(&chunks[next]) == cell {
                *first |= SEVERAL;
                next += 1;
            }
        }
        Plan { chunks, first_of_cell, grid_shift }
    }

    /// All chunks.
    pub fn chunks(&self) -> &[Chunk<K>] {
        &self.chunks
    }

    /// The chunk of a code.
    #[inline]
    pub fn chunk_of(&self, key: K) -> usize {
        let first = self.first_of_cell[key.ancestor(self.grid_shift).low_u64() as usize];
        if first & SEVERAL == 0 {
            return first as usize;
        }
        let first = (first & !SEVERAL) as usize;
        first + self.chunks[first + 1..].partition_point(|chunk| chunk.start <= key)
    }
}

/// Cutting in progress.
struct Cut<K> {
    chunks: Vec<Chunk<K>>,
    root_bits: u32,
    levels: u32,
    /// Most sample points of a chunk.
    most: usize,
    /// Sample points of the chunk that may grow, and the cell within which it may: its level and
    /// code.
    run: Option<(usize, u32, K)>,
}

impl<K: MortonKey> Cut<K> {
    /// Cuts the cell of that code and level, which holds these sample points.
    fn pieces(&mut self, sample: &[K], code: K, level: u32) {
        if sample.len() <= self.most || level == self.root_bits {
            return self.piece(sample.len(), code, level);
        }
        let shift = self.root_bits - level - 1;
        let mut rest = sample;
        let mut child = code.first_within(1);
        for _ in 0..8 {
            let count = rest.partition_point(|key| key.ancestor(shift) <= child);
            let (inside, tail) = rest.split_at(count);
            self.pieces(inside, child, level + 1);
            rest = tail;
            child = child.next();
        }
    }

    fn piece(&mut self, points: usize, code: K, level: u32) {
        // Cells as small as a root's finest or smaller join only their siblings.
        let is_deep = level > self.levels;
        let family = if is_deep { (level - 1, code.ancestor(1)) } else { (0, K::default()) };
        if let Some((run, family_level, family_code)) = &mut self.run
            && (*family_level, *family_code) == family
            && *run + points <= self.most
        {
            *run += points;
            return;
        }
        self.run = Some((points, family.0, family.1));
        let start = code.first_within(self.root_bits - level);
        self.chunks.push(Chunk { start, end: None, level: level.max(self.levels) });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_code_has_its_chunk(
            mut sample in proptest::collection::vec(0u64..1 << 27, 0..500),
            target in 1u64..100,
            levels in 2u32..5,
            keys in proptest::collection::vec(0u64..1 << 27, 100),
        ) {
            // Half of them crowd in one place.
            let half = sample.len() / 2;
            sample[..half].iter_mut().for_each(|key| *key = *key >> 18 | 5 << 20);
            sample.sort();
            let plan = Plan::new(&sample, 1, target, 9, levels);
            let chunks = plan.chunks();
            prop_assert_eq!(chunks[0].start, 0);
            prop_assert!(chunks.is_sorted_by(|a, b| a.start < b.start));
            for key in keys.into_iter().chain(sample.iter().copied()) {
                let chunk = chunks[plan.chunk_of(key)];
                prop_assert!(chunk.start <= key && chunk.end.is_none_or(|end| key < end));
            }
            for chunk in chunks {
                let inside =
                    |key: &&u64| chunk.start <= **key && chunk.end.is_none_or(|end| **key < end);
                let count = sample.iter().filter(inside).count() as u64;
                prop_assert!(count <= target.max(1) || chunk.level == 9);
                let is_aligned = chunk.start.local(9 - chunk.level) == 0;
                prop_assert!(is_aligned);
                if chunk.level > levels {
                    let last = chunk.end.map_or((1 << 27) - 1, |end| end - 1);
                    let parent = |key: u64| key.ancestor(9 - chunk.level + 1);
                    prop_assert_eq!(parent(chunk.start), parent(last));
                }
            }
        }
    }
}
