//! The boxes each node is asked about with, chosen once and kept.

use crate::geometry::Aabb;
use crate::hierarchy::{BoundingHierarchy, TightCut, tight_cut};
use crate::ids::TreeNodeId;
use crate::visibility::Proxies;

/// Cuts of the nodes that were asked about so far.
#[derive(Clone, Debug, Default)]
pub(super) struct TightBounds {
    limits: TightCut,
    /// First member and number of members of each node's cut; a number of 0: not chosen yet.
    cuts: Vec<(u32, u32)>,
    members: Vec<TreeNodeId>,
}

impl TightBounds {
    /// Forgets all cuts if the tree's size or the limits changed.
    pub fn prepare<H: BoundingHierarchy>(&mut self, tree: &H, limits: TightCut) {
        if self.cuts.len() != tree.node_limit() || self.limits != limits {
            self.limits = limits;
            self.forget();
            self.cuts.resize(tree.node_limit(), (0, 0));
        }
    }

    /// Forgets all cuts: boxes moved far.
    pub fn forget(&mut self) {
        self.cuts.fill((0, 0));
        self.members.clear();
    }

    /// Appends the widened boxes that stand for a node's. They are read afresh, so they hold the
    /// content of moved objects even where the choice is old.
    pub fn boxes<H: BoundingHierarchy>(
        &mut self,
        tree: &H,
        node: TreeNodeId,
        proxies: &Proxies,
        boxes: &mut Vec<Aabb>,
    ) {
        let (mut first, mut count) = self.cuts[node.index()];
        if count == 0 {
            first = self.members.len() as u32;
            tight_cut(tree, node, &self.limits, &mut self.members);
            count = self.members.len() as u32 - first;
            self.cuts[node.index()] = (first, count);
        }
        let members = &self.members[first as usize..][..count as usize];
        boxes.extend(members.iter().map(|&member| proxies.of(tree, member)));
    }
}
