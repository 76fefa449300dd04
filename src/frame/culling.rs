//! Occlusion culling of a scene: the tree over models and points, what was seen of it, and which
//! nodes of points are therefore left out.
//!
//! Nodes of which nothing was drawn in the last frame, nor of what is below them, are concealed:
//! they cost nothing of the budget and are neither read nor sent. They stay in the tree, are asked
//! about in each frame, and are drawn in the same frame if they show, as far as they are loaded and
//! the budget has room; if not, the next frame counts on them. Nodes that the last frame did not
//! look at share the lot of the nearest node above that it did.
//!
//! Points take part on the compute paths, in pictures of one part. Not where gaps between points
//! are filled and there are models: what a model hides may fill a gap beside it.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Instant;

use crate::frame::culling_costs::CostMeter;
use crate::frame::culling_view::NoDevice;
use crate::frame::device::{Device, GpuPass};
use crate::frame::renderer::milliseconds;
use crate::frame::{FrameSettings, NodeSource, Renderer};
use crate::geometry::View;
use crate::hierarchy::{
    BoundingHierarchy, Bvh, ChosenNodes, Forest, ForestTree, Joined, Side, SubtreeBoxes,
};
use crate::ids::{NodeId, ObjectId};
use crate::octree::Octree;
use crate::passes::{CulledDraws, DrawTable, DrawnNode, SceneTree};
use crate::select::{Cut, SplatSettings, SplatSize};
use crate::stream::SceneNode;
use crate::visibility::{Algorithm, Culler};

/// Frames without change after which a view that stands still counts as settled: in as many every
/// leaf that shows was asked about.
const SETTLED_FRAMES: u32 = 14;
/// Frames after which a view that stands still settles in any case: what is drawn of two nodes may
/// depend on each other in turns, when the budget has room for one.
const MOST_STILL_FRAMES: u32 = 64;

/// What is known of a scene for culling.
pub(super) struct SceneCulling {
    pub(super) culler: Culler,
    pub(super) meter: CostMeter,
    /// The tree over the objects of models; empty without any.
    pub(super) objects: Bvh,
    clouds: Vec<CloudCulling>,
    /// Whether points are in the tree of this frame, and of the last one that was drawn.
    pub(super) has_points: bool,
    had_points: bool,
    /// Whether this frame counts on what the last one saw.
    is_coherent: bool,
    /// Number of the last frame that was drawn.
    frame: u32,
    /// Changes with the set of concealed nodes.
    version: u64,
    revealed: usize,
    quiet_frames: u32,
    /// The view of the last frame, and how many frames it was drawn in a row.
    drawn_view: Option<View>,
    still_frames: u32,
    /// Nodes that came into sight in the last frame and are not loaded, or have no budget.
    nodes_missing: u32,
    is_over_budget: bool,
    /// Whether the budget left nodes out of the last frame's cuts.
    pub(super) budget_binds: bool,
}

/// One cloud of the scene.
struct CloudCulling {
    boxes: SubtreeBoxes,
    chosen: ChosenNodes,
    /// Frame in which something of a node's subtree was last drawn.
    drawn_in: Vec<u32>,
}

/// What the last frame tells of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Seen {
    Nothing,
    Hidden,
    Shown,
}

impl SceneCulling {
    pub(super) fn new(algorithm: Algorithm, objects: Bvh) -> Self {
        SceneCulling {
            culler: Culler::new(algorithm),
            meter: CostMeter::default(),
            objects,
            clouds: Vec::new(),
            has_points: false,
            had_points: false,
            is_coherent: false,
            frame: 0,
            version: 0,
            revealed: 0,
            quiet_frames: 0,
            drawn_view: None,
            still_frames: 0,
            nodes_missing: 0,
            is_over_budget: false,
            budget_binds: false,
        }
    }

    /// Settles whether points take part in the coming frame, and what it may count on.
    fn begin(&mut self, sources: &[Arc<dyn NodeSource>], view: &View, has_points: bool) {
        if has_points != self.has_points {
            // Ids of the tree are others.
            self.culler.forget();
            self.had_points = false;
        }
        self.has_points = has_points;
        if self.drawn_view.replace(*view) != Some(*view) {
            self.still_frames = 0;
        }
        if !has_points {
            return;
        }
        if self.clouds.is_empty() {
            self.clouds.extend(sources.iter().map(|source| CloudCulling {
                boxes: SubtreeBoxes::new(source.octree()),
                chosen: ChosenNodes::default(),
                drawn_in: vec![0; source.octree().nodes().len()],
            }));
        }
        let tree = tree(&self.objects, &self.clouds, sources);
        let is_coherent = self.had_points && self.culler.will_cohere(&tree, &view.camera);
        self.is_coherent = is_coherent;
    }

    fn seen(&self, octree: &Octree, (cloud, node): SceneNode) -> Seen {
        let cloud = &self.clouds[cloud];
        let mut at = Some(node);
        while let Some(node) = at {
            if cloud.drawn_in[node.index()] == self.frame {
                return Seen::Shown;
            }
            if cloud.chosen.holds(node) {
                return Seen::Hidden;
            }
            at = octree.node(node).parent;
        }
        Seen::Nothing
    }

    /// Whether a node, with all below it, is left out as hidden.
    fn conceals(&self, octree: &Octree, node: SceneNode) -> bool {
        self.is_coherent && self.seen(octree, node) == Seen::Hidden
    }

    /// The tree of this frame, over what its cuts chose.
    pub(super) fn tree<'a>(&'a self, sources: &'a [Arc<dyn NodeSource>]) -> SceneTree<'a> {
        let clouds = if self.has_points { &self.clouds[..] } else { &[] };
        tree(&self.objects, clouds, sources)
    }

    /// Takes in the cuts of the frame, what they ask for included; splats stick out by up to half
    /// their size and what finishing the picture reaches.
    fn choose(
        &mut self,
        sources: &[Arc<dyn NodeSource>],
        cuts: &[Cut],
        table: &DrawTable,
        (view, settings): (&View, &FrameSettings),
        reach_px: u32,
    ) {
        let overhang = |largest_px: f64| (0.5 * largest_px.ceil() + 1.0) as f32 + reach_px as f32;
        let mut draws = table.draws.as_slice();
        for ((cloud, source), cut) in self.clouds.iter_mut().zip(sources).zip(cuts) {
            let octree = source.octree();
            let (of_cloud, rest) = draws.split_at(cut.draw.len());
            draws = rest;
            let drawn = of_cloud
                .iter()
                .map(|draw| (draw.node, draw.count.max(1), overhang(f64::from(draw.largest_px))));
            let requested = cut.requests.iter().map(|request| {
                let px = expected_px(octree, request.node, view, &settings.cut.splat);
                (request.node, request.count.max(1), overhang(px))
            });
            cloud.chosen.choose(octree, drawn.chain(requested));
        }
    }

    /// The objects that the last frame drew.
    pub(super) fn drawn_objects(&self, sources: &[Arc<dyn NodeSource>]) -> Vec<ObjectId> {
        let tree = self.tree(sources);
        let nodes = self.culler.drawn().iter().filter_map(|&node| match tree.side(node) {
            Side::Root => self.objects.root(),
            Side::First(node) => Some(node),
            Side::Second(_) => None,
        });
        nodes.flat_map(|node| self.objects.objects_of(node)).copied().collect()
    }

    /// Whether points of this frame are to be drawn as culling finds them: it asks, or its time is
    /// wanted to weigh asking by.
    pub(super) fn draws_points(&self, sources: &[Arc<dyn NodeSource>], view: &View) -> bool {
        let asks = || self.culler.will_ask(&self.tree(sources), &view.camera);
        let is_timed = matches!(self.culler.algorithm(), Algorithm::Auto(..))
            && self.culler.switch().is_probing();
        self.has_points && (is_timed || asks())
    }

    /// A frame that is drawn without culling: only counted.
    pub(super) fn pass(&mut self, sources: &[Arc<dyn NodeSource>], view: &View) {
        self.draw(sources, |tree, culler, _| culler.frame(tree, view, &mut NoDevice));
    }

    /// Lends the tree of this frame and the memory of what was seen.
    pub(super) fn draw<R>(
        &mut self,
        sources: &[Arc<dyn NodeSource>],
        draw: impl FnOnce(&SceneTree, &mut Culler, &mut CostMeter) -> R,
    ) -> R {
        let SceneCulling { culler, objects, clouds, meter, .. } = self;
        draw(&tree(objects, clouds, sources), culler, meter)
    }

    /// Takes in what a frame drew.
    pub(super) fn note(&mut self, sources: &[Arc<dyn NodeSource>], draws: Option<&CulledDraws>) {
        let none = CulledDraws::default();
        self.nodes_missing = draws.unwrap_or(&none).nodes_missing;
        self.is_over_budget = draws.unwrap_or(&none).nodes_over_budget > 0;
        if draws.is_none() {
            self.had_points = false;
            return;
        }
        self.had_points = self.culler.has_queried();
        self.still_frames += 1;
        let last = self.frame;
        self.frame += 1;
        let tree = self.tree(sources);
        let mut shown: Vec<SceneNode> = Vec::new();
        for &leaf in self.culler.drawn() {
            let points = match tree.side(leaf) {
                Side::Root => tree.second.root(),
                Side::First(_) => None,
                Side::Second(leaf) => Some(leaf),
            };
            if let Some(points) = points {
                tree.second.for_each_below(points, &mut |cloud, node| shown.push((cloud, node)));
            }
        }
        let (mut newly, mut revealed) = (0usize, 0usize);
        for (cloud, node) in shown {
            let octree = sources[cloud].octree();
            let drawn_in = &mut self.clouds[cloud].drawn_in;
            let mut at = Some(node);
            while let Some(node) = at {
                let before = std::mem::replace(&mut drawn_in[node.index()], self.frame);
                if before == self.frame {
                    break;
                }
                revealed += 1;
                newly += usize::from(before != last);
                at = octree.node(node).parent;
            }
        }
        if newly > 0 || revealed != self.revealed {
            self.version += 1;
            self.quiet_frames = 0;
        } else {
            self.quiet_frames += 1;
        }
        self.revealed = revealed;
    }

    /// Whether another frame of the same view could show more: nodes that came into sight could
    /// not be drawn at once, or budget may yet be freed by what turns out hidden.
    fn is_unsettled(&self) -> bool {
        let frees = self.budget_binds && self.quiet_frames < SETTLED_FRAMES;
        let may_go_on = self.has_points && self.had_points && self.still_frames < MOST_STILL_FRAMES;
        may_go_on && (self.nodes_missing > 0 || self.is_over_budget || frees)
    }
}

fn tree<'a>(
    objects: &'a Bvh,
    clouds: &'a [CloudCulling],
    sources: &'a [Arc<dyn NodeSource>],
) -> SceneTree<'a> {
    let tree = |(cloud, source): (&'a CloudCulling, &'a Arc<dyn NodeSource>)| ForestTree {
        octree: source.octree(),
        boxes: &cloud.boxes,
        chosen: &cloud.chosen,
    };
    Joined { first: objects, second: Forest::new(clouds.iter().zip(sources).map(tree).collect()) }
}

impl Renderer {
    /// Settles how the coming frame is culled, before anything is chosen for it.
    pub(super) fn begin_culling(&mut self, view: &View, settings: &FrameSettings) {
        if self.frozen.is_some() {
            return;
        }
        let algorithm = settings.culling;
        let is_asked =
            !matches!(algorithm, Algorithm::None | Algorithm::Frustum | Algorithm::TwoPass);
        let Device::Gpu(on_gpu) = &self.device else { return };
        let has_points = is_asked
            && !self.sources.is_empty()
            && matches!(on_gpu.pass, GpuPass::Compute(_))
            && on_gpu.gpu.draws_meshes()
            && settings.appear.is_zero()
            && (self.models.is_none() || settings.finish.gap_radius_px == 0)
            && self.tiles(view, settings.finish.reach_px()).len() == 1;
        if !is_asked || (self.models.is_none() && !has_points) {
            self.culling = None;
            return;
        }
        let culling = match &mut self.culling {
            Some(culling) => {
                let algorithm = culling.meter.priced(&algorithm);
                culling.culler.set_algorithm(algorithm);
                culling
            }
            None => {
                let objects = self.models.as_ref().map(|models| models.tree()).unwrap_or_default();
                self.culling.insert(Box::new(SceneCulling::new(algorithm, objects)))
            }
        };
        culling.culler.set_more_follow(settings.more_follow);
        culling.begin(&self.sources, view, has_points);
    }

    /// Whether a node is left out, with all below it, because it was hidden in the last frame.
    pub(super) fn is_concealed(&self, node: SceneNode) -> bool {
        self.culling.as_ref().is_some_and(|culling| {
            culling.has_points && culling.conceals(self.sources[node.0].octree(), node)
        })
    }

    /// Number that changes when other nodes are concealed.
    pub(super) fn concealment(&self) -> u64 {
        let culling = self.culling.as_ref().filter(|culling| culling.has_points);
        culling.map_or(0, |culling| match culling.is_coherent {
            true => culling.version + 1,
            false => 0,
        })
    }

    /// Puts what was chosen into the tree.
    pub(super) fn choose_nodes(&mut self, cuts: &[Cut], view: &View, settings: &FrameSettings) {
        let start = Instant::now();
        let Some(culling) = &mut self.culling else { return };
        if !culling.has_points || self.frozen.is_some() {
            return;
        }
        let reach_px = if self.models.is_some() { settings.finish.reach_px() } else { 0 };
        culling.choose(&self.sources, cuts, &self.table, (view, settings), reach_px);
        self.note_time("select", milliseconds(start));
    }

    /// Nodes that came into sight and must be read to be drawn.
    pub(super) fn nodes_missing(&self) -> u32 {
        match &self.frozen {
            Some(_) => 0,
            None => self.culling.as_ref().map_or(0, |culling| culling.nodes_missing),
        }
    }

    /// Whether the same view could show more in another frame, for what culling finds.
    pub(super) fn is_culling_unsettled(&self) -> bool {
        // What is frozen stays as it is.
        self.frozen.is_none() && self.culling.as_ref().is_some_and(|c| c.is_unsettled())
    }
}

/// The draws of a table by node, and whether each can be drawn now.
pub(super) fn draws_by_node(
    table: &DrawTable,
    is_ready: impl Fn(SceneNode) -> bool,
) -> (HashMap<SceneNode, u32>, Vec<bool>) {
    let node = |draw: &DrawnNode| (draw.cloud, draw.node);
    let draws = table.draws.iter().zip(0u32..).map(|(draw, at)| (node(draw), at)).collect();
    (draws, table.draws.iter().map(|draw| is_ready(node(draw))).collect())
}

/// The largest splat of a node that is not there yet, pixels: its finest cell as it appears from
/// near by.
fn expected_px(octree: &Octree, node: NodeId, view: &View, splat: &SplatSettings) -> f64 {
    let edge = octree.cell_size(octree.node(node).depth + octree.depth()).max_element();
    let distance = octree.tight_box(node).distance(view.camera.eye).max(view.camera.near);
    match splat.size {
        SplatSize::Fixed { px } => px * splat.multiplier,
        _ => (splat.multiplier * edge * view.focal_px() / distance).min(splat.max_px),
    }
}
