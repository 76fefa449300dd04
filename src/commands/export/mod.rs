//! `esker export`: a store's points back into a scan file.
//!
//! Without a selection every point and attribute of the input comes back, with its header's facts
//! and variable length records. Points stand in the store's order, coarse to fine.

mod las;
mod rows;
mod selection;
mod tabular;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::bail;
use clap::Args;
use glam::DVec3;
use rayon::prelude::*;

use super::convert::cancelled_by_signal;
use super::quantities::parse_count;
use crate::build::BuildError;
use crate::geometry::Aabb;
use crate::ids::NodeId;
use crate::output::{PlyEncoding, TextKind, WriteReport};
use crate::store::Store;
use rows::{RowReader, origin_of};
use selection::Selection;

/// Arguments of `esker export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// The store
    store: PathBuf,
    /// The file to write; its suffix says what: .las, .laz, .copc.laz, .ply, .xyz, .txt, .csv, .pts
    #[arg(short, long)]
    output: PathBuf,
    /// Replace an existing file
    #[arg(long)]
    overwrite: bool,
    /// Only points inside: minx,miny,minz,maxx,maxy,maxz
    #[arg(long, value_parser = parse_bounds, allow_hyphen_values = true)]
    bounds: Option<Aabb>,
    /// Only nodes down to this depth of the octree (0 is the root)
    #[arg(long)]
    level: Option<u32>,
    /// At most so many points, such as 2M: the coarsest levels of the whole cloud
    #[arg(long, value_parser = parse_count)]
    budget: Option<u64>,
    /// Only points of these classes, such as 2,6
    #[arg(long, value_delimiter = ',')]
    class: Vec<u8>,
    /// Write PLY as text
    #[arg(long)]
    ascii: bool,
    /// Print one JSON object at the end
    #[arg(long)]
    json: bool,
}

fn parse_bounds(text: &str) -> Result<Aabb, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|n| n.trim().parse::<f64>()).collect();
    match numbers.as_deref() {
        Ok(&[x0, y0, z0, x1, y1, z1]) if numbers.iter().flatten().all(|n| n.is_finite()) => {
            Ok(Aabb::new(DVec3::new(x0, y0, z0), DVec3::new(x1, y1, z1)))
        }
        _ => Err(format!("'{text}' is not six numbers minx,miny,minz,maxx,maxy,maxz")),
    }
}

/// What the suffix of a file asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Las,
    Laz,
    Copc,
    Ply,
    Text(TextKind),
}

impl Format {
    fn of(path: &Path) -> anyhow::Result<Self> {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        let suffixes = [
            (".copc.laz", Format::Copc),
            (".las", Format::Las),
            (".laz", Format::Laz),
            (".ply", Format::Ply),
            (".xyz", Format::Text(TextKind::Xyz)),
            (".pts", Format::Text(TextKind::Pts)),
            (".txt", Format::Text(TextKind::Txt)),
            (".csv", Format::Text(TextKind::Csv)),
        ];
        let found = suffixes.iter().find(|(suffix, _)| name.ends_with(suffix));
        match found {
            Some((_, format)) => Ok(*format),
            None => {
                let known: Vec<&str> = suffixes.iter().map(|(suffix, _)| *suffix).collect();
                bail!("{}: export writes {}", path.display(), known.join(", "))
            }
        }
    }
}

/// What the export of one store works with.
struct Job<'a> {
    store: &'a Store,
    output: &'a Path,
    rows: RowReader<'a>,
    cancelled: &'a AtomicBool,
}

/// What came of it, and what the file cannot say.
struct Outcome {
    report: WriteReport,
    notes: Vec<String>,
}

/// Runs the command.
pub fn run(args: ExportArgs) -> anyhow::Result<ExitCode> {
    let format = Format::of(&args.output)?;
    let store = Store::open(&args.store)?;
    if args.output.exists() && !args.overwrite {
        bail!("{}: exists already (--overwrite replaces it)", args.output.display());
    }
    let selection = Selection::new(&args, &store, origin_of(&store))?;
    let cancelled = cancelled_by_signal();
    let rows = RowReader::new(&store, &selection);
    let job = Job { store: &store, output: &args.output, rows, cancelled: &cancelled };
    let outcome = match format {
        Format::Las | Format::Laz => las::write_las(&job, format == Format::Laz)?,
        Format::Copc => las::write_copc(&job)?,
        Format::Ply if args.ascii => tabular::write_ply(&job, PlyEncoding::Ascii)?,
        Format::Ply => tabular::write_ply(&job, PlyEncoding::BinaryLittleEndian)?,
        Format::Text(kind) => tabular::write_text(&job, kind)?,
    };
    let Outcome { report, notes } = outcome;
    notes.iter().for_each(|note| eprintln!("esker: {}: {note}", args.output.display()));
    if args.json {
        let json = serde_json::json!({
            "output": args.output, "points": report.points, "output_bytes": report.bytes,
            "notes": notes,
        });
        println!("{json}");
    } else {
        println!("{}: {} points, {} bytes", args.output.display(), report.points, report.bytes);
    }
    Ok(ExitCode::SUCCESS)
}

/// Points whose rows are in memory at once, if nodes are not larger.
const POINTS_AT_ONCE: u64 = 1 << 19;

impl Job<'_> {
    fn check_cancelled(&self) -> anyhow::Result<()> {
        if self.cancelled.load(Ordering::Relaxed) {
            return Err(BuildError::Interrupted.into());
        }
        Ok(())
    }

    /// Smallest and largest values of the store's attributes.
    fn ranges(&self) -> Vec<Vec<[f64; 2]>> {
        let ranges = self.store.metadata().attribute_ranges.iter();
        ranges
            .map(|components| components.iter().map(|range| [range.min, range.max]).collect())
            .collect()
    }

    /// Calls `take` with what `encode` makes of each node's rows, in the order of nodes. Nodes are
    /// read and encoded side by side.
    fn for_each_node(
        &self,
        encode: &(dyn Fn(&[u8], &mut Vec<u8>) + Sync),
        take: &mut dyn FnMut(&[u8], u64) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        let nodes: Vec<NodeId> =
            (0..self.store.octree().nodes().len() as u32).map(NodeId).collect();
        let row_bytes = self.store.metadata().schema.record_bytes as usize;
        let mut rest = &nodes[..];
        let mut buffers: Vec<(Vec<u8>, Vec<u8>)> = Vec::new();
        while !rest.is_empty() {
            self.check_cancelled()?;
            let mut points = 0;
            let count = rest
                .iter()
                .take_while(|&&node| {
                    let fits = points < POINTS_AT_ONCE;
                    points += self.rows.most_points(node);
                    fits
                })
                .count();
            let (group, after) = rest.split_at(count);
            rest = after;
            buffers.resize_with(buffers.len().max(count), Default::default);
            let work = group.par_iter().zip(&mut buffers);
            work.try_for_each(|(&node, (rows, encoded))| -> anyhow::Result<()> {
                self.rows.read(node, rows)?;
                encoded.clear();
                encode(rows, encoded);
                Ok(())
            })?;
            for (rows, encoded) in &buffers[..count] {
                take(encoded, (rows.len() / row_bytes) as u64)?;
            }
        }
        Ok(())
    }
}
