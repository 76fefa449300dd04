//! What drawing and asking cost on this adapter, measured while culling tries whether asking pays.
//!
//! A frame that is timed waits for the device before its models are drawn and after, so that the
//! time is theirs alone. That is done for the few frames that the switch names, never for others.

use std::time::Instant;

use serde::Serialize;

use crate::budget::CullingPrices;
use crate::gpu::{Gpu, GpuError};
use crate::visibility::{Algorithm, Culler, CullingCosts};

/// Measured prices, nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct CullingCostStats {
    /// Of a triangle drawn.
    pub triangle_ns: f64,
    /// Of a leaf drawn, whatever its size.
    pub leaf_ns: f64,
    /// Of a question.
    pub question_ns: f64,
    /// Of a wait for answers.
    pub wait_ns: f64,
    /// Frames timed so far.
    pub timed_frames: u64,
    /// Fits of prices to their times.
    pub fits: u64,
}

/// Learns the prices of one scene on one device.
#[derive(Debug)]
pub(super) struct CostMeter {
    prices: CullingPrices,
    timed_frames: u64,
}

impl Default for CostMeter {
    fn default() -> Self {
        let CullingCosts { triangle, leaf, query, round, .. } = CullingCosts::default();
        CostMeter { prices: CullingPrices::new([triangle, leaf, query, round]), timed_frames: 0 }
    }
}

impl CostMeter {
    /// The algorithm with the prices that are known.
    pub(super) fn priced(&self, algorithm: &Algorithm) -> Algorithm {
        let Algorithm::Auto(options, _) = algorithm else { return *algorithm };
        let [triangle, leaf, query, round] = self.prices.prices();
        let costs = CullingCosts { query, query_pixel: 0.0, round, leaf, triangle, pixel: 0.0 };
        Algorithm::Auto(*options, costs)
    }

    /// Begins to time a frame, if it is one that tells prices.
    pub(super) fn begin(&self, gpu: &Gpu, culler: &Culler) -> Result<Option<Instant>, GpuError> {
        if !(matches!(culler.algorithm(), Algorithm::Auto(..)) && culler.switch().is_probing()) {
            return Ok(None);
        }
        gpu.wait()?;
        Ok(Some(Instant::now()))
    }

    /// Ends it.
    pub(super) fn end(
        &mut self,
        gpu: &Gpu,
        culler: &Culler,
        begun: Option<Instant>,
    ) -> Result<(), GpuError> {
        let Some(begun) = begun else { return Ok(()) };
        gpu.wait()?;
        let counters = culler.counters();
        let work = [
            counters.triangles_drawn,
            counters.leaves_drawn,
            counters.queries_issued,
            counters.blocking_waits,
        ];
        self.timed_frames += 1;
        self.prices.observe(work.map(|count| count as f64), begun.elapsed().as_nanos() as f64);
        Ok(())
    }

    /// What is known, once a frame was timed.
    pub(super) fn stats(&self) -> Option<CullingCostStats> {
        let [triangle_ns, leaf_ns, question_ns, wait_ns] = self.prices.prices();
        let (timed_frames, fits) = (self.timed_frames, self.prices.fits());
        let stats =
            CullingCostStats { triangle_ns, leaf_ns, question_ns, wait_ns, timed_frames, fits };
        (timed_frames > 0).then_some(stats)
    }
}
