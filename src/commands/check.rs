//! `esker check`: is every byte of a store what was written, and does the octree hold?

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;

use crate::commands::quantities::show_bytes;
use crate::store;

/// Arguments of `esker check`.
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// The store
    store: PathBuf,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// Findings printed in full; a store damaged all over says how many more there are.
const MOST_LINES: usize = 20;

/// Runs the command.
pub fn run(args: CheckArgs) -> anyhow::Result<ExitCode> {
    let report = store::check(&args.store)?;
    let path = args.store.display();
    if args.json {
        println!("{}", serde_json::to_string(&report)?);
    }
    for finding in report.findings.iter().take(MOST_LINES) {
        eprintln!("esker: {path}: {}", finding.message);
    }
    if report.findings.len() > MOST_LINES {
        eprintln!("esker: {path}: {} more findings", report.findings.len() - MOST_LINES);
    }
    if !report.findings.is_empty() {
        return Ok(ExitCode::FAILURE);
    }
    if !args.json {
        println!(
            "{path}: {} points in {} nodes, {}, all as written",
            report.points,
            report.nodes,
            show_bytes(report.bytes)
        );
    }
    Ok(ExitCode::SUCCESS)
}
