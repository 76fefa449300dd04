//! The depth at which each point finds its node.
//!
//! A node takes the first arrival of each of its finest cells and passes the others on, to a node
//! whose finest cells are half as wide. So what happens to a point is decided by the points in its
//! cells alone: of the points in a finest cell of the root, the one with the smallest input index
//! is at home in the root, of the others in each of its eight subcells the smallest is at home at
//! depth 1, and so on. Nodes that turn out too small are dissolved later (`chunk`).

/// Marks points that no node's cell takes, because cells do not get smaller than a lattice step:
/// they stay in the deepest node beyond one per cell.
pub const BEYOND: u8 = 0x80;

/// Points waiting for their homes, in Morton order.
#[derive(Default)]
pub struct Waiting {
    /// Order of arrival, and below it where the answer goes.
    tags: Vec<u64>,
    /// Levels of cells that a point shares with the one before it, plus one; 0 for the first.
    shared: Vec<u8>,
    /// Per cell the tag of its first arrival.
    first: Vec<u64>,
}

impl Waiting {
    /// Lets no point wait.
    pub fn clear(&mut self) {
        self.tags.clear();
        self.shared.clear();
    }

    /// The next point: its order of arrival, where its answer goes, and how many levels of cells it
    /// shares with the one before it, plus one.
    #[inline]
    pub fn push(&mut self, order: u32, place: u32, shared: u8) {
        self.tags.push(u64::from(order) << 32 | u64::from(place));
        self.shared.push(if self.shared.is_empty() { 0 } else { shared });
    }
}

/// The cells that nodes take points from.
#[derive(Clone, Copy, Debug)]
pub struct Homes {
    /// Bits per axis of the root cube.
    pub root_bits: u32,
    /// Levels of a node (the paper's D).
    pub levels: u32,
}

impl Homes {
    /// Deepest depth whose finest cells are lattice steps.
    pub fn max_depth(&self) -> u32 {
        self.root_bits - self.levels
    }

    /// Writes `homes[place]` of all points, which have been passed on by all nodes above `depth`.
    pub fn assign(&self, waiting: &mut Waiting, depth: u32, homes: &mut [u8]) {
        let Waiting { tags, shared, first } = waiting;
        let mut count = tags.len();
        if first.len() < count {
            first.resize(count, 0);
        }
        let mut depth = depth;
        while depth <= self.max_depth() && self.cells(shared, depth) * FEW < count {
            self.take_from_long(tags, shared, depth, homes);
            depth += 1;
        }
        count = drop_taken(tags, shared);
        while depth <= self.max_depth() && count > 0 {
            let (tags, shared) = (&mut tags[..count], &mut shared[..count]);
            count = self.take_from_short(tags, shared, first, depth, homes);
            depth += 1;
        }
        for tag in &tags[..count] {
            homes[*tag as u32 as usize] = self.max_depth() as u8 | BEYOND;
        }
    }

    /// The levels that points in a finest cell of a node at `depth` share, at least.
    fn least_shared(&self, depth: u32) -> u8 {
        (depth + self.levels) as u8
    }

    /// Number of finest cells of nodes at `depth`.
    fn cells(&self, shared: &[u8], depth: u32) -> usize {
        let least = self.least_shared(depth);
        shared.iter().filter(|&&shared| shared <= least).count()
    }

    /// Takes the first arrival of each cell: cell by cell, where these hold many points. Those
    /// taken stay in place as [`TAKEN`].
    fn take_from_long(&self, tags: &mut [u64], shared: &[u8], depth: u32, homes: &mut [u8]) {
        let least = self.least_shared(depth);
        let mut start = 0;
        while start < tags.len() {
            let inside = shared[start + 1..].iter().position(|&shared| shared <= least);
            let end = inside.map_or(tags.len(), |inside| start + 1 + inside);
            let cell = &mut tags[start..end];
            start = end;
            let earliest = cell.iter().fold(TAKEN, |a, &b| a.min(b));
            if earliest != TAKEN
                && let Some(taken) = cell.iter_mut().find(|tag| **tag == earliest)
            {
                homes[earliest as u32 as usize] = depth as u8;
                *taken = TAKEN;
            }
        }
    }

    /// Takes the first arrival of each cell and returns how many are left: in two passes over all,
    /// one to find those, one to let them go. Cells of a few points are too short for branches to
    /// be foretold, so where one begins and whom it takes is decided by arithmetic.
    fn take_from_short(
        &self,
        tags: &mut [u64],
        shared: &mut [u8],
        first: &mut [u64],
        depth: u32,
        homes: &mut [u8],
    ) -> usize {
        let least = self.least_shared(depth);
        let (mut cell, mut earliest) = (usize::MAX, 0);
        for (&tag, &shared) in tags.iter().zip(shared.iter()) {
            let is_same = shared > least;
            cell = cell.wrapping_add(usize::from(!is_same));
            // The largest number if another cell begins.
            earliest = tag.min(earliest | u64::from(is_same).wrapping_sub(1));
            first[cell] = earliest;
        }
        let (mut cell, mut left, mut gap) = (usize::MAX, 0, u8::MAX);
        for i in 0..tags.len() {
            let (tag, shared_here) = (tags[i], shared[i]);
            cell = cell.wrapping_add(usize::from(shared_here <= least));
            let is_taken = tag == first[cell];
            // Those that stay on have another depth written over it.
            homes[tag as u32 as usize] = depth as u8;
            gap = gap.min(shared_here);
            tags[left] = tag;
            shared[left] = gap;
            left += usize::from(!is_taken);
            gap |= u8::from(is_taken).wrapping_sub(1);
        }
        left
    }
}

/// Cells with so many points on average are worth going through one by one.
const FEW: usize = 16;

/// The tag of a point that has found its home. No other has it: places are smaller.
const TAKEN: u64 = u64::MAX;

/// Moves those that still wait together; returns how many they are.
fn drop_taken(tags: &mut [u64], shared: &mut [u8]) -> usize {
    let (mut left, mut gap) = (0, u8::MAX);
    for i in 0..tags.len() {
        let tag = tags[i];
        gap = gap.min(shared[i]);
        tags[left] = tag;
        shared[left] = gap;
        left += usize::from(tag != TAKEN);
        gap |= u8::from(tag == TAKEN).wrapping_sub(1);
    }
    left
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::MortonKey;
    use proptest::prelude::*;
    use std::collections::HashSet;

    proptest! {
        /// Against inserting one point after the other.
        #[test]
        fn equals_insertion(cells in proptest::collection::vec([0u32..32, 0..32, 0..32], 1..300)) {
            let homes_of = Homes { root_bits: 5, levels: 2 };
            let mut points: Vec<(u64, u32)> = cells.iter().map(|&cell| u64::encode(cell)).zip(0..).collect();
            points.sort();
            let (mut waiting, mut previous) = (Waiting::default(), 0);
            for &(key, i) in &points {
                waiting.push(i, i, key.shared_levels(previous, 5) as u8 + 1);
                previous = key;
            }
            let mut homes = vec![0xff; cells.len()];
            homes_of.assign(&mut waiting, 0, &mut homes);

            let mut taken = HashSet::new();
            for (cell, home) in cells.iter().zip(homes) {
                let key = u64::encode(*cell);
                let free = (0..=3).find(|&depth| taken.insert((depth, key.ancestor(3 - depth))));
                prop_assert_eq!(home, free.map_or(3 | BEYOND, |depth| depth as u8));
            }
        }
    }
}
