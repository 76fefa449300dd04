//! `esker generate`: a made-up scan of any size, or a made-up model, from a seed.

mod glb;

use std::io;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::Ordering;

use anyhow::Context;
use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};
use glam::DVec3;
use rayon::prelude::*;

use crate::build::BuildError;
use crate::commands::convert::cancelled_by_signal;
use crate::commands::quantities::parse_count;
use crate::input::{LasTemplate, NewScan, PointFormat};
use crate::mesh::scenes::{ModelScene, SceneKind, SurfaceSampler};
use crate::output::{Compression, LasWriter};
use crate::points::Lattice;
use crate::sampling::{Random, scene, scene::Scene, scene::SceneSettings};

/// Points made at once by one thread, and all threads together.
const PART_POINTS: usize = 1 << 15;
const BATCH_POINTS: usize = 1 << 19;

/// What the points show.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Subject {
    /// Hills, houses and trees, scanned from 48 stations and from the air.
    Scene,
    /// A cube filled evenly.
    Cube,
    /// The surfaces of a made model.
    Model(SceneKind),
}

const SUBJECTS: [Subject; 2 + SceneKind::ALL.len()] = {
    let mut all = [Subject::Scene; 2 + SceneKind::ALL.len()];
    all[1] = Subject::Cube;
    let mut at = 0;
    while at < SceneKind::ALL.len() {
        all[2 + at] = Subject::Model(SceneKind::ALL[at]);
        at += 1;
    }
    all
};

impl ValueEnum for Subject {
    fn value_variants<'a>() -> &'a [Self] {
        &SUBJECTS
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        let (name, help) = match self {
            Subject::Scene => {
                ("scene", "Hills, houses and trees, scanned from 48 stations and from the air")
            }
            Subject::Cube => ("cube", "A cube filled evenly"),
            Subject::Model(kind) => (kind.name(), kind.description()),
        };
        Some(PossibleValue::new(name).help(help))
    }
}

/// Arguments of `esker generate`.
#[derive(Debug, Args)]
pub struct GenerateArgs {
    /// File to write: .las or .laz; .glb for the model itself of a subject that has surfaces
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,

    /// Replace an existing file
    #[arg(long)]
    pub overwrite: bool,

    /// Number of points, such as 50M
    #[arg(long, default_value = "1M", value_parser = parse_count)]
    pub points: u64,

    /// Another seed gives other points
    #[arg(long, default_value_t = 1)]
    pub seed: u64,

    /// What the points show
    #[arg(long, value_enum, default_value_t = Subject::Scene)]
    pub subject: Subject,

    /// Size of a subject with surfaces, such as blocks along a side of the city [default: some
    /// thousand objects]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub size: Option<u32>,

    /// World coordinates of the lower corner
    #[arg(long, value_name = "X,Y,Z", value_parser = parse_corner, default_value = "476000,5429000,300", allow_hyphen_values = true)]
    pub origin: DVec3,

    /// World length of one step of the coordinates
    #[arg(long, default_value_t = 0.001)]
    pub step: f64,
}

/// Writes the file.
pub fn run(args: GenerateArgs) -> anyhow::Result<ExitCode> {
    let suffix = args.output.extension().map(|suffix| suffix.to_ascii_lowercase());
    if suffix.as_ref().is_some_and(|suffix| suffix == "glb") {
        return write_model(&args);
    }
    let compression = match suffix.as_ref().and_then(|suffix| suffix.to_str()) {
        Some("las") => Compression::None,
        Some("laz") => Compression::Laz,
        _ => anyhow::bail!("the output must end in .las, .laz or .glb: {}", args.output.display()),
    };
    refuse_existing(&args)?;
    anyhow::ensure!(args.step.is_finite() && args.step > 0.0, "--step must be above 0");
    let settings = SceneSettings {
        points: args.points,
        seed: args.seed,
        origin: args.origin,
        step: args.step,
    };
    let scene = Scene::new(settings);
    let made = make_model(&args);
    let surface = made.as_ref().map(|made| SurfaceSampler::new(&made.model, args.seed));
    let (scale, mut offset) = scene.scale_and_offset();
    if let Some(made) = &made {
        offset = args.origin;
        let far = made.model.bounds();
        let steps = far.min.abs().max(far.max.abs()).max_element() / args.step;
        anyhow::ensure!(steps < f64::from(i32::MAX), "--step is too small for the size");
    }
    let point_format = PointFormat::new(scene::POINT_FORMAT).expect("the scene's format exists");
    let template = LasTemplate::for_new_scan(&NewScan {
        minor: if args.points > u64::from(u32::MAX) { 4 } else { 2 },
        point_format,
        extra_bytes: 0,
        lattice: Lattice { scale, offset },
        system_identifier: "SYNTHETIC",
        generating_software: "esker generate",
        creation: (0, 0),
    });
    let (schema, _) = point_format.schema(scene::RECORD_BYTES as u16, &[]);
    let mut writer = LasWriter::create(&args.output, &template, &schema, compression)?;
    let mut records = vec![0; BATCH_POINTS * scene::RECORD_BYTES];
    let mut first = 0;
    let cancelled = cancelled_by_signal();
    while first < args.points {
        if cancelled.load(Ordering::Relaxed) {
            return Err(BuildError::Interrupted.into());
        }
        let count = (args.points - first).min(BATCH_POINTS as u64) as usize;
        let batch = &mut records[..count * scene::RECORD_BYTES];
        let parts = batch.par_chunks_mut(PART_POINTS * scene::RECORD_BYTES).enumerate();
        parts.for_each(|(part, records)| {
            let first = first + (part * PART_POINTS) as u64;
            scene.fill(first, records);
            if args.subject == Subject::Cube {
                spread(first, records, &args);
            }
            if let Some(surface) = &surface {
                put_on_surface(first, records, surface, args.step);
            }
        });
        writer.write(batch)?;
        first += count as u64;
    }
    let report = writer.finish(&mut io::empty())?;
    eprintln!("{} points, {} bytes: {}", report.points, report.bytes, args.output.display());
    Ok(ExitCode::SUCCESS)
}

fn refuse_existing(args: &GenerateArgs) -> anyhow::Result<()> {
    if args.output.exists() && !args.overwrite {
        anyhow::bail!("{}: exists already (--overwrite replaces it)", args.output.display());
    }
    Ok(())
}

fn make_model(args: &GenerateArgs) -> Option<ModelScene> {
    let Subject::Model(kind) = args.subject else { return None };
    Some(kind.make(args.size.unwrap_or(kind.usual_size()), args.seed))
}

/// Writes the model itself.
fn write_model(args: &GenerateArgs) -> anyhow::Result<ExitCode> {
    refuse_existing(args)?;
    let made = make_model(args)
        .context("only subjects with surfaces, such as city, are written as .glb")?;
    glb::write(&made.model, args.origin, &args.output)?;
    let (objects, triangles) = (made.model.objects.len(), made.model.triangle_count());
    eprintln!("{objects} objects, {triangles} triangles: {}", args.output.display());
    Ok(ExitCode::SUCCESS)
}

/// Where records of the scene hold red, green and blue.
const COLOR_AT: usize = 28;

/// Moves the scene's points onto the surfaces of a model, evenly by area, in their colours.
fn put_on_surface(first: u64, records: &mut [u8], surface: &SurfaceSampler, step: f64) {
    for (index, record) in (first..).zip(records.chunks_exact_mut(scene::RECORD_BYTES)) {
        let Some(point) = surface.point(index) else { return };
        let steps = (point.position / step).round();
        for axis in 0..3 {
            record[4 * axis..][..4].copy_from_slice(&(steps[axis] as i32).to_le_bytes());
            let color = u16::from(point.color[axis]) * 257;
            record[COLOR_AT + 2 * axis..][..2].copy_from_slice(&color.to_le_bytes());
        }
    }
}

/// Moves the scene's points to even places in a cube with the scene's edge.
fn spread(first: u64, records: &mut [u8], args: &GenerateArgs) {
    let half = 0.5 * scene::SIDE / args.step;
    for (index, record) in (first..).zip(records.chunks_exact_mut(scene::RECORD_BYTES)) {
        let mut random = Random::new(args.seed ^ 0x00c0_be00, index);
        for coordinate in record[..12].chunks_exact_mut(4) {
            coordinate.copy_from_slice(&(random.between(-half, half) as i32).to_le_bytes());
        }
    }
}

fn parse_corner(text: &str) -> anyhow::Result<DVec3> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    let numbers = numbers.with_context(|| format!("'{text}' is not X,Y,Z"))?;
    let corner: [f64; 3] =
        numbers.try_into().map_err(|_| anyhow::anyhow!("'{text}' is not X,Y,Z"))?;
    anyhow::ensure!(corner.iter().all(|axis| axis.is_finite()), "'{text}' is not finite");
    Ok(corner.into())
}
