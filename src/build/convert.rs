//! A conversion from its inputs to the finished store, as a list of steps.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use crate::build::BuildError;
use crate::build::budget::Budget;
use crate::build::checkpoint::{self, Checkpoints, State, Step};
use crate::build::disk::DiskNeed;
use crate::build::machine::free_disk;
use crate::build::node::TreeShape;
use crate::build::options::{ConvertOptions, DEPTH_RANGE};
use crate::build::ordered::Built;
use crate::build::pages::{PageStore, Slab};
use crate::build::progress::{Clock, PointSample, Progress, Silent, Stage, StageTime};
use crate::build::sources::Sources;
use crate::build::steps::Steps;
use crate::build::work::Work;
use crate::geometry::MortonKey;
use crate::store::{Metadata, SourceInfo, StoreWriter, ValueRange, remove_dead_part, sections_for};

/// What a conversion did.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ConvertReport {
    /// Points in the store.
    pub points: u64,
    /// Points of the input that are not, each with a reason in `sources`.
    pub dropped_points: u64,
    /// Nodes of the octree.
    pub nodes: u64,
    /// Points in nodes beyond one per finest cell.
    pub overflow_points: u64,
    /// Size of the store.
    pub output_bytes: u64,
    /// Bytes written to temporary files.
    pub temporary_bytes: u64,
    /// What that was expected to be, by a sample of the input.
    pub expected_temporary_bytes: u64,
    /// Whether all points were held in memory at once.
    pub in_memory: bool,
    /// Whether it went on from where a killed run was.
    pub resumed: bool,
    /// Whether no point was read twice because headers told the bounds, and points bore them out.
    pub read_once: bool,
    /// The parts of the work in order, with their times.
    pub stages: Vec<StageTime>,
    /// Per source how many points came in, and what became of them.
    pub sources: Vec<SourceInfo>,
    /// What headers said and points did not bear out, each with its file.
    pub warnings: Vec<String>,
}

/// Converts scan files into one store.
///
/// `inputs` count in the order given. Nothing appears under `output` unless everything succeeded.
/// Setting `cancelled` ends the work soon, with [`BuildError::Interrupted`].
pub fn convert(
    inputs: &[PathBuf],
    output: &Path,
    options: &ConvertOptions,
    progress: &dyn Progress,
    cancelled: &AtomicBool,
) -> Result<ConvertReport, BuildError> {
    convert_with(output, options, progress, cancelled, |conversion| {
        let sources = Sources::open(inputs, &options.read);
        conversion.run(&sources.map_err(|error| error.unless_cancelled(cancelled))?)
    })
}

/// Converts files that are open already; see [`convert`].
pub fn convert_sources(
    sources: &Sources,
    output: &Path,
    options: &ConvertOptions,
    progress: &dyn Progress,
    cancelled: &AtomicBool,
) -> Result<ConvertReport, BuildError> {
    convert_with(output, options, progress, cancelled, |conversion| conversion.run(sources))
}

fn convert_with(
    output: &Path,
    options: &ConvertOptions,
    progress: &dyn Progress,
    cancelled: &AtomicBool,
    run: impl FnOnce(Conversion<'_>) -> Result<ConvertReport, BuildError> + Send,
) -> Result<ConvertReport, BuildError> {
    assert!(
        options.depth == 0 || DEPTH_RANGE.contains(&options.depth),
        "depth {} is not in {DEPTH_RANGE:?}",
        options.depth
    );
    let conversion = Conversion { output, options, progress, cancelled };
    if output.exists() && !options.overwrite {
        // A run that was killed when it was done may have left its work.
        conversion.work().discard();
        remove_dead_part(output);
        return Err(BuildError::Exists { path: output.into() });
    }
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(options.threads)
        .build()
        .map_err(|error| temporary("cannot start threads", std::io::Error::other(error), output))?;
    pool.install(|| run(conversion))
}

/// Where an interrupted conversion to that output keeps what it has done, if it does.
pub fn kept_work(output: &Path, options: &ConvertOptions) -> Option<PathBuf> {
    let (progress, cancelled) = (&Silent, &AtomicBool::new(false));
    let work = Conversion { output, options, progress, cancelled }.work();
    work.has_state().then(|| work.folder().to_path_buf())
}

struct Conversion<'a> {
    output: &'a Path,
    options: &'a ConvertOptions,
    progress: &'a dyn Progress,
    cancelled: &'a AtomicBool,
}

impl Conversion<'_> {
    fn run(&self, sources: &Sources) -> Result<ConvertReport, BuildError> {
        // Damaged files are opened as far as they can be read, and so are those given up meanwhile.
        if self.cancelled.load(Ordering::Relaxed) {
            return Err(BuildError::Interrupted);
        }
        let work = self.work();
        let outcome = self.run_in(sources, &work);
        let outcome = outcome.map_err(|error| error.unless_cancelled(self.cancelled));
        // What a failed run noted down serves the next one only if nothing is wrong with the input.
        let can_go_on = matches!(outcome, Err(BuildError::Interrupted)) && work.has_state();
        if !can_go_on {
            work.remove();
            if outcome.is_err() {
                remove_dead_part(self.output);
            }
        }
        outcome
    }

    fn run_in(&self, sources: &Sources, work: &Work) -> Result<ConvertReport, BuildError> {
        let mut clock = Clock::new(self.progress);
        let schema = sources.schema();
        let inputs: Vec<PathBuf> =
            sources.scans().iter().map(|source| source.path().to_path_buf()).collect();
        let job = checkpoint::job(&inputs, self.options);
        let mut resumed: Option<State> = work.state(&job)?;
        if let Some(State { step: Step::Build { writer, .. }, .. }) = &resumed
            && !StoreWriter::can_resume(self.output, writer)
        {
            work.remove();
            resumed = None;
        }
        let mut budget = Budget::new(self.options, schema, sources.expected_points())?;
        budget.page_bytes = resumed.as_ref().map_or(budget.page_bytes, |state| state.page_bytes);
        let disk = DiskNeed::of(sources, &budget);
        if resumed.is_none() {
            self.check_disk(disk)?;
        }
        let mut slab = Slab::reserve(budget.slab_bytes, budget.page_bytes);
        let pages_end = resumed.as_ref().map_or(0, |state| state.pages_end);
        let pages = PageStore::new(work, budget.page_bytes, &mut slab, pages_end);
        let every = self.options.checkpoint_every;
        let before_write = || work.before_write();
        let mut steps = Steps {
            progress: self.progress,
            cancelled: self.cancelled,
            sources,
            budget,
            pages: &pages,
            output: self.output,
            before_write: &before_write,
            checkpoints: Checkpoints::new(work, job, every, budget.page_bytes),
        };
        let is_resumed = resumed.is_some();
        clock.begin(Stage::Read, sources.expected_points());
        let depth = self.options.depth_for(schema);
        // Who wants points wants them before they are sorted.
        let may_trust = self.options.trust_headers && self.progress.wanted_points() == 0;
        let claims = may_trust.then(|| sources.claims(depth)).flatten();
        let mut surveyed = steps.survey(resumed, claims)?;
        let (built, root_bits) = loop {
            let survey = &mut surveyed.survey;
            let records = survey.take_records();
            if !records.is_empty() {
                let (schema, lattice) = (schema.clone(), sources.lattice());
                self.progress.take_points(PointSample { records, schema, lattice });
            }
            let root_bits = survey.all.root_bits(depth);
            if root_bits > u128::MAX_BITS {
                let path = sources.scans().last().expect("there is a file").path().to_path_buf();
                return Err(BuildError::TooWide { steps: 1 << (root_bits - 1), path });
            }
            let tree = TreeShape {
                root_bits,
                levels: depth,
                threshold: self.options.threshold.max(1) as usize,
                representative: self.options.representative,
            };
            let built = if survey.all.points == 0 {
                Some(Built::new(StoreWriter::create(self.output, &before_write)?))
            } else if root_bits <= u64::MAX_BITS {
                steps.build::<u64>(&mut surveyed, tree, &mut clock)?
            } else {
                steps.build::<u128>(&mut surveyed, tree, &mut clock)?
            };
            if let Some(built) = built {
                break (built, root_bits);
            }
            clock.begin(Stage::Read, sources.expected_points());
            surveyed = steps.survey(None, None)?;
        };
        let (survey, read_once) = (&surveyed.survey, surveyed.read_once);
        let (all, color_bits) = (survey.all, survey.color_bits(schema));
        let sections = sections_for(schema, color_bits);
        clock.begin(Stage::Write, all.points);
        let mut points_of_source = vec![0; sources.scans().len()];
        for ((source, _), points) in sources.blocks().iter().zip(&survey.block_points) {
            points_of_source[*source] += points;
        }
        let described = sources.describe(&points_of_source);
        let has_points = all.points > 0;
        let lattice = sources.lattice();
        let metadata = Metadata {
            generator: concat!("esker ", env!("CARGO_PKG_VERSION")).into(),
            points: all.points,
            dropped_points: described.dropped_points,
            scale: lattice.scale.to_array(),
            offset: lattice.offset.to_array(),
            root_min: if has_points { all.min } else { [0; 3] },
            root_bits,
            depth,
            threshold: self.options.threshold.max(1),
            overflow_points: built.overflow_points,
            bounds_min: if has_points { all.min } else { [0; 3] },
            bounds_max: if has_points { all.max } else { [0; 3] },
            color_bits,
            schema: schema.clone(),
            attribute_ranges: finite(built.ranges),
            sections,
            crs: described.crs,
            sources: described.infos,
        };
        let nodes = built.writer.node_count();
        let overwrite = self.options.overwrite;
        let temporary_bytes = pages.written_bytes();
        drop((steps, surveyed));
        drop(pages);
        // The disk is waited for while the system takes back the memory, which takes time.
        let (output_bytes, ()) = rayon::join(
            || built.writer.finish(&metadata, &described.appendix, overwrite),
            || slab.release(),
        );
        let output_bytes = output_bytes?;
        self.progress.advance(all.points);
        let warnings = metadata
            .sources
            .iter()
            .flat_map(|source| source.warnings.iter().map(|w| format!("{}: {w}", source.name)))
            .collect();
        Ok(ConvertReport {
            points: all.points,
            dropped_points: metadata.dropped_points,
            nodes,
            overflow_points: built.overflow_points,
            output_bytes,
            temporary_bytes,
            expected_temporary_bytes: disk.temporary,
            in_memory: temporary_bytes == 0,
            resumed: is_resumed,
            read_once,
            stages: clock.finish(),
            sources: metadata.sources,
            warnings,
        })
    }

    /// Refuses what the disks will not hold: better now than after an hour.
    fn check_disk(&self, need: DiskNeed) -> Result<(), BuildError> {
        let (least_output, temporary) = (need.store, need.least_temporary());
        let temp_dir = self.temp_dir();
        let output_dir = self.output.parent().filter(|folder| !folder.as_os_str().is_empty());
        let output_dir = output_dir.unwrap_or(Path::new("."));
        let check = |folder: &Path, needed: u64| match free_disk(folder) {
            Some(free) if free < needed => {
                Err(BuildError::DiskRoom { needed, free, path: folder.into() })
            }
            _ => Ok(()),
        };
        // Mostly the same disk; two folders of it must not be counted as two disks.
        if free_disk(&temp_dir) == free_disk(output_dir) {
            return check(output_dir, least_output + temporary);
        }
        check(output_dir, least_output)?;
        check(&temp_dir, temporary)
    }

    fn work(&self) -> Work {
        Work::new(&self.temp_dir(), self.output, self.options.before_write.clone())
    }

    fn temp_dir(&self) -> PathBuf {
        let folder = self.options.temp_dir.clone().or_else(|| self.output.parent().map(Into::into));
        folder.filter(|f| !f.as_os_str().is_empty()).unwrap_or_else(|| PathBuf::from("."))
    }
}

/// Ranges as JSON can hold them: attributes without any number get 0..0.
fn finite(mut ranges: Vec<Vec<ValueRange>>) -> Vec<Vec<ValueRange>> {
    for range in ranges.iter_mut().flatten() {
        if range.min > range.max {
            *range = ValueRange { min: 0.0, max: 0.0 };
        }
        range.min = range.min.clamp(f64::MIN, f64::MAX);
        range.max = range.max.clamp(f64::MIN, f64::MAX);
    }
    ranges
}

fn temporary(action: &'static str, source: std::io::Error, path: &Path) -> BuildError {
    BuildError::Temporary { action, source, path: path.into() }
}
