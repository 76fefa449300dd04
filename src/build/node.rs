//! One memory-optimized sequential point tree out of the points that entered a node.
//!
//! Which points show on which level is decided per cell with ties broken by input order, so
//! nothing depends on the order of work. Equal to inserting the points one after another.
//! After: Wimmer and Scheiblauer 2006, section 6.4.6 of the dissertation chapter.

use crate::build::encode::{Encoder, Encoding, FinishedNode};
use crate::build::rows::RowTable;
use crate::build::sort::Item;
use crate::geometry::MortonKey;

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

/// An octree to be made, whatever its nodes hold.
#[derive(Clone, Copy, Debug)]
pub struct TreeShape {
    /// Bits per axis of the root cube.
    pub root_bits: u32,
    /// The paper's D.
    pub levels: u32,
    /// Fewest points that make a child.
    pub threshold: usize,
    /// How representatives are chosen.
    pub representative: Representative,
}

impl TreeShape {
    /// The rules of the octree with nodes that are encoded like that.
    pub fn rules<'a>(&self, encoding: Encoding<'a>) -> TreeRules<'a> {
        let TreeShape { root_bits, levels, threshold, representative } = *self;
        TreeRules { root_bits, levels, threshold, representative, encoding }
    }
}

/// What is the same for all nodes of a build.
pub struct TreeRules<'a> {
    /// Bits per axis of the root cube.
    pub root_bits: u32,
    /// The paper's D.
    pub levels: u32,
    /// Fewest points that make a child.
    pub threshold: usize,
    /// How representatives are chosen.
    pub representative: Representative,
    /// How nodes are encoded.
    pub encoding: Encoding<'a>,
}

impl TreeRules<'_> {
    /// Deepest outer depth whose finest cells are still at least one lattice step.
    pub fn max_depth(&self) -> u32 {
        self.root_bits - self.levels
    }
}

/// Points in Morton order, equal codes in input order, with the depths they are at home at.
pub struct SortedPoints<'a, K> {
    /// Codes and slots.
    pub items: &'a [Item<K>],
    /// Depth per item, marked with [`BEYOND`](crate::build::home::BEYOND) if no cell takes the point.
    pub homes: &'a [u8],
    /// The rows.
    pub rows: RowTable<'a>,
}

impl<'a, K: MortonKey> SortedPoints<'a, K> {
    /// Whether a cell of the node at `depth` takes the point.
    #[inline]
    pub fn is_kept(&self, place: u32, depth: u32) -> bool {
        u32::from(self.homes[place as usize]) == depth
    }

    /// A point's row.
    #[inline]
    pub fn row(&self, place: u32) -> &'a [u8] {
        self.rows.row(self.items[place as usize].slot)
    }
}

/// What choosing a representative looks at.
#[derive(Clone, Copy, Debug, Default)]
pub struct Candidate {
    /// Colour of the point.
    pub color: [u16; 3],
    /// Its place in the input.
    pub index: u64,
}

/// Turns points into nodes; its memory is used again.
#[derive(Default)]
pub struct NodeBuilder<K> {
    candidates: Vec<Candidate>,
    /// Codes of the cells at work, and the candidate that stands for each.
    codes: Vec<K>,
    standing: Vec<u32>,
    candidate_levels: Vec<u8>,
    levels: Vec<u8>,
    ordered: Vec<u32>,
    encoder: Encoder,
}

impl<K: MortonKey> NodeBuilder<K> {
    /// Levels, final order and encoding of the node at `depth` whose points are given by their
    /// places, in rising order.
    pub fn finish(
        &mut self,
        rules: &TreeRules,
        depth: u32,
        points: &SortedPoints<K>,
        members: &[u32],
    ) -> FinishedNode {
        self.assign_levels(rules, depth, points, members);
        let mut totals = vec![0u32; rules.levels as usize + 1];
        self.levels.iter().for_each(|&level| totals[usize::from(level)] += 1);
        for level in 1..totals.len() {
            totals[level] += totals[level - 1];
        }
        let mut places: Vec<u32> =
            std::iter::once(0).chain(totals.iter().copied()).take(totals.len()).collect();
        self.ordered.clear();
        self.ordered.resize(members.len(), 0);
        for (&member, &level) in members.iter().zip(&self.levels) {
            let place = &mut places[usize::from(level)];
            self.ordered[*place as usize] = member;
            *place += 1;
        }
        let local_bits = rules.root_bits - depth;
        let encoding = &rules.encoding;
        let mut finished =
            self.encoder.encode(depth, local_bits, points, &self.ordered, totals, encoding);
        finished.overflow_points = (members.len() - self.candidates.len()) as u64;
        finished
    }

    /// Fills `levels`, one per member: 0 for the node's single coarsest point.
    fn assign_levels(
        &mut self,
        rules: &TreeRules,
        depth: u32,
        points: &SortedPoints<K>,
        members: &[u32],
    ) {
        let finest_shift = rules.root_bits - depth - rules.levels;
        let layout = points.rows.layout();
        self.codes.resize(members.len(), K::default());
        self.candidates.resize(members.len(), Candidate::default());
        let mut kept = 0;
        for &member in members {
            let item = &points.items[member as usize];
            let row = points.rows.row(item.slot);
            // Written in any case, and over again by the next one if it does not count.
            self.codes[kept] = item.key.ancestor(finest_shift);
            self.candidates[kept] =
                Candidate { color: layout.color(row), index: layout.index(row) };
            kept += usize::from(points.is_kept(member, depth));
        }
        self.codes.truncate(kept);
        self.candidates.truncate(kept);
        self.candidate_levels.clear();
        self.candidate_levels.resize(self.candidates.len(), rules.levels as u8);
        self.standing.clear();
        self.standing.extend(0..self.candidates.len() as u32);
        let centers = rules.representative == Representative::Center;
        let is_by_arrival =
            matches!(rules.representative, Representative::Color | Representative::First);
        let chosen: Vec<K> = if centers {
            let kept = members.iter().filter(|&&member| points.is_kept(member, depth));
            kept.map(|&member| points.items[member as usize].key).collect()
        } else {
            Vec::new()
        };
        for level in (0..rules.levels).rev() {
            let shift = rules.root_bits - depth - level;
            let (mut start, mut end) = (0, 0);
            while start < self.codes.len() {
                let code = self.codes[start].ancestor(1);
                let mut stop = start + 1;
                while stop < self.codes.len() && self.codes[stop].ancestor(1) == code {
                    stop += 1;
                }
                let group = &self.standing[start..stop];
                let winner = match group {
                    [only] => *only,
                    // Two are equally far from their mean: the earlier one, except by chance.
                    &[a, b] if is_by_arrival => {
                        let index = |i: u32| self.candidates[i as usize].index;
                        if index(a) < index(b) { a } else { b }
                    }
                    _ => pick(
                        group,
                        &self.candidates,
                        &chosen,
                        shift,
                        rules.representative,
                        layout.has_color(),
                    ),
                };
                self.candidate_levels[winner as usize] = level as u8;
                self.standing[end] = winner;
                self.codes[end] = code;
                end += 1;
                start = stop;
            }
            self.standing.truncate(end);
            self.codes.truncate(end);
        }
        let mut next = self.candidate_levels.iter();
        self.levels.clear();
        self.levels.extend(members.iter().map(|&member| match points.is_kept(member, depth) {
            true => *next.next().expect("every kept point has a level"),
            false => rules.levels as u8,
        }));
    }
}

/// The member of a group that stands for all of it. `keys` are the codes of the candidates, and
/// the cell is that of the lowest `3 shift` bits.
pub fn pick<K: MortonKey>(
    group: &[u32],
    candidates: &[Candidate],
    keys: &[K],
    shift: u32,
    representative: Representative,
    has_color: bool,
) -> u32 {
    match representative {
        Representative::Center => nearest_to_center(group, keys, shift, candidates),
        _ => choose(group, candidates, representative, has_color),
    }
}

fn choose(
    group: &[u32],
    candidates: &[Candidate],
    representative: Representative,
    has_color: bool,
) -> u32 {
    let index = |i: u32| candidates[i as usize].index;
    let best = match representative {
        Representative::Color if has_color => return nearest_to_mean(group, candidates),
        Representative::Random => {
            group.iter().copied().min_by_key(|&i| (scramble(index(i)), index(i)))
        }
        _ => group.iter().copied().min_by_key(|&i| index(i)),
    };
    best.expect("a group has a candidate")
}

/// The candidate whose colour is nearest to the mean of all.
fn nearest_to_mean(group: &[u32], candidates: &[Candidate]) -> u32 {
    let size = group.len() as i64;
    let mut sum = [0i64; 3];
    for &i in group {
        let color = candidates[i as usize].color;
        sum.iter_mut().zip(color).for_each(|(sum, channel)| *sum += i64::from(channel));
    }
    let mut best = (i64::MAX, u64::MAX, 0);
    for &i in group {
        let candidate = &candidates[i as usize];
        // Distances to the mean times the group's size, so that all stays in integers.
        let mut distance = 0;
        for (sum, channel) in sum.iter().zip(candidate.color) {
            distance += (size * i64::from(channel) - sum).pow(2);
        }
        if (distance, candidate.index) < (best.0, best.1) {
            best = (distance, candidate.index, i);
        }
    }
    best.2
}

fn nearest_to_center<K: MortonKey>(
    group: &[u32],
    keys: &[K],
    shift: u32,
    candidates: &[Candidate],
) -> u32 {
    let off = |i: u32| -> i128 {
        let local = keys[i as usize].local(shift).decode();
        let edge = 1i128 << shift;
        local.map(|c| (2 * i128::from(c) + 1 - edge).pow(2)).iter().sum()
    };
    let best = group.iter().copied().min_by_key(|&i| (off(i), candidates[i as usize].index));
    best.expect("a group has a candidate")
}

/// A bijective 64-bit hash (the finalizer of SplitMix64).
fn scramble(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}
