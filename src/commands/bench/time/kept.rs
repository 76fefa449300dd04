//! The study *kept*: a flight that keeps to a time, and the same frames once more.

use std::fmt::Write;

use super::frames::{Outcome, Plan, on_path, settings, test_frame};
use crate::budget::quantile;
use crate::commands::bench::plot::{Panel, Scale, Series};
use crate::commands::bench::time::score::Score;
use crate::frame::{NodeSource, Renderer};
use crate::geometry::View;

/// A flight with a target time: what was expected, what it took, what it cost to know.
pub(super) fn flight(
    name: &str,
    renderer: &mut Renderer,
    source: &dyn NodeSource,
    plan: &Plan,
    outcome: &mut Outcome,
) -> anyhow::Result<()> {
    // A target that a third of a million points or so would take.
    let mut settings = settings(5_000_000, 1.0);
    let middle = test_frame(source, plan, plan.tests / 2).0;
    let mut limited = settings.clone();
    limited.cut.point_budget = plan.curve[plan.curve.len() - 2];
    let mut totals = Vec::new();
    for _ in 0..5 {
        totals.push(renderer.time_frame(&middle, &limited)?.total_ms);
    }
    let target_ms = 1.5 * quantile(&totals[1..], 0.5).unwrap_or(30.0);
    settings.target_ms = Some(target_ms);
    let (mut pairs, mut safe) = (Vec::new(), Vec::new());
    let (mut learned, mut waits, mut planning_ms, mut tried) = (0, 0, 0.0, 0);
    let mut budgets = Vec::new();
    let mut looked_at = Vec::new();
    for frame in 0..plan.flight {
        let view = on_path(source, plan, f64::from(frame) / f64::from(plan.flight));
        let stats = renderer.render(&view, &settings)?;
        let Some(pacing) = stats.pacing else { continue };
        budgets.push(stats.points_drawn as f64);
        planning_ms += pacing.planning_ms;
        tried += pacing.cuts_tried;
        let checked = pacing.frames_learned + pacing.frames_together;
        // The first tenth warms up.
        let is_warm = frame >= plan.flight / 10;
        waits += u64::from(is_warm) * pacing.blocking_waits;
        if checked != learned
            && is_warm
            && let (Some(predicted), Some(bound), Some(measured)) =
                (pacing.checked_predicted_ms, pacing.checked_safe_ms, pacing.checked_measured_ms)
        {
            pairs.push((predicted, measured));
            safe.push((bound, measured));
            looked_at.push((view, pacing.point_budget));
        }
        learned = checked;
    }
    let us = 1e3 * planning_ms / f64::from(plan.flight.max(1));
    let path = format!("{name}, {target_ms:.0} ms");
    outcome.scores.push(Score::of(("kept", &path, "frame loop"), &pairs, us));
    outcome.scores.push(Score::of(("kept", &path, "frame loop, guarded"), &safe, us));
    writeln!(
        outcome.text,
        "flight of {} frames at a target of {target_ms:.1} ms: {:.0} to {:.0} points, {:.2} cuts \
         tried and {us:.0} us of planning per frame, {waits} waits for the GPU after warm-up",
        plan.flight,
        budgets.iter().copied().fold(f64::INFINITY, f64::min),
        budgets.iter().copied().fold(0.0, f64::max),
        f64::from(tried) / f64::from(plan.flight.max(1)),
    )?;
    let numbered = |values: Vec<f64>| (0..).map(f64::from).zip(values).collect();
    outcome.panels.push(Panel {
        title: format!("{name}: a flight at {target_ms:.0} ms"),
        x_label: "measured frame".into(),
        y_label: "point pass, ms".into(),
        x_scale: Scale::Linear,
        y_scale: Scale::Linear,
        series: vec![
            Series {
                name: "measured".into(),
                points: numbered(pairs.iter().map(|p| p.1).collect()),
            },
            Series {
                name: "predicted".into(),
                points: numbered(pairs.iter().map(|p| p.0).collect()),
            },
            Series { name: "guarded".into(), points: numbered(safe.iter().map(|p| p.0).collect()) },
        ],
    });
    // A scene at a tenth of its target: nothing to plan.
    let mut roomy = settings.clone();
    roomy.target_ms = Some(1e5);
    let mut planning_us = Vec::new();
    for frame in 0..40 {
        let (view, _) = test_frame(source, plan, frame);
        if let Some(pacing) = renderer.render(&view, &roomy)?.pacing {
            planning_us.push(1e3 * pacing.planning_ms);
        }
    }
    writeln!(
        outcome.text,
        "with room to spare: {:.1} us of planning in the middle frame, {:.1} us in the 95th of 100\n",
        quantile(&planning_us, 0.5).unwrap_or(0.0),
        quantile(&planning_us, 0.95).unwrap_or(0.0),
    )?;
    replay(&path, renderer, plan, &looked_at, outcome)
}

/// The looked-at frames of a flight with the budgets that they had, twice more each: how well one
/// timing of a frame tells the next, and the least of four the next least of four.
fn replay(
    path: &str,
    renderer: &mut Renderer,
    plan: &Plan,
    frames: &[(View, u64)],
    outcome: &mut Outcome,
) -> anyhow::Result<()> {
    let base_ms = renderer.calibration().map_or(0.0, |calibration| calibration.base_px_ms)
        * f64::from(plan.size.0)
        * f64::from(plan.size.1);
    let (mut single, mut least) = (Vec::new(), Vec::new());
    for (view, budget) in frames {
        let settings = settings(*budget, 1.0);
        renderer.time_frame(view, &settings)?;
        let mut times = Vec::new();
        for _ in 0..8 {
            let points_ms = renderer.time_frame(view, &settings)?.points_ms;
            times.push((points_ms - base_ms).max(0.25 * points_ms));
        }
        let least_of = |times: &[f64]| times.iter().copied().fold(f64::INFINITY, f64::min);
        single.push((times[0], times[1]));
        least.push((least_of(&times[..4]), least_of(&times[4..])));
    }
    outcome.scores.push(Score::of(("kept", path, "the same again"), &single, 0.0));
    outcome.scores.push(Score::of(("kept", path, "least of 4, again"), &least, 0.0));
    Ok(())
}
