//! `esker export`: a store's points back into a scan file.
//!
//! Without a selection every point and attribute of the input comes back, with its header's facts
//! and variable length records. Points stand in the store's order, coarse to fine.

use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::Ordering;

use anyhow::{Context, bail};
use clap::Args;
use glam::{DVec3, I64Vec3};
use rayon::prelude::*;

use super::convert::cancelled_by_signal;
use crate::build::BuildError;
use crate::geometry::Aabb;
use crate::ids::NodeId;
use crate::input::LasTemplate;
use crate::output::{Compression, LasWriter};
use crate::points::{Attribute, Schema, names, record_coordinates};
use crate::store::{Store, StoreError};

/// Arguments of `esker export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// The store
    store: PathBuf,
    /// The file to write; its suffix says what: .las or .laz
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
    /// Only points of these classes, such as 2,6
    #[arg(long, value_delimiter = ',')]
    class: Vec<u8>,
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

/// Nodes read side by side before their records are written in order.
const NODES_AT_ONCE: usize = 16;

/// Runs the command.
pub fn run(args: ExportArgs) -> anyhow::Result<ExitCode> {
    let store = Store::open(&args.store)?;
    let compression = compression_of(&args.output)?;
    if args.output.exists() && !args.overwrite {
        bail!("{}: exists already (--overwrite replaces it)", args.output.display());
    }
    let (template, evlr_offset) = template_of(&store)?;
    let schema = &store.metadata().schema;
    let source_bytes = source_bytes(schema);
    let own = Schema { record_bytes: schema.record_bytes - source_bytes as u32, ..schema.clone() };
    let mut writer = LasWriter::create(&args.output, &template, &own, compression)?;
    let selection = Selection::new(&args, &store)?;
    let nodes: Vec<NodeId> = (0..store.octree().nodes().len() as u32)
        .map(NodeId)
        .filter(|&node| selection.takes_node(&store, node))
        .collect();
    let cancelled = cancelled_by_signal();
    for group in nodes.chunks(NODES_AT_ONCE) {
        if cancelled.load(Ordering::Relaxed) {
            return Err(BuildError::Interrupted.into());
        }
        let parts: Vec<anyhow::Result<Vec<u8>>> = group
            .par_iter()
            .map(|&node| {
                let mut records = Vec::new();
                store.read_records(node, &mut records)?;
                selection.keep_points(&store, &mut records);
                cut_tails(&mut records, schema.record_bytes as usize, source_bytes);
                Ok(records)
            })
            .collect();
        for records in parts {
            let records = records.with_context(|| args.store.display().to_string())?;
            writer.write(&records)?;
        }
    }
    let mut evlrs = AppendixReader { store: &store, at: evlr_offset.0, left: evlr_offset.1 };
    let report = writer.finish(&mut evlrs)?;
    if args.json {
        let json = serde_json::json!({
            "output": args.output, "points": report.points, "output_bytes": report.bytes,
        });
        println!("{json}");
    } else {
        println!("{}: {} points, {} bytes", args.output.display(), report.points, report.bytes);
    }
    Ok(ExitCode::SUCCESS)
}

fn compression_of(path: &Path) -> anyhow::Result<Compression> {
    let suffix = path.extension().map(|suffix| suffix.to_string_lossy().to_ascii_lowercase());
    match suffix.as_deref() {
        Some("las") => Ok(Compression::None),
        Some("laz") => Ok(Compression::Laz),
        _ => bail!("{}: export writes .las and .laz files", path.display()),
    }
}

/// Bytes at the end of records that tell which of several files a point came from.
fn source_bytes(schema: &Schema) -> usize {
    let last = schema.attributes.last().filter(|last| last.name == names::SOURCE);
    last.map_or(0, Attribute::bytes)
}

/// Removes the last bytes of each record.
fn cut_tails(records: &mut Vec<u8>, record_bytes: usize, tail_bytes: usize) {
    if tail_bytes == 0 {
        return;
    }
    let kept = record_bytes - tail_bytes;
    let count = records.len() / record_bytes;
    for row in 1..count {
        records.copy_within(row * record_bytes..row * record_bytes + kept, row * kept);
    }
    records.truncate(count * kept);
}

/// Header and records of the first input, and where its extended records stand in the appendix.
fn template_of(store: &Store) -> anyhow::Result<(LasTemplate, (u64, u64))> {
    let path = store.path().display();
    let source = store.metadata().sources.first();
    let source = source.with_context(|| format!("{path}: it names no input file"))?;
    let header = store.read_appendix(0, source.header_bytes)?;
    let vlrs = store.read_appendix(source.header_bytes, source.vlr_bytes)?;
    let template = LasTemplate::new(header, vlrs, Vec::new())
        .map_err(|fault| anyhow::anyhow!("{path}: header of the input: {fault}"))?;
    Ok((template, (source.header_bytes + source.vlr_bytes, source.evlr_bytes)))
}

/// Which points to write.
struct Selection {
    /// Inclusive box on the store's lattice.
    steps: Option<(I64Vec3, I64Vec3)>,
    bounds: Option<Aabb>,
    level: u32,
    classes: Vec<u8>,
    /// Where the class stands in a record, and which bits of it.
    class_place: Option<(usize, u8)>,
}

impl Selection {
    fn new(args: &ExportArgs, store: &Store) -> anyhow::Result<Self> {
        let metadata = store.metadata();
        let class = metadata.schema.find(names::CLASSIFICATION);
        if !args.class.is_empty() && class.is_none() {
            bail!("{}: its points have no class", args.store.display());
        }
        // In formats up to 5 the upper bits of the class byte are flags; later ones have a byte.
        let is_las = metadata.sources.iter().any(|source| source.point_format.is_some());
        let old_format = is_las && metadata.schema.find(names::FLAGS).is_none();
        let class_bits = if old_format { 0x1f } else { 0xff };
        let lattice = metadata.lattice();
        let steps = args.bounds.map(|bounds| {
            let (low, high) = (lattice.lattice(bounds.min), lattice.lattice(bounds.max));
            // Coordinates are decimal numbers: what prints as on the border is inside.
            let slack = DVec3::splat(1e-6);
            ((low - slack).ceil().as_i64vec3(), (high + slack).floor().as_i64vec3())
        });
        Ok(Selection {
            steps,
            bounds: args.bounds,
            level: args.level.unwrap_or(u32::MAX),
            classes: args.class.clone(),
            class_place: class.map(|(_, a)| (a.record_offset as usize, class_bits)),
        })
    }

    fn takes_node(&self, store: &Store, node: NodeId) -> bool {
        let octree = store.octree();
        let near = |bounds: Aabb| {
            let slack = 1e-5 * store.metadata().lattice().scale;
            let node_box = octree.tight_box(node);
            Aabb::new(bounds.min - slack, bounds.max + slack).intersects(&node_box)
        };
        octree.node(node).depth <= self.level && self.bounds.is_none_or(near)
    }

    fn keep_points(&self, store: &Store, records: &mut Vec<u8>) {
        if self.steps.is_none() && self.classes.is_empty() {
            return;
        }
        let record_bytes = store.metadata().schema.record_bytes as usize;
        let takes = |record: &[u8]| {
            let inside = self.steps.is_none_or(|(low, high)| {
                let position = I64Vec3::from_array(record_coordinates(record).map(i64::from));
                position.cmpge(low).all() && position.cmple(high).all()
            });
            let class_fits = self.classes.is_empty()
                || self
                    .class_place
                    .is_some_and(|(at, bits)| self.classes.contains(&(record[at] & bits)));
            inside && class_fits
        };
        let mut end = 0;
        for start in (0..records.len()).step_by(record_bytes) {
            if takes(&records[start..start + record_bytes]) {
                records.copy_within(start..start + record_bytes, end);
                end += record_bytes;
            }
        }
        records.truncate(end);
    }
}

/// A range of a store's appendix, read in pieces.
struct AppendixReader<'a> {
    store: &'a Store,
    at: u64,
    left: u64,
}

impl Read for AppendixReader<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let length = (buffer.len() as u64).min(self.left);
        let bytes = self.store.read_appendix(self.at, length).map_err(|error| match error {
            StoreError::Io { source, .. } => source,
            other => io::Error::other(other),
        })?;
        buffer[..bytes.len()].copy_from_slice(&bytes);
        self.at += length;
        self.left -= length;
        Ok(bytes.len())
    }
}
