//! The study *flight*: a camera through a store that is larger than the room for it.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Context;

use super::{Drawing, FRAME_TIME, MIB, Plan, largest_node_bytes, open, settings, word_bytes};
use crate::commands::bench::plot::{Panel, Scale, Series};
use crate::commands::bench::slow_bytes::Disk;
use crate::commands::bench::{RowFile, cameras};
use crate::frame::{FrameSettings, FrameStats, Loading, NodeSource};
use crate::metrics::{Pixels, compare, rss_bytes};
use crate::passes::Picture;
use crate::store::Store;
use crate::stream::{StreamSettings, StreamWhen};

/// What the caches of a flight do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Caching {
    Full,
    NoLookAhead,
    KeepsLittle,
}

impl Caching {
    pub(super) const ALL: [Caching; 3] =
        [Caching::Full, Caching::NoLookAhead, Caching::KeepsLittle];

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
pub(super) struct Row {
    frame: u32,
    seconds: f64,
    frame_ms: f64,
    stats: FrameStats,
    reads: u64,
    /// Of the process, without the pictures that are kept to be looked at.
    rss_bytes: u64,
}

pub(super) const FLIGHT_HEADER: &str = "scan,disk,caching,frame,seconds,frame_ms,points_drawn,nodes_drawn,\
    nodes_requested,nodes_without_room,nodes_loaded,nodes_evicted,nodes_waited_for,node_bytes,\
    ram_bytes,ram_peak_bytes,ram_limit_bytes,nodes_in_flight,in_flight_bytes,nodes_queued,\
    ram_hits,nodes_read,nodes_read_again,nodes_read_ahead,exchanges_skipped,bytes_read,\
    bytes_uploaded,reads,rss_bytes";

impl Row {
    pub(super) fn csv(&self, scan: &str, disk: Disk, caching: Caching) -> String {
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

/// Where the rows of a flight go, frame by frame.
pub(super) struct FlightRows<'a> {
    pub(super) scan: &'a str,
    pub(super) file: &'a mut RowFile,
}

/// A flight, and what was seen.
pub(super) struct Flight {
    disk: Disk,
    caching: Caching,
    limit_bytes: u64,
    scene_bytes: u64,
    pub(super) frames: Vec<Row>,
    /// Frame, what was shown, what there was to be shown within the room.
    looked_at: Vec<(u32, Picture, Picture)>,
}

/// Flies through a store with room for a tenth of it: half of that for what is drawn, half for
/// what waits.
pub(super) fn fly(
    drawing: &Drawing,
    store: &Store,
    plan: &Plan,
    disk: Disk,
    caching: Caching,
    rows: FlightRows,
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
        let row = Row { frame, seconds, frame_ms, stats, reads, rss_bytes };
        rows.file.add(&row.csv(rows.scan, disk, caching))?;
        frames.push(row);
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

/// What stands below the lines of all flights.
pub(super) const FLIGHT_NOTES: &str = "missing: share of the wanted nodes that have room and are \
    not there; grown: resident memory of the process at its highest against the fifth frame; rmse: \
    colour error of looked-at frames against all that has room\n";

/// The value below which a share of sorted values lies.
fn at_share(sorted: &[f64], share: f64) -> f64 {
    let last = sorted.len().saturating_sub(1);
    sorted.get((share * last as f64).round() as usize).copied().unwrap_or(0.0)
}

impl Flight {
    /// Heads the lines of flights like this one.
    pub(super) fn heading(&self) -> String {
        format!(
            "Flight: {} frames at 30 a second, {} MiB of {} MiB to draw from and as many beside it\n\
             {:<16}{:<17}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}{:>8}{:>9}{:>8}{:>9}{:>11}{:>8}",
            self.frames.len(),
            self.limit_bytes / MIB,
            self.scene_bytes / MIB,
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
        )
    }

    /// This one's line.
    pub(super) fn line(&self) -> String {
        let rows = &self.frames;
        let mut missing: Vec<f64> = rows.iter().map(Row::missing).collect();
        let mut times: Vec<f64> = rows.iter().map(|row| row.frame_ms).collect();
        missing.sort_by(f64::total_cmp);
        times.sort_by(f64::total_cmp);
        let mean = missing.iter().sum::<f64>() / missing.len().max(1) as f64;
        let whole = rows.iter().filter(|row| row.stats.complete).count();
        let last = rows.last().and_then(|row| row.stats.stream).unwrap_or_default();
        let sum =
            |pick: fn(&FrameStats) -> u64| rows.iter().map(|row| pick(&row.stats)).sum::<u64>();
        format!(
            "{:<16}{:<17}{:>8.1}%{:>8.1}%{:>8.1}%{:>9.1}{:>9.1}{:>9.1}{:>9}{:>9}{:>9}{:>8}{:>8.1}%\
         {:>8}{:>9}{:>11.1}{:>8.2}",
            self.disk.name,
            self.caching.name(),
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
            100.0 * last.ram_peak_bytes as f64 / self.limit_bytes.max(1) as f64,
            sum(|stats| stats.nodes_waited_for.into()),
            last.exchanges_skipped,
            self.grown_bytes() as f64 / MIB as f64,
            self.rmse(),
        )
    }

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
    pub(super) fn panels(&self) -> Vec<Panel> {
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
    pub(super) fn write_pictures(&self, folder: &Path, name: &str) -> anyhow::Result<()> {
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
