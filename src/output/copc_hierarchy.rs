//! The table of chunks of a COPC file: which cube stands where, in pages.
//!
//! Source: "Cloud Optimized Point Cloud Specification 1.0", copc.io, section 3.3.

use std::collections::BTreeMap;

use super::copc_tree::VoxelKey;

/// Tables of at most so many entries are one page.
const ONE_PAGE: usize = 4096;
/// Levels between the roots of pages, and fewest entries of a page below another.
const PAGE_LEVELS: u32 = 4;
const LEAST_PAGE: usize = 64;

/// Where a cube's chunk stands; all zero where a cube has none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Place {
    pub offset: u64,
    pub bytes: u32,
    pub points: u32,
}

/// All cubes of a file.
///
/// Invariant, upheld by the tree: the parent of a cube is a cube of the file.
#[derive(Default)]
pub(super) struct Hierarchy {
    places: BTreeMap<VoxelKey, Place>,
}

impl Hierarchy {
    /// Adds a cube.
    pub fn add(&mut self, key: VoxelKey, place: Place) {
        self.places.insert(key, place);
    }

    /// All pages, for a file in which they begin at `start`; and where within them the root's page
    /// begins, which reaches to their end.
    pub fn pages(&self, start: u64) -> (Vec<u8>, usize) {
        let mut counts: BTreeMap<VoxelKey, usize> = BTreeMap::new();
        // Deeper cubes come later in the order of keys.
        for key in self.places.keys().rev() {
            let count = counts.entry(*key).or_insert(0);
            *count += 1;
            let count = *count;
            if key[0] > 0 {
                *counts.entry(parent(*key)).or_insert(0) += count;
            }
        }
        let mut pages = Pages { places: &self.places, counts, start, bytes: Vec::new() };
        let (root, _) = pages.add([0; 4]);
        (pages.bytes, root)
    }
}

struct Pages<'a> {
    places: &'a BTreeMap<VoxelKey, Place>,
    /// Cubes in the subtree of each.
    counts: BTreeMap<VoxelKey, usize>,
    start: u64,
    bytes: Vec<u8>,
}

impl Pages<'_> {
    /// Adds the page of a cube after those below it; returns its place and size.
    fn add(&mut self, root: VoxelKey) -> (usize, usize) {
        let one_page = self.counts.get(&[0; 4]).is_none_or(|&count| count <= ONE_PAGE);
        let mut page = Vec::new();
        let mut waiting = vec![root];
        while let Some(key) = waiting.pop() {
            let Some(place) = self.places.get(&key) else { continue };
            put_entry(&mut page, key, place.offset, place.bytes as i32, place.points as i32);
            for octant in (0..8).rev() {
                let child = child(key, octant);
                let count = self.counts.get(&child).copied().unwrap_or(0);
                if !one_page && child[0].is_multiple_of(PAGE_LEVELS) && count >= LEAST_PAGE {
                    let (offset, bytes) = self.add(child);
                    put_entry(&mut page, child, self.start + offset as u64, bytes as i32, -1);
                } else if count > 0 {
                    waiting.push(child);
                }
            }
        }
        let offset = self.bytes.len();
        self.bytes.extend_from_slice(&page);
        (offset, page.len())
    }
}

fn parent([depth, x, y, z]: VoxelKey) -> VoxelKey {
    [depth - 1, x / 2, y / 2, z / 2]
}

fn child([depth, x, y, z]: VoxelKey, octant: u32) -> VoxelKey {
    [depth + 1, 2 * x + (octant & 1), 2 * y + (octant >> 1 & 1), 2 * z + (octant >> 2)]
}

fn put_entry(page: &mut Vec<u8>, key: VoxelKey, offset: u64, bytes: i32, points: i32) {
    key.iter().for_each(|part| page.extend_from_slice(&part.to_le_bytes()));
    page.extend_from_slice(&offset.to_le_bytes());
    page.extend_from_slice(&bytes.to_le_bytes());
    page.extend_from_slice(&points.to_le_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Entries of a page, by key.
    fn read(page: &[u8]) -> Vec<(VoxelKey, u64, i32, i32)> {
        let word = |entry: &[u8], i: usize| {
            i32::from_le_bytes(entry[4 * i..4 * i + 4].try_into().expect("4"))
        };
        page.chunks_exact(32)
            .map(|entry| {
                let key = [0, 1, 2, 3].map(|i| word(entry, i) as u32);
                let offset = u64::from_le_bytes(entry[16..24].try_into().expect("8"));
                (key, offset, word(entry, 6), word(entry, 7))
            })
            .collect()
    }

    /// All cubes that a reader finds, following pages from the root's.
    fn walk(pages: &[u8], start: u64, root: usize) -> BTreeMap<VoxelKey, Place> {
        let mut found = BTreeMap::new();
        let mut waiting = vec![(root, pages.len() - root)];
        while let Some((offset, bytes)) = waiting.pop() {
            for (key, offset, bytes, points) in read(&pages[offset..offset + bytes]) {
                if points < 0 {
                    waiting.push(((offset - start) as usize, bytes as usize));
                } else {
                    let place = Place { offset, bytes: bytes as u32, points: points as u32 };
                    assert_eq!(found.insert(key, place), None, "{key:?} twice");
                }
            }
        }
        found
    }

    #[test]
    fn every_cube_is_found_through_the_pages() {
        for levels in [0u32, 1, 4, 7] {
            let mut hierarchy = Hierarchy::default();
            // A diagonal wall of cubes: four children each.
            for depth in 0..=levels {
                for x in 0..1u32 << depth {
                    for y in 0..1u32 << depth {
                        let key = [depth, x, y, (x + y) / 2];
                        if depth > 0 && !hierarchy.places.contains_key(&parent(key)) {
                            continue;
                        }
                        let place = Place { offset: u64::from(x) << 32, bytes: y, points: depth };
                        hierarchy.add(key, place);
                    }
                }
            }
            let (pages, root) = hierarchy.pages(1000);
            assert_eq!(walk(&pages, 1000, root), hierarchy.places, "{levels}");
            let is_one = hierarchy.places.len() <= ONE_PAGE;
            assert_eq!(root == 0, is_one, "{} cubes", hierarchy.places.len());
        }
        let (pages, root) = Hierarchy::default().pages(0);
        assert!(pages.is_empty() && root == 0);
    }
}
