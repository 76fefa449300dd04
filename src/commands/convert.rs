//! `esker convert`: scan files into one store.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::Args;

use crate::build::{self, AppendReport, BuildError, ConvertOptions, DEPTH_RANGE, Representative};
use crate::commands::inputs;
use crate::commands::progress::{ProgressKind, listener};
use crate::commands::quantities::{parse_bytes, show_bytes};
use crate::input::{Cancel, ColumnList, ReadOptions};
use crate::metrics::peak_rss_bytes;
use crate::store::SourceInfo;

/// Arguments of `esker convert`.
#[derive(Debug, Args)]
pub struct ConvertArgs {
    /// Scans: files, folders or patterns
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// The store to write
    #[arg(short, long, value_name = "OUT.esker", required_unless_present = "append")]
    output: Option<PathBuf>,
    /// Add the points of the scans to this store, in place
    #[arg(long, value_name = "STORE", conflicts_with_all = ["output", "overwrite", "depth", "threshold"])]
    append: Option<PathBuf>,
    /// With --append: write the store anew afterwards, without the bytes it no longer uses
    /// [default: when these are more than the others]
    #[arg(long, requires = "append")]
    compact: bool,
    /// Most memory to use, such as 4GiB [default: half of what there is]
    #[arg(long, value_parser = parse_bytes)]
    memory: Option<u64>,
    /// Worker threads [default: one per core]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    threads: usize,
    /// Folder of temporary files [default: the output's]
    #[arg(long)]
    temp_dir: Option<PathBuf>,
    /// Replace an existing store
    #[arg(long)]
    overwrite: bool,
    /// Levels within a node beyond its coarsest [default: 7, fewer for long records]
    #[arg(long, value_parser = clap::value_parser!(u32)
        .range(*DEPTH_RANGE.start() as i64..=*DEPTH_RANGE.end() as i64))]
    depth: Option<u32>,
    /// Fewest points that make a child node
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..))]
    threshold: u32,
    /// Which point of a cell stands for it
    #[arg(long, value_enum, default_value_t)]
    representative: Representative,
    /// Columns of text files: names separated by commas, `skip` for one to leave out
    /// [default: those of the header, or guessed]
    #[arg(long, value_name = "x,y,z,...", value_parser = parse_columns)]
    columns: Option<String>,
    /// Take what can be read of damaged files and account for the rest, instead of refusing them
    #[arg(long)]
    salvage: bool,
    /// Seconds between two notes of how far the work is, from which a killed run goes on
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0, value_parser = parse_seconds)]
    checkpoint_seconds: f64,
    /// Look at all points before sorting them, whatever bounds headers claim
    #[arg(long, hide = true)]
    read_twice: bool,
    /// How progress is shown on standard error
    #[arg(long, value_enum, default_value = "bar")]
    progress: ProgressKind,
    /// Print one JSON object at the end
    #[arg(long)]
    json: bool,
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| format!("'{text}' is not a number"))?;
    // As long as a clock can count.
    (0.0..=1e9).contains(&seconds).then_some(seconds).ok_or_else(|| "0 to 1e9".to_string())
}

/// Runs the command.
pub fn run(args: ConvertArgs) -> anyhow::Result<ExitCode> {
    let began = Instant::now();
    let files = inputs::expand(&args.inputs)?;
    let cancelled = cancelled_by_signal();
    let mut options = ConvertOptions {
        threads: args.threads,
        temp_dir: args.temp_dir.clone(),
        overwrite: args.overwrite,
        depth: args.depth.unwrap_or(0),
        threshold: args.threshold,
        representative: args.representative,
        trust_headers: !args.read_twice,
        compact_above: if args.compact { 0.0 } else { ConvertOptions::default().compact_above },
        checkpoint_every: Duration::from_secs_f64(args.checkpoint_seconds),
        read: ReadOptions {
            columns: args.columns,
            salvage: args.salvage,
            temp_dir: args.temp_dir,
            cancel: Cancel::when(&cancelled),
        },
        ..ConvertOptions::default()
    };
    if let Some(memory) = args.memory {
        options.memory_bytes = memory;
    }
    let progress = listener(args.progress);
    if let Some(store) = &args.append {
        let report = build::append(store, &files, &options, &*progress, &cancelled)?;
        drop(progress);
        return tell_append(store, &report, &options, began, args.json);
    }
    let output = args.output.context("an output or a store to append to is needed")?;
    let outcome = build::convert(&files, &output, &options, &*progress, &cancelled);
    drop(progress);
    if let (Err(BuildError::Interrupted), Some(kept)) =
        (&outcome, build::kept_work(&output, &options))
    {
        eprintln!(
            "esker: what is done so far waits in {} (the same command goes on from there, any \
             other conversion to this output removes it)",
            kept.display()
        );
    }
    let report = outcome?;
    for warning in &report.warnings {
        eprintln!("esker: {warning}");
    }
    if report.resumed {
        eprintln!("esker: went on from where an earlier run was stopped");
    }
    let seconds = began.elapsed().as_secs_f64();
    let peak = peak_rss_bytes();
    if args.json {
        let mut json = serde_json::to_value(&report)?;
        let more = serde_json::json!({
            "seconds": seconds,
            "points_per_second": report.points as f64 / seconds,
            "memory_bytes": options.memory_bytes,
            "peak_rss_bytes": peak,
            "output": output,
        });
        if let (Some(object), serde_json::Value::Object(more)) = (json.as_object_mut(), more) {
            object.extend(more);
        }
        println!("{json}");
    } else {
        println!(
            "{}: {} points in {} nodes, {} ({:.2} bytes a point), {seconds:.2} s, {:.2} M points/s{}",
            output.display(),
            report.points,
            report.nodes,
            show_bytes(report.output_bytes),
            report.output_bytes as f64 / report.points.max(1) as f64,
            report.points as f64 / seconds / 1e6,
            peak.map_or(String::new(), |peak| format!(", at most {} of memory", show_bytes(peak))),
        );
        print_account(&report.sources);
    }
    Ok(ExitCode::SUCCESS)
}

/// Tells what an addition to a store did.
fn tell_append(
    store: &Path,
    report: &AppendReport,
    options: &ConvertOptions,
    began: Instant,
    json: bool,
) -> anyhow::Result<ExitCode> {
    for warning in &report.warnings {
        eprintln!("esker: {warning}");
    }
    let (seconds, peak) = (began.elapsed().as_secs_f64(), peak_rss_bytes());
    if json {
        let mut json = serde_json::to_value(report)?;
        let more = serde_json::json!({
            "seconds": seconds,
            "points_per_second": report.new_points as f64 / seconds,
            "memory_bytes": options.memory_bytes,
            "peak_rss_bytes": peak,
            "output": store,
        });
        if let (Some(object), serde_json::Value::Object(more)) = (json.as_object_mut(), more) {
            object.extend(more);
        }
        println!("{json}");
    } else {
        if report.rebuilt {
            println!("the store could not hold the new points: all of it was written anew");
        }
        println!(
            "{}: {} points added, {} now in {} nodes, {} of them written ({}), {seconds:.2} s, \
             {} no longer in use",
            store.display(),
            report.new_points,
            report.points,
            report.nodes,
            report.nodes_written,
            show_bytes(report.bytes_written),
            show_bytes(report.unused_bytes),
        );
        print_account(&report.sources);
    }
    Ok(ExitCode::SUCCESS)
}

/// Sources that are told one by one.
const MOST_SOURCES_TOLD: usize = 20;

/// Where the points of each source went, if that is not obvious.
fn print_account(sources: &[SourceInfo]) {
    let is_obvious = |source: &&SourceInfo| {
        sources.len() == 1 && source.dropped.is_empty() && source.skipped.is_empty()
    };
    let told = sources.iter().filter(|source| !is_obvious(source));
    for source in told.clone().take(MOST_SOURCES_TOLD) {
        let scan = source.scan.as_ref().map_or(String::new(), |scan| format!(" ({scan})"));
        let kept = source.points - source.dropped_points().min(source.points);
        print!(
            "  {}{scan}: {} points came in, {kept} are in the store",
            source.name, source.points
        );
        for dropped in &source.dropped {
            print!(", {} dropped: {}", dropped.points, dropped.reason);
        }
        for skipped in &source.skipped {
            print!("; left out: {} {}", skipped.count, skipped.what);
        }
        println!();
    }
    let rest = told.skip(MOST_SOURCES_TOLD).count();
    if rest > 0 {
        println!("  and {rest} more sources (esker info tells all)");
    }
}

/// Checks a list of columns before any file is opened.
pub(super) fn parse_columns(text: &str) -> Result<String, String> {
    text.parse::<ColumnList>().map(|_| text.to_string())
}

/// A flag that SIGINT, SIGTERM and SIGHUP set.
pub(super) fn cancelled_by_signal() -> Arc<AtomicBool> {
    let cancelled = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&cancelled);
    // Fails only if a handler is there already, and then that one serves.
    let _ = ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed));
    cancelled
}
