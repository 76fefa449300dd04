//! Measured costs, predicted frame time, milliseconds to points and bytes.
//!
//! A frame takes `system + max(cpu, gpu)` ([`FrameModel`]); the drawing part of `gpu` is predicted
//! from counts of what is drawn ([`Workload`]) by one of five formulas ([`CostModel`]), by tables
//! measured per object ([`PosTable`]) or per view cell ([`CellTable`]). Constants come from a fit
//! to timed samples ([`Design`]) and follow the machine frame by frame ([`OnlineModel`]), which
//! refuses what samples do not tell apart. Turned around, the prediction says how much may be drawn
//! and sent in a given time ([`TimePlan`]).
//!
//! Arithmetic only: no GPU, no clock, no files. Measuring is the business of `frame`.
//!
//! Units: milliseconds, f64; counts are f64 because they are multiplied by prices.
//! After: Wimmer and Wonka, "Rendering Time Estimation for Real-Time Rendering", 2003; what is ours
//! is said where it stands and argued in `docs/rendering-time.md`.

mod branch;
mod culling_prices;
mod fit;
mod footprint;
mod frame_model;
mod guard;
mod heuristic;
mod least_squares;
mod online;
mod order;
mod pipeline;
mod plan;
mod pos_table;
pub mod procedural;
mod quantile;
mod search;
mod vertex_cache;
mod view_cell;

pub use branch::{choose_alternative, still_needed, ticks_left};
pub use culling_prices::{CullingPrices, CullingWork, FittedPrices};
pub use footprint::{Footprint, sphere_footprint, visible_angle};
pub use frame_model::{CpuTime, FrameModel, GpuTime, OverlapSample};
pub use guard::{Drift, Guard};
pub use heuristic::{CostModel, Heuristic, Sample, Workload};
pub use least_squares::{Design, FitError, Solution};
pub use online::{OnlineModel, Rejected};
pub use order::{DrawState, StateChanges, StateOrder, state_changes};
pub use pipeline::{Triangle, TwoStagePipeline};
pub use plan::{TimePlan, UPLOAD_SHARE, Uploads, fitting_prefix, sure_points};
pub use pos_table::{Lookup, PosTable, ViewAngles};
pub use quantile::{SystemNoise, quantile};
pub use search::{BudgetSearch, MOST_TRIALS};
pub use vertex_cache::{VertexCache, transformed_vertices};
pub use view_cell::{CellTable, SphereObject, cell_bound, paper_candidates};
