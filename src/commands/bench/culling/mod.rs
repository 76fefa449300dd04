//! `esker bench culling`: what each way of occlusion culling asks, draws and gets wrong, on made
//! scenes along camera paths.
//!
//! Every method sees the same scene, tree and cameras, frame by frame beside the others; its picture
//! is compared with that of frustum culling pixel by pixel. Counters repeat on any machine. The
//! times are of the exact software device, which draws on one core: ratios within a run only.

mod methods;
#[cfg(feature = "gpu")]
mod on_device;
#[cfg(feature = "gpu")]
mod points;
mod race;
#[cfg(feature = "gpu")]
mod shading;
mod studies;

use std::fmt::Write;

use anyhow::Context;
use clap::ValueEnum;

use crate::commands::bench::{BenchArgs, machine, write_file};
use crate::mesh::scenes::{CameraPath, SceneKind};

use race::{Race, Result};

/// The parts of the suite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Study {
    /// All methods on all scenes.
    Methods,
    /// The parts of CHC++ one after the other.
    Ablation,
    /// Error against cost as the visibility threshold grows.
    Threshold,
    /// The size of batches, and rounds allowed.
    Batches,
    /// Times, and the ways to deal with late answers, on the adapter that is there.
    #[cfg(feature = "gpu")]
    Device,
    /// Times on the adapter as shading grows dearer, with depth first and without.
    #[cfg(feature = "gpu")]
    Shading,
    /// Points of a store of the city, along its paths on the device; only for stores that are named.
    Points,
}

/// Sizes of a run.
#[derive(Clone, Copy, Debug)]
struct Extent {
    width: u32,
    height: u32,
    frames: u32,
    quick: bool,
}

impl Extent {
    fn of(args: &BenchArgs) -> Self {
        let usual = if args.quick { (160, 90) } else { (640, 360) };
        let (width, height) = args.size.unwrap_or(usual);
        let frames = args.culling_frames.unwrap_or(if args.quick { 12 } else { 120 });
        Extent { width, height, frames, quick: args.quick }
    }

    /// The size at which a scene is made.
    fn scene_size(&self, kind: SceneKind) -> u32 {
        if !self.quick {
            return kind.usual_size();
        }
        match kind {
            SceneKind::City | SceneKind::Terrain | SceneKind::Rooms => 3,
            SceneKind::Pipes => 8,
            SceneKind::Boxes | SceneKind::Window => 300,
            SceneKind::Shells => 6,
            SceneKind::Plates | SceneKind::Field => 16,
            SceneKind::Slit => 100,
        }
    }
}

/// Scenes with the paths they are tried on.
const COURSES: [(SceneKind, CameraPath); 13] = [
    (SceneKind::City, CameraPath::Walk),
    (SceneKind::City, CameraPath::Fly),
    (SceneKind::City, CameraPath::Rise),
    (SceneKind::City, CameraPath::Rotate),
    (SceneKind::Pipes, CameraPath::Walk),
    (SceneKind::Rooms, CameraPath::Walk),
    (SceneKind::Terrain, CameraPath::Walk),
    (SceneKind::Boxes, CameraPath::Walk),
    (SceneKind::Window, CameraPath::Walk),
    (SceneKind::Shells, CameraPath::Walk),
    (SceneKind::Plates, CameraPath::Still),
    (SceneKind::Field, CameraPath::Still),
    (SceneKind::Slit, CameraPath::Walk),
];

/// The courses that were asked for.
fn courses(args: &BenchArgs) -> impl Iterator<Item = (SceneKind, CameraPath)> {
    let chosen = |(kind, path): &(SceneKind, CameraPath)| {
        let name = format!("{}-{}", kind.name(), path.name());
        args.culling_course.is_empty() || args.culling_course.contains(&name)
    };
    COURSES.into_iter().filter(chosen)
}

/// Runs the suite.
pub(super) fn run(args: &BenchArgs) -> anyhow::Result<()> {
    let extent = Extent::of(args);
    println!(
        "culling: {}x{}, {} frames, software device on {}",
        extent.width,
        extent.height,
        extent.frames,
        machine()
    );
    let chosen = |study| args.culling_study.is_empty() || args.culling_study.contains(&study);
    let mut csv = String::from(Result::CSV_HEAD);
    if chosen(Study::Methods) {
        studies::methods(&extent, &mut csv, args)?;
    }
    if chosen(Study::Ablation) {
        studies::ablation(&extent, &mut csv);
    }
    if chosen(Study::Threshold) {
        studies::threshold(&extent, &mut csv, args)?;
    }
    if chosen(Study::Batches) {
        studies::batches(&extent, &mut csv);
    }
    #[cfg(feature = "gpu")]
    if chosen(Study::Points) && !args.files.is_empty() {
        points::run(&extent, args)?;
    }
    write_file(&args.output.join("culling.csv"), &csv)?;
    #[cfg(feature = "gpu")]
    if chosen(Study::Device) || chosen(Study::Shading) {
        on_device::run(&extent, args, chosen(Study::Device), chosen(Study::Shading))?;
    }
    Ok(())
}

/// Prints a table of results and adds their lines.
fn report(heading: &str, race: &Race, csv: &mut String) {
    println!("\n{heading}: {} objects, {} triangles", race.objects, race.triangles);
    println!("{}", Result::TABLE_HEAD);
    for result in race.results() {
        println!("{}", result.table_line());
        let _ = writeln!(csv, "{}", result.csv_line(heading));
    }
}

/// Writes a plot.
fn save_plot(args: &BenchArgs, name: &str, svg: &str) -> anyhow::Result<()> {
    let path = args.output.join(name);
    write_file(&path, svg).context("the plot")
}
