//! One memory-optimized sequential point tree out of the points that entered a node.
//!
//! Works on points sorted by Morton code. Which points a node keeps, which it passes on, and on
//! which level each kept point shows are all decided per cell with ties broken by input order, so
//! nothing depends on the order of work. Equal to inserting the points one after another.
//! After: Wimmer and Scheiblauer 2006, section 6.4.6 of the dissertation chapter.

use crate::build::rows::Rows;
use crate::geometry::MortonKey;

/// A point on its way through the build: its Morton code and its row among the job's records.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Entry<K> {
    /// Morton code over all bits of the root cube.
    pub key: K,
    /// Row; rows stand in input order.
    pub row: u32,
}

/// How a cell's representative is chosen among those of its child cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Representative {
    /// Colour nearest to the mean colour of the candidates (the paper's choice).
    #[default]
    Color,
    /// First in the input.
    First,
    /// Nearest to the middle of the cell.
    Center,
    /// By a hash of the input index: white noise instead of scan-line patterns.
    Random,
}

/// The cells of one node: `bits` of the root cube, the node's outer depth, levels within it.
#[derive(Clone, Copy, Debug)]
pub struct NodeGrid {
    /// Bits per axis of the root cube.
    pub root_bits: u32,
    /// Outer depth of the node.
    pub depth: u32,
    /// The paper's D.
    pub levels: u32,
}

impl NodeGrid {
    /// How many levels above single lattice steps the node's level `level` is.
    pub fn shift(&self, level: u32) -> u32 {
        self.root_bits - self.depth - level
    }
}

/// Level of each kept point: 0 for the node's single coarsest, up to `grid.levels`.
///
/// `kept` holds at most one entry per finest cell, in Morton order. Replaces `levels`.
pub fn assign_levels<K: MortonKey>(
    kept: &[Entry<K>],
    grid: NodeGrid,
    representative: Representative,
    rows: &Rows,
    levels: &mut Vec<u8>,
) {
    levels.clear();
    levels.resize(kept.len(), grid.levels as u8);
    let mut candidates: Vec<u32> = (0..kept.len() as u32).collect();
    let mut winners = Vec::with_capacity(kept.len() / 2);
    for level in (0..grid.levels).rev() {
        let shift = grid.shift(level);
        let cell = |i: u32| kept[i as usize].key.ancestor(shift);
        winners.clear();
        for group in candidates.chunk_by(|&a, &b| cell(a) == cell(b)) {
            let winner = match group {
                [only] => *only,
                _ => choose(group, kept, shift, representative, rows),
            };
            levels[winner as usize] = level as u8;
            winners.push(winner);
        }
        std::mem::swap(&mut candidates, &mut winners);
    }
}

fn choose<K: MortonKey>(
    group: &[u32],
    kept: &[Entry<K>],
    shift: u32,
    representative: Representative,
    rows: &Rows,
) -> u32 {
    let row = |i: u32| kept[i as usize].row;
    let best = match representative {
        Representative::Color if rows.has_color() => {
            // Distances to the mean times the group's size, so that all stays in integers.
            let size = group.len() as i64;
            let colors: [[i64; 3]; 8] = std::array::from_fn(|i| {
                group.get(i).map_or([0; 3], |&point| rows.color(row(point)).map(i64::from))
            });
            let colors = &colors[..group.len()];
            let sum = [0, 1, 2].map(|c| colors.iter().map(|color| color[c]).sum::<i64>());
            let distance = |color: &[i64; 3]| -> i64 {
                (0..3).map(|c| (size * color[c] - sum[c]).pow(2)).sum()
            };
            (0..group.len()).min_by_key(|&i| (distance(&colors[i]), row(group[i])))
        }
        Representative::Color | Representative::First => {
            (0..group.len()).min_by_key(|&i| row(group[i]))
        }
        Representative::Center => (0..group.len()).min_by_key(|&i| {
            let local = kept[group[i] as usize].key.local(shift).decode();
            let edge = 1i128 << shift;
            let off = local.map(|c| (2 * i128::from(c) + 1 - edge).pow(2));
            (off.iter().sum::<i128>(), row(group[i]))
        }),
        Representative::Random => (0..group.len())
            .min_by_key(|&i| (scramble(rows.input_index(row(group[i]))), row(group[i]))),
    };
    group[best.expect("a group has a candidate")]
}

/// A bijective 64-bit hash (the finalizer of SplitMix64).
fn scramble(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}
