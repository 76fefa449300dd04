//! What the coherent algorithms are held against: no culling, the frustum alone, and the two that
//! wait for every answer.

use crate::hierarchy::BoundingHierarchy;
use crate::ids::TreeNodeId;
use crate::visibility::frontier::Order;
use crate::visibility::walk::{Reached, Walk};

/// Draws every leaf.
pub(super) fn everything<H: BoundingHierarchy>(walk: &mut Walk<H>) {
    walk.start(Order::DepthFirst);
    while let Some(node) = walk.frontier.pop() {
        walk.counters.nodes_visited += 1;
        if walk.is_leaf(node) {
            walk.draw(node);
        } else {
            walk.push_children(node);
        }
    }
}

/// Draws every leaf in the frustum, front to back.
pub(super) fn frustum<H: BoundingHierarchy>(walk: &mut Walk<H>) {
    leaves_in_frustum(walk, |walk, leaf, _| walk.draw(leaf));
}

/// Asks about every leaf in the frustum, front to back, and waits each time.
pub(super) fn naive<H: BoundingHierarchy>(walk: &mut Walk<H>, threshold: u64) {
    leaves_in_frustum(walk, |walk, leaf, near| {
        if near || ask(walk, leaf) > threshold {
            walk.draw(leaf);
        }
    });
}

/// Hierarchical stop-and-wait: asks about every node on the way down, and waits each time.
///
/// It knows nothing of the last frame, and so is the oracle for what is visible on a tree.
pub(super) fn stop_and_wait<H: BoundingHierarchy>(walk: &mut Walk<H>, threshold: u64) {
    walk.start(Order::Nearest);
    while let Some(node) = walk.frontier.pop() {
        let seen = match walk.reach(node) {
            Reached::Outside => false,
            Reached::Near { .. } => true,
            Reached::Inside { .. } => ask(walk, node) > threshold,
        };
        if !seen {
            continue;
        }
        walk.pull_up(node);
        if walk.is_leaf(node) {
            walk.draw(node);
        } else {
            walk.push_children(node);
        }
    }
}

fn leaves_in_frustum<H: BoundingHierarchy>(
    walk: &mut Walk<H>,
    mut take: impl FnMut(&mut Walk<H>, TreeNodeId, bool),
) {
    walk.start(Order::Nearest);
    while let Some(node) = walk.frontier.pop() {
        let near = match walk.reach(node) {
            Reached::Outside => continue,
            Reached::Near { .. } => true,
            Reached::Inside { .. } => false,
        };
        if walk.is_leaf(node) {
            take(walk, node, near);
        } else {
            // Only leaves are asked about; the guard counts for them alone.
            walk.counters.near_plane_forced -= u64::from(near);
            walk.push_children(node);
        }
    }
}

fn ask<H: BoundingHierarchy>(walk: &mut Walk<H>, node: TreeNodeId) -> u64 {
    walk.counters.queries_issued += 1;
    walk.counters.queries_hidden += 1;
    walk.counters.query_boxes += 1;
    walk.counters.hidden_nodes_decided += 1;
    let proxy = walk.proxy(node);
    let query = walk.device.query(&[proxy]);
    walk.samples(query)
}
