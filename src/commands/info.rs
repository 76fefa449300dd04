//! `esker info`: the facts of scans and stores, without reading their points.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use serde_json::{Value, json};

use crate::commands::convert::parse_columns;
use crate::commands::models::{self, ModelArgs};
use crate::commands::quantities::show_bytes;
use crate::input::{CoordinateKind, ForeignFacts, ReadOptions, Scan, ScanPart, detect_model};
use crate::store::Store;
pub use crate::store::is_store;

/// Arguments of `esker info`.
#[derive(Debug, Args)]
pub struct InfoArgs {
    /// Stores, scans or models
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Columns of text files: names separated by commas, `skip` for one to leave out
    /// [default: those of the header, or guessed]
    #[arg(long, value_name = "x,y,z,...", value_parser = parse_columns)]
    columns: Option<String>,
    #[command(flatten)]
    models: ModelArgs,
    /// Print one JSON object per file
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(args: InfoArgs) -> anyhow::Result<ExitCode> {
    let read = ReadOptions { columns: args.columns, ..ReadOptions::default() };
    for path in &args.files {
        let facts = if is_store(path) {
            store_facts(path)?
        } else if detect_model(path).is_some() {
            models::facts(path, &args.models.options())?
        } else {
            scan_facts(path, &read)?
        };
        if args.json {
            println!("{facts}");
        } else {
            print_facts(&facts);
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn store_facts(path: &Path) -> anyhow::Result<Value> {
    let store = Store::open(path)?;
    let (metadata, octree) = (store.metadata(), store.octree());
    let bounds = metadata.bounds();
    let levels = octree.nodes().last().map_or(0, |node| node.depth + 1);
    let mut nodes_per_level = vec![0u64; levels as usize];
    let mut points_per_level = vec![0u64; levels as usize];
    for node in octree.nodes() {
        nodes_per_level[node.depth as usize] += 1;
        points_per_level[node.depth as usize] += u64::from(node.point_count());
    }
    let attributes: Vec<Value> = metadata
        .schema
        .attributes
        .iter()
        .enumerate()
        .map(|(i, attribute)| {
            let ranges = metadata.attribute_ranges.get(i);
            json!({
                "name": attribute.name, "type": attribute.scalar,
                "components": attribute.components,
                "min": ranges.map(|r| r.iter().map(|range| range.min).collect::<Vec<_>>()),
                "max": ranges.map(|r| r.iter().map(|range| range.max).collect::<Vec<_>>()),
            })
        })
        .collect();
    let file_bytes = store.header().file_bytes;
    Ok(json!({
        "file": path, "format": "esker", "points": metadata.points,
        "bounds": (metadata.points > 0)
            .then(|| json!({"min": bounds.min.to_array(), "max": bounds.max.to_array()})),
        "scale": metadata.scale, "offset": metadata.offset,
        "epsg": metadata.crs.epsg, "wkt": metadata.crs.wkt,
        "attributes": attributes, "color_bits": metadata.color_bits,
        "levels": levels, "nodes": octree.nodes().len(),
        "nodes_per_level": nodes_per_level, "points_per_level": points_per_level,
        "levels_in_node": metadata.depth + 1, "threshold": metadata.threshold,
        "overflow_points": metadata.overflow_points,
        "file_bytes": file_bytes,
        "bytes_per_point": file_bytes as f64 / metadata.points.max(1) as f64,
        "sources": metadata.sources, "generator": metadata.generator,
    }))
}

fn scan_facts(path: &Path, read: &ReadOptions) -> anyhow::Result<Value> {
    let scan = Scan::open(path, read)?;
    let mut facts = match scan.las() {
        Some(las) => serde_json::to_value(las.facts())?,
        None => scan.foreign().map_or(Value::Null, foreign_facts),
    };
    let lattice = scan.lattice();
    let more = json!({
        "file": path,
        "file_bytes": scan.file_bytes(),
        "scale": lattice.scale.to_array(),
        "offset": lattice.offset.to_array(),
        "attributes": scan.schema().attributes.iter().map(|attribute| json!({
            "name": attribute.name, "type": attribute.scalar, "components": attribute.components,
        })).collect::<Vec<_>>(),
        "bytes_per_point": scan.file_bytes() as f64 / scan.points().max(1) as f64,
        "warnings": scan.warnings(),
    });
    if let (Some(facts), Value::Object(more)) = (facts.as_object_mut(), more) {
        facts.extend(more);
    }
    Ok(facts)
}

fn foreign_facts(facts: &ForeignFacts) -> Value {
    let coordinates = match facts.coordinates {
        CoordinateKind::F32 => "f32".to_string(),
        CoordinateKind::F64 => "f64".to_string(),
        CoordinateKind::Decimal { digits } => format!("text with {digits} digits after the point"),
        CoordinateKind::Lattice(_) => "integers".to_string(),
        CoordinateKind::Computed => "computed".to_string(),
    };
    let scan = |part: &ScanPart| {
        json!({
            "name": part.name, "points": part.points,
            "position": part.pose.map(|pose| pose.translation.to_array()),
            "rotation": part.pose.map(|pose| {
                let [x, y, z, w] = pose.rotation.to_array();
                [w, x, y, z]
            }),
        })
    };
    let is_plain = matches!(&facts.parts[..], [part] if part.name.is_none() && part.pose.is_none());
    let [min, max] = facts.bounds.map(|corner| corner.to_array());
    json!({
        "format": facts.format, "points": facts.points, "points_exact": true,
        "dropped_points": facts.dropped_points,
        "bounds": (facts.points > 0).then(|| json!({"min": min, "max": max})),
        "coordinates": coordinates,
        "scans": (!is_plain).then(|| facts.parts.iter().map(scan).collect::<Vec<_>>()),
        "skipped": (!facts.skipped.is_empty()).then(|| {
            let item = |(what, count): &(String, u64)| json!({"what": what, "count": count});
            facts.skipped.iter().map(item).collect::<Vec<_>>()
        }),
        "crs": facts.crs,
    })
}

/// Prints one line per fact, lists of objects one line per object.
fn print_facts(facts: &Value) {
    let Some(object) = facts.as_object() else { return };
    let file = object.get("file").and_then(Value::as_str).unwrap_or_default();
    println!("{file}");
    for (name, value) in object {
        let name = name.replace('_', " ");
        match value {
            Value::Null => {}
            _ if name == "file" => {}
            Value::Number(bytes) if name == "file bytes" => {
                println!("  {name}: {bytes} ({})", show_bytes(bytes.as_u64().unwrap_or(0)));
            }
            Value::Array(items) if items.iter().any(Value::is_object) => {
                println!("  {name}:");
                items.iter().for_each(|item| println!("    {}", one_line(item)));
            }
            Value::Object(_) => println!("  {name}: {}", one_line(value)),
            Value::String(text) => println!("  {name}: {text}"),
            other => println!("  {name}: {other}"),
        }
    }
}

fn one_line(value: &Value) -> String {
    let Some(object) = value.as_object() else { return value.to_string() };
    let show = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let parts: Vec<String> = object
        .iter()
        .filter(|(_, value)| !value.is_null())
        .map(|(name, value)| format!("{} {}", name.replace('_', " "), show(value)))
        .collect();
    parts.join(", ")
}
