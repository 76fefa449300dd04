//! The two ideals that culling is held against, worked out from the exact visible set.
//!
//! The optimum draws the visible leaves and asks nothing. The optimum of near optimal culling draws
//! the same and asks one question about each hidden node where the walk must end: the hidden
//! frontier, and of these only where a question is cheaper than drawing.

use crate::geometry::{Containment, Frustum, View};
use crate::hierarchy::BoundingHierarchy;
use crate::ids::TreeNodeId;
use crate::visibility::cost::screen_rectangle;
use crate::visibility::{CullingCosts, Proxies, meets_near_plane};

/// The largest hidden nodes in the frustum.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Frontier {
    /// Hidden nodes whose parent is not hidden, in no order.
    pub nodes: Vec<TreeNodeId>,
    /// How many of them are cheaper to ask about than to draw.
    pub feasible: u64,
}

/// The hidden frontier of a view, from the leaves that are visible in it.
///
/// Boxes that meet the near plane can't be asked about and are opened.
pub fn hidden_frontier<H: BoundingHierarchy>(
    tree: &H,
    view: &View,
    visible_leaves: &[TreeNodeId],
    leaf_cost: u64,
    costs: &CullingCosts,
) -> Frontier {
    let mut visible = vec![false; tree.node_limit()];
    for &leaf in visible_leaves {
        let mut at = Some(leaf);
        while let Some(node) = at
            && !visible[node.index()]
        {
            visible[node.index()] = true;
            at = tree.parent(node);
        }
    }
    let (frustum, proxies) = (Frustum::new(view), Proxies::new(view));
    let mut frontier = Frontier::default();
    let mut open: Vec<TreeNodeId> = tree.root().into_iter().collect();
    while let Some(node) = open.pop() {
        let bounds = proxies.of(tree, node);
        if frustum.test_box(&bounds) == Containment::Outside {
            continue;
        }
        let leaf = tree.is_leaf(node) || tree.cost(node) < leaf_cost;
        if visible[node.index()] || meets_near_plane(view, &bounds) {
            if !leaf {
                open.extend(tree.children(node));
            }
            continue;
        }
        let pixels = screen_rectangle(view, &bounds)
            .map_or(0.0, |(low, high)| (high[0] - low[0]) * (high[1] - low[1]));
        let pays = costs.of_query(pixels) < costs.of_drawing(tree.cost(node), pixels);
        frontier.feasible += u64::from(pays);
        frontier.nodes.push(node);
    }
    frontier
}
