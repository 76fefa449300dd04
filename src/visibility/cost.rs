//! What questions and drawing cost on a device.

use glam::DVec3;

use crate::geometry::{Aabb, View};
use crate::visibility::CullCounters;

/// Costs in any common unit, such as nanoseconds; measured on the device where it matters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CullingCosts {
    /// A question, whatever its size.
    pub query: f64,
    /// A pixel of a question's boxes.
    pub query_pixel: f64,
    /// A submission whose answers are waited for.
    pub round: f64,
    /// A leaf drawn, whatever its size.
    pub leaf: f64,
    /// A triangle drawn.
    pub triangle: f64,
    /// A pixel drawn.
    pub pixel: f64,
}

impl Default for CullingCosts {
    /// Nanoseconds as a software adapter on two cores shows them.
    fn default() -> Self {
        CullingCosts {
            query: 2_000.0,
            query_pixel: 0.3,
            round: 150_000.0,
            leaf: 400.0,
            triangle: 60.0,
            pixel: 0.5,
        }
    }
}

impl CullingCosts {
    /// Cost of drawing leaves with so many triangles together.
    pub fn of_leaves(&self, leaves: u64, triangles: u64) -> f64 {
        self.leaf * leaves as f64 + self.triangle * triangles as f64
    }

    /// Cost of a frame: what it drew, asked and waited for.
    pub fn of_frame(&self, counters: &CullCounters) -> f64 {
        self.of_leaves(counters.leaves_drawn, counters.triangles_drawn)
            + self.query * counters.queries_issued as f64
            + self.round * counters.blocking_waits as f64
    }

    /// Cost of asking about a box that covers this many pixels.
    pub fn of_query(&self, pixels: f64) -> f64 {
        self.query + self.query_pixel * pixels
    }

    /// Cost of drawing a subtree in a box that covers this many pixels.
    pub fn of_drawing(&self, triangles: u64, pixels: f64) -> f64 {
        (self.leaf + self.triangle * triangles as f64).max(self.pixel * pixels)
    }
}

/// The rectangle of the picture that a box may cover, in pixels, as (low, high); `None` if the box
/// meets the near plane or lies beside the picture.
pub(super) fn screen_rectangle(view: &View, bounds: &Aabb) -> Option<([f64; 2], [f64; 2])> {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for corner in 0..8 {
        let pick = |axis: usize| [bounds.min, bounds.max][corner >> axis & 1][axis];
        let (x, y, _) = view.project(DVec3::new(pick(0), pick(1), pick(2)))?;
        low = [low[0].min(x), low[1].min(y)];
        high = [high[0].max(x), high[1].max(y)];
    }
    let size = [f64::from(view.width_px), f64::from(view.height_px)];
    let low = [low[0].max(0.0), low[1].max(0.0)];
    let high = [high[0].min(size[0]), high[1].min(size[1])];
    (low[0] < high[0] && low[1] < high[1]).then_some((low, high))
}
