//! What the suite `lod` prints and writes: tables, rows and plots.

use std::fmt::Write;
use std::path::Path;

use crate::commands::bench::lod::{Row, Study};
use crate::commands::bench::plot::{Panel, Scale, Series, svg};
use crate::commands::bench::write_file;
use crate::metrics::PictureError;

pub(super) fn write_csv_row(csv: &mut String, row: &Row) {
    let error = &row.error;
    let scan = row.scan.replace([',', '"', '\n'], "_");
    let result = writeln!(
        csv,
        "{scan},\"{}\",{},\"{}\",{},{},{},{},{},{:.4},{:.3},{:.8},{:.8},{:.4},{:.6}",
        row.view,
        row.study.name(),
        row.rule,
        row.splats,
        row.error_px,
        row.point_budget,
        row.points_drawn,
        row.nodes_drawn,
        row.select_ms,
        row.frame_ms,
        error.hole_fraction,
        error.excess_fraction,
        error.rmse,
        error.ssim
    );
    result.expect("a string takes all text");
}

/// The rules side by side for each view, at the wanted error of one pixel.
pub(super) fn rules_by_view(rows: &[Row], study: Study) -> String {
    let rows: Vec<&Row> =
        rows.iter().filter(|row| row.study == study && row.error_px == 1.0).collect();
    let views = unique(rows.iter().map(|row| row.view.as_str()));
    let rules = unique(rows.iter().map(|row| row.rule));
    let mut out = format!(
        "{} at 1 px, splats of 1 px, no budget: points drawn, share of the reference's pixels \
         left empty, colour RMSE\n",
        if study == Study::Approach { "Approach" } else { "Rules" }
    );
    let mut line = |name: &str, cells: Vec<String>| {
        let cells: String = cells.iter().map(|cell| format!("{cell:>26}")).collect();
        out.push_str(&format!("{name:<20}{cells}\n"));
    };
    line("view", rules.iter().map(|rule| rule.to_string()).collect());
    for view in views {
        let cell = |rule: &&str| {
            let row = rows.iter().find(|row| row.view == view && row.rule == *rule);
            row.map_or(String::new(), |row| cell(row.points_drawn as f64, &row.error))
        };
        line(view, rules.iter().map(cell).collect());
    }
    let of_rule =
        |rule: &str| -> Vec<&Row> { rows.iter().copied().filter(|row| row.rule == rule).collect() };
    line(
        "mean",
        rules
            .iter()
            .map(|rule| {
                let rows = of_rule(rule);
                let mean = Mean::of(&rows);
                cell(mean.points, &mean.error)
            })
            .collect(),
    );
    line(
        "most holes",
        rules.iter().map(|rule| percent(Mean::of(&of_rule(rule)).most_holes)).collect(),
    );
    out.push('\n');
    out
}

fn cell(points: f64, error: &PictureError) -> String {
    format!("{} {:>9} {:>5.2}", count(points), percent(error.hole_fraction), error.rmse)
}

/// Means over the views for each line and setting of a study.
pub(super) fn means(rows: &[Row], study: Study) -> String {
    let rows: Vec<&Row> = rows.iter().filter(|row| row.study == study).collect();
    let names = |row: &Row| match study {
        Study::Sizes => (row.splats, budget_name(row.point_budget)),
        _ => (row.rule, format!("{} px", row.error_px)),
    };
    let title = match study {
        Study::Sizes => "Splat sizes and budgets, parent cell, edge, at 1 px",
        _ => "Rules and error settings, splats of 1 px, no budget",
    };
    let mut out = format!(
        "{title}: means over the views\n{:<24}{:<10}{:>9}{:>9}{:>11}{:>10}{:>11}{:>11}{:>8}{:>8}\n",
        study.name(),
        "setting",
        "points",
        "nodes",
        "select ms",
        "frame ms",
        "holes",
        "most holes",
        "RMSE",
        "SSIM"
    );
    for (name, setting) in unique(rows.iter().map(|row| names(row))) {
        let group: Vec<&Row> =
            rows.iter().copied().filter(|row| names(row) == (name, setting.clone())).collect();
        let mean = Mean::of(&group);
        out.push_str(&format!(
            "{name:<24}{setting:<10}{:>9}{:>9.0}{:>11.3}{:>10.1}{:>11}{:>11}{:>8.2}{:>8.4}\n",
            count(mean.points),
            mean.nodes,
            mean.select_ms,
            mean.frame_ms,
            percent(mean.error.hole_fraction),
            percent(mean.most_holes),
            mean.error.rmse,
            mean.error.ssim
        ));
    }
    out.push('\n');
    out
}

/// How many points a draw has, and the most draws of one picture, with the default rule.
pub(super) fn draw_economy(rows: &[Row]) -> String {
    let rows: Vec<&Row> =
        rows.iter().filter(|row| row.study == Study::Sizes && row.point_budget == 0).collect();
    let points: u64 = rows.iter().map(|row| row.points_drawn).sum();
    let nodes: u64 = rows.iter().map(|row| u64::from(row.nodes_drawn)).sum();
    let most = rows.iter().map(|row| row.nodes_drawn).max().unwrap_or(0);
    let mean = points as f64 / nodes.max(1) as f64;
    format!("Parent cell, edge, at 1 px: {mean:.0} points per node drawn, at most {most} nodes\n\n")
}

/// Means over rows.
struct Mean {
    points: f64,
    nodes: f64,
    select_ms: f64,
    frame_ms: f64,
    error: PictureError,
    most_holes: f64,
}

impl Mean {
    fn of(rows: &[&Row]) -> Self {
        let mean = |value: &dyn Fn(&Row) -> f64| {
            rows.iter().map(|row| value(row)).sum::<f64>() / rows.len().max(1) as f64
        };
        Mean {
            points: mean(&|row| row.points_drawn as f64),
            nodes: mean(&|row| f64::from(row.nodes_drawn)),
            select_ms: mean(&|row| row.select_ms),
            frame_ms: mean(&|row| row.frame_ms),
            error: PictureError {
                hole_fraction: mean(&|row| row.error.hole_fraction),
                excess_fraction: mean(&|row| row.error.excess_fraction),
                rmse: mean(&|row| row.error.rmse),
                ssim: mean(&|row| row.error.ssim),
            },
            most_holes: rows.iter().map(|row| row.error.hole_fraction).fold(0.0, f64::max),
        }
    }
}

pub(super) fn write_plot(folder: &Path, name: &str, rows: &[Row]) -> anyhow::Result<()> {
    let points = |mean: &Mean| mean.points;
    let time = |mean: &Mean| mean.frame_ms;
    let holes = |mean: &Mean| 100.0 * mean.error.hole_fraction;
    let rmse = |mean: &Mean| mean.error.rmse;
    let unlike = |mean: &Mean| 1.0 - mean.error.ssim;
    type Value = fn(&Mean) -> f64;
    let columns: [(&str, Value, &str, Value); 4] = [
        ("points drawn", points, "empty pixels, %", holes),
        ("points drawn", points, "colour RMSE (0-255)", rmse),
        ("points drawn", points, "1 - SSIM", unlike),
        ("frame time, ms", time, "colour RMSE (0-255)", rmse),
    ];
    let studies = [
        (Study::Rules, "rules, rising error settings"),
        (Study::Sizes, "splat sizes, rising budgets"),
    ];
    let mut panels = Vec::new();
    for (study, title) in studies {
        let lines = lines(rows, study);
        for (x_label, x, y_label, y) in columns {
            let series = lines.iter().map(|(name, means)| Series {
                name: (*name).to_owned(),
                points: means.iter().map(|mean| (x(mean), y(mean))).collect(),
            });
            panels.push(Panel {
                title: title.to_owned(),
                x_label: x_label.to_owned(),
                y_label: y_label.to_owned(),
                x_scale: Scale::Log,
                y_scale: Scale::Log,
                series: series.collect(),
            });
        }
    }
    let heading = format!("{name}: error against the reference picture, mean over the views");
    write_file(&folder.join(format!("lod-{name}.svg")), &svg(&heading, &panels, 4))
}

/// The lines of a study's plots: per rule or policy the means over the views of each setting, from
/// few points to many.
fn lines(rows: &[Row], study: Study) -> Vec<(&'static str, Vec<Mean>)> {
    let line_of = |row: &Row| if study == Study::Rules { row.rule } else { row.splats };
    let setting_of = |row: &Row| (row.error_px, row.point_budget);
    let rows: Vec<&Row> = rows.iter().filter(|row| row.study == study).collect();
    let line = |name: &'static str| {
        let rows: Vec<&Row> = rows.iter().copied().filter(|row| line_of(row) == name).collect();
        let mean = |setting| {
            let group = rows.iter().copied().filter(|row| setting_of(row) == setting);
            Mean::of(&group.collect::<Vec<_>>())
        };
        let settings = unique(rows.iter().map(|row| setting_of(row)));
        let mut means: Vec<Mean> = settings.into_iter().map(mean).collect();
        means.sort_by(|a, b| a.points.total_cmp(&b.points));
        (name, means)
    };
    unique(rows.iter().map(|row| line_of(row))).into_iter().map(line).collect()
}

/// The different values, in order of appearance.
fn unique<T: PartialEq>(values: impl IntoIterator<Item = T>) -> Vec<T> {
    let mut seen = Vec::new();
    for value in values {
        if !seen.contains(&value) {
            seen.push(value);
        }
    }
    seen
}

fn budget_name(point_budget: u64) -> String {
    match point_budget {
        0 => "all".into(),
        budget => count(budget as f64).trim().into(),
    }
}

/// A count in thousands or millions.
pub(super) fn count(points: f64) -> String {
    match points {
        p if p < 9_995.0 => format!("{p:>7.0}"),
        p if p < 999_500.0 => format!("{:>6.0}k", p / 1e3),
        p => format!("{:>6.2}M", p / 1e6),
    }
}

pub(super) fn percent(share: f64) -> String {
    format!("{:.3} %", 100.0 * share)
}
