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
//! (which nodes are under way when the view changes is a matter of time).

use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;
use serde::Serialize;

use crate::commands::bench::plot::{Panel, Scale, Series, svg};
use crate::commands::bench::slow_bytes::{Disk, SlowBytes};
use crate::commands::bench::{BenchArgs, cameras, machine, open_all, write_file};
use crate::frame::{FIRST_PICTURE_BYTES, FrameSettings, FrameStats, Loading, NodeSource, Renderer};
use crate::geometry::{Camera, View, ViewPreset};
use crate::gpu::layout::position_words;
use crate::ids::NodeId;
use crate::metrics::{Pixels, compare, rss_bytes};
use crate::passes::Picture;
use crate::store::Store;
use crate::stream::{StreamSettings, StreamWhen};

/// Points drawn at most, as in a window without a GPU.
const POINT_BUDGET: u64 = 2_000_000;
const MIB: u64 = 1 << 20;
/// Longest wait for a picture to be complete.
const PATIENCE: Duration = Duration::from_secs(180);
const FRAME_TIME: Duration = Duration::from_nanos(33_333_333);

/// What is tried.
struct Plan {
    size: (u32, u32),
    disks: &'static [Disk],
    quotas: &'static [u64],
    flight_frames: u32,
    flight_disks: &'static [Disk],
    looked_at: u32,
}

impl Plan {
    fn new(args: &BenchArgs) -> Self {
        if args.quick {
            Plan {
                size: args.size.unwrap_or((640, 360)),
                disks: &[Disk::LOCAL, Disk::SPINNING],
                quotas: &[8 * MIB],
                flight_frames: 45,
                flight_disks: &[Disk::SPINNING],
                looked_at: 2,
            }
        } else {
            Plan {
                size: args.size.unwrap_or((1280, 720)),
                disks: &[Disk::LOCAL, Disk::SPINNING, Disk::DISTANT],
                quotas: &[MIB, 4 * MIB, 8 * MIB, 32 * MIB],
                flight_frames: 300,
                flight_disks: &[Disk::LOCAL, Disk::SPINNING, Disk::DISTANT],
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
    let (mut starts, mut flights) = (format!("{START_HEADER}\n"), format!("{FLIGHT_HEADER}\n"));
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
        let rows = start_rows(&drawing, &name, &store, &plan)?;
        rows.iter().for_each(|row| starts.push_str(&row.csv()));
        print!("{}", start_table(&rows));
        let mut panels = Vec::new();
        let mut runs = Vec::new();
        for &disk in plan.flight_disks {
            for caching in Caching::ALL {
                let run = fly(&drawing, &store, &plan, disk, caching)?;
                run.frames.iter().for_each(|row| flights.push_str(&row.csv(&name, disk, caching)));
                runs.push(run);
            }
        }
        print!("{}", flight_table(&runs));
        for run in &runs {
            panels.extend(run.panels());
            run.write_pictures(&args.output, &name)?;
        }
        let heading = format!("{name}: a flight with room for a tenth of it");
        write_file(&args.output.join(format!("stream-{name}.svg")), &svg(&heading, &panels, 3))?;
    }
    write_file(&args.output.join("stream-start.csv"), &starts)?;
    write_file(&args.output.join("stream-flight.csv"), &flights)?;
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

/// Who reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Reader {
    Loader,
    OneAtATime,
    InFrame,
}

impl Reader {
    fn name(self) -> &'static str {
        match self {
            Reader::Loader => "loader",
            Reader::OneAtATime => "loader, 1 at a time",
            Reader::InFrame => "in the frame",
        }
    }

    fn at_once(self) -> u32 {
        match self {
            Reader::Loader => StreamSettings::default().in_flight_nodes,
            Reader::OneAtATime => 1,
            Reader::InFrame => rayon::current_num_threads() as u32,
        }
    }

    fn settings(self) -> StreamSettings {
        let settings = StreamSettings { look_ahead: Duration::ZERO, ..StreamSettings::default() };
        let in_flight_nodes = self.at_once();
        match self {
            Reader::InFrame => StreamSettings { when: StreamWhen::Never, ..settings },
            _ => StreamSettings { when: StreamWhen::Always, in_flight_nodes, ..settings },
        }
    }
}

/// One start of one store.
#[derive(Clone, Debug, Serialize)]
struct Start {
    scan: String,
    disk: &'static str,
    reader: &'static str,
    quota_bytes: u64,
    first_ms: f64,
    first_reads: u64,
    first_bytes: u64,
    first_covered: f64,
    complete_ms: f64,
    least_ms: f64,
    frames: u32,
    longest_ms: f64,
    reads: u64,
    bytes_read: u64,
    points_drawn: u64,
    nodes_waited_for: u64,
}

const START_HEADER: &str = "scan,disk,reader,quota_bytes,first_ms,first_reads,first_bytes,\
    first_covered,complete_ms,least_ms,frames,longest_ms,reads,bytes_read,points_drawn,\
    nodes_waited_for";

impl Start {
    fn csv(&self) -> String {
        format!(
            "{},\"{}\",\"{}\",{},{:.2},{},{},{:.4},{:.2},{:.2},{},{:.2},{},{},{},{}\n",
            self.scan.replace([',', '"', '\n'], "_"),
            self.disk,
            self.reader,
            self.quota_bytes,
            self.first_ms,
            self.first_reads,
            self.first_bytes,
            self.first_covered,
            self.complete_ms,
            self.least_ms,
            self.frames,
            self.longest_ms,
            self.reads,
            self.bytes_read,
            self.points_drawn,
            self.nodes_waited_for
        )
    }
}

fn start_rows(
    drawing: &Drawing,
    name: &str,
    store: &Store,
    plan: &Plan,
) -> anyhow::Result<Vec<Start>> {
    let mut rows = Vec::new();
    let usual = *plan.quotas.iter().find(|&&quota| quota == 8 * MIB).unwrap_or(&plan.quotas[0]);
    for &disk in plan.disks {
        for reader in [Reader::Loader, Reader::OneAtATime, Reader::InFrame] {
            rows.push(start(drawing, name, store, plan, (disk, reader, usual))?);
        }
    }
    for &quota in plan.quotas.iter().filter(|&&quota| quota != usual) {
        rows.push(start(drawing, name, store, plan, (Disk::LOCAL, Reader::Loader, quota))?);
    }
    Ok(rows)
}

/// Opens a store and draws it from outside until nothing is missing.
fn start(
    drawing: &Drawing,
    name: &str,
    store: &Store,
    plan: &Plan,
    (disk, reader, quota_bytes): (Disk, Reader, u64),
) -> anyhow::Result<Start> {
    let mut renderer = drawing.renderer(word_bytes(store).max(64 * MIB))?;
    let streaming = reader.settings();
    renderer.set_streaming(streaming);
    let settings = settings(quota_bytes);
    let began = Instant::now();
    let store = open(store, disk)?;
    renderer.set_scene(vec![store.clone() as Arc<dyn NodeSource>]);
    let view = from_outside(&renderer, plan.size);
    let mut row = Start {
        scan: name.to_owned(),
        disk: disk.name,
        reader: reader.name(),
        quota_bytes,
        first_ms: 0.0,
        first_reads: 0,
        first_bytes: 0,
        first_covered: 0.0,
        complete_ms: 0.0,
        least_ms: 0.0,
        frames: 0,
        longest_ms: 0.0,
        reads: 0,
        bytes_read: 0,
        points_drawn: 0,
        nodes_waited_for: 0,
    };
    let mut first = None;
    loop {
        let frame_ms = drawing.frame(&mut renderer, &view, &settings)?;
        let stats = renderer.stats().clone();
        row.nodes_waited_for += u64::from(stats.nodes_waited_for);
        if stats.unchanged {
            std::thread::sleep(Duration::from_millis(1));
        } else {
            row.frames += 1;
            row.longest_ms = row.longest_ms.max(frame_ms);
            row.points_drawn = stats.points_drawn;
        }
        if first.is_none() && stats.points_drawn > 0 {
            row.first_ms = began.elapsed().as_secs_f64() * 1e3;
            (row.first_reads, row.first_bytes) = (store.reads(), store.bytes_read());
            first = renderer.read_picture()?.map(|picture| covered(&picture));
        }
        if stats.complete {
            break;
        }
        anyhow::ensure!(began.elapsed() < PATIENCE, "{name}: not complete after {PATIENCE:?}");
    }
    row.complete_ms = began.elapsed().as_secs_f64() * 1e3;
    (row.reads, row.bytes_read) = (store.reads(), store.bytes_read());
    row.least_ms = 1e3 * disk.least_seconds(row.reads, row.bytes_read, reader.at_once());
    let all = renderer.read_picture()?.map_or(0, |picture| covered(&picture));
    row.first_covered = first.unwrap_or(0) as f64 / all.max(1) as f64;
    Ok(row)
}

fn covered(picture: &Picture) -> usize {
    picture.distances.iter().filter(|distance| distance.is_finite()).count()
}

fn from_outside(renderer: &Renderer, (width_px, height_px): (u32, u32)) -> View {
    let aspect = f64::from(width_px) / f64::from(height_px);
    let fov_y_rad = 60f64.to_radians();
    let camera = Camera::framing(&renderer.bounds(), ViewPreset::Iso, fov_y_rad, aspect);
    View { camera, width_px, height_px }
}

fn start_table(rows: &[Start]) -> String {
    let mut out = format!(
        "Start: from opening the store to the first and to the whole picture\n\
         {:<16}{:<21}{:>7}{:>10}{:>7}{:>9}{:>9}{:>11}{:>10}{:>8}{:>9}{:>8}{:>10}{:>8}\n",
        "disk",
        "reader",
        "quota",
        "first ms",
        "reads",
        "KiB",
        "covered",
        "whole ms",
        "disk ms",
        "frames",
        "max ms",
        "reads",
        "KiB",
        "waited"
    );
    for row in rows {
        let result = writeln!(
            out,
            "{:<16}{:<21}{:>3} MiB{:>10.1}{:>7}{:>9}{:>8.1}%{:>11.1}{:>10.1}{:>8}{:>9.1}{:>8}\
             {:>10}{:>8}",
            row.disk,
            row.reader,
            row.quota_bytes / MIB,
            row.first_ms,
            row.first_reads,
            row.first_bytes / 1024,
            100.0 * row.first_covered,
            row.complete_ms,
            row.least_ms,
            row.frames,
            row.longest_ms,
            row.reads,
            row.bytes_read / 1024,
            row.nodes_waited_for
        );
        result.expect("a string takes all text");
    }
    out.push('\n');
    out
}

/// What the caches of a flight do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Caching {
    Full,
    NoLookAhead,
    KeepsLittle,
}

impl Caching {
    const ALL: [Caching; 3] = [Caching::Full, Caching::NoLookAhead, Caching::KeepsLittle];

    fn name(self) -> &'static str {
        match self {
            Caching::Full => "ahead and kept",
            Caching::NoLookAhead => "kept, not ahead",
            Caching::KeepsLittle => "little kept",
        }
    }
}

/// One frame of a flight.
#[derive(Clone, Debug)]
struct Row {
    frame: u32,
    seconds: f64,
    frame_ms: f64,
    stats: FrameStats,
    reads: u64,
    /// Of the process, without the pictures that are kept to be looked at.
    rss_bytes: u64,
}

const FLIGHT_HEADER: &str = "scan,disk,caching,frame,seconds,frame_ms,points_drawn,nodes_drawn,\
    nodes_requested,nodes_without_room,nodes_loaded,nodes_evicted,nodes_waited_for,node_bytes,\
    ram_bytes,ram_peak_bytes,ram_limit_bytes,nodes_in_flight,in_flight_bytes,nodes_queued,\
    ram_hits,nodes_read,nodes_read_again,nodes_read_ahead,exchanges_skipped,bytes_read,\
    bytes_uploaded,reads,rss_bytes";

impl Row {
    fn csv(&self, scan: &str, disk: Disk, caching: Caching) -> String {
        let stats = &self.stats;
        let stream = stats.stream.unwrap_or_default();
        let counts = [
            stats.points_drawn,
            stats.nodes_drawn.into(),
            stats.nodes_requested.into(),
            stats.nodes_without_room.into(),
            stats.nodes_loaded.into(),
            stats.nodes_evicted.into(),
            stats.nodes_waited_for.into(),
            stats.node_bytes,
            stream.ram_bytes,
            stream.ram_peak_bytes,
            stream.ram_limit_bytes,
            stream.nodes_in_flight.into(),
            stream.in_flight_bytes,
            stream.nodes_queued.into(),
            stream.ram_hits,
            stream.nodes_read,
            stream.nodes_read_again,
            stream.nodes_read_ahead,
            stream.exchanges_skipped,
            stats.bytes_read,
            stats.bytes_uploaded,
            self.reads,
            self.rss_bytes,
        ];
        let scan = scan.replace([',', '"', '\n'], "_");
        let (disk, caching) = (disk.name, caching.name());
        let mut line = format!(
            "{scan},\"{disk}\",\"{caching}\",{},{:.4},{:.2}",
            self.frame, self.seconds, self.frame_ms
        );
        counts.iter().for_each(|count| line.push_str(&format!(",{count}")));
        line.push('\n');
        line
    }

    /// Share of the wanted nodes with room that were not there.
    fn missing(&self) -> f64 {
        let missing = f64::from(self.stats.nodes_requested);
        missing / (missing + f64::from(self.stats.nodes_drawn)).max(1.0)
    }
}

/// A flight, and what was seen.
struct Flight {
    disk: Disk,
    caching: Caching,
    limit_bytes: u64,
    scene_bytes: u64,
    frames: Vec<Row>,
    /// Frame, what was shown, what there was to be shown within the room.
    looked_at: Vec<(u32, Picture, Picture)>,
}

/// Flies through a store with room for a tenth of it: half of that for what is drawn, half for
/// what waits.
fn fly(
    drawing: &Drawing,
    store: &Store,
    plan: &Plan,
    disk: Disk,
    caching: Caching,
) -> anyhow::Result<Flight> {
    let scene_bytes = word_bytes(store);
    // Nodes of a small scan are large beside it; a few must have room.
    let limit_bytes = (scene_bytes / 20).max(8 * largest_node_bytes(store));
    let mut renderer = drawing.renderer(limit_bytes)?;
    let streaming = StreamSettings {
        when: StreamWhen::Always,
        memory_bytes: limit_bytes,
        ..StreamSettings::default()
    };
    renderer.set_streaming(match caching {
        Caching::Full => streaming,
        Caching::NoLookAhead => StreamSettings { look_ahead: Duration::ZERO, ..streaming },
        // Enough for what is under way.
        Caching::KeepsLittle => StreamSettings {
            look_ahead: Duration::ZERO,
            memory_bytes: (limit_bytes / 8).max(4 * largest_node_bytes(store)),
            ..streaming
        },
    });
    let source = open(store, disk)?;
    renderer.set_scene(vec![source.clone() as Arc<dyn NodeSource>]);
    let views = cameras::flight(store, plan.size, plan.flight_frames)?;
    let settings = settings(8 * MIB);
    let step = (plan.flight_frames / plan.looked_at.max(1)).max(1);
    let (mut frames, mut shown) = (Vec::new(), Vec::<(u32, Picture)>::new());
    let began = Instant::now();
    let mut paused = Duration::ZERO;
    for (frame, view) in (0u32..).zip(&views) {
        let frame_ms = drawing.frame(&mut renderer, view, &settings)?;
        let seconds = (began.elapsed() - paused).as_secs_f64();
        let (stats, reads) = (renderer.stats().clone(), source.reads());
        // Pictures that are kept to be looked at later are not the renderer's.
        let kept_bytes: u64 = shown.iter().map(|(_, picture)| picture_bytes(picture)).sum();
        let rss_bytes = rss_bytes().unwrap_or(0).saturating_sub(kept_bytes);
        frames.push(Row { frame, seconds, frame_ms, stats, reads, rss_bytes });
        if frame % step == step - 1 {
            // Reading back is no part of the flight.
            let start = Instant::now();
            shown.extend(renderer.read_picture()?.map(|picture| (frame, picture)));
            paused += start.elapsed();
        }
        let due = began + paused + FRAME_TIME * (frame + 1);
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
    }
    // The same frames with all that has room.
    renderer.set_streaming(StreamSettings { when: StreamWhen::Never, ..streaming });
    let all = FrameSettings { loading: Loading::All, ..settings };
    let mut looked_at = Vec::new();
    for (frame, picture) in shown {
        drawing.frame(&mut renderer, &views[frame as usize], &all)?;
        looked_at.extend(renderer.read_picture()?.map(|whole| (frame, picture, whole)));
    }
    Ok(Flight { disk, caching, limit_bytes, scene_bytes, frames, looked_at })
}

fn flight_table(flights: &[Flight]) -> String {
    let mut out = String::new();
    let Some(first) = flights.first() else { return out };
    let result = writeln!(
        out,
        "Flight: {} frames at 30 a second, {} MiB of {} MiB to draw from and as many beside it\n\
         {:<16}{:<17}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}{:>8}{:>9}{:>8}{:>9}{:>11}{:>8}",
        first.frames.len(),
        first.limit_bytes / MIB,
        first.scene_bytes / MIB,
        "disk",
        "caches",
        "missing",
        "p95",
        "whole",
        "frame ms",
        "max ms",
        "read MiB",
        "again",
        "ahead",
        "evicted",
        "hits",
        "ram max",
        "waited",
        "skipped",
        "grown MiB",
        "rmse"
    );
    result.expect("a string takes all text");
    for flight in flights {
        let rows = &flight.frames;
        let mut missing: Vec<f64> = rows.iter().map(Row::missing).collect();
        let mut times: Vec<f64> = rows.iter().map(|row| row.frame_ms).collect();
        missing.sort_by(f64::total_cmp);
        times.sort_by(f64::total_cmp);
        let mean = missing.iter().sum::<f64>() / missing.len().max(1) as f64;
        let whole = rows.iter().filter(|row| row.stats.complete).count();
        let last = rows.last().and_then(|row| row.stats.stream).unwrap_or_default();
        let sum =
            |pick: fn(&FrameStats) -> u64| rows.iter().map(|row| pick(&row.stats)).sum::<u64>();
        let result = writeln!(
            out,
            "{:<16}{:<17}{:>8.1}%{:>8.1}%{:>8.1}%{:>9.1}{:>9.1}{:>9.1}{:>9}{:>9}{:>9}{:>8}{:>8.1}%\
             {:>8}{:>9}{:>11.1}{:>8.2}",
            flight.disk.name,
            flight.caching.name(),
            100.0 * mean,
            100.0 * at_share(&missing, 0.95),
            100.0 * whole as f64 / rows.len().max(1) as f64,
            at_share(&times, 0.5),
            at_share(&times, 1.0),
            sum(|stats| stats.bytes_read) as f64 / MIB as f64,
            last.nodes_read_again,
            last.nodes_read_ahead,
            sum(|stats| stats.nodes_evicted.into()),
            last.ram_hits,
            100.0 * last.ram_peak_bytes as f64 / flight.limit_bytes.max(1) as f64,
            sum(|stats| stats.nodes_waited_for.into()),
            last.exchanges_skipped,
            flight.grown_bytes() as f64 / MIB as f64,
            flight.rmse(),
        );
        result.expect("a string takes all text");
    }
    out.push_str(
        "missing: share of the wanted nodes that have room and are not there; grown: resident \
         memory of the process at its highest against the fifth frame; rmse: colour error of \
         looked-at frames against all that has room\n\n",
    );
    out
}

/// The value below which a share of sorted values lies.
fn at_share(sorted: &[f64], share: f64) -> f64 {
    let last = sorted.len().saturating_sub(1);
    sorted.get((share * last as f64).round() as usize).copied().unwrap_or(0.0)
}

impl Flight {
    /// By how much the process grew while it flew, once it had drawn some frames.
    fn grown_bytes(&self) -> u64 {
        let most = self.frames.iter().map(|row| row.rss_bytes).max().unwrap_or(0);
        most - self.frames.get(4).map_or(most, |row| row.rss_bytes)
    }

    fn rmse(&self) -> f64 {
        let errors = self
            .looked_at
            .iter()
            .map(|(_, shown, whole)| compare(pixels(whole), pixels(shown)).rmse);
        errors.sum::<f64>() / self.looked_at.len().max(1) as f64
    }

    /// Memory, what is missing, and the time of frames, over the flight.
    fn panels(&self) -> Vec<Panel> {
        let title = format!("{}, {}", self.disk.name, self.caching.name());
        let series = |name: &str, value: &dyn Fn(&Row) -> f64| Series {
            name: name.to_owned(),
            points: self.frames.iter().map(|row| (row.seconds, value(row))).collect(),
        };
        let panel = |y_label: &str, series: Vec<Series>| Panel {
            title: title.clone(),
            x_label: "seconds".into(),
            y_label: y_label.into(),
            x_scale: Scale::Linear,
            y_scale: Scale::Linear,
            series,
        };
        let stream = |row: &Row| row.stats.stream.unwrap_or_default();
        let mib = |bytes: u64| bytes as f64 / MIB as f64;
        vec![
            panel(
                "MiB",
                vec![
                    series("limit of each", &|_| mib(self.limit_bytes)),
                    series("drawn from", &|row| mib(row.stats.node_bytes)),
                    series("main memory", &|row| mib(stream(row).ram_bytes)),
                ],
            ),
            panel(
                "nodes",
                vec![
                    series("missing", &|row| f64::from(row.stats.nodes_requested)),
                    series("under way", &|row| f64::from(stream(row).nodes_in_flight)),
                    series("waited for", &|row| f64::from(row.stats.nodes_waited_for)),
                ],
            ),
            panel("milliseconds of a frame", vec![series("frame", &|row| row.frame_ms)]),
        ]
    }

    /// What was shown in the looked-at frames, above what there was to be shown.
    fn write_pictures(&self, folder: &Path, name: &str) -> anyhow::Result<()> {
        if self.caching != Caching::Full {
            return Ok(());
        }
        for (frame, shown, whole) in &self.looked_at {
            let disk = self.disk.name.replace([' ', ','], "").replace('/', "p");
            let path = folder.join(format!("stream-{name}-{disk}-{frame:04}.png"));
            let (width, height) = (shown.width_px, shown.height_px + whole.height_px);
            let words = shown.colors.iter().chain(&whole.colors);
            let bytes: Vec<u8> =
                words.flat_map(|word| (word | 0xff00_0000).to_le_bytes()).collect();
            image::save_buffer(&path, &bytes, width, height, image::ExtendedColorType::Rgba8)
                .with_context(|| format!("{}: cannot write", path.display()))?;
        }
        Ok(())
    }
}

fn picture_bytes(picture: &Picture) -> u64 {
    4 * (picture.colors.len() + picture.distances.len()) as u64
}

fn pixels(picture: &Picture) -> Pixels<'_> {
    Pixels { width_px: picture.width_px, colors: &picture.colors, distances: &picture.distances }
}
