//! One memory-optimized sequential point tree out of the points that entered a node.
//!
//! Which points show on which level is decided per cell with ties broken by input order, so
//! nothing depends on the order of work. Equal to inserting the points one after another.
//! After: Wimmer and Scheiblauer 2006, section 6.4.6 of the dissertation chapter.

use crate::build::encode::{Encoder, Encoding, FinishedNode};
use crate::build::levels::{Levels, grow};
use crate::build::rows::RowLayout;
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
    /// Codes.
    pub keys: &'a [K],
    /// Depth per point, marked with [`BEYOND`](crate::build::home::BEYOND) if no cell takes it.
    pub homes: &'a [u8],
    /// Their rows, one after the other.
    pub rows: &'a [u8],
    /// How rows are laid out.
    pub layout: RowLayout,
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
        let stride = self.layout.stride();
        &self.rows[place as usize * stride..][..stride]
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
    levels: Levels<K>,
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
        let (totals, kept) = self.levels.assign(rules, depth, points, members);
        let mut places: Vec<u32> =
            std::iter::once(0).chain(totals.iter().copied()).take(totals.len()).collect();
        grow(&mut self.ordered, members.len());
        let ordered = &mut self.ordered[..members.len()];
        for (&member, &level) in members.iter().zip(self.levels.levels()) {
            let place = &mut places[usize::from(level)];
            ordered[*place as usize] = member;
            *place += 1;
        }
        let local_bits = rules.root_bits - depth;
        let encoding = &rules.encoding;
        let mut finished =
            self.encoder.encode(depth, local_bits, points, ordered, totals, encoding);
        finished.overflow_points = (members.len() - kept) as u64;
        finished
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
        let distance = from_mean(candidate.color.map(i64::from), sum, size);
        if (distance, candidate.index) < (best.0, best.1) {
            best = (distance, candidate.index, i);
        }
    }
    best.2
}

/// How far a colour is from the mean of some, squared, times the square of their number, so that
/// all stays in integers.
#[inline]
pub fn from_mean(color: [i64; 3], sum: [i64; 3], size: i64) -> i64 {
    let off = |i: usize| size * color[i] - sum[i];
    off(0) * off(0) + off(1) * off(1) + off(2) * off(2)
}

/// How far a point is from the middle of its cell of the lowest `3 shift` bits, squared, in half
/// steps.
pub fn from_center<K: MortonKey>(key: K, shift: u32) -> i128 {
    let edge = 1i128 << shift;
    key.local(shift).decode().map(|c| (2 * i128::from(c) + 1 - edge).pow(2)).iter().sum()
}

fn nearest_to_center<K: MortonKey>(
    group: &[u32],
    keys: &[K],
    shift: u32,
    candidates: &[Candidate],
) -> u32 {
    let off = |i: u32| from_center(keys[i as usize], shift);
    let best = group.iter().copied().min_by_key(|&i| (off(i), candidates[i as usize].index));
    best.expect("a group has a candidate")
}

/// A bijective 64-bit hash (the finalizer of SplitMix64).
pub fn scramble(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}
