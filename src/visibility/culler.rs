//! One view's culling, frame by frame, by any of the algorithms.

use crate::geometry::{Camera, View};
use crate::hierarchy::BoundingHierarchy;
use crate::ids::TreeNodeId;
use crate::visibility::automatic::InFrustum;
use crate::visibility::chc::Chc;
use crate::visibility::chc_plus::ChcPlus;
use crate::visibility::frontier::Frontier;
use crate::visibility::near_optimal::Judge;
use crate::visibility::walk::{Parts, Walk};
use crate::visibility::{
    AutoSwitch, ChcOptions, ChcPlusOptions, CoherenceTable, CullCounters, CullingCosts,
    OcclusionDevice, ViewHistory, reference,
};

/// How it is decided what is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Algorithm {
    /// Everything.
    None,
    /// What lies in the view frustum.
    Frustum,
    /// Each leaf in the frustum is asked about and waited for.
    Naive,
    /// Each node on the way down is asked about and waited for.
    StopAndWait,
    /// Coherent hierarchical culling.
    Chc(ChcOptions),
    /// CHC++.
    ChcPlus(ChcPlusOptions),
    /// CHC with questions only where they are expected to pay.
    NearOptimal(ChcOptions, CullingCosts),
    /// What was visible in the last frame first, then what a test on the device finds, which takes
    /// place in [`passes`](crate::passes): nothing is read back. A culler takes it for the frustum.
    TwoPass,
    /// CHC++ while it pays, the frustum alone otherwise.
    Auto(ChcPlusOptions, CullingCosts),
}

impl Algorithm {
    /// The name on the command line.
    pub fn name(&self) -> &'static str {
        match self {
            Algorithm::None => "none",
            Algorithm::Frustum => "frustum",
            Algorithm::Naive => "naive",
            Algorithm::StopAndWait => "stop-and-wait",
            Algorithm::Chc(_) => "chc",
            Algorithm::ChcPlus(_) => "chc++",
            Algorithm::NearOptimal(..) => "near-optimal",
            Algorithm::TwoPass => "two-pass",
            Algorithm::Auto(..) => "auto",
        }
    }

    /// Those that a user chooses among, with the options that are usual.
    pub fn usual() -> [Algorithm; 8] {
        let plus = ChcPlusOptions::default();
        [
            Algorithm::Auto(plus, CullingCosts::default()),
            Algorithm::None,
            Algorithm::Frustum,
            Algorithm::Naive,
            Algorithm::StopAndWait,
            Algorithm::Chc(ChcOptions::default()),
            Algorithm::ChcPlus(plus),
            Algorithm::TwoPass,
        ]
    }

    /// Whether a frame without a last one draws all that lies in the frustum.
    fn seeds(&self) -> bool {
        match self {
            Algorithm::Chc(options) | Algorithm::NearOptimal(options, _) => {
                options.seed_first_frame
            }
            Algorithm::ChcPlus(options) | Algorithm::Auto(options, _) => options.seed_first_frame,
            _ => false,
        }
    }

    fn leaf_cost(&self) -> u64 {
        match self {
            Algorithm::Chc(options) | Algorithm::NearOptimal(options, _) => options.leaf_cost,
            Algorithm::ChcPlus(options) | Algorithm::Auto(options, _) => options.leaf_cost,
            _ => 0,
        }
    }
}

/// A view moves incoherently when its eye jumps this share of the scene's diagonal, or it turns by
/// more than 45 degrees.
const JUMP: f64 = 0.05;
const TURN_COSINE: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// The state of one view: a camera, or a light.
#[derive(Clone, Debug)]
pub struct Culler {
    algorithm: Algorithm,
    history: ViewHistory,
    frontier: Frontier,
    chc: Chc,
    plus: ChcPlus,
    switch: AutoSwitch,
    last_camera: Option<Camera>,
    queried_last: bool,
    more_follow: bool,
    /// That of the last frame's tree.
    generation: u64,
    drawn: Vec<TreeNodeId>,
    counters: CullCounters,
}

impl Culler {
    /// A view that was never seen.
    pub fn new(algorithm: Algorithm) -> Self {
        Culler {
            algorithm,
            history: ViewHistory::default(),
            frontier: Frontier::default(),
            chc: Chc::default(),
            plus: ChcPlus::default(),
            switch: AutoSwitch::default(),
            last_camera: None,
            queried_last: false,
            more_follow: true,
            generation: 0,
            drawn: Vec::new(),
            counters: CullCounters::default(),
        }
    }

    /// The algorithm at work.
    pub fn algorithm(&self) -> &Algorithm {
        &self.algorithm
    }

    /// Changes the algorithm or its options; what was learned is forgotten if the algorithm is
    /// another one.
    pub fn set_algorithm(&mut self, algorithm: Algorithm) {
        if std::mem::discriminant(&algorithm) != std::mem::discriminant(&self.algorithm) {
            self.forget();
        }
        self.algorithm = algorithm;
    }

    /// Says whether frames follow that look much like the next one. If none do, a frame without a
    /// last one draws what lies in the frustum and asks nothing: the answers would serve nobody.
    /// Algorithms that know no last frame ask all the same.
    pub fn set_more_follow(&mut self, more_follow: bool) {
        self.more_follow = more_follow;
    }

    /// Forgets what was seen: the scene was rebuilt.
    pub fn forget(&mut self) {
        self.history.forget();
        self.chc.forget();
        self.plus.forget();
        self.switch = AutoSwitch::default();
        self.last_camera = None;
        self.queried_last = false;
    }

    /// Lets tight bounds be chosen anew: boxes moved far.
    pub fn forget_tight_bounds(&mut self) {
        self.plus.forget_tight_bounds();
    }

    /// Leaves drawn in the last frame, in order. Subtrees that counted as leaves stand as one.
    pub fn drawn(&self) -> &[TreeNodeId] {
        &self.drawn
    }

    /// Counts of the last frame.
    pub fn counters(&self) -> &CullCounters {
        &self.counters
    }

    /// What each node remembers.
    pub fn history(&self) -> &ViewHistory {
        &self.history
    }

    /// Whether the last frame put questions whose answers the next one may use.
    pub(super) fn queried_last(&self) -> bool {
        self.queried_last
    }

    /// How likely hidden nodes are to stay hidden, as CHC++ learned it.
    pub fn hidden_coherence(&self) -> &CoherenceTable {
        self.plus.hidden_table()
    }

    /// The switch of [`Algorithm::Auto`].
    pub fn switch(&self) -> &AutoSwitch {
        &self.switch
    }

    /// Draws one frame through a device, between its `begin_frame` and `end_frame`.
    pub fn frame<H: BoundingHierarchy>(
        &mut self,
        tree: &H,
        view: &View,
        device: &mut dyn OcclusionDevice,
    ) -> CullCounters {
        if std::mem::replace(&mut self.generation, tree.generation()) != tree.generation() {
            // Ids mean other nodes now, in answers that are still to come as well.
            self.forget();
        }
        let near_last = self.is_coherent(tree, &view.camera);
        let coherent = self.queried_last && near_last;
        self.last_camera = Some(view.camera);
        self.counters = CullCounters::default();
        self.drawn.clear();
        device.begin_frame(view);
        self.history.begin_frame(tree);
        let parts = Parts {
            history: &mut self.history,
            device,
            counters: &mut self.counters,
            drawn: &mut self.drawn,
            frontier: &mut self.frontier,
        };
        let mut walk = Walk::new(tree, view, self.algorithm.leaf_cost(), parts);
        let mut queries = false;
        let in_vain = !self.more_follow && !coherent && self.algorithm.seeds();
        match self.algorithm {
            _ if in_vain => reference::frustum(&mut walk),
            Algorithm::None => reference::everything(&mut walk),
            Algorithm::Frustum | Algorithm::TwoPass => reference::frustum(&mut walk),
            Algorithm::Naive => {
                reference::naive(&mut walk, 0);
                queries = true;
            }
            Algorithm::StopAndWait => {
                reference::stop_and_wait(&mut walk, 0);
                queries = true;
            }
            Algorithm::Chc(options) => {
                self.chc.judge = None;
                self.chc.frame(&mut walk, &options, !coherent);
                queries = true;
            }
            Algorithm::NearOptimal(options, costs) => {
                self.chc.judge.get_or_insert_with(|| Judge::new(costs)).set_costs(costs);
                self.chc.frame(&mut walk, &options, !coherent);
                queries = true;
            }
            Algorithm::ChcPlus(options) => {
                self.plus.frame(&mut walk, &options, !coherent);
                queries = true;
            }
            Algorithm::Auto(options, _) => {
                queries = self.switch.begin_frame(near_last);
                if queries {
                    self.plus.frame(&mut walk, &options, !coherent);
                } else {
                    if self.queried_last {
                        // Answers that nobody will read, and nodes as they then were.
                        self.plus.forget();
                    }
                    reference::frustum(&mut walk);
                }
            }
        }
        device.end_frame();
        self.queried_last = queries;
        self.counters.state_switches = device.state_switches();
        self.counters.rounds = device.rounds();
        if in_vain {
            // Answers that nobody will read.
            self.chc.forget();
            self.plus.forget();
        } else if let Algorithm::Auto(options, costs) = self.algorithm {
            let in_frustum = || InFrustum::count(tree, view, options.leaf_cost);
            self.switch.observe(&self.counters, &costs, in_frustum);
        }
        self.counters
    }

    /// Whether the last frame put questions.
    pub fn has_queried(&self) -> bool {
        self.queried_last
    }

    /// Whether a frame from here puts questions.
    pub fn will_ask<H: BoundingHierarchy>(&self, tree: &H, camera: &Camera) -> bool {
        let near_last = self.is_coherent(tree, camera);
        let counts_on_last = self.queried_last && near_last;
        let in_vain = !self.more_follow && !counts_on_last && self.algorithm.seeds();
        match self.algorithm {
            Algorithm::None | Algorithm::Frustum | Algorithm::TwoPass => false,
            _ if in_vain => false,
            Algorithm::Auto(..) => self.switch.would_ask(near_last),
            _ => true,
        }
    }

    /// Whether a frame from here counts on what the last one saw: that put questions, and the
    /// camera did not jump.
    pub fn will_cohere<H: BoundingHierarchy>(&self, tree: &H, camera: &Camera) -> bool {
        self.queried_last && self.is_coherent(tree, camera)
    }

    fn is_coherent<H: BoundingHierarchy>(&self, tree: &H, camera: &Camera) -> bool {
        let (Some(last), Some(root)) = (self.last_camera, tree.root()) else { return false };
        let far = JUMP * tree.bounds(root).diagonal();
        last.eye.distance(camera.eye) <= far && last.forward.dot(camera.forward) >= TURN_COSINE
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hierarchy::Bvh;
    use crate::mesh::scenes::{CameraPath, SceneKind, camera_path};
    use crate::visibility::{ItemBuffer, Latency, ModelLeaves, SoftwareDevice};

    /// Frame numbers start again after four billion frames, and nothing is lost or drawn for good.
    #[test]
    fn frame_numbers_wrap_around() {
        let scene = SceneKind::Window.make(40, 1);
        let model = &scene.model;
        let costs = vec![12; model.objects.len()];
        let tree = Bvh::build(&model.object_bounds(), &costs, 1);
        let leaves = ModelLeaves { model, tree: &tree };
        let camera = camera_path(&scene, CameraPath::Still, 1)[0];
        let view = View { camera, width_px: 120, height_px: 90 };
        let picture = |algorithm: Algorithm, from: u32| {
            let mut device = SoftwareDevice::new(leaves, &view, Latency::Batches);
            let mut culler = Culler::new(algorithm);
            culler.history.set_frame(from);
            let mut drawn = Vec::new();
            for _ in 0..30 {
                drawn.push(culler.frame(&tree, &view, &mut device).triangles_drawn);
            }
            (device.picture().clone(), drawn)
        };
        let all = |picture: &ItemBuffer| picture.visible_items();
        let (expected, _) = picture(Algorithm::Frustum, 0);
        for algorithm in [
            Algorithm::Chc(ChcOptions { assume_visible_frames: 3, ..ChcOptions::default() }),
            Algorithm::ChcPlus(ChcPlusOptions::default()),
        ] {
            let (_, usual) = picture(algorithm, 1000);
            let (found, drawn) = picture(algorithm, u32::MAX - 12);
            assert_eq!(all(&found), all(&expected));
            assert_eq!(expected.differing_pixels(&found), 0);
            assert_eq!(drawn[29], usual[29], "{algorithm:?}: {drawn:?}");
        }
    }
}
