//! The suite `stream`: how soon a picture is there, and what a flight through a store that is
//! larger than memory costs.
//!
//! *Start*: a store is opened and drawn from outside until nothing is missing, from the machine's
//! own disk and from slower ones, through the loader and without it, at several upload quotas.
//! *Flight*: a camera flies through the scan at 30 frames a second with caps that hold a tenth of
//! it; with and without reading ahead and keeping. What was missing in each frame is counted
//! against what the frame wants, and some frames are compared with the picture that has all of it.
//!
//! Times are the wall clock's and differ from run to run; counts of reads and bytes nearly repeat
//! (which nodes are under way when the view changes is a matter of time). Rows of both studies are
//! written and printed as they come: a run that is stopped leaves what it saw.

mod flight;
mod start;

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::ValueEnum;

use self::flight::{Caching, FLIGHT_HEADER, FLIGHT_NOTES, FlightRows, fly};
use self::start::{START_HEADER, start_rows};
use crate::commands::bench::plot::svg;
use crate::commands::bench::slow_bytes::{Disk, SlowBytes};
use crate::commands::bench::{BenchArgs, RowFile, machine, open_all, write_file};
use crate::frame::{FIRST_PICTURE_BYTES, FrameSettings, Loading, Renderer};
use crate::geometry::View;
use crate::gpu::layout::position_words;
use crate::ids::NodeId;
use crate::store::Store;

/// Points drawn at most, as in a window without a GPU.
const POINT_BUDGET: u64 = 2_000_000;
const MIB: u64 = 1 << 20;
/// Longest wait for a picture to be complete.
const PATIENCE: Duration = Duration::from_secs(180);
const FRAME_TIME: Duration = Duration::from_nanos(33_333_333);

/// The parts of the suite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Study {
    /// From opening a store to its first and its whole picture
    Start,
    /// A camera through a store that is larger than the room for it
    Flight,
}

/// The disks of flights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum DiskChoice {
    /// The machine's own
    Local,
    /// 8 ms a read, 150 MB/s
    Spinning,
    /// 50 ms a read, 25 MB/s
    Distant,
}

impl DiskChoice {
    fn disk(self) -> Disk {
        match self {
            DiskChoice::Local => Disk::LOCAL,
            DiskChoice::Spinning => Disk::SPINNING,
            DiskChoice::Distant => Disk::DISTANT,
        }
    }
}

impl BenchArgs {
    fn wants_stream(&self, study: Study) -> bool {
        self.stream_study.is_empty() || self.stream_study.contains(&study)
    }
}

/// What is tried.
struct Plan {
    size: (u32, u32),
    disks: &'static [Disk],
    quotas: &'static [u64],
    flight_frames: u32,
    flight_disks: Vec<Disk>,
    looked_at: u32,
}

impl Plan {
    fn new(args: &BenchArgs) -> Self {
        let mut plan = Plan::of_suite(args);
        plan.flight_frames = args.stream_frames.unwrap_or(plan.flight_frames);
        if !args.stream_disk.is_empty() {
            plan.flight_disks = args.stream_disk.iter().map(|choice| choice.disk()).collect();
        }
        plan
    }

    fn of_suite(args: &BenchArgs) -> Self {
        if args.quick {
            Plan {
                size: args.size.unwrap_or((640, 360)),
                disks: &[Disk::LOCAL, Disk::SPINNING],
                quotas: &[8 * MIB],
                flight_frames: 45,
                flight_disks: vec![Disk::SPINNING],
                looked_at: 2,
            }
        } else {
            Plan {
                size: args.size.unwrap_or((1280, 720)),
                disks: &[Disk::LOCAL, Disk::SPINNING, Disk::DISTANT],
                quotas: &[MIB, 4 * MIB, 8 * MIB, 32 * MIB],
                flight_frames: 300,
                flight_disks: vec![Disk::LOCAL, Disk::SPINNING, Disk::DISTANT],
                looked_at: 4,
            }
        }
    }
}

/// Runs the suite.
pub fn run(args: &BenchArgs) -> anyhow::Result<()> {
    let plan = Plan::new(args);
    let folder = tempfile::tempdir()?;
    let drawing = Drawing::open();
    let mut starts = RowFile::begin(args.output.join("stream-start.csv"), START_HEADER)?;
    let mut flights = RowFile::begin(args.output.join("stream-flight.csv"), FLIGHT_HEADER)?;
    for (name, store) in open_all(args, folder.path())? {
        let octree = store.octree();
        let (width, height) = plan.size;
        println!(
            "{name}: {} points, {} nodes, {} MiB as drawn; {width}x{height} by {}, {}\n",
            octree.point_count(),
            octree.nodes().len(),
            word_bytes(&store) / MIB,
            drawing.name(),
            machine()
        );
        if octree.nodes().is_empty() {
            println!("nothing to stream\n");
            continue;
        }
        if args.wants_stream(Study::Start) {
            start_rows(&drawing, &name, &store, &plan, &mut starts)?;
        }
        if !args.wants_stream(Study::Flight) {
            continue;
        }
        let mut panels = Vec::new();
        let mut is_first = true;
        for &disk in &plan.flight_disks {
            for caching in Caching::ALL {
                let rows = FlightRows { scan: &name, file: &mut flights };
                let run = fly(&drawing, &store, &plan, disk, caching, rows)?;
                if std::mem::take(&mut is_first) {
                    println!("{}", run.heading());
                }
                println!("{}", run.line());
                panels.extend(run.panels());
                run.write_pictures(&args.output, &name)?;
            }
        }
        println!("{FLIGHT_NOTES}");
        let heading = format!("{name}: a flight with room for a tenth of it");
        write_file(&args.output.join(format!("stream-{name}.svg")), &svg(&heading, &panels, 3))?;
    }
    println!("rows, plots and pictures are in {}", args.output.display());
    Ok(())
}

/// What draws: a device where there is one, else the CPU.
struct Drawing {
    #[cfg(feature = "gpu")]
    gpu: Option<Arc<crate::gpu::Gpu>>,
}

impl Drawing {
    #[cfg(feature = "gpu")]
    fn open() -> Self {
        Drawing { gpu: crate::gpu::Gpu::open().ok().map(Arc::new) }
    }

    #[cfg(not(feature = "gpu"))]
    fn open() -> Self {
        Drawing {}
    }

    fn name(&self) -> String {
        #[cfg(feature = "gpu")]
        if let Some(gpu) = &self.gpu {
            return gpu.description();
        }
        "the CPU".into()
    }

    fn renderer(&self, limit_bytes: u64) -> anyhow::Result<Renderer> {
        #[cfg(feature = "gpu")]
        if let Some(gpu) = &self.gpu
            && let Some(&path) = crate::frame::RasterPath::offered_by(gpu).first()
        {
            return Ok(Renderer::on_gpu(gpu.clone(), path, limit_bytes)?);
        }
        Ok(Renderer::on_cpu(limit_bytes))
    }

    /// Draws a frame and waits until it is there; the time that took.
    fn frame(
        &self,
        renderer: &mut Renderer,
        view: &View,
        settings: &FrameSettings,
    ) -> anyhow::Result<f64> {
        let start = Instant::now();
        renderer.render(view, settings)?;
        #[cfg(feature = "gpu")]
        if let Some(gpu) = &self.gpu {
            gpu.wait()?;
        }
        Ok(start.elapsed().as_secs_f64() * 1e3)
    }
}

fn open(store: &Store, disk: Disk) -> anyhow::Result<Arc<Store>> {
    let path = store.path();
    let bytes =
        SlowBytes::open(path, disk).with_context(|| format!("{}: cannot open", path.display()))?;
    Ok(Arc::new(Store::open_bytes(Box::new(bytes), path, FIRST_PICTURE_BYTES)?))
}

/// Bytes of the words of all nodes, one after the other.
fn node_bytes(store: &Store) -> impl Iterator<Item = u64> + '_ {
    let octree = store.octree();
    (0..octree.nodes().len() as u32).map(NodeId).map(move |node| {
        let words = u64::from(position_words(octree.local_bits(node))) + 1;
        4 * words * u64::from(octree.node(node).point_count())
    })
}

fn word_bytes(store: &Store) -> u64 {
    node_bytes(store).sum()
}

fn largest_node_bytes(store: &Store) -> u64 {
    node_bytes(store).max().unwrap_or(0)
}

fn settings(quota_bytes: u64) -> FrameSettings {
    let loading = Loading::Quota { bytes: quota_bytes };
    let mut settings = FrameSettings { loading, ..FrameSettings::default() };
    settings.cut.point_budget = POINT_BUDGET;
    settings
}
