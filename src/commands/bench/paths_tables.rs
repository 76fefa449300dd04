//! What the studies *paths* and *splats* print and write.

use std::fmt::Write;
use std::path::Path;

use crate::commands::bench::paths::{Found, Row};
use crate::commands::bench::plot::{Panel, Scale, Series, svg};
use crate::commands::bench::write_file;

pub(super) fn paths_table(view: &str, found: &[Found], copy_gb_s: f64) -> String {
    let rows: Vec<&Row> = found.iter().map(|found| &found.row).collect();
    let of = |path: &str| rows.iter().find(|row| row.path == path);
    let mut out = format!(
        "Paths, {view}: points of one pixel; least times of whole frames\n{:<14}{:>9}{:>7}{:>10}\
         {:>9}{:>9}{:>11}{:>9}{:>11}{:>11}{:>9}{:>9}{:>11}{:>9}\n",
        "path",
        "points",
        "nodes",
        "frame ms",
        "/ bare",
        "list /",
        "cores' ms",
        "/ bare",
        "points ms",
        "resolve ms",
        "B/point",
        "of copy",
        "differing",
        "no ties"
    );
    for row in &rows {
        let against = |of: Option<&&Row>, value: fn(&Row) -> f64| match of.map(|of| value(of)) {
            Some(other) if other > 0.0 && value(row) > 0.0 => value(row) / other,
            _ => f64::NAN,
        };
        let ratio = |ratio: f64| match ratio.is_nan() {
            true => String::new(),
            false => format!("{ratio:.2}"),
        };
        // Without a clock of the device the whole frame counts.
        let pass_ms = if row.points_ms > 0.0 { row.points_ms } else { row.frame_ms };
        let gb_s = row.points_drawn as f64 * row.bytes_per_point / pass_ms * 1e-6;
        let _ = writeln!(
            out,
            "{:<14}{:>9}{:>7}{:>10.2}{:>9}{:>9}{:>11.2}{:>9}{:>11.2}{:>11.2}{:>9.1}{:>9}{:>11}\
             {:>9}",
            row.path,
            row.points_drawn,
            row.nodes_drawn,
            row.frame_ms,
            ratio(against(of("bare loop"), |row| row.frame_ms)),
            ratio(1.0 / against(of("point list"), |row| row.frame_ms)),
            row.processor_ms,
            ratio(against(of("bare loop"), |row| row.processor_ms)),
            row.points_ms,
            row.resolve_ms,
            row.bytes_per_point,
            format!("{:.1} %", 100.0 * gb_s / copy_gb_s),
            row.pixels_differing,
            row.pixels_differing - row.pixels_tied
        );
    }
    out.push('\n');
    out
}

pub(super) fn splats_table(view: &str, rows: &[Row]) -> String {
    let mut out = format!(
        "Splats, {view}: points of one size, squares; least times of whole frames, ms\n{:<12}{:>9}",
        "side", "points"
    );
    let mut paths: Vec<&str> = rows.iter().map(|row| row.path).collect();
    paths.dedup();
    let mut names: Vec<&str> = Vec::new();
    paths.into_iter().for_each(|path| {
        if !names.contains(&path) {
            names.push(path)
        }
    });
    names.iter().for_each(|name| out.push_str(&format!("{name:>12}")));
    out.push('\n');
    let mut sides: Vec<f64> = rows.iter().map(|row| row.splat_px).collect();
    sides.dedup();
    for side in sides {
        let of_side: Vec<&Row> = rows.iter().filter(|row| row.splat_px == side).collect();
        let _ = write!(out, "{:<12}{:>9}", format!("{side:.0} px"), of_side[0].points_drawn);
        for name in &names {
            let row = of_side.iter().find(|row| row.path == *name);
            out.push_str(&row.map_or(String::new(), |row| format!("{:>12.1}", row.frame_ms)));
        }
        let worst = of_side.iter().map(|row| row.pixels_differing - row.pixels_tied).max();
        let _ = writeln!(out, "   pixels unlike the CPU's but for ties: {}", worst.unwrap_or(0));
    }
    out.push('\n');
    out
}

pub(super) fn write_csv_row(csv: &mut String, row: &Row) {
    let _ = writeln!(
        csv,
        "{},\"{}\",{},{},{:.2},{},{},{},{},{},{:.3},{:.3},{:.3},{:.3},{:.3},{:.3},{},{}",
        row.scan,
        row.view,
        row.study,
        row.path,
        row.splat_px,
        row.points_drawn,
        row.nodes_drawn,
        row.splat_pixels,
        row.dispatches,
        row.draw_calls,
        row.bytes_per_point,
        row.frame_ms,
        row.processor_ms,
        row.points_ms,
        row.grow_ms,
        row.resolve_ms,
        row.pixels_differing,
        row.pixels_tied
    );
}

pub(super) fn write_plot(folder: &Path, name: &str, rows: &[Row]) -> anyhow::Result<()> {
    let rows: Vec<&Row> = rows.iter().filter(|row| row.study == "splats").collect();
    let mut series: Vec<Series> = Vec::new();
    for row in rows {
        let point = (row.splat_px, row.frame_ms);
        match series.iter_mut().find(|line| line.name == row.path) {
            Some(line) => line.points.push(point),
            None => series.push(Series { name: row.path.to_owned(), points: vec![point] }),
        }
    }
    let panel = Panel {
        title: "splats of one size".into(),
        x_label: "side, pixels".into(),
        y_label: "frame time, ms".into(),
        x_scale: Scale::Log,
        y_scale: Scale::Log,
        series,
    };
    let heading = format!("{name}: ways to draw splats");
    write_file(&folder.join(format!("lod-splats-{name}.svg")), &svg(&heading, &[panel], 1))
}
