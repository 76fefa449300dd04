//! What each node remembers of the last frames of one view.
//!
//! Flags are not cleared between frames: a node counts as visible last frame only if it was reached
//! in the last frame, so nodes that are new or come back into the frustum count as hidden. Frame
//! numbers wrap around and are compared by their difference.

use crate::hierarchy::BoundingHierarchy;
use crate::ids::TreeNodeId;

/// The longest time that a classification is counted.
pub(super) const LONGEST_PERSISTENCE: u16 = 64;

/// One node's memory, 32 bytes.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct NodeHistory {
    /// Frame in which the traversal reached the node; 0: never.
    pub last_visited: u32,
    /// Frame in which it was drawn; 0: never.
    pub last_drawn: u32,
    /// Visible leaves: first frame in which the node is to be asked about again.
    pub next_test: u32,
    /// Frame in which the node was found outside the frustum; 0: never.
    pub last_outside: u32,
    /// Tests in a row that kept the present classification.
    pub persistence: u16,
    /// Inner nodes: frame in which the box was last found visible after being hidden; 0: never.
    pub opened_at: u32,
    /// Inner nodes: up to this frame the node is not asked about as a whole; see `splits`.
    pub split_until: u32,
    /// How often in a row the box was visible and nothing in it.
    pub splits: u8,
    /// Visible leaves: frames from the last test to `next_test`.
    pub waited: u8,
    pub visible: bool,
    /// Whether it is drawn in the frame `last_visited` without being asked about.
    pub forced: bool,
    /// Whether the node came back into the frustum in the frame `last_visited`.
    pub reentered: bool,
}

/// The memory of one view: a camera, or a light.
#[derive(Clone, Debug, Default)]
pub struct ViewHistory {
    frame: u32,
    nodes: Vec<NodeHistory>,
}

impl ViewHistory {
    /// Starts a frame over a tree; forgets everything if the tree has another size.
    pub fn begin_frame<H: BoundingHierarchy>(&mut self, tree: &H) {
        if self.nodes.len() != tree.node_limit() {
            self.forget();
            self.nodes.resize(tree.node_limit(), NodeHistory::default());
        }
        self.frame = self.frame.wrapping_add(1);
        if self.frame == 0 {
            // 0 stands for never.
            self.frame = 1;
            self.nodes.fill(NodeHistory::default());
        }
    }

    /// Forgets every node: the next frame begins as the first one.
    pub fn forget(&mut self) {
        self.nodes.clear();
    }

    /// Number of the present frame.
    pub fn frame(&self) -> u32 {
        self.frame
    }

    /// Sets the frame number, to come near its end.
    #[cfg(test)]
    pub(super) fn set_frame(&mut self, frame: u32) {
        self.frame = frame;
    }

    pub(super) fn node(&mut self, node: TreeNodeId) -> &mut NodeHistory {
        &mut self.nodes[node.index()]
    }

    /// Whether the node was reached in the last frame and ended it visible.
    pub fn was_visible(&self, node: TreeNodeId) -> bool {
        let node = &self.nodes[node.index()];
        node.visible && node.last_visited == self.frame.wrapping_sub(1)
    }

    /// Whether the node was reached in the present frame and something below was seen, so far.
    pub fn is_visible(&self, node: TreeNodeId) -> bool {
        let node = &self.nodes[node.index()];
        node.visible && node.last_visited == self.frame
    }

    /// Whether a frame over this tree was begun.
    pub(super) fn fits<H: BoundingHierarchy>(&self, tree: &H) -> bool {
        self.frame != 0 && self.nodes.len() == tree.node_limit()
    }

    /// Whether the present frame came to the node, inside of the frustum or outside.
    pub(super) fn is_reached(&self, node: TreeNodeId) -> bool {
        self.nodes[node.index()].last_visited == self.frame || self.is_outside(node)
    }

    /// Whether the present frame found the node outside of the frustum.
    pub(super) fn is_outside(&self, node: TreeNodeId) -> bool {
        self.nodes[node.index()].last_outside == self.frame
    }

    /// Whether the present frame drew the node without asking.
    pub(super) fn was_forced(&self, node: TreeNodeId) -> bool {
        let node = &self.nodes[node.index()];
        node.forced && node.last_visited == self.frame
    }

    /// Whether frame `at` has come.
    pub(super) fn is_due(&self, at: u32) -> bool {
        self.frame.wrapping_sub(at) as i32 >= 0
    }

    /// Whether the node is drawn for the first time in this frame.
    pub(super) fn mark_drawn(&mut self, node: TreeNodeId) -> bool {
        let frame = self.frame;
        let node = self.node(node);
        let first = node.last_drawn != frame;
        node.last_drawn = frame;
        first
    }

    /// Makes a node and its ancestors visible, up to one that already is.
    ///
    /// The early stop is right because every ancestor's flag was cleared when the traversal reached
    /// it, in the same frame as the node's.
    pub(super) fn pull_up<H: BoundingHierarchy>(&mut self, tree: &H, node: TreeNodeId) {
        let visited = self.node(node).last_visited;
        let mut at = Some(node);
        while let Some(node) = at {
            let history = self.node(node);
            debug_assert_eq!(history.last_visited, visited, "ancestors are reached together");
            if history.visible {
                break;
            }
            history.visible = true;
            at = tree.parent(node);
        }
    }
}
