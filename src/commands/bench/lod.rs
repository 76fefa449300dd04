//! The suite `lod`: what a picture costs against how far it is from the reference picture.
//!
//! Three studies. *Rules*: the four level rules at several error settings, splats of one pixel, no
//! budget, so that only the choice of levels counts. *Sizes*: the four splat policies at rising
//! budgets, the default rule at 1 pixel. *Approach*: the rules at 1 pixel while the whole cloud
//! recedes, because the largest spacing that a rule accepts occurs only at some distances. Points and nodes repeat on any
//! machine; times are the least of two warm frames and compare within one run only. Two more
//! pairs of studies stand in `options` and `paths`.

use std::sync::Arc;

use clap::ValueEnum;
use serde::Serialize;

use crate::build::available_memory;
use crate::commands::bench::lod_tables::{
    draw_economy, means, rules_by_view, write_csv_row, write_plot,
};
#[cfg(feature = "gpu")]
use crate::commands::bench::paths;
use crate::commands::bench::{BenchArgs, cameras, machine, open_all, options, write_file};
use crate::frame::{ColorMode, FrameSettings, NodeSource, Renderer, reference_picture};
use crate::geometry::View;
use crate::metrics::{PictureError, Pixels, compare};
use crate::passes::Picture;
use crate::select::{CutSettings, LevelRule, SplatPolicy, SplatSettings};

/// One picture: what was asked for, what it took, how far off it is. A row of the CSV file.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Row {
    pub(super) scan: String,
    pub(super) view: String,
    pub(super) study: Study,
    pub(super) rule: &'static str,
    pub(super) splats: &'static str,
    pub(super) error_px: f64,
    /// 0: none.
    pub(super) point_budget: u64,
    pub(super) points_drawn: u64,
    pub(super) nodes_drawn: u32,
    pub(super) select_ms: f64,
    pub(super) frame_ms: f64,
    #[serde(flatten)]
    pub(super) error: PictureError,
}

/// What a row belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Study {
    Rules,
    Sizes,
    Approach,
}

impl Study {
    pub(super) fn name(self) -> &'static str {
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
