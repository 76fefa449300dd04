//! Opening files beside the window: stores and models at once, scans after converting them.
//!
//! One thread works through the files of one request and reports over a channel; the window asks
//! for news each time it is drawn, and is woken when there are some. Dropping the request cancels
//! it and waits for its end, so that no temporary file stays behind.
//!
//! Scans without a store are shown at once as a preview, a store of some points of all of them,
//! then as a finer one, then as they are. The first comes before the conversion begins, of points
//! that are quick to get at; the finer one when the conversion has read all points, of some spread
//! evenly over them. Both take a known small part of its time.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use anyhow::Context;
use crossbeam_channel::{Receiver, Sender};
use serde::Serialize;
use tempfile::TempDir;

use crate::build::{ConvertOptions, PointSample, Progress, Sources, Stage, convert_sources};
use crate::frame::FIRST_PICTURE_BYTES;
use crate::input::{Cancel, ModelOptions, ReadOptions, detect_model};
use crate::store::{Store, is_store};
use crate::viewer::kept::{can_write_beside, is_las, made_from, store_beside};
use crate::viewer::models::{OpenedModel, open_model};
use crate::viewer::preview::{FIRST_PREVIEW_POINTS, make_preview, preview_of, preview_sizes};

/// Called from the opening thread when something happened.
pub type Wake = Arc<dyn Fn(Sign) + Send + Sync>;

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sign {
    /// A part of the work began. Nothing has to be shown at once.
    Begun,
    /// There is news, or no more will come.
    News,
}

/// Lists the scans and models in a folder.
pub type ListFolder = fn(&Path) -> anyhow::Result<Vec<PathBuf>>;

/// How files are opened.
#[derive(Clone, Debug, Default)]
pub struct OpeningOptions {
    /// Convert scans to temporary stores, never beside them.
    pub temporary: bool,
    /// Points of the first preview, 0 for no previews; 250,000 if not told.
    pub preview_points: Option<u64>,
    /// Where previews are made; in memory or among temporary files, if not told.
    pub preview_folder: Option<PathBuf>,
    /// What makes a folder a list of files, of which the scans become one store; without, folders are
    /// refused.
    pub list_folder: Option<ListFolder>,
    /// How models are placed.
    pub models: ModelOptions,
}

/// A file or a folder that is open.
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
    /// Some of the points, and those of other scans of the request, are in a store without a name.
    Preview,
}

/// News of a request.
#[derive(Debug)]
pub enum Opened {
    /// Files are open. They take the place of a preview.
    Files(Vec<OpenedFile>),
    /// A model is open.
    Model(OpenedModel),
    /// A preview of all that is still to come. It takes the place of the one before.
    Preview(OpenedFile),
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
    /// The part it is at; none while a preview is made.
    pub stage: Option<&'static str>,
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
    cancelled: Arc<AtomicBool>,
    converting: Mutex<Option<Advance>>,
    points_done: AtomicU64,
}

impl Shared {
    fn set_converting(&self, state: Option<Advance>) {
        self.points_done.store(0, Ordering::Relaxed);
        *self.converting.lock().unwrap_or_else(PoisonError::into_inner) = state;
    }
}

impl Opening {
    /// Starts to open files and folders: those with a store first, then the others, in order.
    pub fn start(
        paths: Vec<PathBuf>,
        options: OpeningOptions,
        wake: Wake,
    ) -> std::io::Result<Opening> {
        let (sender, news) = crossbeam_channel::unbounded();
        let shared = Arc::new(Shared::default());
        let worker = Worker { shared: Arc::clone(&shared), options, wake, sender };
        let thread =
            std::thread::Builder::new().name("open".into()).spawn(move || worker.run(paths))?;
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
        let points_done = self.shared.points_done.load(Ordering::Relaxed);
        converting.clone().map(|advance| Advance { points_done, ..advance })
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
    options: OpeningOptions,
    wake: Wake,
    sender: Sender<Opened>,
}

/// Scans that become one store.
struct Job {
    path: PathBuf,
    scans: Vec<PathBuf>,
}

impl Worker {
    fn run(&self, paths: Vec<PathBuf>) {
        let mut jobs = Vec::new();
        for path in paths {
            let (models, scans) = match self.list(&path) {
                Ok(files) => files,
                Err(error) => {
                    self.tell(Opened::Failed(format!("{error:#}")));
                    continue;
                }
            };
            models.iter().for_each(|model| self.show_model(model));
            if scans.is_empty() {
                continue;
            }
            match self.find(&path, scans) {
                Ok(Found::Open(file)) => self.tell(Opened::Files(vec![file])),
                Ok(Found::Scans(scans)) => jobs.push(Job { path, scans }),
                Err(error) => self.tell(Opened::Failed(format!("{error:#}"))),
            }
        }
        self.convert_all(&jobs);
        (self.wake)(Sign::News);
    }

    fn is_cancelled(&self) -> bool {
        self.shared.cancelled.load(Ordering::Relaxed)
    }

    fn tell(&self, news: Opened) {
        // The receiver is gone only if nobody wants to know.
        let _ = self.sender.send(news);
        (self.wake)(Sign::News);
    }

    /// The models and the scans that a path stands for.
    fn list(&self, path: &Path) -> anyhow::Result<(Vec<PathBuf>, Vec<PathBuf>)> {
        let files = match self.options.list_folder {
            Some(list) if path.is_dir() => list(path)?,
            _ => vec![path.to_owned()],
        };
        Ok(files.into_iter().partition(|file| detect_model(file).is_some()))
    }

    fn show_model(&self, path: &Path) {
        match open_model(path, &self.options.models, &self.shared.cancelled) {
            Ok((model, lines)) => {
                lines.into_iter().for_each(|line| self.tell(Opened::Warning(line)));
                self.tell(Opened::Model(model));
            }
            // Whoever cancelled needs no message.
            Err(_) if self.is_cancelled() => {}
            Err(error) => self.tell(Opened::Failed(format!("{error:#}"))),
        }
    }

    /// Opens a store, or the store that was made of the scans, or finds that there is none.
    fn find(&self, path: &Path, scans: Vec<PathBuf>) -> anyhow::Result<Found> {
        let opened = |store, kept_in| Found::Open(file(path, store, kept_in, None));
        if is_store(path) {
            return Ok(opened(Store::open_with_coarse(path, FIRST_PICTURE_BYTES)?, KeptIn::Itself));
        }
        if !self.options.temporary
            && let Some(beside) = store_beside(path)
            && let Some(store) = made_from(&beside, &scans)
        {
            return Ok(opened(store, KeptIn::Found(beside)));
        }
        Ok(Found::Scans(scans))
    }

    fn convert_all(&self, jobs: &[Job]) {
        let [first, more @ ..] = jobs else { return };
        // Opened once for previews and conversion: that may mean reading all of it.
        let mut sources = None;
        if more.is_empty() {
            match Sources::open(&first.scans, &self.read_options()) {
                Ok(opened) => sources = Some(opened),
                // Whoever cancelled needs no message.
                Err(_) if self.is_cancelled() => return,
                Err(error) => return self.tell(Opened::Failed(error.to_string())),
            }
        }
        let mut even_points = 0;
        let has_preview = match &sources {
            Some(sources) => {
                let mut sizes = self.preview_sizes(sources);
                if sizes.len() > 1 {
                    even_points = sizes.pop().unwrap_or(0);
                    sizes.truncate(1);
                }
                self.show_previews(&first.path, sources, &sizes)
            }
            None => {
                let scans = jobs.iter().flat_map(|job| &job.scans).filter(|scan| is_las(scan));
                let scans: Vec<_> = scans.cloned().collect();
                // What is wrong with any of them is told by its conversion.
                Sources::open(&scans, &self.read_options()).is_ok_and(|sources| {
                    let sizes = self.preview_sizes(&sources);
                    self.show_previews(&first.path, &sources, &sizes)
                })
            }
        };
        let mut converted = Vec::new();
        for job in jobs {
            if self.is_cancelled() {
                return;
            }
            match self.convert(job, sources.as_ref(), even_points) {
                Ok(file) if has_preview => converted.push(file),
                Ok(file) => self.tell(Opened::Files(vec![file])),
                // Whoever cancelled needs no message.
                Err(_) if self.is_cancelled() => {}
                Err(error) => self.tell(Opened::Failed(format!("{error:#}"))),
            }
            self.shared.set_converting(None);
        }
        if !converted.is_empty() {
            self.tell(Opened::Files(converted));
        }
    }

    fn read_options(&self) -> ReadOptions {
        ReadOptions { cancel: Cancel::when(&self.shared.cancelled), ..ReadOptions::default() }
    }

    fn preview_sizes(&self, sources: &Sources) -> Vec<u64> {
        let first = self.options.preview_points.unwrap_or(FIRST_PREVIEW_POINTS);
        preview_sizes(sources.expected_points(), first)
    }

    /// Shows finer and finer previews; whether there was any.
    fn show_previews(&self, path: &Path, sources: &Sources, sizes: &[u64]) -> bool {
        let listener = Listener { worker: self, path, is_preview: true, even_points: 0 };
        let (folder, cancelled) = (self.options.preview_folder.as_deref(), &self.shared.cancelled);
        let mut has_preview = false;
        for &points in sizes {
            // Without a preview there is only longer to wait; what is wrong the conversion tells.
            match make_preview(sources, points, folder, &listener, cancelled) {
                Ok((store, folder)) if store.metadata().points > 0 => {
                    let preview = file(path, store, KeptIn::Preview, folder);
                    self.tell(Opened::Preview(preview));
                    has_preview = true;
                }
                _ => break,
            }
        }
        self.shared.set_converting(None);
        has_preview
    }

    /// Converts scans to a store beside them, or to a temporary one where that is not possible.
    /// As soon as all is read, so many points are shown as a preview.
    fn convert(
        &self,
        job: &Job,
        sources: Option<&Sources>,
        even_points: u64,
    ) -> anyhow::Result<OpenedFile> {
        let beside = store_beside(&job.path).filter(|beside| {
            !self.options.temporary && !beside.exists() && can_write_beside(beside)
        });
        let (output, folder) = match &beside {
            Some(beside) => (beside.clone(), None),
            None => {
                let folder = tempfile::Builder::new()
                    .prefix("esker-view-")
                    .tempdir()
                    .context("cannot make a temporary folder")?;
                (folder.path().join("scan.esker"), Some(folder))
            }
        };
        let mut options = ConvertOptions { read: self.read_options(), ..ConvertOptions::default() };
        // The points on view need memory as well.
        options.memory_bytes /= 2;
        let progress = Listener { worker: self, path: &job.path, is_preview: false, even_points };
        let opened;
        let sources = match sources {
            Some(sources) => sources,
            None => {
                opened = Sources::open(&job.scans, &options.read)?;
                &opened
            }
        };
        let report =
            convert_sources(sources, &output, &options, &progress, &self.shared.cancelled)?;
        report.warnings.into_iter().for_each(|warning| self.tell(Opened::Warning(warning)));
        let kept_in = beside.map_or(KeptIn::Temporary, KeptIn::Made);
        Ok(file(&job.path, Store::open_with_coarse(&output, FIRST_PICTURE_BYTES)?, kept_in, folder))
    }
}

/// What there is of a path.
enum Found {
    Open(OpenedFile),
    Scans(Vec<PathBuf>),
}

fn file(path: &Path, store: Store, kept_in: KeptIn, folder: Option<TempDir>) -> OpenedFile {
    let (store, _folder) = (Arc::new(store), folder.map(Arc::new));
    OpenedFile { path: path.to_owned(), store, kept_in, _folder }
}

struct Listener<'a> {
    worker: &'a Worker,
    path: &'a Path,
    is_preview: bool,
    /// Points of the preview that is shown when all have been read.
    even_points: u64,
}

impl Progress for Listener<'_> {
    fn begin(&self, stage: Stage, points_total: u64) {
        let stage = (!self.is_preview).then_some(stage.name());
        let path = self.path.to_owned();
        let advance = Advance { path, stage, points_done: 0, points_total };
        self.worker.shared.set_converting(Some(advance));
        (self.worker.wake)(Sign::Begun);
    }

    fn advance(&self, points: u64) {
        self.worker.shared.points_done.fetch_add(points, Ordering::Relaxed);
    }

    fn wanted_points(&self) -> u64 {
        self.even_points
    }

    fn take_points(&self, sample: PointSample) {
        let listener = Listener { is_preview: true, even_points: 0, ..*self };
        let folder = self.worker.options.preview_folder.as_deref();
        let cancelled = &self.worker.shared.cancelled;
        let preview = Sources::of_points(sample)
            .map_err(anyhow::Error::from)
            .and_then(|sources| preview_of(&sources, folder, &listener, cancelled));
        // Without it there is only longer to wait.
        if let Ok((store, folder)) = preview {
            let preview = file(self.path, store, KeptIn::Preview, folder);
            self.worker.tell(Opened::Preview(preview));
        }
    }
}
