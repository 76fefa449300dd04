//! One walk over the octrees of a scene: which nodes are seen, how large they are, what becomes of
//! each. What goes in and comes out is in `cut`.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use glam::DVec3;

use crate::geometry::{Aabb, CellDescent, ClipCell, Containment, Frustum, View};
use crate::ids::NodeId;
use crate::octree::{Node, Octree};
use crate::select::cut::{Availability, Cut, CutSettings, DrawNode, Request, Residency};
use crate::select::level::{
    self, LevelRule, RuleCell, off_axis_cosine, projected_px, required_level,
};

/// A node that is seen and not yet fine enough.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    priority_px: f64,
    depth: u32,
    octree: u32,
    node: NodeId,
    /// Leading points that its size on screen asks for.
    count: u32,
    /// Share of these that is drawn.
    share: f32,
    has_drawn_ancestor: bool,
    wholly_inside: bool,
    cell: ClipCell,
}

impl Candidate {
    /// Larger on screen first, then coarser, then by octree and path.
    fn order(&self) -> (u32, u32, NodeId) {
        (self.depth, self.octree, self.node)
    }

    /// Points that are drawn of it, at least one if there are any.
    fn points(&self) -> u32 {
        match self.share < 1.0 {
            true => ((f64::from(self.count) * f64::from(self.share)).ceil() as u32)
                .clamp(1, self.count.max(1)),
            false => self.count,
        }
    }
}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        self.priority_px
            .total_cmp(&other.priority_px)
            .then_with(|| other.order().cmp(&self.order()))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Candidate {}

/// One octree as the view sees it.
#[derive(Clone, Debug)]
pub(super) struct Space {
    /// The eye in lattice steps from the lowest corner of the root.
    eye_steps: DVec3,
    /// World length of a lattice step.
    scale: DVec3,
    bits: u32,
    /// World edges of the root cell.
    root_size: DVec3,
    /// The length that stands for the root cell under the rule.
    root_span: f64,
    descent: CellDescent,
}

impl Space {
    pub(super) fn new(octree: &Octree, view: &View, frustum: &Frustum, rule: &LevelRule) -> Self {
        let lattice = octree.lattice();
        let root = octree.root_cube();
        let half_steps = 0.5 * f64::from(root.bits).exp2();
        let center = (root.min.as_dvec3() + half_steps) * lattice.scale + lattice.offset;
        Space {
            eye_steps: lattice.lattice(view.camera.eye) - root.min.as_dvec3(),
            scale: lattice.scale,
            bits: root.bits,
            root_size: octree.cell_size(0),
            root_span: rule.span(octree.cell_size(0)),
            descent: frustum.descend(center, half_steps * lattice.scale),
        }
    }

    /// A node's closed cell, world lengths relative to the eye.
    fn cell_box(&self, node: &Node) -> Aabb {
        let edge = f64::from(self.bits - node.depth).exp2();
        let min = node.cell.as_dvec3() * edge - self.eye_steps;
        Aabb::new(min * self.scale, (min + (edge - 1.0)) * self.scale)
    }
}

pub(super) struct Walk<'a> {
    pub(super) scene: &'a [(&'a Octree, &'a dyn Residency)],
    pub(super) view: &'a View,
    pub(super) focal_px: f64,
    pub(super) settings: &'a CutSettings,
    pub(super) spaces: &'a [Space],
    pub(super) wanted: &'a mut [Vec<u8>],
    pub(super) remaining: u64,
    pub(super) cuts: &'a mut [Cut],
}

/// Whether a node's judged spacing has passed the wanted error.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Past {
    NotYet,
    /// Only where levels pass continuously.
    Partly {
        share: f32,
    },
    Wholly,
}

impl Past {
    fn of(judged_px: f64, error_px: f64, continuous: bool) -> Self {
        // Half an octave before the error and half an octave after it.
        let share = match continuous && error_px > 0.0 {
            true => (judged_px / error_px).log2() + 0.5,
            false if judged_px <= error_px => 0.0,
            false => 1.0,
        };
        match share {
            share if share <= 0.0 => Past::NotYet,
            share if share < 1.0 => Past::Partly { share: share as f32 },
            _ => Past::Wholly,
        }
    }
}

/// What became of a candidate.
enum Step {
    /// It counts, and its children are next.
    Descend { drawn: bool },
    /// It counts, and its subtree waits for it.
    Wait,
    /// It did not fit; nothing after it may.
    Stop,
}

impl Walk<'_> {
    /// Every node that is seen and not fine enough, coarse to fine; the budget cannot bind.
    pub(super) fn everything(&mut self, list: &mut Vec<Candidate>) {
        list.clear();
        self.roots(|root| list.push(root));
        let mut next = 0;
        while next < list.len() {
            let candidate = list[next];
            next += 1;
            if let Step::Descend { drawn } = self.take(&candidate) {
                self.children(&candidate, drawn, |child| list.push(child));
            }
        }
    }

    /// The largest on screen first, until the budget is used up.
    pub(super) fn by_priority(&mut self, queue: &mut BinaryHeap<Candidate>) {
        queue.clear();
        self.roots(|root| queue.push(root));
        while let Some(candidate) = queue.pop() {
            self.cuts[candidate.octree as usize].counters.queue_pops += 1;
            match self.take(&candidate) {
                Step::Descend { drawn } => {
                    self.children(&candidate, drawn, |child| queue.push(child));
                }
                Step::Wait => {}
                Step::Stop => break,
            }
        }
        // Other octrees keep one point each, so that none vanishes.
        for candidate in queue.drain() {
            self.cuts[candidate.octree as usize].counters.nodes_over_budget += 1;
            if !candidate.has_drawn_ancestor {
                self.take_levels(&candidate, 1);
            }
        }
    }

    /// Draws a candidate or asks for it, if the budget allows.
    fn take(&mut self, candidate: &Candidate) -> Step {
        let availability = self.availability(candidate);
        if availability == Availability::Failed {
            self.cuts[candidate.octree as usize].counters.nodes_failed += 1;
            return Step::Descend { drawn: false };
        }
        if availability == Availability::Concealed {
            self.record(candidate, candidate.count, candidate.share, availability);
            return Step::Descend { drawn: true };
        }
        if u64::from(candidate.points()) > self.remaining {
            self.cuts[candidate.octree as usize].counters.nodes_over_budget += 1;
            if !candidate.has_drawn_ancestor {
                self.take_levels(candidate, self.remaining.max(1));
            } else if self.settings.fill {
                self.take_levels(candidate, self.remaining);
            }
            return Step::Stop;
        }
        self.remaining -= u64::from(candidate.points());
        self.record(candidate, candidate.count, candidate.share, availability);
        match availability {
            Availability::Resident => Step::Descend { drawn: true },
            _ => Step::Wait,
        }
    }

    /// Takes the levels of a candidate that have at most `limit` points together, if any.
    fn take_levels(&mut self, candidate: &Candidate, limit: u64) {
        let levels = &self.scene[candidate.octree as usize].0.node(candidate.node).levels;
        let limit = limit.min(u64::from(candidate.count));
        let fitting = levels.totals().iter().rev().find(|&&total| u64::from(total) <= limit);
        if let Some(&count) = fitting {
            self.remaining = self.remaining.saturating_sub(u64::from(count));
            self.record(candidate, count, 1.0, self.availability(candidate));
        }
    }

    fn availability(&self, candidate: &Candidate) -> Availability {
        self.scene[candidate.octree as usize].1.availability(candidate.node)
    }

    fn record(
        &mut self,
        candidate: &Candidate,
        count: u32,
        share: f32,
        availability: Availability,
    ) {
        let (octree, node) = (candidate.octree as usize, candidate.node);
        let cut = &mut self.cuts[octree];
        match availability {
            Availability::Resident | Availability::Concealed => {
                let points = u64::from(Candidate { count, share, ..*candidate }.points());
                let concealed = availability == Availability::Concealed;
                let counters = &mut cut.counters;
                let (nodes_of, points_of) = match concealed {
                    true => (&mut counters.nodes_concealed, &mut counters.points_concealed),
                    false => (&mut counters.nodes_drawn, &mut counters.points_drawn),
                };
                *nodes_of += 1;
                *points_of += points;
                let priority_px = candidate.priority_px;
                cut.draw.push(DrawNode {
                    node,
                    count,
                    splat_level: 0,
                    share,
                    priority_px,
                    concealed,
                });
                self.wanted[octree].push(0);
            }
            Availability::Absent => {
                cut.counters.nodes_requested += 1;
                cut.counters.points_requested += u64::from(count);
                cut.requests.push(Request { node, count, priority_px: candidate.priority_px });
            }
            Availability::Failed => cut.counters.nodes_failed += 1,
        }
    }

    fn roots(&mut self, mut push: impl FnMut(Candidate)) {
        for (i, (octree, _)) in self.scene.iter().enumerate() {
            if octree.nodes().is_empty() {
                continue;
            }
            let cell = self.spaces[i].descent.root();
            if let Some(root) = self.consider(i as u32, NodeId::ROOT, cell, false, false) {
                push(root);
            }
        }
    }

    fn children(&mut self, parent: &Candidate, drawn: bool, mut push: impl FnMut(Candidate)) {
        let octree = self.scene[parent.octree as usize].0;
        let node = octree.node(parent.node);
        let ancestor = drawn || parent.has_drawn_ancestor;
        let mut wanted = 0;
        let octants = (0..8usize).filter(|o| node.child_mask >> o & 1 == 1);
        for (octant, child) in octants.zip(node.children()) {
            let descent = &self.spaces[parent.octree as usize].descent;
            let cell = descent.child(&parent.cell, node.depth + 1, octant);
            let candidate =
                self.consider(parent.octree, child, cell, parent.wholly_inside, ancestor);
            if let Some(candidate) = candidate {
                wanted |= 1 << octant;
                push(candidate);
            }
        }
        if drawn {
            let masks = &mut self.wanted[parent.octree as usize];
            *masks.last_mut().expect("the parent was drawn last") = wanted;
        }
    }

    /// A node as a candidate, unless it is out of sight or what is drawn there is fine enough.
    fn consider(
        &mut self,
        octree_index: u32,
        id: NodeId,
        cell: ClipCell,
        mut wholly_inside: bool,
        has_drawn_ancestor: bool,
    ) -> Option<Candidate> {
        let octree = self.scene[octree_index as usize].0;
        let space = &self.spaces[octree_index as usize];
        let node = octree.node(id);
        self.cuts[octree_index as usize].counters.nodes_visited += 1;
        if self.settings.cull_frustum && !wholly_inside {
            match space.descent.test(&cell, node.depth) {
                Containment::Outside => {
                    self.cuts[octree_index as usize].counters.nodes_culled += 1;
                    return None;
                }
                Containment::Inside => wholly_inside = true,
                Containment::Partial => {}
            }
        }
        let bounds = space.cell_box(node);
        let distance = bounds.distance(DVec3::ZERO);
        let shrink = (-f64::from(node.depth)).exp2();
        let coarsest_px = self.cell_px(&bounds, distance, space.root_span * shrink);
        let finest_px = coarsest_px * (-f64::from(octree.depth())).exp2();
        let judged_px = match self.settings.rule.cell {
            RuleCell::Own => finest_px,
            RuleCell::Parent => 2.0 * finest_px,
        };
        let error_px = self.settings.error_px;
        let past = Past::of(judged_px, error_px, self.settings.continuous);
        if has_drawn_ancestor && past == Past::NotYet {
            self.cuts[octree_index as usize].counters.nodes_fine_enough += 1;
            return None;
        }
        let (count, share) = match past {
            Past::Wholly | Past::NotYet if !self.settings.continuous => {
                (node.levels.prefix_len(required_level(coarsest_px, error_px, octree.depth())), 1.0)
            }
            _ if !has_drawn_ancestor => {
                level::continuous_prefix(&node.levels, coarsest_px, error_px)
            }
            Past::Partly { share } => (node.point_count(), share),
            _ => (node.point_count(), 1.0),
        };
        let edge = space.root_size.max_element() * shrink;
        let priority_px = match distance > 0.0 {
            true => projected_px(edge, distance.max(self.view.camera.near), self.focal_px),
            false => f64::INFINITY,
        };
        Some(Candidate {
            priority_px: if priority_px.is_nan() { 0.0 } else { priority_px },
            depth: node.depth,
            octree: octree_index,
            node: id,
            count,
            share,
            has_drawn_ancestor,
            wholly_inside,
            cell,
        })
    }

    /// Size on screen of a length within a node's box, as the rule judges it, pixels.
    fn cell_px(&self, bounds: &Aabb, distance: f64, span: f64) -> f64 {
        let cosine = match self.settings.rule.off_axis {
            true => off_axis_cosine(self.view, bounds.center(), 0.5 * bounds.diagonal()),
            false => 1.0,
        };
        projected_px(span, distance * cosine * cosine, self.focal_px)
    }
}
