//! The suite `convert`: how far a conversion is from what the machine allows.
//!
//! In one run: conversions of the scan, with the time of each stage, and then each step that bounds
//! them, alone (see `limits`). Conversions come first, so that the peak of memory is theirs. Times
//! compare within one run only.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use glam::DVec3;
use rayon::prelude::*;

use crate::build::{self, ConvertOptions, ConvertReport, Progress, Stage};
use crate::commands::bench::bars::{Bar, svg};
use crate::commands::bench::limits::{self, Limits};
use crate::commands::bench::{BenchArgs, machine, write_file};
use crate::commands::generate::{self, GenerateArgs, Subject};
use crate::commands::inputs;
use crate::ids::NodeId;
use crate::metrics::peak_rss_bytes;
use crate::store::{SectionContent, Store};

/// What is converted if nothing is named and it is there.
const DEFAULT_SCAN: &str = "../shared/data/autzen-rgb-10m.laz";
/// Points of the scan that is made otherwise.
const GENERATED_POINTS: u64 = 10_000_000;
const QUICK_POINTS: u64 = 300_000;
/// Conversions of each scan; the median counts.
const RUNS: usize = 3;

const CSV_HEADER: &str = "scan,points,kind,step,ns_per_point,points_per_second";

/// Runs the suite.
pub fn run(args: &BenchArgs) -> anyhow::Result<()> {
    let folder = tempfile::tempdir_in(&args.output)?;
    let mut csv = format!("{CSV_HEADER}\n");
    for path in scans(args, folder.path())? {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let runs = if args.quick { 1 } else { RUNS };
        let conversion = convert(&path, folder.path(), args, runs)?;
        let limits = limits::measure(&path, folder.path())?;
        let result = Measured { name, conversion, limits };
        print!("{}", result.table());
        result.write_csv(&mut csv);
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        write_file(&args.output.join(format!("convert-{stem}.svg")), &result.plot())?;
    }
    write_file(&args.output.join("convert.csv"), &csv)?;
    println!("rows and plots are in {}", args.output.display());
    Ok(())
}

/// The scans of the arguments, else the default one, else one made in `folder`.
fn scans(args: &BenchArgs, folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    if !args.files.is_empty() {
        return inputs::expand(&args.files);
    }
    let default = PathBuf::from(DEFAULT_SCAN);
    if default.exists() && !args.quick {
        return Ok(vec![default]);
    }
    let output = folder.join("generated.laz");
    generate::run(GenerateArgs {
        size: None,
        output: output.clone(),
        overwrite: true,
        points: if args.quick { QUICK_POINTS } else { GENERATED_POINTS },
        seed: 1,
        subject: Subject::Scene,
        origin: DVec3::new(476_000.0, 5_429_000.0, 300.0),
        step: 0.001,
    })?;
    Ok(vec![output])
}

/// The median conversion of some.
struct Conversion {
    report: ConvertReport,
    seconds: f64,
    /// Each stage with its seconds; together the whole.
    stages: Vec<(&'static str, f64)>,
    peak_rss_bytes: Option<u64>,
    reading: Reading,
}

/// Seconds to open a store and decode its nodes, on all cores.
#[derive(Clone, Copy)]
struct Reading {
    /// Every section.
    all: f64,
    /// What a coloured picture needs.
    drawn: f64,
}

/// Reads a store some times; the fastest counts.
fn read_back(path: &Path) -> anyhow::Result<Reading> {
    let mut fastest = Reading { all: f64::INFINITY, drawn: f64::INFINITY };
    for _ in 0..RUNS {
        for is_drawn in [false, true] {
            let began = Instant::now();
            let store = Store::open(path)?;
            let wanted = |content| {
                !is_drawn || matches!(content, SectionContent::Positions | SectionContent::Color)
            };
            let sections = &store.metadata().sections;
            (0..store.octree().nodes().len() as u32).into_par_iter().try_for_each_init(
                Vec::new,
                |bytes, node| {
                    let sections = sections.iter().enumerate();
                    sections.filter(|(_, section)| wanted(section.content)).try_for_each(
                        |(section, _)| store.read_section(NodeId(node), section, bytes),
                    )
                },
            )?;
            let seconds = began.elapsed().as_secs_f64();
            let best = if is_drawn { &mut fastest.drawn } else { &mut fastest.all };
            *best = best.min(seconds);
        }
    }
    Ok(fastest)
}

fn convert(
    path: &Path,
    folder: &Path,
    args: &BenchArgs,
    runs: usize,
) -> anyhow::Result<Conversion> {
    let store = folder.join("bench.esker");
    let mut options = ConvertOptions { overwrite: true, ..ConvertOptions::default() };
    options.memory_bytes = args.memory.unwrap_or(options.memory_bytes);
    let mut conversions = Vec::with_capacity(runs);
    let mut reading = Reading { all: 0.0, drawn: 0.0 };
    for _ in 0..runs {
        let clock = StageClock::default();
        let began = Instant::now();
        let input = [path.to_path_buf()];
        let report = build::convert(&input, &store, &options, &clock, &AtomicBool::new(false))?;
        let ended = Instant::now();
        let seconds = (ended - began).as_secs_f64();
        let stages = clock.stages(began, ended);
        let peak_rss_bytes = peak_rss_bytes();
        if conversions.len() + 1 == runs {
            reading = read_back(&store)?;
        }
        std::fs::remove_file(&store)?;
        conversions.push(Conversion { report, seconds, stages, peak_rss_bytes, reading });
    }
    conversions.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    let peak = conversions.iter().filter_map(|conversion| conversion.peak_rss_bytes).max();
    let median = conversions.swap_remove(conversions.len() / 2);
    Ok(Conversion { peak_rss_bytes: peak, reading, ..median })
}

/// Notes when stages begin.
#[derive(Default)]
struct StageClock {
    begun: Mutex<Vec<(Stage, Instant)>>,
}

impl Progress for StageClock {
    fn begin(&self, stage: Stage, _: u64) {
        self.begun.lock().expect("no holder of the lock panics").push((stage, Instant::now()));
    }

    fn advance(&self, _: u64) {}
}

impl StageClock {
    /// Seconds of each stage, in order; what stands before the first counts as opening.
    fn stages(self, began: Instant, ended: Instant) -> Vec<(&'static str, f64)> {
        let begun = self.begun.into_inner().expect("no holder of the lock panics");
        let names = ["open"].into_iter().chain(begun.iter().map(|(stage, _)| stage.name()));
        let starts = [began].into_iter().chain(begun.iter().map(|&(_, start)| start));
        let ends = begun.iter().map(|&(_, start)| start).chain([ended]);
        let mut stages: Vec<(&'static str, f64)> = Vec::new();
        for ((name, start), end) in names.zip(starts).zip(ends) {
            let seconds = end.saturating_duration_since(start).as_secs_f64();
            match stages.iter_mut().find(|(known, _)| *known == name) {
                Some((_, sum)) => *sum += seconds,
                None => stages.push((name, seconds)),
            }
        }
        stages
    }
}

/// All that was measured with one scan.
struct Measured {
    name: String,
    conversion: Conversion,
    limits: Limits,
}

impl Measured {
    fn ns_per_point(&self, seconds: f64) -> f64 {
        seconds * 1e9 / self.conversion.report.points.max(1) as f64
    }

    fn per_point(&self, bytes: u64) -> f64 {
        bytes as f64 / self.conversion.report.points.max(1) as f64
    }

    /// Wall time of the limit, for one point: processor, disk, the larger of both.
    fn limit(&self) -> (f64, f64, f64) {
        let report = &self.conversion.report;
        let output = self.per_point(report.output_bytes);
        let temporary = self.per_point(report.temporary_bytes);
        let (processor, disk) = self.limits.parts_ns(output, temporary);
        (processor, disk, self.limits.limit_ns(output, temporary))
    }

    /// Rows of the CSV file: kind, step, nanoseconds of wall time for one point.
    fn rows(&self) -> Vec<(&'static str, &'static str, f64)> {
        let cores = self.limits.cores as f64;
        let steps = self.limits.steps.iter();
        let mut rows: Vec<_> =
            steps.map(|step| ("bound", step.name, step.core_ns / cores)).collect();
        let (processor, disk, limit) = self.limit();
        rows.extend([
            ("limit", "processor", processor),
            ("limit", "disk", disk),
            ("limit", "limit", limit),
        ]);
        let stages = self.conversion.stages.iter();
        rows.extend(stages.map(|&(name, seconds)| ("stage", name, self.ns_per_point(seconds))));
        rows.push(("conversion", "whole", self.ns_per_point(self.conversion.seconds)));
        let reading = self.conversion.reading;
        rows.push(("reading", "all of the store", self.ns_per_point(reading.all)));
        rows.push(("reading", "positions and colours", self.ns_per_point(reading.drawn)));
        rows
    }

    fn table(&self) -> String {
        let (report, limits) = (&self.conversion.report, &self.limits);
        let mut out = format!(
            "{}: {} points of {} bytes; {}\n\n",
            self.name,
            report.points,
            limits.record_bytes,
            machine()
        );
        line(&mut out, format_args!("{:<28}{:>14}{:>14}", "", "ns a point", "M points/s"));
        let mut kind = "";
        for (row_kind, name, ns) in self.rows() {
            let heading = match row_kind {
                "bound" => "each step alone, on all cores",
                "limit" => "the limit, if all overlapped",
                "stage" => "stages of a conversion",
                "reading" => "opening the store and decoding its nodes",
                _ => "",
            };
            if row_kind != kind && !heading.is_empty() {
                line(&mut out, format_args!("{heading}"));
            }
            kind = row_kind;
            line(&mut out, format_args!("  {name:<26}{ns:>14.1}{:>14.2}", 1e3 / ns.max(1e-9)));
        }
        let (_, _, limit) = self.limit();
        let whole = self.ns_per_point(self.conversion.seconds);
        line(
            &mut out,
            format_args!(
                "\nconversion: {:.2} s, {:.1} x the limit ({:.0} % of its rate)",
                self.conversion.seconds,
                whole / limit,
                100.0 * limit / whole
            ),
        );
        let output = self.per_point(report.output_bytes);
        line(
            &mut out,
            format_args!(
                "store: {output:.2} bytes a point, {:.2} x the records (columns alone {:.2}); \
                 temporary files {:.1} bytes a point, in memory: {}",
                output / f64::from(limits.record_bytes),
                limits.column_bytes,
                self.per_point(report.temporary_bytes),
                if report.in_memory { "yes" } else { "no" },
            ),
        );
        if let Some(decode) = limits.steps.iter().find(|step| step.name == "decode") {
            let decode = decode.core_ns / limits.cores as f64;
            let reading = self.conversion.reading;
            line(
                &mut out,
                format_args!(
                    "reading: decoding the input takes {:.1} x as long as all of the store, {:.1} x \
                     as long as its positions and colours",
                    decode / self.ns_per_point(reading.all),
                    decode / self.ns_per_point(reading.drawn),
                ),
            );
        }
        if let Some(peak) = self.conversion.peak_rss_bytes {
            line(&mut out, format_args!("peak memory: {:.0} MB", peak as f64 / 1e6));
        }
        out.push('\n');
        out
    }

    fn write_csv(&self, csv: &mut String) {
        let scan = self.name.replace([',', '"', '\n'], "_");
        let points = self.conversion.report.points;
        for (kind, name, ns) in self.rows() {
            let rate = 1e9 / ns.max(1e-9);
            line(csv, format_args!("{scan},{points},{kind},{name},{ns:.3},{rate:.0}"));
        }
    }

    fn plot(&self) -> String {
        let rows = self.rows();
        let parts = |wanted: &str| {
            let rows = rows.iter().filter(|(kind, _, _)| *kind == wanted);
            rows.map(|&(_, name, ns)| (name.to_string(), ns)).collect::<Vec<_>>()
        };
        let (_, disk, _) = self.limit();
        let bars = [
            Bar { name: "steps alone".into(), parts: parts("bound") },
            Bar { name: "disk alone".into(), parts: vec![("disk".into(), disk)] },
            Bar { name: "conversion".into(), parts: parts("stage") },
        ];
        svg(&format!("Conversion of {} beside its limit", self.name), "ns a point", &bars)
    }
}

fn line(out: &mut String, content: std::fmt::Arguments) {
    writeln!(out, "{content}").expect("a string takes all text");
}
