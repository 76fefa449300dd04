//! Nodes still to be looked at, the nearest first.

use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

use crate::ids::TreeNodeId;

/// In which order nodes are taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Order {
    /// The nearest of all: front to back even for nodes found late.
    #[default]
    Nearest,
    /// The last one put in; children are put in far to near. Cheaper, and front to back only
    /// within a subtree.
    DepthFirst,
}

#[derive(Clone, Copy, Debug)]
struct Key {
    distance: f64,
    node: TreeNodeId,
}

impl PartialEq for Key {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Key {}

impl PartialOrd for Key {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Key {
    /// Equal distances go by id, so that counters repeat.
    fn cmp(&self, other: &Self) -> Ordering {
        self.distance.total_cmp(&other.distance).then(self.node.cmp(&other.node))
    }
}

/// The open nodes of a traversal.
#[derive(Clone, Debug, Default)]
pub(super) struct Frontier {
    order: Order,
    heap: BinaryHeap<Reverse<Key>>,
    stack: Vec<Key>,
}

impl Frontier {
    pub fn clear(&mut self, order: Order) {
        self.order = order;
        self.heap.clear();
        self.stack.clear();
    }

    pub fn is_empty(&self) -> bool {
        self.heap.is_empty() && self.stack.is_empty()
    }

    /// Puts siblings in, each with its distance.
    pub fn push(&mut self, siblings: impl Iterator<Item = (f64, TreeNodeId)>) {
        let keys = siblings.map(|(distance, node)| Key { distance, node });
        match self.order {
            Order::Nearest => self.heap.extend(keys.map(Reverse)),
            Order::DepthFirst => {
                let from = self.stack.len();
                self.stack.extend(keys);
                self.stack[from..].sort_unstable_by(|a, b| b.cmp(a));
            }
        }
    }

    pub fn pop(&mut self) -> Option<TreeNodeId> {
        match self.order {
            Order::Nearest => self.heap.pop().map(|Reverse(key)| key.node),
            Order::DepthFirst => self.stack.pop().map(|key| key.node),
        }
    }
}
