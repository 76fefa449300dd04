//! Which points of a node show on which level: representatives move up, level by level.
//!
//! Of the points that stand for the cells of a level, each cell of the level above takes one. A
//! cell has at most eight candidates, mostly three or four, too few for branches to be foretold:
//! each level is three passes over all that stand, which decide by arithmetic where a cell begins
//! and who is best. Ties are broken by input order, so nothing depends on the order of work.
//! After: Wimmer and Scheiblauer 2006, section 6.4.6 of the dissertation chapter.

use crate::build::node::{
    Representative, SortedPoints, TreeRules, from_center, from_mean, scramble,
};
use crate::geometry::MortonKey;

/// Chooses representatives; its memory is used again.
#[derive(Default)]
pub struct Levels<K> {
    /// Per point its level.
    levels: Vec<u8>,
    /// Those that stand: colour (see [`color_word`]), place in the input, number of the point,
    /// levels of cells that it shares with the one before it plus one, 0 for the first.
    colors: Vec<u64>,
    indices: Vec<u64>,
    numbers: Vec<u32>,
    shared: Vec<u8>,
    /// Their codes, if they matter.
    keys: Vec<K>,
    /// Per cell: sum of the candidates' colours, and who is best.
    sums: Vec<u64>,
    winners: Vec<u32>,
}

/// Bits of a channel in a colour word: room for the sum of eight.
const CHANNEL_BITS: u32 = 20;

/// A colour in a word that can be added up for up to eight candidates, which counts them, too.
fn color_word([r, g, b]: [u16; 3]) -> u64 {
    u64::from(r)
        | u64::from(g) << CHANNEL_BITS
        | u64::from(b) << (2 * CHANNEL_BITS)
        | 1 << (3 * CHANNEL_BITS)
}

fn channels(word: u64) -> [i64; 3] {
    [0, 1, 2].map(|i| (word >> (i * CHANNEL_BITS) & ((1 << CHANNEL_BITS) - 1)) as i64)
}

impl<K: MortonKey> Levels<K> {
    /// Assigns the points of the node at `depth`, given by their places in rising order. Returns
    /// how many show up to each level, and how many a cell has taken.
    pub fn assign(
        &mut self,
        rules: &TreeRules,
        depth: u32,
        points: &SortedPoints<K>,
        members: &[u32],
    ) -> (Vec<u32>, usize) {
        let kept = self.take(rules, depth, points, members);
        let mut totals = vec![0; rules.levels as usize + 1];
        totals[rules.levels as usize] = members.len() as u32;
        let mut standing = kept;
        for level in (0..rules.levels).rev() {
            // Cells of a level are shared by points that share so many levels of the octree.
            let least = (depth + level) as u8;
            standing = match rules.representative {
                Representative::Color if points.layout.has_color() => {
                    self.sum(standing, least);
                    self.stand(standing, least, |these, i, group| {
                        let sum = these.sums[group];
                        let size = (sum >> (3 * CHANNEL_BITS)) as i64;
                        let off = from_mean(channels(these.colors[i]), channels(sum), size);
                        (off as u128) << 64 | u128::from(these.indices[i])
                    })
                }
                Representative::Color | Representative::First => {
                    self.stand(standing, least, |these, i, _| these.indices[i])
                }
                Representative::Random => self.stand(standing, least, |these, i, _| {
                    u128::from(scramble(these.indices[i])) << 64 | u128::from(these.indices[i])
                }),
                Representative::Center => {
                    let shift = rules.root_bits - depth - level;
                    let standing = self.stand(standing, least, |these, i, _| {
                        (from_center(these.keys[i], shift), these.indices[i])
                    });
                    for (group, &winner) in self.winners[..standing].iter().enumerate() {
                        self.keys[group] = self.keys[winner as usize];
                    }
                    standing
                }
            };
            totals[level as usize] = standing as u32;
            for &number in &self.numbers[..standing] {
                self.levels[number as usize] = level as u8;
            }
        }
        (totals, kept)
    }

    /// Per point of the last node its level.
    pub fn levels(&self) -> &[u8] {
        &self.levels
    }

    /// Lets all points stand that a cell has taken; returns how many these are.
    fn take(
        &mut self,
        rules: &TreeRules,
        depth: u32,
        points: &SortedPoints<K>,
        members: &[u32],
    ) -> usize {
        let count = members.len();
        self.levels.clear();
        self.levels.resize(count, rules.levels as u8);
        grow(&mut self.colors, count);
        grow(&mut self.indices, count);
        grow(&mut self.numbers, count);
        grow(&mut self.shared, count);
        grow(&mut self.sums, count);
        grow(&mut self.winners, count);
        let centers = rules.representative == Representative::Center;
        if centers {
            grow(&mut self.keys, count);
        }
        let layout = points.layout;
        let (mut kept, mut previous) = (0, None);
        for (number, &member) in (0u32..).zip(members) {
            let (key, row) = (points.keys[member as usize], points.row(member));
            let is_kept = points.is_kept(member, depth);
            // Written in any case, and over again by the next one if it does not count.
            self.colors[kept] = color_word(layout.color(row));
            self.indices[kept] = layout.index(row);
            self.numbers[kept] = number;
            self.shared[kept] = match previous {
                Some(previous) => key.shared_levels(previous, rules.root_bits) as u8 + 1,
                None => 0,
            };
            if centers {
                self.keys[kept] = key;
            }
            if is_kept {
                previous = Some(key);
            }
            kept += usize::from(is_kept);
        }
        kept
    }

    /// Adds up the colours of each cell's candidates.
    fn sum(&mut self, standing: usize, least: u8) {
        let (colors, shared) = (&self.colors[..standing], &self.shared[..standing]);
        let sums = &mut self.sums[..standing];
        let (mut group, mut sum) = (usize::MAX, 0);
        for (&color, &shared) in colors.iter().zip(shared) {
            let is_same = shared > least;
            group = group.wrapping_add(usize::from(!is_same));
            sum = color + (sum & u64::from(is_same).wrapping_neg());
            sums[group] = sum;
        }
    }

    /// Lets the candidate of the smallest rank stand for each cell; returns how many cells these
    /// are. Ranks of two candidates of a cell differ.
    #[inline(always)]
    fn stand<R: Ord + Copy + Default>(
        &mut self,
        standing: usize,
        least: u8,
        rank: impl Fn(&Self, usize, usize) -> R,
    ) -> usize {
        let (mut group, mut winner, mut first) = (usize::MAX, 0, 0);
        let mut best = R::default();
        for i in 0..standing {
            let shared = self.shared[i];
            let is_same = shared > least;
            group = group.wrapping_add(usize::from(!is_same));
            let rank = rank(self, i, group);
            let is_better = !is_same | (rank < best);
            best = if is_better { rank } else { best };
            winner = if is_better { i as u32 } else { winner };
            first = if is_same { first } else { shared };
            self.winners[group] = winner;
            // No later than where it was read.
            self.shared[group] = first;
        }
        let groups = group.wrapping_add(1);
        for group in 0..groups {
            let winner = self.winners[group] as usize;
            self.colors[group] = self.colors[winner];
            self.indices[group] = self.indices[winner];
            self.numbers[group] = self.numbers[winner];
        }
        groups
    }
}

/// Makes a list at least so long; what is in it does not matter.
pub fn grow<T: Clone + Default>(list: &mut Vec<T>, count: usize) {
    if list.len() < count {
        list.resize(count, T::default());
    }
}
