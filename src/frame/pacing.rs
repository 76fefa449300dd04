//! Frames within a time: from a target in milliseconds to a budget of points and bytes, and what
//! was measured back into the prices.
//!
//! Before a frame its cost is predicted from the counts of its cut; a cut that would take too long
//! is chosen again with fewer points, at most twice. After the frame, as soon as its clock was
//! read (frames later, never waited for), prices and guard learn. Without a target none of this
//! exists; where everything fits with room to spare nothing is predicted.
//!
//! A target is for views that move. One that rests gets more with every frame until nothing is held
//! back, however long that takes (`rest`).

#[cfg(feature = "gpu")]
use std::collections::VecDeque;
use std::time::Instant;

use serde::Serialize;

use crate::budget::{BudgetSearch, OnlineModel, TimePlan, UPLOAD_SHARE, Workload, sure_points};
use crate::frame::calibration::{Calibration, beyond_base};
use crate::frame::device::Device;
use crate::frame::renderer::milliseconds;
use crate::frame::rest::Rest;
use crate::frame::workload::workload;
use crate::frame::{FrameError, FrameSettings, Loading, Renderer};
use crate::geometry::View;
use crate::select::{Availability, Cut};

/// What pacing did in a frame. Times are milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PacingStats {
    /// What the frame may take.
    pub target_ms: f64,
    /// Of that, what drawing points may take.
    pub free_ms: f64,
    /// Points that may be drawn; the most there is if the scene surely fits.
    pub point_budget: u64,
    /// Bytes that may be sent.
    pub upload_bytes: u64,
    /// Expected time of drawing the points of this frame; of a scene that surely fits only one
    /// frame in eight is predicted.
    pub predicted_ms: Option<f64>,
    /// Expected time of the whole frame, CPU and GPU.
    pub frame_predicted_ms: Option<f64>,
    /// Share that is added for safety.
    pub guard_share: f64,
    /// Cuts that were tried for the budget.
    pub cuts_tried: u32,
    /// Time that predicting took, trial cuts included.
    pub planning_ms: f64,
    /// Of the latest frame whose clock was read: what was expected of its points.
    pub checked_predicted_ms: Option<f64>,
    /// The same with the share for safety.
    pub checked_safe_ms: Option<f64>,
    /// And what they took.
    pub checked_measured_ms: Option<f64>,
    /// Frames from which each price was learned by itself so far.
    pub frames_learned: u64,
    /// Frames that did not tell the prices apart, so that all moved together.
    pub frames_together: u64,
    /// Measurements that made no sense.
    pub frames_rejected: u64,
    /// Times that drawing was calibrated.
    pub calibrations: u32,
    /// Times that predictions had missed to one side for long and learning began anew.
    pub restarts: u32,
    /// Frames that decided half-way to draw the coarser cut, so far.
    pub frames_cut_short: u64,
    /// Waits for the GPU in this frame.
    pub blocking_waits: u64,
    /// Whether the view rests, so that it gets more points than fit the time.
    pub rests: bool,
}

/// Measurement and prediction of one view's frames.
#[derive(Debug)]
pub(super) struct Pacer {
    calibration: Calibration,
    pub(super) online: OnlineModel,
    /// What the GPU may take in the frame that is being drawn, milliseconds.
    pub(super) gpu_ms: f64,
    /// What fitted the last frame.
    last_budget: Option<u64>,
    /// Nodes and pixels per point of the last cut.
    nodes_each: f64,
    pixels_each: f64,
    /// CPU part of a frame without drawing, milliseconds.
    cpu_ms: f64,
    /// Passes other than that of points, per pixel of the target, milliseconds.
    setup_px_ms: f64,
    /// Frames whose clocks were not read yet.
    #[cfg(feature = "gpu")]
    under_way: VecDeque<UnderWay>,
    /// The frame that is being drawn.
    pub(super) next: Option<UnderWay>,
    /// First frames of a pipeline, which are not learned from.
    skipped: u32,
    frames: u64,
    areas: Vec<f64>,
    stats: PacingStats,
    waits_before: u64,
    /// What views that rest are told by.
    pub(super) rest: Rest,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct UnderWay {
    #[cfg(feature = "gpu")]
    frame: u64,
    pub(super) work: Workload,
    pub(super) predicted_ms: f64,
    safe_ms: f64,
    target_px: f64,
}

/// First frames that are not learned from.
const SKIPPED: u32 = 2;
/// Of a scene that surely fits, one frame in so many is looked at.
const LEARN_EVERY: u64 = 8;
/// Frames whose clocks may be outstanding.
#[cfg(feature = "gpu")]
const MOST_UNDER_WAY: usize = 16;
/// Largest share of the target that the system's noise may claim; what is beyond is the guard's.
const MOST_NOISE: f64 = 0.2;
/// Where the device has no clock that can be trusted, one frame in so many is waited for.
#[cfg(feature = "gpu")]
const SYNC_EVERY: u64 = 8;

impl Renderer {
    /// What drawing costs here, once a target time was set.
    pub fn calibration(&self) -> Option<&Calibration> {
        self.pacer.as_ref().map(|pacer| &pacer.calibration)
    }

    /// Takes over prices that were measured before, instead of measuring.
    pub fn set_calibration(&mut self, calibration: Calibration) {
        self.pacer = Some(Box::new(Pacer::new(calibration)));
    }

    /// The settings with budgets that fit the target time; `None` without a target. `pipelined`
    /// says whether frames follow each other without waiting.
    pub(super) fn pace(
        &mut self,
        view: &View,
        settings: &FrameSettings,
        pipelined: bool,
    ) -> Result<Option<FrameSettings>, FrameError> {
        let Some(target_ms) = settings.target_ms else {
            self.pacer = None;
            return Ok(None);
        };
        self.calibrate_if_needed(view)?;
        self.drain_before_sync()?;
        self.learn();
        let waits = self.waits();
        let Some(mut pacer) = self.pacer.take() else { return Ok(None) };
        let start = Instant::now();
        let target_px = f64::from(view.width_px) * f64::from(view.height_px);
        let plan = pacer.plan(target_ms, target_px, pipelined);
        let mut paced = settings.clone();
        let upload_bytes = plan.upload_bytes(pacer.calibration.byte_ms, UPLOAD_SHARE);
        let rest_budget = match pipelined {
            true => pacer.rest.budget(view, settings),
            false => None,
        };
        if let Loading::Quota { bytes } = settings.loading
            && rest_budget.is_none()
        {
            paced.loading = Loading::Quota { bytes: bytes.min(upload_bytes.max(1)) };
        }
        pacer.gpu_ms = plan.target_ms;
        let free_ms = plan.free_ms();
        let mut cuts_tried = 0;
        let scene_points: u64 = self.sources.iter().map(|s| s.octree().point_count()).sum();
        let scene_nodes: usize = self.sources.iter().map(|s| s.octree().nodes().len()).sum();
        let most_points = scene_points.min(settings.cut.point_budget);
        // Twice the pixels of the last frame's points; a frame of the view before says nothing of
        // the first.
        let scene = Workload::points(
            scene_nodes as f64,
            most_points as f64,
            most_points as f64 * 2.0 * pacer.pixels_each.max(1.0),
        );
        let surely_fits =
            pacer.frames > 0 && sure_points(&plan, pacer.online.model(), &scene) && free_ms > 0.0;
        if let Some(budget) = rest_budget {
            paced.cut.point_budget = budget;
        } else if !surely_fits {
            let proposed = plan.points(pacer.online.model(), pacer.nodes_each, pacer.pixels_each);
            // What fitted the last frame is the better guess: with fewer points splats grow.
            let first = pacer.last_budget.unwrap_or(proposed);
            let mut search = BudgetSearch::new(first, settings.cut.point_budget, free_ms);
            while let Some(budget) = search.next_trial() {
                paced.cut.point_budget = budget;
                let (work, is_bound) = self.trial(view, &paced, &mut pacer.areas);
                let expected_ms = pacer.online.predict(&work);
                search.note(budget, work.transformed as u64, expected_ms, is_bound);
            }
            cuts_tried = search.tries();
            paced.cut.point_budget = search.budget();
            pacer.last_budget = Some(search.budget()).filter(|&budget| budget > 0);
        }
        pacer.stats = PacingStats {
            target_ms,
            free_ms,
            point_budget: paced.cut.point_budget,
            upload_bytes,
            guard_share: pacer.online.guard_share(),
            cuts_tried,
            planning_ms: milliseconds(start),
            predicted_ms: None,
            frame_predicted_ms: None,
            rests: rest_budget.is_some(),
            ..pacer.stats
        };
        pacer.waits_before = waits;
        self.pacer = Some(pacer);
        Ok(Some(paced))
    }

    /// Before a frame that will be waited for: waits for those before it, whose work would count
    /// as this one's.
    fn drain_before_sync(&mut self) -> Result<(), FrameError> {
        #[cfg(feature = "gpu")]
        if let (Some(pacer), Device::Gpu(on_gpu)) = (&self.pacer, &self.device)
            && !on_gpu.has_true_clock()
            && (pacer.frames + 1).is_multiple_of(SYNC_EVERY)
        {
            on_gpu.gpu.wait()?;
        }
        Ok(())
    }

    /// After the cuts are chosen: what they are expected to take.
    pub(super) fn predict(&mut self, cuts: &[Cut], view: &View, settings: &FrameSettings) {
        let Some(mut pacer) = self.pacer.take() else { return };
        if pacer.stats.cuts_tried == 0 && !pacer.frames.is_multiple_of(LEARN_EVERY) {
            self.pacer = Some(pacer);
            return;
        }
        let start = Instant::now();
        let work = self.scene_workload(cuts, view, settings, &mut pacer.areas);
        pacer.note_shape(&work);
        let target_px = f64::from(view.width_px) * f64::from(view.height_px);
        let predicted_ms = pacer.online.predict(&work);
        pacer.stats.predicted_ms = Some(predicted_ms);
        let gpu_ms = predicted_ms + pacer.reserved_ms(target_px);
        let frame_ms = pacer.calibration.frame.parts_ms(pacer.cpu_ms, gpu_ms);
        pacer.stats.frame_predicted_ms = Some(frame_ms);
        pacer.stats.planning_ms += milliseconds(start);
        pacer.next = Some(UnderWay {
            #[cfg(feature = "gpu")]
            frame: 0,
            work,
            predicted_ms,
            safe_ms: pacer.online.predict_safely(&work),
            target_px,
        });
        self.pacer = Some(pacer);
    }

    /// After a frame of one tile was drawn: notes it, to be compared when its time is known.
    pub(super) fn note_paced(&mut self, started: Instant) -> Result<(), FrameError> {
        let cpu_spent = |pass: &str| {
            let of_pass = self.stats.passes.iter().filter(|p| p.pass == pass && p.clock == "cpu");
            of_pass.map(|p| p.pass_ms).sum::<f64>()
        };
        let drawn_ms = cpu_spent("points");
        #[cfg(feature = "gpu")]
        let prepared_ms = cpu_spent("load") + cpu_spent("select");
        let others_ms = match &self.device {
            Device::Cpu { .. } => drawn_ms + cpu_spent("resolve") + cpu_spent("load"),
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) if on_gpu.has_true_clock() => cpu_spent("load"),
            // Software adapters draw while commands are handed over.
            #[cfg(feature = "gpu")]
            Device::Gpu(_) => cpu_spent("load") + cpu_spent("draw"),
        };
        let Some(pacer) = &mut self.pacer else { return Ok(()) };
        let next = pacer.next.take();
        let cpu_ms = (milliseconds(started) - others_ms).max(0.0) + pacer.stats.planning_ms;
        // Slowly, because of single interrupted frames.
        pacer.cpu_ms += 0.1 * (cpu_ms - pacer.cpu_ms).clamp(-pacer.cpu_ms, pacer.cpu_ms.max(0.1));
        pacer.frames += 1;
        match (&mut self.device, next) {
            (_, None) => {}
            (Device::Cpu { .. }, Some(next)) => pacer.check(&next, drawn_ms),
            #[cfg(feature = "gpu")]
            (Device::Gpu(on_gpu), Some(next)) if on_gpu.has_true_clock() => {
                if pacer.under_way.len() == MOST_UNDER_WAY {
                    pacer.under_way.pop_front();
                }
                let frame = on_gpu.timer.frame();
                pacer.under_way.push_back(UnderWay { frame, ..next });
            }
            #[cfg(feature = "gpu")]
            (Device::Gpu(on_gpu), Some(next)) => {
                if pacer.frames.is_multiple_of(SYNC_EVERY) {
                    on_gpu.gpu.wait()?;
                    let setup_ms = pacer.setup_px_ms * next.target_px;
                    pacer.check(&next, milliseconds(started) - prepared_ms - setup_ms);
                }
            }
        }
        self.learn();
        let waits = self.waits();
        if let Some(pacer) = &mut self.pacer {
            pacer.stats.blocking_waits = waits - pacer.waits_before;
            self.stats.pacing = Some(pacer.stats);
        }
        Ok(())
    }

    /// After waiting for a picture: its own clock may have been read by now.
    pub(super) fn note_checked(&mut self) {
        self.learn();
        if let (Some(pacer), Some(pacing)) = (&self.pacer, &mut self.stats.pacing) {
            *pacing = PacingStats { blocking_waits: pacing.blocking_waits, ..pacer.stats };
        }
    }

    /// Takes in the clocks that were read meanwhile.
    pub(super) fn learn(&mut self) {
        #[cfg(feature = "gpu")]
        if let (Some(pacer), Device::Gpu(on_gpu)) = (&mut self.pacer, &mut self.device) {
            for measured in on_gpu.timer.take_measured() {
                if measured.choice == Some(1) {
                    pacer.stats.frames_cut_short += 1;
                }
                pacer.under_way.retain(|frame| frame.frame >= measured.frame);
                let is_this = pacer.under_way.front().filter(|f| f.frame == measured.frame);
                let Some(frame) = is_this.copied() else { continue };
                pacer.under_way.pop_front();
                let points_ms = points_ms(&measured.passes);
                let all_ms: f64 = measured.passes.iter().map(|(_, ms)| ms).sum();
                pacer.note_setup((all_ms - points_ms) / frame.target_px);
                // What was drawn instead says nothing about what was expected.
                if measured.choice != Some(1) {
                    pacer.check(&frame, points_ms);
                }
            }
        }
    }

    fn calibrate_if_needed(&mut self, view: &View) -> Result<(), FrameError> {
        let drifts = self.pacer.as_ref().is_some_and(|pacer| pacer.online.is_drifting());
        if self.pacer.is_none() {
            let calibration = self.calibrate(view.width_px, view.height_px)?;
            self.set_calibration(calibration);
            if let Some(pacer) = &mut self.pacer {
                pacer.stats.calibrations = 1;
            }
        } else if drifts && let Some(pacer) = &mut self.pacer {
            // Measuring anew would stop the window for a second; prices learn from new frames
            // alone instead.
            pacer.online.start_anew();
            pacer.stats.restarts += 1;
        }
        Ok(())
    }

    /// Chooses cuts as the frame will, without loading; their counts, and whether the budget
    /// bound them.
    fn trial(
        &mut self,
        view: &View,
        settings: &FrameSettings,
        areas: &mut Vec<f64>,
    ) -> (Workload, bool) {
        let mut scratch = std::mem::take(&mut self.scratch);
        let cuts =
            self.select(view, &settings.cut, &mut scratch, |node| match self.availability(node) {
                Availability::Absent if settings.loading == Loading::All => Availability::Resident,
                other => other,
            });
        self.scratch = scratch;
        let is_bound = cuts.iter().any(|cut| cut.counters.nodes_over_budget > 0);
        let work = self.scene_workload(&cuts, view, settings, areas);
        cuts.into_iter().for_each(|cut| self.scratch.recycle(cut));
        (work, is_bound)
    }

    /// The counts of what would be drawn.
    pub(super) fn trial_workload(&mut self, view: &View, settings: &FrameSettings) -> Workload {
        self.trial(view, settings, &mut Vec::new()).0
    }

    pub(super) fn scene_workload(
        &self,
        cuts: &[Cut],
        view: &View,
        settings: &FrameSettings,
        areas: &mut Vec<f64>,
    ) -> Workload {
        let clouds = self.sources.iter().zip(cuts);
        clouds.fold(Workload::default(), |sum, (source, cut)| {
            sum.with(&workload(source.octree(), cut, view, &settings.cut.splat, areas))
        })
    }

    fn waits(&self) -> u64 {
        match &self.device {
            Device::Cpu { .. } => 0,
            #[cfg(feature = "gpu")]
            Device::Gpu(on_gpu) => on_gpu.gpu.waits(),
        }
    }
}

impl Pacer {
    fn new(calibration: Calibration) -> Self {
        Pacer {
            online: OnlineModel::new(calibration.model),
            gpu_ms: 0.0,
            last_budget: None,
            nodes_each: 1e-4,
            pixels_each: 4.0,
            cpu_ms: calibration.cpu_ms,
            setup_px_ms: calibration.setup_px_ms,
            #[cfg(feature = "gpu")]
            under_way: VecDeque::new(),
            next: None,
            skipped: 0,
            frames: 0,
            areas: Vec::new(),
            stats: PacingStats::default(),
            waits_before: 0,
            rest: Rest::default(),
            calibration,
        }
    }

    /// Whether the frame that is being drawn is one of a view that rests.
    #[cfg(feature = "gpu")]
    pub(super) fn rests(&self) -> bool {
        self.stats.rests
    }

    fn plan(&self, target_ms: f64, target_px: f64, pipelined: bool) -> TimePlan {
        let frame = self.calibration.frame;
        // A single picture waits for the GPU, so the parts follow each other.
        let overlap = if pipelined { frame.overlap } else { 0.0 };
        let system_ms = frame.system_ms.min(MOST_NOISE * target_ms);
        let parts = crate::budget::FrameModel { system_ms, overlap };
        TimePlan {
            target_ms: parts.gpu_ms_within(target_ms, self.cpu_ms),
            system_ms: 0.0,
            reserved_ms: self.reserved_ms(target_px),
            guard_share: self.online.guard_share(),
        }
    }

    pub(super) fn reserved_ms(&self, target_px: f64) -> f64 {
        (self.setup_px_ms + self.calibration.base_px_ms) * target_px
    }

    /// What the last cut looked like is what the next will look like.
    fn note_shape(&mut self, work: &Workload) {
        if work.transformed >= 1.0 {
            self.nodes_each = work.draws / work.transformed;
            self.pixels_each = work.pixels / work.transformed;
        }
    }

    #[cfg(feature = "gpu")]
    fn note_setup(&mut self, px_ms: f64) {
        // What no clock sees stays as calibrated: the stamped part may only add to it.
        if px_ms.is_finite() && px_ms > self.setup_px_ms {
            self.setup_px_ms += 0.1 * (px_ms - self.setup_px_ms);
        }
    }

    /// Compares a frame with its prediction and learns from it.
    fn check(&mut self, frame: &UnderWay, points_ms: f64) {
        let base_ms = self.calibration.base_px_ms * frame.target_px;
        let measured_ms = beyond_base(points_ms, base_ms);
        if self.skipped < SKIPPED {
            self.skipped += 1;
            return;
        }
        if self.online.observe(&frame.work, measured_ms).is_ok() {
            self.stats.checked_predicted_ms = Some(frame.predicted_ms);
            self.stats.checked_safe_ms = Some(frame.safe_ms);
            self.stats.checked_measured_ms = Some(measured_ms);
        }
        let (learned, together, rejected) = self.online.counts();
        self.stats.frames_learned = learned;
        self.stats.frames_together = together;
        self.stats.frames_rejected = rejected;
    }
}

/// The passes that draw points, by their names.
#[cfg(feature = "gpu")]
pub(super) fn points_ms(passes: &[(&'static str, f64)]) -> f64 {
    let draws_points = |pass: &str| pass.starts_with("points") || pass == "grow";
    passes.iter().filter(|(pass, _)| draws_points(pass)).map(|(_, ms)| ms).sum()
}
