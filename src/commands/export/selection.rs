//! Which points of a store are exported.

use anyhow::bail;
use glam::{DVec3, I64Vec3};

use super::ExportArgs;
use super::rows::positions_of;
use crate::geometry::Aabb;
use crate::ids::NodeId;
use crate::octree::Node;
use crate::output::Positions;
use crate::points::{names, record_coordinates};
use crate::store::Store;

/// Which points to write: of some nodes, a prefix, and of that what lies inside and has the class.
#[derive(Debug)]
pub struct Selection {
    region: Region,
    classes: Vec<u8>,
    /// Where the class stands in a row, and which bits of it.
    class_place: Option<(usize, u8)>,
    /// Points of each node that are looked at.
    shares: Vec<Share>,
}

/// Where points are taken.
#[derive(Debug)]
enum Region {
    Everywhere,
    /// Inclusive box on the store's lattice.
    Steps(I64Vec3, I64Vec3),
    /// Inclusive box of exact positions, where they lie between steps.
    Exact(Aabb, Box<Positions>),
}

/// The first points of a node, and an even part of the level after them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Share {
    /// Leading points that are taken.
    pub whole: usize,
    /// Points of the next level, of which a part is taken.
    pub sampled: usize,
    /// How many of `part.1` are taken, `part.0`, and the place of the first sampled one among them.
    part: (u64, u64),
    first: u64,
}

impl Share {
    /// All points of a node.
    fn all(node: &Node) -> Self {
        Share { whole: node.point_count() as usize, ..Share::default() }
    }

    /// Points that are read for it.
    pub fn points(&self) -> usize {
        self.whole + self.sampled
    }

    /// Whether the point of that place in the node belongs to it.
    pub fn takes(&self, index: usize) -> bool {
        if index < self.whole {
            return true;
        }
        let place = u128::from(self.first) + (index - self.whole) as u128;
        let (kept, of) = (u128::from(self.part.0), u128::from(self.part.1));
        index < self.points() && (place + 1) * kept / of > place * kept / of
    }
}

impl Selection {
    /// What the arguments ask for, of rows whose coordinates count from `origin`.
    pub fn new(args: &ExportArgs, store: &Store, origin: I64Vec3) -> anyhow::Result<Self> {
        let metadata = store.metadata();
        let class = metadata.schema.find(names::CLASSIFICATION);
        if !args.class.is_empty() && class.is_none() {
            bail!("{}: its points have no class", args.store.display());
        }
        // Point formats up to 5 have flags in the upper bits of the class byte; they are those
        // that pack returns and have no byte of flags.
        let has = |name| metadata.schema.find(name).is_some();
        let is_packed = has(names::RETURNS) && !has(names::FLAGS);
        let class_bits = if is_packed { 0x1f } else { 0xff };
        let lattice = metadata.lattice();
        let is_exact = has(names::COORDINATE_RESIDUAL);
        let region = match args.bounds {
            None => Region::Everywhere,
            Some(bounds) if is_exact => {
                Region::Exact(bounds, Box::new(positions_of(store, origin)))
            }
            Some(bounds) => {
                let (low, high) = (lattice.lattice(bounds.min), lattice.lattice(bounds.max));
                // Coordinates are decimal numbers: what prints as on the border is inside.
                let slack = DVec3::splat(1e-6);
                let low = (low - slack).ceil().as_i64vec3() - origin;
                Region::Steps(low, (high + slack).floor().as_i64vec3() - origin)
            }
        };
        let level = args.level.unwrap_or(u32::MAX);
        let octree = store.octree();
        let takes_node = |node: NodeId| {
            let near = |bounds: Aabb| {
                let slack = if is_exact { lattice.scale } else { 1e-5 * lattice.scale };
                Aabb::new(bounds.min - slack, bounds.max + slack)
                    .intersects(&octree.tight_box(node))
            };
            octree.node(node).depth <= level && args.bounds.is_none_or(near)
        };
        let nodes = octree.nodes();
        let taken: Vec<bool> = (0..nodes.len() as u32).map(|i| takes_node(NodeId(i))).collect();
        Ok(Selection {
            region,
            classes: args.class.clone(),
            class_place: class.map(|(_, a)| (a.record_offset as usize, class_bits)),
            shares: shares(nodes, &taken, args.budget.unwrap_or(u64::MAX)),
        })
    }

    /// Which points of a node are looked at.
    pub fn share(&self, node: NodeId) -> Share {
        self.shares[node.index()]
    }

    /// Whether all points that are looked at are taken.
    pub fn takes_all(&self) -> bool {
        let has_part = self.shares.iter().any(|share| share.sampled > 0);
        matches!(self.region, Region::Everywhere) && self.classes.is_empty() && !has_part
    }

    /// Whether a row that is looked at is taken, by its place and class.
    pub fn takes_row(&self, row: &[u8]) -> bool {
        let inside = match &self.region {
            Region::Everywhere => true,
            Region::Steps(low, high) => {
                let steps = I64Vec3::from_array(record_coordinates(row).map(i64::from));
                steps.cmpge(*low).all() && steps.cmple(*high).all()
            }
            Region::Exact(bounds, positions) => {
                let position = positions.of(row);
                position.cmpge(bounds.min).all() && position.cmple(bounds.max).all()
            }
        };
        let class_fits = self.classes.is_empty()
            || self.class_place.is_some_and(|(at, bits)| self.classes.contains(&(row[at] & bits)));
        inside && class_fits
    }
}

/// What each node gives so that all together give at most `budget` points.
///
/// A node's points are coarse to fine, and all nodes of a depth are needed before the next depth
/// adds anything: levels count in the order of (depth, level in the node). Of the first level that
/// does not fit an even part is taken, so the budget is used up.
fn shares(nodes: &[Node], taken: &[bool], budget: u64) -> Vec<Share> {
    let taken_nodes = || nodes.iter().zip(taken).filter(|(_, taken)| **taken).map(|(node, _)| node);
    let all: u64 = taken_nodes().map(|node| u64::from(node.point_count())).sum();
    if all <= budget {
        let share = |(node, taken): (&Node, &bool)| {
            if *taken { Share::all(node) } else { Share::default() }
        };
        return nodes.iter().zip(taken).map(share).collect();
    }
    // Points per (depth, level), coarse to fine.
    let levels = nodes.first().map_or(0, |node| node.levels.totals().len());
    let depths = nodes.last().map_or(0, |node| node.depth as usize + 1);
    let mut counts = vec![0u64; depths * levels];
    for node in taken_nodes() {
        for level in 0..levels {
            counts[node.depth as usize * levels + level] += level_points(node, level) as u64;
        }
    }
    let mut left = budget;
    let mut cut = 0;
    while counts[cut] <= left {
        left -= counts[cut];
        cut += 1;
    }
    let (cut_depth, cut_level) = (cut / levels, cut % levels);
    let mut first = 0;
    let share = |(node, taken): (&Node, &bool)| {
        if !taken || node.depth as usize > cut_depth {
            return Share::default();
        }
        if (node.depth as usize) < cut_depth {
            return Share::all(node);
        }
        let sampled = level_points(node, cut_level);
        let whole = node.levels.totals()[cut_level] as usize - sampled;
        let share = Share { whole, sampled, part: (left, counts[cut]), first };
        first += sampled as u64;
        share
    };
    nodes.iter().zip(taken).map(share).collect()
}

/// Points that a level adds to those before it.
fn level_points(node: &Node, level: usize) -> usize {
    let totals = node.levels.totals();
    let before = if level == 0 { 0 } else { totals[level - 1] };
    (totals[level] - before) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::octree::LevelIndex;
    use glam::UVec3;

    fn node(depth: u32, totals: &[u32]) -> Node {
        Node {
            depth,
            cell: UVec3::ZERO,
            parent: None,
            first_child: NodeId(0),
            child_mask: 0,
            levels: LevelIndex::new(totals.to_vec()).expect("totals rise from 1"),
            tight_min: UVec3::ZERO,
            tight_max: UVec3::ZERO,
        }
    }

    #[test]
    fn a_budget_takes_whole_levels_of_whole_depths_and_an_even_part_of_the_next() {
        let nodes = [node(0, &[1, 4, 10]), node(1, &[1, 3, 40]), node(1, &[1, 5, 60])];
        for budget in [0, 1, 3, 4, 9, 10, 11, 12, 13, 18, 19, 50, 109, 110, 1000] {
            let shares = shares(&nodes, &[true; 3], budget);
            let taken: Vec<Vec<usize>> = nodes
                .iter()
                .zip(&shares)
                .map(|(node, share)| {
                    (0..node.point_count() as usize).filter(|&i| share.takes(i)).collect()
                })
                .collect();
            let count: usize = taken.iter().map(Vec::len).sum();
            assert_eq!(count as u64, budget.min(110), "budget {budget}");
            if budget < 10 {
                assert!(taken[1].is_empty() && taken[2].is_empty(), "the root comes first");
            } else {
                assert_eq!(taken[0].len(), 10);
            }
            if budget == 50 {
                // 10 of the root, 8 coarse ones; 32 of 92: 12 or 13 of 37 and the rest of 55.
                assert!((15..=16).contains(&taken[1].len()), "{taken:?}");
            }
        }
        let shares = shares(&nodes, &[true, false, true], 30);
        assert_eq!(shares[1].points(), 0, "what is not selected uses no budget");
    }
}
