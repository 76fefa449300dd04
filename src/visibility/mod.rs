//! What is hidden: occlusion culling by questions to whatever draws the picture.
//!
//! An algorithm walks a [`BoundingHierarchy`](crate::hierarchy::BoundingHierarchy), tells an
//! [`OcclusionDevice`] what to draw and asks it whether boxes would show; what was learned is kept
//! per view in a [`ViewHistory`]. A guess that something is visible costs time only; a guess that
//! something is hidden is always checked before the picture is finished, unless the answers are
//! chosen to arrive a frame late. The picture is therefore that of drawing everything.
//!
//! Answers arrive late: `Unknown` is one. Not here: drawing, and how a question is put to a GPU
//! (`passes`).
//!
//! After: Wimmer and Bittner 2005 and Bittner et al. 2004 (CHC); Mattausch, Bittner and Wimmer 2008
//! (CHC++); Guthe et al. 2006 (the cost rule of [`Algorithm::NearOptimal`]).

mod automatic;
mod chc;
mod chc_plus;
mod coherence;
mod cost;
mod counters;
mod culler;
mod device;
mod frontier;
mod grouping;
mod history;
mod item_buffer;
mod near_optimal;
mod optimum;
mod proxy;
mod reference;
mod retest;
mod software;
mod states;
mod tight;
mod walk;

pub use automatic::AutoSwitch;
pub use chc::ChcOptions;
pub use chc_plus::ChcPlusOptions;
pub use coherence::{CoherenceTable, KeepRule};
pub use cost::CullingCosts;
pub use counters::CullCounters;
pub use culler::{Algorithm, Culler};
pub use device::{Answer, OcclusionDevice, QueryId};
pub use frontier::Order;
pub use grouping::{best_group, group_sizes};
pub use history::ViewHistory;
pub use item_buffer::{ItemBuffer, NO_ITEM};
pub use optimum::{Frontier as HiddenFrontier, hidden_frontier};
pub use proxy::{Proxies, meets_near_plane};
pub use software::{Drawables, Latency, ModelLeaves, SoftwareDevice};
pub use states::{NodeState, NodeStatus};
pub use walk::LateAnswers;
