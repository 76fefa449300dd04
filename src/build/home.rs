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
    ///
    /// Depth by depth, two passes over all that still wait: one finds the first arrival of each
    /// cell, one lets it go. Cells mostly hold a few points, too few for branches to be foretold,
    /// so where one begins and whom it takes is decided by arithmetic.
    pub fn assign(&self, waiting: &mut Waiting, depth: u32, homes: &mut [u8]) {
        let Waiting { tags, shared, first } = waiting;
        let mut count = tags.len();
        if first.len() < count {
            first.resize(count, 0);
        }
        for depth in depth..=self.max_depth() {
            if count == 0 {
                return;
            }
            let (tags, shared) = (&mut tags[..count], &mut shared[..count]);
            // Cells of a depth are shared by points that share so many levels.
            let least = (depth + self.levels) as u8;
            let (mut cell, mut earliest) = (usize::MAX, 0);
            for (&tag, &shared) in tags.iter().zip(shared.iter()) {
                let is_same = shared > least;
                cell = cell.wrapping_add(usize::from(!is_same));
                // The largest number if another cell begins.
                earliest = tag.min(earliest | u64::from(is_same).wrapping_sub(1));
                first[cell] = earliest;
            }
            let (mut cell, mut left, mut gap) = (usize::MAX, 0, u8::MAX);
            for i in 0..count {
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
            count = left;
        }
        for tag in &tags[..count] {
            homes[*tag as u32 as usize] = self.max_depth() as u8 | BEYOND;
        }
    }
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
