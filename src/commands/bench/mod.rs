//! `esker bench`: suites that put run time and deterministic counts against error, in one run.

#[cfg(feature = "gpu")]
mod bare;
mod bars;
mod cameras;
mod convert;
mod culling;
mod limits;
mod lod;
mod lod_tables;
mod options;
#[cfg(feature = "gpu")]
mod paths;
#[cfg(feature = "gpu")]
mod paths_tables;
mod plot;
mod slow_bytes;
mod stability;
mod stability_sets;
mod steps;
mod stream;
mod time;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use anyhow::Context;
use clap::{Args, ValueEnum};

use crate::build::{self, ConvertOptions, Silent};
use crate::commands::inputs;
use crate::commands::quantities::{parse_bytes, parse_picture_size};
use crate::store::Store;

/// Arguments of `esker bench`.
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// What is measured
    #[arg(value_enum)]
    suite: Suite,
    /// lod, stream: stores or scans; scans are converted into a temporary store first. convert: scans
    /// [default: one beside the checkout, else one that is made]. time: stores or scans [default: a
    /// scan that is made]
    #[arg(value_name = "FILE", required_if_eq_any([("suite", "lod"), ("suite", "stream")]))]
    files: Vec<PathBuf>,
    /// Folder for the CSV file and the plots
    #[arg(short, long, value_name = "DIR", default_value = "out/bench")]
    output: PathBuf,
    /// Fewer views and settings, smaller pictures
    #[arg(long)]
    quick: bool,
    /// Size of the pictures [default: 1280x720, with --quick 640x360]
    #[arg(long, value_name = "WxH", value_parser = parse_picture_size)]
    size: Option<(u32, u32)>,
    /// lod: only these studies [default: all]
    #[arg(long, value_enum, value_delimiter = ',')]
    study: Vec<lod::StudyChoice>,
    /// culling: only these studies [default: all]
    #[arg(long, value_enum, value_delimiter = ',', value_name = "STUDY")]
    culling_study: Vec<culling::Study>,
    /// culling: only these courses of the studies of methods and of the device, such as city-walk
    /// [default: all]
    #[arg(long, value_delimiter = ',', value_name = "COURSE")]
    culling_course: Vec<String>,
    /// culling: frames of a course [default: 120, with --quick 12]
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    culling_frames: Option<u32>,
    /// stream: only these studies [default: all]
    #[arg(long, value_enum, value_delimiter = ',', value_name = "STUDY")]
    stream_study: Vec<stream::Study>,
    /// stream: flights from these disks only [default: all of the suite]
    #[arg(long, value_enum, value_delimiter = ',', value_name = "DISK")]
    stream_disk: Vec<stream::DiskChoice>,
    /// stream: frames of a flight [default: 300, with --quick 45]
    #[arg(long, value_name = "FRAMES", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    stream_frames: Option<u32>,
    /// time: only these studies [default: all]
    #[arg(long, value_enum, value_delimiter = ',', value_name = "STUDY")]
    time_study: Vec<time::Study>,
    /// convert: most memory to use, such as 2GiB [default: half of what there is]
    #[arg(long, value_parser = parse_bytes)]
    memory: Option<u64>,
}

/// The suites.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Suite {
    /// Level of detail: points drawn and time against holes, colour error and similarity
    Lod,
    /// Places and pixels against f64 as offsets, extents, near planes and angles grow extreme
    Stability,
    /// Conversion: the time of its stages against what the machine allows
    Convert,
    /// Streaming: time to the first and to the whole picture from slow disks, a flight through
    /// more than memory holds
    Stream,
    /// Rendering time: what estimators predict against what frames take
    Time,
    /// Occlusion culling: questions, triangles, time and wrong pixels of every method on made scenes
    Culling,
}

/// Runs a suite.
pub fn run(args: BenchArgs) -> anyhow::Result<ExitCode> {
    std::fs::create_dir_all(&args.output)
        .with_context(|| format!("{}: cannot make the folder", args.output.display()))?;
    match args.suite {
        Suite::Lod => lod::run(&args)?,
        Suite::Convert => convert::run(&args)?,
        Suite::Stream => stream::run(&args)?,
        Suite::Stability => stability::run(&args)?,
        Suite::Time => time::run(&args)?,
        Suite::Culling => culling::run(&args)?,
    }
    Ok(ExitCode::SUCCESS)
}

/// The stores of the arguments, each with its name; scans are converted into `folder`.
fn open_all(args: &BenchArgs, folder: &Path) -> anyhow::Result<Vec<(String, Store)>> {
    open_files(&args.files, folder)
}

/// The stores of some files, each with its name; scans are converted into `folder`.
fn open_files(files: &[PathBuf], folder: &Path) -> anyhow::Result<Vec<(String, Store)>> {
    let mut stores = Vec::new();
    for path in inputs::expand(files)? {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let store = if inputs::is_scan(&path) {
            let converted = folder.join(format!("{}-{stem}.esker", stores.len()));
            let options = ConvertOptions::default();
            let scan = std::slice::from_ref(&path);
            build::convert(scan, &converted, &options, &Silent, &AtomicBool::new(false))?;
            Store::open(&converted)?
        } else {
            Store::open(&path)?
        };
        stores.push((stem, store));
    }
    Ok(stores)
}

/// The machine, for the reader of a table: threads and the processor's name where it is told.
fn machine() -> String {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = info.lines().find_map(|line| line.strip_prefix("model name")?.split(": ").nth(1));
    format!("{threads} threads of {}", name.unwrap_or(std::env::consts::ARCH))
}

/// Rows of a CSV file that are on disk as soon as they are known, so that a suite that is stopped
/// leaves what it has measured.
struct RowFile {
    path: PathBuf,
    file: std::fs::File,
}

impl RowFile {
    /// Begins a file with its header.
    fn begin(path: PathBuf, header: &str) -> anyhow::Result<Self> {
        let file = std::fs::File::create(&path)
            .with_context(|| format!("{}: cannot write", path.display()))?;
        let mut rows = RowFile { path, file };
        rows.add(&format!("{header}\n"))?;
        Ok(rows)
    }

    /// Adds a line, its end included.
    fn add(&mut self, line: &str) -> anyhow::Result<()> {
        let written = self.file.write_all(line.as_bytes());
        written.with_context(|| format!("{}: cannot write", self.path.display()))
    }
}

fn write_file(path: &Path, content: &str) -> anyhow::Result<()> {
    std::fs::write(path, content).with_context(|| format!("{}: cannot write", path.display()))
}
