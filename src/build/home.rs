//! The depth at which each point finds its node.
//!
//! A node takes the first arrival of each of its finest cells and passes the others on, to a node
//! whose finest cells are half as wide. So what happens to a point is decided by the points in its
//! cells alone: of the points in a finest cell of the root, the one with the smallest input index
//! is at home in the root, of the others in each of its eight subcells the smallest is at home at
//! depth 1, and so on. Nodes that turn out too small are dissolved later (`chunk`).

use crate::geometry::MortonKey;

/// Marks points that no node's cell takes, because cells do not get smaller than a lattice step:
/// they stay in the deepest node beyond one per cell.
pub const BEYOND: u8 = 0x80;

/// A point waiting for its home.
#[derive(Clone, Copy, Debug, Default)]
pub struct Waiting<K> {
    /// Morton code.
    pub key: K,
    /// Order of arrival.
    pub index: u32,
    /// Where its answer goes.
    pub place: u32,
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

    /// Writes `homes[place]` of all points, which lie in Morton order and have been passed on by
    /// all nodes above `depth`. Afterwards their order is undefined.
    pub fn assign<K: MortonKey>(&self, points: &mut [Waiting<K>], depth: u32, homes: &mut [u8]) {
        let shift = self.max_depth() - depth;
        let mut rest = points;
        while let Some(first) = rest.first() {
            let cell = first.key.ancestor(shift);
            let count = cell_length(rest, cell, shift);
            let (points, tail) = rest.split_at_mut(count);
            rest = tail;
            self.cell(points, depth, homes);
        }
    }

    /// Points of one finest cell of a node at `depth`.
    fn cell<K: MortonKey>(&self, points: &mut [Waiting<K>], depth: u32, homes: &mut [u8]) {
        let beyond = depth == self.max_depth();
        match points {
            [only] => homes[only.place as usize] = depth as u8,
            [a, b] => {
                let (first, second) = if a.index < b.index { (a, b) } else { (b, a) };
                homes[first.place as usize] = depth as u8;
                homes[second.place as usize] =
                    if beyond { depth as u8 | BEYOND } else { depth as u8 + 1 };
            }
            _ => {
                let mut first = 0;
                for (i, point) in points.iter().enumerate() {
                    if point.index < points[first].index {
                        first = i;
                    }
                }
                homes[points[first].place as usize] = depth as u8;
                // Mostly a few: not worth a call.
                for i in (0..first).rev() {
                    points[i + 1] = points[i];
                }
                let rest = &mut points[1..];
                if beyond {
                    let marked = depth as u8 | BEYOND;
                    rest.iter().for_each(|point| homes[point.place as usize] = marked);
                } else {
                    self.assign(rest, depth + 1, homes);
                }
            }
        }
    }
}

/// How many of the points, which lie in Morton order, begin in the cell of the first.
fn cell_length<K: MortonKey>(points: &[Waiting<K>], cell: K, shift: u32) -> usize {
    // Cells mostly hold few points; long ones are found by doubling steps.
    let mut step = 1;
    let mut low = 0;
    while low + step < points.len() && points[low + step].key.ancestor(shift) == cell {
        low += step;
        step *= 2;
    }
    let high = (low + step).min(points.len());
    low + points[low..high].partition_point(|point| point.key.ancestor(shift) == cell)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::HashSet;

    proptest! {
        /// Against inserting one point after the other.
        #[test]
        fn equals_insertion(cells in proptest::collection::vec([0u32..32, 0..32, 0..32], 1..300)) {
            let homes_of = Homes { root_bits: 5, levels: 2 };
            let mut waiting: Vec<Waiting<u64>> = cells
                .iter()
                .enumerate()
                .map(|(i, cell)| Waiting { key: u64::encode(*cell), index: i as u32, place: i as u32 })
                .collect();
            waiting.sort_by_key(|point| point.key);
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
