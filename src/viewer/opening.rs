//! Opening files beside the window: stores at once, scans after converting them.
//!
//! One thread works through the files of one request and reports over a channel; the window asks
//! for news each time it is drawn, and is woken when there are some. Dropping the request cancels
//! it and waits for its end, so that no temporary file stays behind.
//!
//! Where the store of a scan goes: beside the scan as `NAME.esker`, so that the next look at it
//! needs no conversion. A store that is there and was made from this file, after its last change,
//! is opened instead. Into a temporary folder if another file has that name, if nothing can be
//! written there, or on demand; it is removed when the scan is closed.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use anyhow::Context;
use crossbeam_channel::{Receiver, Sender};
use serde::Serialize;
use tempfile::TempDir;

use crate::build::{self, ConvertOptions, Progress, Stage};
use crate::store::{Store, is_store};

/// Called from the opening thread when there is news.
pub type Wake = Arc<dyn Fn() + Send + Sync>;

/// A file that is open.
#[derive(Clone, Debug)]
pub struct OpenedFile {
    /// What was asked for.
    pub path: PathBuf,
    /// Its points.
    pub store: Arc<Store>,
    /// Where they are kept, if not in `path` itself.
    pub kept_in: KeptIn,
    /// The folder of a temporary store; removed with the last owner.
    _folder: Option<Arc<TempDir>>,
}

/// Where the store of an opened file is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum KeptIn {
    /// The file is a store.
    Itself,
    /// In a store beside it that was there.
    Found(PathBuf),
    /// In a store beside it that was made now.
    Made(PathBuf),
    /// In a temporary store.
    Temporary,
}

/// News of a request.
#[derive(Debug)]
pub enum Opened {
    /// A file is open.
    File(OpenedFile),
    /// Something to tell about a file that is open nevertheless.
    Warning(String),
    /// A file cannot be opened.
    Failed(String),
}

/// How far a conversion is.
#[derive(Clone, Debug, PartialEq)]
pub struct Advance {
    /// The scan.
    pub path: PathBuf,
    /// The part it is at.
    pub stage: &'static str,
    /// Points of that part that are done.
    pub points_done: u64,
    /// Points of that part.
    pub points_total: u64,
}

/// A request to open files, in progress.
#[derive(Debug)]
pub struct Opening {
    news: Receiver<Opened>,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Shared {
    cancelled: AtomicBool,
    converting: Mutex<Option<(PathBuf, Stage, u64)>>,
    points_done: AtomicU64,
}

impl Shared {
    fn set_converting(&self, state: Option<(PathBuf, Stage, u64)>) {
        self.points_done.store(0, Ordering::Relaxed);
        *self.converting.lock().unwrap_or_else(PoisonError::into_inner) = state;
    }
}

impl Opening {
    /// Starts to open files, in order. With `temporary`, nothing is written beside scans.
    pub fn start(files: Vec<PathBuf>, temporary: bool, wake: Wake) -> std::io::Result<Opening> {
        let (sender, news) = crossbeam_channel::unbounded();
        let shared = Arc::new(Shared::default());
        let worker = Worker { shared: Arc::clone(&shared), temporary, wake, sender };
        let thread =
            std::thread::Builder::new().name("open".into()).spawn(move || worker.run(&files))?;
        Ok(Opening { news, shared, thread: Some(thread) })
    }

    /// The next news, if any has come.
    pub fn next(&self) -> Option<Opened> {
        self.news.try_recv().ok()
    }

    /// Whether all files were opened or refused. News may still wait.
    pub fn is_finished(&self) -> bool {
        self.thread.as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// The conversion that is going on.
    pub fn advance(&self) -> Option<Advance> {
        let converting = self.shared.converting.lock().unwrap_or_else(PoisonError::into_inner);
        converting.as_ref().map(|(path, stage, points_total)| Advance {
            path: path.clone(),
            stage: stage.name(),
            points_done: self.shared.points_done.load(Ordering::Relaxed),
            points_total: *points_total,
        })
    }

    /// Ends the work soon; what is open stays open.
    pub fn cancel(&self) {
        self.shared.cancelled.store(true, Ordering::Relaxed);
    }
}

impl Drop for Opening {
    fn drop(&mut self) {
        self.cancel();
        if let Some(thread) = self.thread.take() {
            // A panic there has been printed and has no further meaning here.
            let _ = thread.join();
        }
    }
}

struct Worker {
    shared: Arc<Shared>,
    temporary: bool,
    wake: Wake,
    sender: Sender<Opened>,
}

impl Worker {
    fn run(&self, files: &[PathBuf]) {
        for file in files {
            if self.is_cancelled() {
                break;
            }
            match self.open(file) {
                Ok(opened) => self.tell(Opened::File(opened)),
                // Whoever cancelled needs no message.
                Err(_) if self.is_cancelled() => {}
                Err(error) => self.tell(Opened::Failed(format!("{error:#}"))),
            }
            self.shared.set_converting(None);
        }
        (self.wake)();
    }

    fn is_cancelled(&self) -> bool {
        self.shared.cancelled.load(Ordering::Relaxed)
    }

    fn tell(&self, news: Opened) {
        // The receiver is gone only if nobody wants to know.
        let _ = self.sender.send(news);
        (self.wake)();
    }

    fn open(&self, path: &Path) -> anyhow::Result<OpenedFile> {
        let opened = |store, kept_in, folder: Option<TempDir>| OpenedFile {
            path: path.to_owned(),
            store: Arc::new(store),
            kept_in,
            _folder: folder.map(Arc::new),
        };
        if is_store(path) {
            return Ok(opened(Store::open(path)?, KeptIn::Itself, None));
        }
        let beside = store_beside(path);
        if !self.temporary && beside.exists() {
            if let Some(store) = made_from(&beside, path) {
                return Ok(opened(store, KeptIn::Found(beside), None));
            }
        } else if !self.temporary && can_write_beside(path) {
            self.convert(path, &beside)?;
            return Ok(opened(Store::open(&beside)?, KeptIn::Made(beside), None));
        }
        let folder = tempfile::Builder::new()
            .prefix("esker-view-")
            .tempdir()
            .context("cannot make a temporary folder")?;
        let output = folder.path().join("scan.esker");
        self.convert(path, &output)?;
        Ok(opened(Store::open(&output)?, KeptIn::Temporary, Some(folder)))
    }

    fn convert(&self, path: &Path, output: &Path) -> anyhow::Result<()> {
        let cores = std::thread::available_parallelism().map_or(1, |cores| cores.get());
        let mut options = ConvertOptions {
            // One core stays with the window.
            threads: cores.saturating_sub(1).max(1),
            ..ConvertOptions::default()
        };
        // The points on view need memory as well.
        options.memory_bytes /= 2;
        let progress = Listener { worker: self, path };
        let report = build::convert(
            &[path.to_owned()],
            output,
            &options,
            &progress,
            &self.shared.cancelled,
        )?;
        report.warnings.into_iter().for_each(|warning| self.tell(Opened::Warning(warning)));
        Ok(())
    }
}

struct Listener<'a> {
    worker: &'a Worker,
    path: &'a Path,
}

impl Progress for Listener<'_> {
    fn begin(&self, stage: Stage, total: u64) {
        self.worker.shared.set_converting(Some((self.path.to_owned(), stage, total)));
        (self.worker.wake)();
    }

    fn advance(&self, points: u64) {
        self.worker.shared.points_done.fetch_add(points, Ordering::Relaxed);
    }
}

fn store_beside(scan: &Path) -> PathBuf {
    scan.with_extension("esker")
}

/// The store, if it was made from just this scan since its last change.
fn made_from(store_path: &Path, scan: &Path) -> Option<Store> {
    let changed = |path: &Path| fs::metadata(path).and_then(|facts| facts.modified()).ok();
    if changed(store_path)? < changed(scan)? || !is_store(store_path) {
        return None;
    }
    let store = Store::open(store_path).ok()?;
    let [source] = store.metadata().sources.as_slice() else { return None };
    (scan.file_name()?.to_str()? == source.name).then_some(store)
}

fn can_write_beside(scan: &Path) -> bool {
    let folder = scan.parent().filter(|folder| !folder.as_os_str().is_empty());
    tempfile::tempfile_in(folder.unwrap_or(Path::new("."))).is_ok()
}
