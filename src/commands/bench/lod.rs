//! The suite `lod`: what a picture costs against how far it is from the reference picture.
//!
//! Three studies. *Rules*: the four level rules at several error settings, splats of one pixel, no
//! budget, so that only the choice of levels counts. *Sizes*: the four splat policies at rising
//! budgets, the default rule at 1 pixel. *Approach*: the rules at 1 pixel while the whole cloud
//! recedes, because the largest spacing that a rule accepts occurs only at some distances. Points and nodes repeat on any
//! machine; times are the least of two warm frames and compare within one run only. Two more
//! pairs of studies stand in `options` and `paths`.

use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;

use clap::ValueEnum;
use serde::Serialize;

use crate::build::available_memory;
#[cfg(feature = "gpu")]
use crate::commands::bench::paths;
use crate::commands::bench::plot::{Panel, Scale, Series, svg};
use crate::commands::bench::{BenchArgs, cameras, machine, open_all, options, write_file};
use crate::frame::{ColorMode, FrameSettings, NodeSource, Renderer, reference_picture};
use crate::geometry::View;
use crate::metrics::{PictureError, Pixels, compare};
use crate::passes::Picture;
use crate::select::{CutSettings, LevelRule, SplatPolicy, SplatSettings};

/// One picture: what was asked for, what it took, how far off it is. A row of the CSV file.
#[derive(Clone, Debug, Serialize)]
struct Row {
    scan: String,
    view: String,
    study: Study,
    rule: &'static str,
    splats: &'static str,
    error_px: f64,
    /// 0: none.
    point_budget: u64,
    points_drawn: u64,
    nodes_drawn: u32,
    select_ms: f64,
    frame_ms: f64,
    #[serde(flatten)]
    error: PictureError,
}

/// What a row belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Study {
    Rules,
    Sizes,
    Approach,
}

impl Study {
    fn name(self) -> &'static str {
        match self {
            Study::Rules => "rules",
            Study::Sizes => "sizes",
            Study::Approach => "approach",
        }
    }
}

const CSV_HEADER: &str = "scan,view,study,rule,splats,error_px,point_budget,points_drawn,\
    nodes_drawn,select_ms,frame_ms,hole_fraction,excess_fraction,rmse,ssim";

/// The parts of the suite that can be run alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum StudyChoice {
    /// Rules, sizes and approach: errors against points drawn
    Errors,
    /// Ways to show points: what each costs and changes
    Options,
    /// Ways to draw points: what each costs
    Paths,
}

impl BenchArgs {
    /// Whether a study is to be run.
    fn wants(&self, study: StudyChoice) -> bool {
        self.study.is_empty() || self.study.contains(&study)
    }
}

/// What is tried.
struct Plan {
    size: (u32, u32),
    view_step: usize,
    approach_steps: u32,
    errors_px: &'static [f64],
    budgets: &'static [u64],
}

impl Plan {
    fn new(args: &BenchArgs) -> Self {
        if args.quick {
            Plan {
                size: args.size.unwrap_or((640, 360)),
                view_step: 2,
                approach_steps: 4,
                errors_px: &[1.0, 2.0],
                budgets: &[50_000, 200_000, 800_000],
            }
        } else {
            Plan {
                size: args.size.unwrap_or((1280, 720)),
                view_step: 1,
                approach_steps: 10,
                errors_px: &[0.5, 1.0, 2.0, 4.0],
                budgets: &[
                    25_000, 50_000, 100_000, 200_000, 400_000, 800_000, 1_600_000, 3_200_000,
                    6_400_000,
                ],
            }
        }
    }
}

/// Runs the suite.
pub fn run(args: &BenchArgs) -> anyhow::Result<()> {
    let plan = Plan::new(args);
    let folder = tempfile::tempdir()?;
    let mut csv = format!("{CSV_HEADER}\n");
    for (name, store) in open_all(args, folder.path())? {
        let points = store.octree().point_count();
        let nodes = store.octree().nodes().len();
        let (width, height) = plan.size;
        println!(
            "{name}: {points} points, {nodes} nodes; {width}x{height}, drawn by {}\n",
            machine()
        );
        let source: Arc<dyn NodeSource> = Arc::new(store);
        if args.wants(StudyChoice::Errors) {
            let rows = measure(&name, Arc::clone(&source), &plan)?;
            rows.iter().for_each(|row| write_csv_row(&mut csv, row));
            print!("{}", rules_by_view(&rows, Study::Rules));
            print!("{}", rules_by_view(&rows, Study::Approach));
            print!("{}", means(&rows, Study::Rules));
            print!("{}", means(&rows, Study::Sizes));
            print!("{}", draw_economy(&rows));
            write_plot(&args.output, &name, &rows)?;
        }
        if args.wants(StudyChoice::Options) {
            options::run(args, &name, Arc::clone(&source))?;
        }
        #[cfg(feature = "gpu")]
        if args.wants(StudyChoice::Paths) {
            paths::run(args, &name, Arc::clone(&source))?;
        }
    }
    if args.wants(StudyChoice::Errors) {
        write_file(&args.output.join("lod.csv"), &csv)?;
    }
    println!("rows and plots are in {}", args.output.display());
    Ok(())
}

/// All pictures of one scan.
fn measure(name: &str, source: Arc<dyn NodeSource>, plan: &Plan) -> anyhow::Result<Vec<Row>> {
    let mut bench = Bench::new(name, Arc::clone(&source));
    let points = source.octree().point_count();
    let views = cameras::views_of(source.as_ref(), plan.size)?;
    for named_view in views.into_iter().step_by(plan.view_step) {
        if !bench.look_at(named_view)? {
            continue;
        }
        bench.rules(plan.errors_px, Study::Rules)?;
        let budgets = plan.budgets.iter().copied().filter(|&budget| budget < points);
        for point_budget in budgets.chain([points]) {
            for policy in SplatPolicy::ALL {
                let splat = SplatSettings { policy, ..SplatSettings::default() };
                let cut = CutSettings { point_budget, splat, ..CutSettings::default() };
                bench.add(Study::Sizes, cut)?;
            }
        }
    }
    for named_view in cameras::approach(source.as_ref(), plan.size, plan.approach_steps) {
        if bench.look_at(named_view)? {
            bench.rules(&[1.0], Study::Approach)?;
        }
    }
    Ok(bench.rows)
}

/// One scan, the view at hand with its reference picture, and the rows so far.
struct Bench {
    scan: String,
    source: Arc<dyn NodeSource>,
    renderer: Renderer,
    settings: FrameSettings,
    view: Option<(String, View, Picture)>,
    rows: Vec<Row>,
}

impl Bench {
    fn new(scan: &str, source: Arc<dyn NodeSource>) -> Self {
        let mut renderer = Renderer::on_cpu(available_memory() / 2);
        renderer.set_scene(vec![Arc::clone(&source)]);
        let settings = FrameSettings { color: ColorMode::Auto, ..FrameSettings::default() };
        Bench { scan: scan.to_owned(), source, renderer, settings, view: None, rows: Vec::new() }
    }

    /// Draws the reference picture of a view; `false` if it shows nothing.
    fn look_at(&mut self, (name, view): cameras::NamedView) -> anyhow::Result<bool> {
        let FrameSettings { color, background, .. } = &self.settings;
        let reference = reference_picture(self.source.as_ref(), &view, color, *background)?;
        let shows = reference.covered() > 0;
        self.view = Some((name, view, reference));
        Ok(shows)
    }

    /// The four rules with splats of one pixel and no budget.
    fn rules(&mut self, errors_px: &[f64], study: Study) -> anyhow::Result<()> {
        let one_px =
            SplatSettings { policy: SplatPolicy::Own, max_px: 1.0, ..SplatSettings::default() };
        let point_budget = self.source.octree().point_count();
        for rule in LevelRule::FOUR {
            for &error_px in errors_px {
                let splat = one_px;
                let cut =
                    CutSettings { point_budget, error_px, rule, splat, ..CutSettings::default() };
                self.add(study, cut)?;
            }
        }
        Ok(())
    }

    /// One row: the view at hand, drawn with these settings.
    fn add(&mut self, study: Study, cut: CutSettings) -> anyhow::Result<()> {
        let (view_name, view, reference) = self.view.as_ref().expect("a view was looked at");
        self.settings.cut = cut;
        let drawn = draw(&mut self.renderer, view, &self.settings)?;
        let unlimited = cut.point_budget >= self.source.octree().point_count();
        let splats = if study == Study::Sizes { cut.splat.policy.name() } else { "1 px" };
        self.rows.push(Row {
            scan: self.scan.clone(),
            view: view_name.clone(),
            study,
            rule: cut.rule.name(),
            splats,
            error_px: cut.error_px,
            point_budget: if unlimited { 0 } else { cut.point_budget },
            points_drawn: drawn.points_drawn,
            nodes_drawn: drawn.nodes_drawn,
            select_ms: drawn.select_ms,
            frame_ms: drawn.frame_ms,
            error: compare(pixels(reference), pixels(&drawn.picture)),
        });
        Ok(())
    }
}

struct Drawn {
    picture: Picture,
    points_drawn: u64,
    nodes_drawn: u32,
    select_ms: f64,
    frame_ms: f64,
}

/// Draws once to load what is needed, then twice for the time.
fn draw(renderer: &mut Renderer, view: &View, settings: &FrameSettings) -> anyhow::Result<Drawn> {
    let mut picture = renderer.render_picture(view, settings)?;
    let (mut select_ms, mut frame_ms) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..2 {
        picture = renderer.render_picture(view, settings)?;
        let stats = renderer.stats();
        let select = stats.passes.iter().find(|pass| pass.pass == "select");
        select_ms = select_ms.min(select.map_or(0.0, |pass| pass.pass_ms));
        frame_ms = frame_ms.min(stats.frame_ms);
    }
    let stats = renderer.stats();
    if let Some(problem) = stats.problems.first() {
        anyhow::bail!("{problem}");
    }
    let (points_drawn, nodes_drawn) = (stats.points_drawn, stats.nodes_drawn);
    Ok(Drawn { picture, points_drawn, nodes_drawn, select_ms, frame_ms })
}

pub(super) fn pixels(picture: &Picture) -> Pixels<'_> {
    Pixels { width_px: picture.width_px, colors: &picture.colors, distances: &picture.distances }
}

fn write_csv_row(csv: &mut String, row: &Row) {
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
fn rules_by_view(rows: &[Row], study: Study) -> String {
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
fn means(rows: &[Row], study: Study) -> String {
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
fn draw_economy(rows: &[Row]) -> String {
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

fn write_plot(folder: &Path, name: &str, rows: &[Row]) -> anyhow::Result<()> {
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
