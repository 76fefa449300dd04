//! Views that rest under a target time.
//!
//! Nobody waits for the next frame of a view that does not move, so what a target held back comes
//! then: every frame at rest has twice the points of the one before, and none decides half-way to
//! draw fewer. So a view that moves again is kept waiting by little more than the frame that it
//! interrupts, and one that stays shows all it may, however slow the machine.

use crate::frame::{FrameSettings, Renderer};
use crate::geometry::View;

/// Points of the first frame at rest, at least.
const LEAST_AT_REST: u64 = 50_000;

/// What frames drew of what was asked for, to tell those at rest.
#[derive(Clone, Debug, Default)]
pub(super) struct Rest {
    /// View and settings of the last frame, and the budget it was drawn with.
    last: Option<(View, FrameSettings, u64)>,
    /// Whether that frame may show less than the settings allow, because of the time.
    holds_back: bool,
}

impl Rest {
    /// The budget of a frame whose view rests; none if it does not.
    pub(super) fn budget(&self, view: &View, settings: &FrameSettings) -> Option<u64> {
        let (last_view, last_settings, budget) = self.last.as_ref()?;
        let rests = last_view == view && last_settings == settings;
        let more = budget.saturating_mul(2).max(LEAST_AT_REST).min(settings.cut.point_budget);
        rests.then_some(if self.holds_back { more } else { *budget })
    }
}

impl Renderer {
    /// Whether the last frame left something out for the time's sake.
    pub(super) fn is_held_back(&self) -> bool {
        self.pacer.as_ref().is_some_and(|pacer| pacer.rest.holds_back)
    }

    /// Once it is known what a frame draws of what was asked for: whether its time may leave
    /// something out.
    pub(super) fn note_held_back(&mut self, asked: &FrameSettings, paced: &FrameSettings) {
        let Some(pacer) = &mut self.pacer else { return };
        let is_less = paced.cut.point_budget < asked.cut.point_budget;
        let over_budget = self.stats.nodes_over_budget > 0;
        pacer.rest.holds_back = is_less && over_budget || self.table.checkpoint.is_some();
    }

    /// Notes a frame that was drawn, or found to be drawn already.
    pub(super) fn note_frame_for_rest(&mut self, view: &View, settings: &FrameSettings) {
        let budget = self.drawn_budget;
        if let Some(pacer) = &mut self.pacer {
            pacer.rest.last = Some((*view, settings.clone(), budget));
        }
    }
}
