//! What became of each part of a scene in a frame of culling: the boxes of the "what is culled"
//! view.
//!
//! Worked out afterwards from what nodes remember and what was drawn, so that a frame that nobody
//! looks into pays nothing for it. Trees of points and of triangles, and both under one root, look
//! the same here.

use crate::geometry::Aabb;
use crate::hierarchy::BoundingHierarchy;
use crate::ids::TreeNodeId;
use crate::visibility::{Algorithm, Culler, ViewHistory};

/// What became of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum NodeState {
    /// A leaf that was drawn: seen in the last frame or in this one, or taken so.
    Drawn,
    /// A leaf that was drawn without being asked about: its box reaches before the near plane, or
    /// no further round was allowed.
    Forced,
    /// One of the largest nodes that are hidden: nothing below was drawn.
    Hidden,
    /// One of the largest nodes outside of the view frustum.
    Outside,
}

impl NodeState {
    /// All states.
    pub const ALL: [NodeState; 4] =
        [NodeState::Drawn, NodeState::Forced, NodeState::Hidden, NodeState::Outside];

    /// The state in a word or two.
    pub fn name(self) -> &'static str {
        match self {
            NodeState::Drawn => "drawn",
            NodeState::Forced => "forced",
            NodeState::Hidden => "hidden",
            NodeState::Outside => "outside",
        }
    }
}

/// A node of which the state is told; together these cover all leaves, each once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeStatus {
    /// The node.
    pub node: TreeNodeId,
    /// The box around all that it holds.
    pub bounds: Aabb,
    /// What became of it.
    pub state: NodeState,
}

impl Culler {
    /// What became of the tree in the last frame, the largest nodes of each state. Empty before the
    /// first frame, and of another tree than that frame's. Leaves without a box are not told.
    pub fn states<H: BoundingHierarchy>(&self, tree: &H) -> Vec<NodeStatus> {
        let history = self.history();
        let (Some(root), true) = (tree.root(), history.fits(tree)) else { return Vec::new() };
        let mut drawn = vec![Below::Nothing; tree.node_limit()];
        for &leaf in self.drawn() {
            drawn[leaf.index()] = Below::Itself;
            let mut at = tree.parent(leaf);
            while let Some(node) = at
                && drawn[node.index()] == Below::Nothing
            {
                drawn[node.index()] = Below::Something;
                at = tree.parent(node);
            }
        }
        let asks = self.asks();
        let mut found = Vec::new();
        let mut open = vec![root];
        while let Some(node) = open.pop() {
            let state = match drawn[node.index()] {
                Below::Itself if asks && history.was_forced(node) => NodeState::Forced,
                Below::Itself => NodeState::Drawn,
                Below::Something => {
                    open.extend(tree.children(node));
                    continue;
                }
                Below::Nothing if history.is_outside(node) => NodeState::Outside,
                // Opened in vain: what it holds was found hidden piece by piece.
                Below::Nothing if is_opened(history, tree, node) => {
                    open.extend(tree.children(node));
                    continue;
                }
                Below::Nothing => NodeState::Hidden,
            };
            found.push(NodeStatus { node, bounds: tree.bounds(node), state });
        }
        found
    }

    /// Whether the last frame could put questions.
    fn asks(&self) -> bool {
        match self.algorithm() {
            Algorithm::None | Algorithm::Frustum => false,
            Algorithm::Auto(..) => self.queried_last(),
            _ => true,
        }
    }
}

/// What was drawn of a subtree.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Below {
    Nothing,
    Something,
    /// It counted as a leaf, and was drawn.
    Itself,
}

fn is_opened<H: BoundingHierarchy>(history: &ViewHistory, tree: &H, node: TreeNodeId) -> bool {
    history.is_reached(node) && tree.children(node).any(|child| history.is_reached(child))
}
