//! The study *start*: from opening a store to its first and to its whole picture.

use std::sync::Arc;
use std::time::{Duration, Instant};

use serde::Serialize;

use super::{Drawing, MIB, PATIENCE, Plan, open, settings, word_bytes};
use crate::commands::bench::RowFile;
use crate::commands::bench::slow_bytes::Disk;
use crate::frame::{NodeSource, Renderer};
use crate::geometry::{Camera, View, ViewPreset};
use crate::passes::Picture;
use crate::store::Store;
use crate::stream::{StreamSettings, StreamWhen};

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
pub(super) struct Start {
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

pub(super) const START_HEADER: &str = "scan,disk,reader,quota_bytes,first_ms,first_reads,first_bytes,\
    first_covered,complete_ms,least_ms,frames,longest_ms,reads,bytes_read,points_drawn,\
    nodes_waited_for";

impl Start {
    pub(super) fn csv(&self) -> String {
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

    fn line(&self) -> String {
        format!(
            "{:<16}{:<21}{:>3} MiB{:>10.1}{:>7}{:>9}{:>8.1}%{:>11.1}{:>10.1}{:>8}{:>9.1}{:>8}\
             {:>10}{:>8}",
            self.disk,
            self.reader,
            self.quota_bytes / MIB,
            self.first_ms,
            self.first_reads,
            self.first_bytes / 1024,
            100.0 * self.first_covered,
            self.complete_ms,
            self.least_ms,
            self.frames,
            self.longest_ms,
            self.reads,
            self.bytes_read / 1024,
            self.nodes_waited_for
        )
    }
}

/// Measures all starts of a store, and tells each at once.
pub(super) fn start_rows(
    drawing: &Drawing,
    name: &str,
    store: &Store,
    plan: &Plan,
    file: &mut RowFile,
) -> anyhow::Result<()> {
    let mut note = |row: Start| -> anyhow::Result<()> {
        println!("{}", row.line());
        file.add(&row.csv())
    };
    print!("{}", heading());
    let usual = *plan.quotas.iter().find(|&&quota| quota == 8 * MIB).unwrap_or(&plan.quotas[0]);
    for &disk in plan.disks {
        for reader in [Reader::Loader, Reader::OneAtATime, Reader::InFrame] {
            note(start(drawing, name, store, plan, (disk, reader, usual))?)?;
        }
    }
    for &quota in plan.quotas.iter().filter(|&&quota| quota != usual) {
        note(start(drawing, name, store, plan, (Disk::LOCAL, Reader::Loader, quota))?)?;
    }
    println!();
    Ok(())
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

fn heading() -> String {
    format!(
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
    )
}
