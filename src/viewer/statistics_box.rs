//! The statistics over the picture.

use egui::{Align2, Grid, Rect, RichText};

use crate::viewer::panels::{grouped, over};
use crate::viewer::statistics::Statistics;

/// The statistics, in the top right corner of the picture.
pub fn show(ctx: &egui::Context, picture: Rect, statistics: &Statistics) {
    over(ctx, "statistics", picture, Align2::RIGHT_TOP, |ui| {
        ui.style_mut().wrap_mode = Some(egui::TextWrapMode::Extend);
        let rows = Grid::new("statistics").num_columns(2).spacing([12.0, 2.0]).min_row_height(0.0);
        rows.show(ui, |ui| {
            for (name, value) in statistic_rows(statistics) {
                ui.label(RichText::new(name).size(11.0));
                ui.label(RichText::new(value).size(11.0).monospace());
                ui.end_row();
            }
        });
    });
}

/// The lines of the statistics.
fn statistic_rows(statistics: &Statistics) -> Vec<(String, String)> {
    let frame = &statistics.frame;
    let mut rows: Vec<(String, String)> = Vec::new();
    let mut row = |name: &str, value: String| rows.push((name.to_owned(), value));
    // The name; driver and versions are in the panel.
    let adapter = statistics.adapter.split(" (").next().unwrap_or_default();
    row("adapter", adapter.to_owned());
    row("renderer", statistics.renderer.to_owned());
    row("points drawn", of(grouped(frame.points_drawn), grouped(statistics.points)));
    row("nodes drawn", of(grouped(frame.nodes_drawn.into()), grouped(statistics.nodes)));
    if statistics.objects > 0 {
        let drawn = [frame.triangles_drawn, frame.objects_drawn.into()].map(grouped);
        let [triangles, objects] = drawn;
        row("triangles drawn", of(triangles, grouped(statistics.triangles)));
        row("objects drawn", of(objects, grouped(statistics.objects)));
    }
    if let Some(culling) = &frame.culling {
        row("hidden objects", statistics.culling.to_owned());
        row("  nodes reached", grouped(culling.nodes_visited));
        let decided =
            culling.hidden_nodes_decided - culling.pulled_down.min(culling.hidden_nodes_decided);
        row("  hidden nodes", grouped(decided));
        row("  questions", grouped(culling.queries_issued));
        let parts = [culling.queries_visible_leaf, culling.queries_hidden, culling.multiqueries];
        let [leaves, nodes, groups] = parts.map(grouped);
        row("    leaf / node / group", format!("{leaves} / {nodes} / {groups}"));
        row("  rounds, waits", format!("{}, {}", culling.rounds, culling.blocking_waits));
        row("  at the eye, unasked", format!("{} nodes", grouped(culling.near_plane_forced)));
    }
    if let Some(costs) = &frame.culling_costs {
        let prices = [costs.triangle_ns, costs.leaf_ns, costs.question_ns, costs.wait_ns];
        let [triangle, leaf, question, wait] = prices.map(|ns| format!("{:.2}", 1e-3 * ns));
        row("  triangle, leaf", format!("{triangle}, {leaf} µs"));
        row("  question, wait", format!("{question}, {wait} µs"));
    }
    row("frame (cpu)", milliseconds(frame.frame_ms));
    for clock in ["cpu", "gpu"] {
        for pass in frame.passes.iter().filter(|pass| pass.clock == clock) {
            row(&format!("  {} ({clock})", pass.pass), milliseconds(pass.pass_ms));
        }
    }
    if let Some(pacing) = &frame.pacing {
        let points = match (pacing.predicted_ms, pacing.rests) {
            (Some(expected_ms), _) => milliseconds(expected_ms),
            (None, true) => "at rest".to_owned(),
            (None, false) => "sure to fit".to_owned(),
        };
        row("points expected", of(points, milliseconds(pacing.free_ms)));
        let expected = pacing.checked_predicted_ms.zip(pacing.checked_measured_ms);
        if let Some((expected_ms, measured_ms)) = expected {
            row("  measured", of(milliseconds(measured_ms), milliseconds(expected_ms)));
        }
        row("  for safety", format!("{:.0} %", 100.0 * pacing.guard_share));
    }
    row("draw calls", of(frame.draw_calls.to_string(), format!("{} disp.", frame.dispatches)));
    row("point memory", of(bytes(frame.node_bytes), bytes(statistics.node_limit_bytes)));
    row("read", of(bytes(frame.bytes_read), bytes(statistics.bytes_read)));
    row("uploaded", of(bytes(frame.bytes_uploaded), bytes(statistics.bytes_uploaded)));
    if frame.nodes_requested > 0 {
        row("waiting for", format!("{} nodes", grouped(frame.nodes_requested.into())));
    }
    if let Some(stream) = &frame.stream {
        let queued = format!("{} reading, {} queued", stream.nodes_in_flight, stream.nodes_queued);
        row("loader", queued);
        row("main memory", of(bytes(stream.ram_bytes), bytes(stream.ram_limit_bytes)));
        row("  found there", of(grouped(stream.ram_hits), grouped(stream.nodes_delivered)));
    }
    row("out of sight", format!("{} nodes", grouped(frame.nodes_culled.into())));
    row("fine enough", format!("{} nodes", grouped(frame.nodes_fine_enough.into())));
    row("over budget", format!("{} nodes", grouped(frame.nodes_over_budget.into())));
    if frame.nodes_without_room > 0 {
        row("no room for", format!("{} nodes", grouped(frame.nodes_without_room.into())));
    }
    if frame.nodes_failed > 0 {
        row("unreadable", format!("{} nodes", grouped(frame.nodes_failed.into())));
    }
    row(
        "queue",
        match frame.queue_pops {
            0 => "skipped, all fits".to_owned(),
            pops => format!("{} pops", grouped(pops.into())),
        },
    );
    row("frames", format!("{} drawn, {} kept", statistics.frames_drawn, statistics.frames_skipped));
    rows
}

fn of(part: String, whole: String) -> String {
    format!("{part} / {whole}")
}

fn milliseconds(ms: f64) -> String {
    format!("{ms:.1} ms")
}

fn bytes(count: u64) -> String {
    let count = count as f64;
    match count {
        n if n >= f64::from(1u32 << 30) => format!("{:.2} GiB", n / f64::from(1u32 << 30)),
        n if n >= f64::from(1u32 << 20) => format!("{:.1} MiB", n / f64::from(1u32 << 20)),
        n if n >= 1024.0 => format!("{:.0} KiB", n / 1024.0),
        n => format!("{n:.0} B"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_told_in_units_that_fit() {
        assert_eq!(bytes(1536), "2 KiB");
        assert_eq!(bytes(3 << 29), "1.50 GiB");
    }
}
