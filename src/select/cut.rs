//! The traversal: from a view and a point budget to the nodes drawn and the nodes wanted.
//!
//! Nodes are taken in the order of their size on screen. A node is dropped with its subtree if the
//! frustum misses it or if what is drawn there already is fine enough; the walk ends at the first
//! node whose points no longer fit the budget, so that a larger budget only ever adds points. A
//! cloud that fits the budget as a whole needs no order: its nodes are walked coarse to fine and
//! no queue is built.
//!
//! Departures from the paper, with their reasons:
//! - culling comes before the budget, or one large node out of sight would end the frame;
//! - a node without a drawn ancestor (the root) is never dropped for being fine enough, or a model
//!   far away would vanish; it draws the levels that its size asks for, at least one point;
//! - nodes that are not resident use up the budget as if they were drawn, or the walk would run
//!   past them and ask for far more than fits.
//!
//! Not here: loading what is asked for, and choosing the budget.
//! Source: the Instant Points chapter, 6.5.3, corrected as above.

use std::collections::BinaryHeap;

use serde::Serialize;

use crate::geometry::{Frustum, View};
use crate::ids::NodeId;
use crate::octree::Octree;
use crate::select::level::LevelRule;
use crate::select::splat::{self, DrawnRow, SplatSettings};
use crate::select::walk::{Candidate, Space, Walk};

/// Whether a node's points can be drawn now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Availability {
    /// They can.
    Resident,
    /// Not yet: it is asked for, and its subtree waits.
    Absent,
    /// They never will (unreadable): it is neither drawn nor asked for, its children are.
    Failed,
    /// It and its subtree stand behind other things: it costs nothing of the budget and is not asked
    /// for. Otherwise it is looked at as if it were drawn, so that what is drawn around it looks as
    /// if it were.
    Concealed,
}

/// What the traversal is told about loading.
pub trait Residency {
    /// Whether a node's points can be drawn now.
    fn availability(&self, node: NodeId) -> Availability;
}

impl<F: Fn(NodeId) -> Availability> Residency for F {
    fn availability(&self, node: NodeId) -> Availability {
        self(node)
    }
}

/// Everything is loaded.
#[derive(Clone, Copy, Debug)]
pub struct AllResident;

impl Residency for AllResident {
    fn availability(&self, _: NodeId) -> Availability {
        Availability::Resident
    }
}

/// What a cut may cost and how exact it shall be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutSettings {
    /// Most points drawn and asked for together. Default 5 million. At least one point of the
    /// root is drawn whatever it says.
    pub point_budget: u64,
    /// Largest spacing on screen that counts as fine enough, pixels. Default 1; half of it costs
    /// about four times the points.
    pub error_px: f64,
    /// How spacing is judged.
    pub rule: LevelRule,
    /// Whether the node that no longer fits the budget still draws the levels that do. Default
    /// off.
    pub fill: bool,
    /// Whether nodes out of sight are dropped. Default on; off only to measure what it saves.
    pub cull_frustum: bool,
    /// Whether a node comes with a rising share of its points as its spacing on screen passes the
    /// error, over a factor of two, instead of at once. Default off. About as many points; no
    /// steps in density and no popping while the camera moves, but no spacing that is sure.
    pub continuous: bool,
    /// How large the points are drawn.
    pub splat: SplatSettings,
}

impl Default for CutSettings {
    fn default() -> Self {
        CutSettings {
            point_budget: 5_000_000,
            error_px: 1.0,
            rule: LevelRule::default(),
            fill: false,
            cull_frustum: true,
            continuous: false,
            splat: SplatSettings::default(),
        }
    }
}

/// One node to draw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DrawNode {
    /// Which.
    pub node: NodeId,
    /// How many of its leading points, at least 1.
    pub count: u32,
    /// Global level whose cell edge sets the size of its splats. With
    /// [`SplatPolicy::PerPoint`](crate::select::SplatPolicy::PerPoint) it is the node's own, and
    /// drawn descendants refine it point by point.
    pub splat_level: u32,
    /// Share of these points that is drawn, 0..=1; below 1 only where levels pass continuously.
    pub share: f32,
    /// Size of its cell on screen, pixels; infinite with the eye inside.
    pub priority_px: f64,
    /// Whether it is here only for the sake of others: see [`Availability::Concealed`].
    pub concealed: bool,
}

/// One node to load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Request {
    /// Which.
    pub node: NodeId,
    /// How many of its leading points would be drawn now.
    pub count: u32,
    /// Size of its cell on screen, pixels; infinite with the eye inside.
    pub priority_px: f64,
}

/// What a traversal did; all of it repeats on any machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct CutCounters {
    /// Nodes looked at.
    pub nodes_visited: u32,
    /// Of these, dropped for being out of sight.
    pub nodes_culled: u32,
    /// Of these, dropped because what is drawn there is fine enough.
    pub nodes_fine_enough: u32,
    /// Nodes drawn.
    pub nodes_drawn: u32,
    /// Points drawn.
    pub points_drawn: u64,
    /// Nodes asked for.
    pub nodes_requested: u32,
    /// Points asked for.
    pub points_requested: u64,
    /// Nodes that cannot be read.
    pub nodes_failed: u32,
    /// Nodes that stand behind other things.
    pub nodes_concealed: u32,
    /// Points that these would have added.
    pub points_concealed: u64,
    /// Nodes wanted that the budget left out (those known when the walk ended).
    pub nodes_over_budget: u32,
    /// Nodes taken from the priority queue; 0 if no queue was needed.
    pub queue_pops: u32,
}

/// The result for one octree.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cut {
    /// What to draw, by falling priority, or coarse to fine if the whole cloud fits the budget;
    /// concealed nodes in their places among them.
    pub draw: Vec<DrawNode>,
    /// What to load, by falling priority.
    pub requests: Vec<Request>,
    /// The drawn nodes sorted by id, linked so that the deepest one around a point can be found.
    pub table: Vec<DrawnRow>,
    /// What it took.
    pub counters: CutCounters,
}

impl Cut {
    /// The nodes to draw that are not concealed.
    pub fn shown(&self) -> impl Iterator<Item = &DrawNode> {
        self.draw.iter().filter(|drawn| !drawn.concealed)
    }

    fn clear(&mut self) {
        self.draw.clear();
        self.requests.clear();
        self.table.clear();
        self.counters = CutCounters::default();
    }
}

/// Memory that traversals reuse, so that a warmed-up one allocates nothing.
#[derive(Debug, Default)]
pub struct CutScratch {
    queue: BinaryHeap<Candidate>,
    list: Vec<Candidate>,
    spaces: Vec<Space>,
    /// Per octree and drawn node: the octants whose child the view wants.
    wanted: Vec<Vec<u8>>,
    splat: splat::Scratch,
    spare: Vec<Cut>,
}

impl CutScratch {
    /// Takes back a cut that is no longer needed, for its memory.
    pub fn recycle(&mut self, cut: Cut) {
        self.spare.push(cut);
    }

    fn fresh_cut(&mut self) -> Cut {
        let mut cut = self.spare.pop().unwrap_or_default();
        cut.clear();
        cut
    }
}

/// Chooses what to draw of one octree.
pub fn select_nodes(
    octree: &Octree,
    view: &View,
    settings: &CutSettings,
    residency: &dyn Residency,
    scratch: &mut CutScratch,
) -> Cut {
    let mut cut = scratch.fresh_cut();
    let scene = [(octree, residency)];
    traverse(&scene, view, settings, scratch, std::slice::from_mut(&mut cut));
    cut
}

/// Chooses what to draw of several octrees that share one budget; one cut each, in their order.
pub fn select_scene(
    scene: &[(&Octree, &dyn Residency)],
    view: &View,
    settings: &CutSettings,
    scratch: &mut CutScratch,
) -> Vec<Cut> {
    let mut cuts: Vec<Cut> = scene.iter().map(|_| scratch.fresh_cut()).collect();
    traverse(scene, view, settings, scratch, &mut cuts);
    cuts
}

fn traverse(
    scene: &[(&Octree, &dyn Residency)],
    view: &View,
    settings: &CutSettings,
    scratch: &mut CutScratch,
    cuts: &mut [Cut],
) {
    let frustum = Frustum::new(view);
    scratch.spaces.clear();
    let space = |(octree, _): &(&Octree, _)| Space::new(octree, view, &frustum, &settings.rule);
    scratch.spaces.extend(scene.iter().map(space));
    scratch.wanted.resize_with(scene.len().max(scratch.wanted.len()), Vec::new);
    scratch.wanted.iter_mut().for_each(Vec::clear);

    let mut walk = Walk {
        scene,
        view,
        focal_px: view.focal_px(),
        settings,
        spaces: &scratch.spaces,
        wanted: &mut scratch.wanted,
        remaining: settings.point_budget,
        cuts,
    };
    let point_count: u64 = scene.iter().map(|(octree, _)| octree.point_count()).sum();
    if point_count <= settings.point_budget {
        walk.everything(&mut scratch.list);
        walk.cuts.iter_mut().for_each(sort_requests);
    } else {
        walk.by_priority(&mut scratch.queue);
    }
    for (((octree, _), cut), wanted) in scene.iter().zip(cuts).zip(&scratch.wanted) {
        splat::link(octree, cut, wanted, settings.splat.policy, &mut scratch.splat);
    }
}

fn sort_requests(cut: &mut Cut) {
    cut.requests
        .sort_unstable_by(|a, b| b.priority_px.total_cmp(&a.priority_px).then(a.node.cmp(&b.node)));
}
