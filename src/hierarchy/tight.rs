//! Tight bounds: a node's box replaced by the boxes of some of its descendants.
//!
//! The descendants are a cut of the subtree, so together they hold all it draws; their surface may
//! only grow by a factor, since every box costs pixels to test. The choice does not depend on the
//! view and stays valid when boxes are refitted.
//!
//! After: Mattausch, Bittner and Wimmer, "CHC++", 2008, section 6. Its sentence leaves open what the
//! growth is measured against; here the whole cut is held against the node by default
//! ([`TightForm::Global`]), which bounds the drawn surface; [`TightForm::Local`] holds each step
//! against its own parent and may reach the factor once per level.

use crate::hierarchy::{BoundingHierarchy, surface_area};
use crate::ids::TreeNodeId;

/// What the growth of the surface is measured against.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TightForm {
    /// The sum of the cut's areas against the node's area.
    #[default]
    Global,
    /// The sum of a member's children's areas against the member's.
    Local,
}

/// How far a box may be taken apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TightCut {
    /// Levels below the node; 0 keeps the node's own box. The papers take 3.
    pub depth: u32,
    /// Factor by which the surface may grow, at least 1. The papers take 1.4.
    pub growth: f64,
    /// What the growth is measured against.
    pub form: TightForm,
}

impl Default for TightCut {
    fn default() -> Self {
        TightCut { depth: 3, growth: 1.4, form: TightForm::Global }
    }
}

/// Appends the nodes whose boxes stand for `node`'s.
pub fn tight_cut<H: BoundingHierarchy>(
    tree: &H,
    node: TreeNodeId,
    limits: &TightCut,
    cut: &mut Vec<TreeNodeId>,
) {
    let area = |node: TreeNodeId| surface_area(&tree.bounds(node));
    let flat = 1e-12 * tree.root().map_or(0.0, &area);
    let own = area(node);
    if limits.depth == 0 || own <= flat {
        cut.push(node);
        return;
    }
    let children_area = |node: TreeNodeId| tree.children(node).map(area).sum::<f64>();
    // Members that may still be refined: (node, depth).
    let mut members = vec![(node, 0u32)];
    let mut total = own;
    loop {
        let refinable = |&(member, depth): &(TreeNodeId, u32)| {
            let is_whole = tree.is_leaf(member) || tree.keeps_whole(member);
            if depth >= limits.depth || area(member) <= flat || is_whole {
                return None;
            }
            let after = children_area(member);
            let allowed = match limits.form {
                TightForm::Global => total - area(member) + after <= limits.growth * own,
                TightForm::Local => after <= limits.growth * area(member),
            };
            allowed.then(|| area(member) - after)
        };
        let best = members
            .iter()
            .enumerate()
            .filter_map(|(at, member)| refinable(member).map(|drop| (at, drop)))
            .max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
        let Some((at, drop)) = best else { break };
        total -= drop;
        let (member, depth) = members.swap_remove(at);
        let sound = |child: &TreeNodeId| !tree.bounds(*child).is_empty();
        members.extend(tree.children(member).filter(sound).map(|child| (child, depth + 1)));
    }
    cut.extend(members.into_iter().map(|(member, _)| member));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Aabb;
    use crate::hierarchy::Bvh;
    use crate::sampling::Random;
    use glam::DVec3;

    /// Small boxes far apart: refining always shrinks the surface.
    fn scattered(count: usize) -> (Bvh, Vec<Aabb>) {
        let bounds: Vec<Aabb> = (0..count)
            .map(|i| {
                let mut random = Random::new(11, i as u64);
                let low = DVec3::from_array(std::array::from_fn(|_| random.unit() * 100.0));
                Aabb::new(low, low + 2.0)
            })
            .collect();
        (Bvh::build(&bounds, &vec![1; count], 1), bounds)
    }

    #[test]
    fn cuts_hold_their_content_within_depth_and_surface() {
        let (bvh, bounds) = scattered(500);
        for form in [TightForm::Global, TightForm::Local] {
            for growth in [1.0, 1.4, f64::INFINITY] {
                for depth in 0..5 {
                    let limits = TightCut { depth, growth, form };
                    for node in (0..bvh.node_count()).step_by(7) {
                        let node = TreeNodeId(node as u32);
                        let mut cut = Vec::new();
                        tight_cut(&bvh, node, &limits, &mut cut);
                        assert!(cut.len() <= 1 << depth);
                        for object in bvh.objects_of(node) {
                            let inside = |at: &TreeNodeId| {
                                bvh.bounds(*at).union(&bounds[object.index()]) == bvh.bounds(*at)
                            };
                            assert!(cut.iter().any(inside), "content is covered");
                        }
                        let total: f64 = cut.iter().map(|at| surface_area(&bvh.bounds(*at))).sum();
                        let own = surface_area(&bvh.bounds(node));
                        let levels = if form == TightForm::Local { depth } else { 1 };
                        assert!(total <= own * growth.powi(levels as i32).max(1.0) * (1.0 + 1e-9));
                    }
                }
            }
        }
    }

    #[test]
    fn scattered_content_is_taken_apart_and_flat_boxes_are_not() {
        let corner = |i: usize| {
            let low =
                DVec3::from_array(std::array::from_fn(|axis| f64::from(i as u32 >> axis & 1)));
            Aabb::new(low * 100.0, low * 100.0 + 2.0)
        };
        let corners: Vec<Aabb> = (0..8).map(corner).collect();
        let bvh = Bvh::build(&corners, &[1; 8], 1);
        let mut cut = Vec::new();
        tight_cut(&bvh, TreeNodeId(0), &TightCut::default(), &mut cut);
        assert_eq!(cut.len(), 8, "one box around each corner");
        let flat = Aabb::new(DVec3::ZERO, DVec3::ZERO);
        let points = Bvh::build(&[flat; 8], &[1; 8], 1);
        cut.clear();
        tight_cut(&points, TreeNodeId(0), &TightCut::default(), &mut cut);
        assert_eq!(cut, [TreeNodeId(0)]);
    }
}
