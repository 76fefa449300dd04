//! The coarser cut that a frame may fall back to half-way.
//!
//! Predictions alone cannot bound every frame. Where the device has a clock that its own shaders
//! can read, about half of the points are drawn first; then the device itself compares the time
//! that is left with what the other half needs, and draws either that or, of the nodes that it
//! concerns, what they are without it.

use crate::frame::device::{Device, GpuPass};
use crate::frame::{FrameSettings, InFrameCheckpoint, Renderer};
use crate::geometry::View;
use crate::passes::CheckpointPlan;
use crate::select::CutSettings;

/// Fewest points for which a decision is worth its pass.
const FEWEST_POINTS: u64 = 20_000;
/// Share of the points that the coarser cut may have.
const COARSER: f64 = 0.5;

impl Renderer {
    /// Adds a coarser alternative to the table, if the frame is to decide.
    pub(super) fn add_alternative(&mut self, view: &View, settings: &FrameSettings) {
        let Device::Gpu(on_gpu) = &self.device else { return };
        let is_wanted = match settings.checkpoint {
            InFrameCheckpoint::Auto => !on_gpu.gpu.is_software(),
            InFrameCheckpoint::On => true,
            InFrameCheckpoint::Off => false,
        };
        let can = matches!(on_gpu.pass, GpuPass::Compute(_)) && on_gpu.timer.measures();
        let points = self.table.points;
        let Some(pacer) = self.pacer.take() else { return };
        let expected = pacer.next.map(|next| (next.work, next.predicted_ms));
        let rests = pacer.rests();
        self.pacer = Some(pacer);
        let Some((_, full_ms)) = expected else { return };
        // Nodes that are still appearing count on being asked for once per frame.
        if rests || !is_wanted || !can || points < FEWEST_POINTS || !settings.appear.is_zero() {
            return;
        }
        let cut = CutSettings { point_budget: (COARSER * points as f64) as u64, ..settings.cut };
        let mut scratch = std::mem::take(&mut self.scratch);
        let cuts = self.select(view, &cut, &mut scratch, |node| self.availability(node));
        self.scratch = scratch;
        let full = std::mem::take(&mut self.table);
        self.fill_table(&cuts, view, settings);
        let coarser = std::mem::replace(&mut self.table, full);
        let work = self.scene_workload(&cuts, view, settings, &mut Vec::new());
        cuts.into_iter().for_each(|cut| self.scratch.recycle(cut));
        let [_, full_points, coarse_points] = self.table.add_alternative(&coarser);
        if let Some(pacer) = &self.pacer {
            let coarse_ms = pacer.online.predict(&work);
            let target_px = f64::from(view.width_px) * f64::from(view.height_px);
            let after_ms = pacer.reserved_ms(target_px);
            // Each part's share of its cut's time.
            let share = |part: u64, all: u64| part as f64 / all.max(1) as f64;
            self.table.checkpoint = Some(CheckpointPlan {
                allowed_ms: pacer.gpu_ms,
                needs_ms: [
                    full_ms * share(full_points, points) + after_ms,
                    coarse_ms * share(coarse_points, coarser.points) + after_ms,
                ],
            });
        }
    }
}
