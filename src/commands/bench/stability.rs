//! The suite `stability`: where points land and which pixels are wrong as numbers grow extreme.
//!
//! Sweeps of the offset from the origin, the extent, the near plane and the field of view, and sets
//! of points and cameras that are degenerate. For each value: the displacement on screen of every
//! point as the passes compute it against f64, and the pixels of every way of drawing against the
//! reference picture, which is f64 too. Scans are seeded, written, converted and drawn like any
//! other. Nothing here depends on time.

use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use serde::Serialize;

use crate::build::{self, ConvertOptions, Silent};
use crate::commands::bench::lod::pixels;
use crate::commands::bench::lod_tables::{count, percent};
use crate::commands::bench::plot::{Panel, Scale, Series, svg};
use crate::commands::bench::stability_sets as sets;
use crate::commands::bench::{BenchArgs, machine, write_file};
use crate::frame::{
    FrameError, FrameSettings, NodeSource, RasterPath, Renderer, reference_picture,
};
use crate::geometry::{Camera, View};
use crate::metrics::{Displacement, compare};
use crate::passes::splat::{eye_relative, local_cell, screen_of};
use crate::passes::{CloudDraw, DrawTable, NodePlace, Picture, Tile};
use crate::points::Lattice;
use crate::select::{AllResident, CutScratch, SplatSettings, SplatSize, select_nodes};
use crate::store::Store;

/// One value of a sweep, drawn by one path. A row of the CSV file.
#[derive(Clone, Debug, Serialize)]
struct Row {
    sweep: &'static str,
    case: String,
    value: f64,
    path: &'static str,
    points: u64,
    views: u32,
    displacement_max_px: f64,
    displacement_rms_px: f64,
    hole_fraction: f64,
    wrong_fraction: f64,
    rmse: f64,
    empty_pictures: u32,
    not_a_number: u64,
    refused: u32,
}

const CSV_HEADER: &str = "sweep,case,value,path,points,views,displacement_max_px,\
    displacement_rms_px,hole_fraction,wrong_fraction,rmse,empty_pictures,not_a_number,refused";

/// How a value of a sweep is made: a scan and the views of it.
pub(super) struct Case {
    pub(super) sweep: &'static str,
    pub(super) name: String,
    pub(super) value: f64,
    pub(super) lattice: Lattice,
    /// Lattice coordinates.
    pub(super) points: Vec<[i32; 3]>,
    /// Cameras relative to the lattice's offset, where f64 is exact.
    pub(super) cameras: Vec<Camera>,
    pub(super) size: (u32, u32),
    pub(super) budget: u64,
}

/// Runs the suite.
pub fn run(args: &BenchArgs) -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    let mut ways = Ways::open();
    println!("Stability, drawn by {} on {}\n", ways.names().join(", "), machine());
    let mut rows = Vec::new();
    for (index, case) in sets::cases(args.quick, args.size).into_iter().enumerate() {
        let path = folder.path().join(format!("case-{index}"));
        let found = measure(&case, &path, &mut ways)
            .with_context(|| format!("{} {}", case.sweep, case.name))?;
        rows.extend(found);
    }
    print!("{}", table(&rows));
    let mut csv = format!("{CSV_HEADER}\n");
    rows.iter().for_each(|row| write_csv_row(&mut csv, row));
    write_file(&args.output.join("stability.csv"), &csv)?;
    write_plot(&args.output, &rows)?;
    println!("rows and plots are in {}", args.output.display());
    let bad = rows.iter().filter(|row| row.empty_pictures > 0 || row.not_a_number > 0).count();
    anyhow::ensure!(bad == 0, "{bad} rows have empty pictures or places that are not numbers");
    Ok(())
}

/// A renderer for each way of drawing.
struct Ways {
    #[cfg(feature = "gpu")]
    gpu: Option<Arc<crate::gpu::Gpu>>,
    paths: Vec<RasterPath>,
}

impl Ways {
    fn open() -> Self {
        let mut paths = vec![RasterPath::Cpu];
        #[cfg(feature = "gpu")]
        {
            let gpu = crate::gpu::Gpu::open().ok().map(Arc::new);
            paths.extend(gpu.iter().flat_map(|gpu| RasterPath::offered_by(gpu)));
            Ways { gpu, paths }
        }
        #[cfg(not(feature = "gpu"))]
        {
            paths.dedup();
            Ways { paths }
        }
    }

    fn names(&self) -> Vec<&'static str> {
        self.paths.iter().map(|path| path.name()).collect()
    }

    fn renderer(&self, path: RasterPath) -> Result<Renderer, FrameError> {
        #[cfg(feature = "gpu")]
        if let (Some(gpu), true) = (&self.gpu, path != RasterPath::Cpu) {
            return Renderer::on_gpu(Arc::clone(gpu), path, 1 << 28);
        }
        let _ = path;
        Ok(Renderer::on_cpu(1 << 28))
    }
}

fn measure(case: &Case, path: &Path, ways: &mut Ways) -> anyhow::Result<Vec<Row>> {
    let scan = path.with_extension("las");
    sets::write_scan(&scan, case.lattice, &case.points)?;
    let converted = path.with_extension("esker");
    // Small nodes, so that small scans have many.
    let options = ConvertOptions { depth: 4, threshold: 64, ..ConvertOptions::default() };
    build::convert(&[scan], &converted, &options, &Silent, &AtomicBool::new(false))?;
    let source: Arc<dyn NodeSource> = Arc::new(Store::open(&converted)?);
    let offset = case.lattice.offset;
    let views = case.cameras.iter().map(|camera| {
        let moved = Camera { eye: camera.eye + offset, ..*camera };
        let [camera, moved] = [*camera, moved].map(|camera| View {
            camera,
            width_px: case.size.0,
            height_px: case.size.1,
        });
        (camera, moved)
    });
    let views: Vec<(View, View)> = views.collect();
    let settings = settings(case);
    let mut displacement = Displacement::default();
    let (mut references, mut not_a_number) = (Vec::new(), 0);
    for (exact, view) in &views {
        references.push(reference_picture(
            source.as_ref(),
            view,
            &settings.color,
            settings.background,
        )?);
        not_a_number += displace(source.as_ref(), case, exact, view, &mut displacement)?;
    }
    let mut rows = Vec::new();
    for path in ways.paths.clone() {
        let mut renderer = ways.renderer(path)?;
        renderer.set_scene(vec![Arc::clone(&source)]);
        let mut row = Row {
            sweep: case.sweep,
            case: case.name.clone(),
            value: case.value,
            path: path.name(),
            points: case.points.len() as u64,
            views: views.len() as u32,
            displacement_max_px: displacement.max_px,
            displacement_rms_px: displacement.rms_px(),
            hole_fraction: 0.0,
            wrong_fraction: 0.0,
            rmse: 0.0,
            empty_pictures: 0,
            not_a_number,
            refused: 0,
        };
        for ((_, view), reference) in views.iter().zip(&references) {
            match picture(&mut renderer, view, &settings) {
                Ok(picture) => note(&mut row, reference, &picture, case.budget),
                Err(error) => {
                    if !matches!(error, FrameError::View { .. }) {
                        return Err(error.into());
                    }
                    row.refused += 1;
                }
            }
        }
        rows.push(row);
    }
    Ok(rows)
}

/// All points, one pixel each.
fn settings(case: &Case) -> FrameSettings {
    let mut settings = FrameSettings::default();
    settings.cut.error_px = 0.0;
    settings.cut.point_budget = case.budget;
    settings.cut.splat.size = SplatSize::Fixed { px: 1.0 };
    settings
}

fn picture(
    renderer: &mut Renderer,
    view: &View,
    settings: &FrameSettings,
) -> Result<Picture, FrameError> {
    // Pictures of several parts have no distances.
    if view.width_px.max(view.height_px) > 4096 {
        let mut picture = renderer.render_picture(view, settings)?;
        if picture.distances.is_empty() {
            let distance = |color: &u32| match *color == settings.background {
                true => f32::INFINITY,
                false => 1.0,
            };
            picture.distances = picture.colors.iter().map(distance).collect();
        }
        return Ok(picture);
    }
    renderer.render(view, settings)?;
    Ok(renderer
        .read_picture()?
        .unwrap_or_else(|| Picture::empty(view.width_px, view.height_px, settings.background)))
}

fn note(row: &mut Row, reference: &Picture, picture: &Picture, budget: u64) {
    let covered = reference.covered();
    row.not_a_number +=
        picture.distances.iter().filter(|distance| distance.is_nan()).count() as u64;
    // A budget below the number of points leaves some out on purpose, maybe all that are seen.
    if covered == 0 || budget < row.points {
        return;
    }
    row.empty_pictures += u32::from(picture.covered() == 0);
    let error = compare(pixels(reference), pixels(picture));
    let wrong = (0..reference.colors.len())
        .filter(|&pixel| reference.colors[pixel] != picture.colors[pixel])
        .count() as f64;
    row.hole_fraction = row.hole_fraction.max(error.hole_fraction);
    row.wrong_fraction = row.wrong_fraction.max(wrong / covered as f64);
    row.rmse = row.rmse.max(error.rmse);
}

/// Adds the displacement of all points on screen; returns how many places are not numbers.
fn displace(
    source: &dyn NodeSource,
    case: &Case,
    exact: &View,
    view: &View,
    displacement: &mut Displacement,
) -> anyhow::Result<u64> {
    let octree = source.octree();
    let settings = settings(case);
    let everything = crate::select::CutSettings { point_budget: u64::MAX, ..settings.cut };
    let scratch = &mut CutScratch::default();
    let cut = select_nodes(octree, view, &everything, &AllResident, scratch);
    let place = |_| NodePlace::default();
    let mut table = DrawTable::default();
    let drawn = CloudDraw { octree, cut: &cut, place: &place, appeared: None };
    table.fill(&[drawn], view, &settings.cut.splat);
    let frame = Tile::whole(view).gpu_frame(view, &SplatSettings::default(), 0);
    let (width, height) = (f64::from(view.width_px), f64::from(view.height_px));
    let mut words = Vec::new();
    let mut not_a_number = 0;
    for (row, node) in cut.table.iter().zip(&table.nodes) {
        source.read_positions(row.node, &mut words)?;
        let base = octree.cell_min(row.node);
        for point in 0..octree.node(row.node).point_count() as usize {
            let cell = local_cell(node, &words, point);
            let steps = base + glam::UVec3::from(cell).as_i64vec3();
            let place = steps.as_dvec3() * case.lattice.scale;
            let [xw, yw, w] = screen_of(&frame, eye_relative(node, cell));
            not_a_number += u64::from(w.is_nan());
            let Some((x, y, distance)) = exact.project(place) else { continue };
            // A point at the near plane may be before it for one and behind it for the other.
            let is_clear = distance > exact.camera.near * (1.0 + 1e-6);
            if !is_clear || !(0.0..width).contains(&x) || !(0.0..height).contains(&y) {
                continue;
            }
            let drawn = [xw / w + frame.center_px[0], yw / w + frame.center_px[1]];
            displacement.add((x, y), (f64::from(drawn[0]), f64::from(drawn[1])));
        }
    }
    Ok(not_a_number)
}

fn table(rows: &[Row]) -> String {
    let mut out = format!(
        "{:<14}{:<30}{:>9}{:>7}{:>13}{:>13}{:<4}{:<12}{:>11}{:>11}{:>8}{:>7}\n",
        "sweep",
        "case",
        "points",
        "views",
        "max px off",
        "rms px off",
        "",
        "path",
        "wrong px",
        "holes",
        "empty",
        "NaN"
    );
    let mut before = "";
    for row in rows {
        let is_first = row.path == rows[0].path;
        if before != row.sweep {
            out.push('\n');
        }
        before = row.sweep;
        let (sweep, case, points, views) = match is_first {
            true => (row.sweep, row.case.as_str(), count(row.points as f64), row.views.to_string()),
            false => ("", "", String::new(), String::new()),
        };
        let off = |px: f64| if is_first { format!("{px:.6}") } else { String::new() };
        let _ = writeln!(
            out,
            "{sweep:<14}{case:<30}{points:>9}{views:>7}{:>13}{:>13}{:<4}{:<12}{:>11}{:>11}{:>8}{:>7}",
            off(row.displacement_max_px),
            off(row.displacement_rms_px),
            "",
            row.path,
            percent(row.wrong_fraction),
            percent(row.hole_fraction),
            row.empty_pictures,
            row.not_a_number
        );
    }
    let worst = rows.iter().map(|row| row.displacement_max_px).fold(0.0, f64::max);
    let refused: u32 = rows.iter().map(|row| row.refused).sum();
    let _ = writeln!(out, "\nLargest displacement {worst:.6} px; {refused} views refused\n");
    out
}

fn write_csv_row(csv: &mut String, row: &Row) {
    let _ = writeln!(
        csv,
        "{},\"{}\",{},{},{},{},{:.8},{:.8},{:.8},{:.8},{:.4},{},{},{}",
        row.sweep,
        row.case,
        row.value,
        row.path,
        row.points,
        row.views,
        row.displacement_max_px,
        row.displacement_rms_px,
        row.hole_fraction,
        row.wrong_fraction,
        row.rmse,
        row.empty_pictures,
        row.not_a_number,
        row.refused
    );
}

fn write_plot(folder: &Path, rows: &[Row]) -> anyhow::Result<()> {
    let sweeps = [
        ("offset", "offset, metres"),
        ("extent", "extent, metres"),
        ("near plane", "near plane, share of the extent"),
        ("field of view", "field of view, degrees"),
    ];
    let mut panels = Vec::new();
    for (sweep, x_label) in sweeps {
        let of = |path: &str, value: fn(&Row) -> f64| -> Vec<(f64, f64)> {
            let rows = rows.iter().filter(|row| row.sweep == sweep && row.path == path);
            // No offset stands a little left of the smallest.
            let place = |value: f64| if value > 0.0 { value } else { 10.0 };
            rows.map(|row| (place(row.value), value(row))).collect()
        };
        let panel = |title: &str, y_label: &str, series| Panel {
            title: format!("{sweep}: {title}"),
            x_label: x_label.into(),
            y_label: y_label.into(),
            x_scale: Scale::Log,
            y_scale: Scale::Log,
            series,
        };
        let displacement = vec![
            Series { name: "largest".into(), points: of("cpu", |row| row.displacement_max_px) },
            Series { name: "rms".into(), points: of("cpu", |row| row.displacement_rms_px) },
        ];
        panels.push(panel("displacement", "pixels", displacement));
        let wrong = ["cpu", "compute", "compute32", "raster"].map(|path| Series {
            name: path.into(),
            points: of(path, |row| 100.0 * row.wrong_fraction),
        });
        let wrong = wrong.into_iter().filter(|series| !series.points.is_empty()).collect();
        panels.push(panel("pixels unlike the reference", "%", wrong));
    }
    let heading = "Stability: places and pixels against f64";
    write_file(&folder.join("stability.svg"), &svg(heading, &panels, 4))
}
