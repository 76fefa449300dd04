//! New points for a store that is there already.
//!
//! They are read in batches that fit memory; each batch goes down the octree (`grow`), nodes that
//! change are written behind the end of the file, and when all is done a new header makes the whole
//! change at once. What it costs is in proportion to the new points and the nodes they change.

mod arrivals;
mod grow;

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use crate::build::BuildError;
use crate::build::convert::convert_sources;
use crate::build::encode::{Encoding, join_ranges};
use crate::build::node::{NodeBuilder, TreeRules};
use crate::build::options::ConvertOptions;
use crate::build::progress::{Clock, Progress, Stage, StageTime};
use crate::build::rows::{RowLayout, RowTable};
use crate::build::sort::{SortScratch, sort_rows};
use crate::build::sources::Sources;
use crate::geometry::MortonKey;
use crate::ids::NodeId;
use crate::store::{
    AppendixPart, CrsInfo, Metadata, SourceInfo, Store, StoreAppender, ValueRange, compact,
};
use arrivals::{Arrivals, joined, read_arrivals};
use grow::{Grown, Growth, Item, Sink, Task};

/// What an addition to a store did.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct AppendReport {
    /// Points in the store now.
    pub points: u64,
    /// New ones among them.
    pub new_points: u64,
    /// Points of the new scans that are not in the store, each with a reason in `sources`.
    pub dropped_points: u64,
    /// Nodes of the octree.
    pub nodes: u64,
    /// Nodes that are new or were written anew.
    pub nodes_written: u64,
    /// Size of the store.
    pub output_bytes: u64,
    /// Bytes written.
    pub bytes_written: u64,
    /// Bytes of the store that are no longer in use.
    pub unused_bytes: u64,
    /// Whether the whole store was written anew, because the new points reach beyond its cube, need
    /// finer steps or wider colours.
    pub rebuilt: bool,
    /// Whether it was written anew afterwards, without unused bytes.
    pub compacted: bool,
    /// The parts of the work in order, with their times.
    pub stages: Vec<StageTime>,
    /// The new sources: how many points came in, and what became of them.
    pub sources: Vec<SourceInfo>,
    /// What is worth telling, each with its file.
    pub warnings: Vec<String>,
}

/// Adds the points of scans to a store.
///
/// They count as inserted after those that are there. The store is the old one until all is done,
/// and stays it if something fails. A store of a single source gets the attribute `source`, zeros for
/// the points it has. Scans must fit its layout; if they reach beyond its root cube, or are exact only
/// on a finer lattice, the whole store is written anew.
pub fn append(
    store: &Path,
    inputs: &[PathBuf],
    options: &ConvertOptions,
    progress: &dyn Progress,
    cancelled: &AtomicBool,
) -> Result<AppendReport, BuildError> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(options.threads).build();
    let pool = pool.map_err(|error| BuildError::Temporary {
        action: "cannot start threads",
        source: std::io::Error::other(error),
        path: store.into(),
    })?;
    pool.install(|| {
        let before_write = || options.before_write.as_ref().map_or(Ok(()), |hook| hook());
        let add = || -> Result<AppendReport, BuildError> {
            let (mut appender, opened) = StoreAppender::open(store, &before_write)?;
            if opened.metadata().points == 0 {
                let reason = "it is empty: convert the scans instead".into();
                return Err(BuildError::Append { reason, path: store.into() });
            }
            let (sources, target) = Sources::open_onto(inputs, &options.read, opened.metadata())?;
            if cancelled.load(Ordering::Relaxed) {
                return Err(BuildError::Interrupted);
            }
            appender.widen(target.sections.len());
            let addition = Addition { sources: &sources, options, progress, cancelled };
            if target.root_bits <= u64::MAX_BITS {
                addition.run::<u64>(appender, opened, target)
            } else {
                addition.run::<u128>(appender, opened, target)
            }
        };
        let added = match add() {
            Err(BuildError::Outgrown { .. }) => {
                rebuild(store, inputs, options, progress, cancelled)
            }
            outcome => outcome,
        };
        let mut report = added.map_err(|error| error.unless_cancelled(cancelled))?;
        let most = options.compact_above * report.output_bytes as f64;
        if report.unused_bytes as f64 > most {
            report.output_bytes = compact(store, &before_write)?;
            report.bytes_written += report.output_bytes;
            (report.unused_bytes, report.compacted) = (0, true);
        }
        Ok(report)
    })
}

/// Writes the whole store anew, with the points that do not fit it in place.
fn rebuild(
    path: &Path,
    inputs: &[PathBuf],
    options: &ConvertOptions,
    progress: &dyn Progress,
    cancelled: &AtomicBool,
) -> Result<AppendReport, BuildError> {
    let store = Store::open(path)?;
    let (points, known) = (store.metadata().points, store.metadata().sources.len());
    let dropped_points = store.metadata().dropped_points;
    let options = ConvertOptions {
        depth: store.metadata().depth,
        threshold: store.metadata().threshold,
        overwrite: true,
        ..options.clone()
    };
    let sources = Sources::open_with_store(store, inputs, &options.read)?;
    let report = convert_sources(&sources, path, &options, progress, cancelled)?;
    Ok(AppendReport {
        points: report.points,
        new_points: report.points - points,
        dropped_points: report.dropped_points - dropped_points,
        nodes: report.nodes,
        nodes_written: report.nodes,
        output_bytes: report.output_bytes,
        bytes_written: report.output_bytes,
        unused_bytes: 0,
        rebuilt: true,
        compacted: false,
        stages: report.stages,
        sources: report.sources[known..].to_vec(),
        warnings: report.warnings,
    })
}

struct Addition<'a> {
    sources: &'a Sources,
    options: &'a ConvertOptions,
    progress: &'a dyn Progress,
    cancelled: &'a AtomicBool,
}

/// New points of a task that is not divided further.
const TASK_POINTS: usize = 1 << 16;
/// Stored bytes of the nodes that such a task may look at.
const TASK_BYTES: u64 = 16 << 20;

impl Addition<'_> {
    fn run<K: MortonKey>(
        &self,
        mut appender: StoreAppender,
        mut store: Store,
        old: Metadata,
    ) -> Result<AppendReport, BuildError> {
        let mut clock = Clock::new(self.progress);
        let sources = self.sources;
        let old_bytes = store.header().file_bytes;
        let blocks = sources.blocks();
        let expected = sources.expected_points();
        let layout = RowLayout::new::<K>(&old.schema, old.points.saturating_add(expected));
        let batch_points = self.options.memory_bytes / 4 / (2 * layout.stride() as u64 + 64);
        let mut metadata = old.clone();
        let mut block_points: Vec<u64> = Vec::with_capacity(blocks.len());
        let mut nodes_written = 0;
        let mut next = 0;
        while next < blocks.len() {
            if next > 0 {
                // What a batch put into nodes the next one must see.
                store = appender.preview(&metadata)?;
            }
            let mut end = next + 1;
            let mut points = blocks[next].1.expected_points();
            while end < blocks.len() && points + blocks[end].1.expected_points() <= batch_points {
                points += blocks[end].1.expected_points();
                end += 1;
            }
            clock.begin(Stage::Read, points);
            let arrivals = read_arrivals::<K>(
                sources,
                &blocks[next..end],
                &old,
                layout,
                metadata.points,
                self.progress,
                self.cancelled,
            )?;
            clock.begin(Stage::Build, arrivals.block_points.iter().sum());
            nodes_written +=
                self.build::<K>(&arrivals, layout, &store, &mut metadata, &mut appender)?;
            let bounds = joined([metadata.bounds_min, metadata.bounds_max], arrivals.bounds);
            [metadata.bounds_min, metadata.bounds_max] = bounds;
            block_points.extend(&arrivals.block_points);
            next = end;
        }
        clock.begin(Stage::Write, 0);
        let mut points_of_source = vec![0; sources.scans().len()];
        for ((source, _), points) in blocks.iter().zip(&block_points) {
            points_of_source[*source] += points;
        }
        let described = sources.describe(&points_of_source);
        let mut warnings: Vec<String> = described
            .infos
            .iter()
            .flat_map(|source| source.warnings.iter().map(|w| format!("{}: {w}", source.name)))
            .collect();
        warnings.extend(self.join_crs(&mut metadata, described.crs));
        metadata.dropped_points += described.dropped_points;
        metadata.sources.extend(described.infos.iter().cloned());
        let mut appendix: Vec<AppendixPart> = vec![appender.old_appendix()];
        appendix.extend(described.appendix);
        let path = store.path().to_path_buf();
        drop(store);
        let header = appender.finish(&metadata, &appendix)?;
        let store = Store::open(&path)?;
        Ok(AppendReport {
            points: metadata.points,
            new_points: metadata.points - old.points,
            dropped_points: described.dropped_points,
            nodes: store.octree().nodes().len() as u64,
            nodes_written,
            output_bytes: header.file_bytes,
            bytes_written: header.file_bytes - old_bytes,
            unused_bytes: store.unused_bytes(),
            rebuilt: false,
            compacted: false,
            stages: clock.finish(),
            sources: described.infos,
            warnings,
        })
    }

    /// Brings one batch into the tree; returns how many nodes were written.
    fn build<K: MortonKey>(
        &self,
        arrivals: &Arrivals,
        layout: RowLayout,
        store: &Store,
        metadata: &mut Metadata,
        appender: &mut StoreAppender,
    ) -> Result<u64, BuildError> {
        const PAGE_SHIFT: u32 = 16;
        let (schema, sections) = (metadata.schema.clone(), metadata.sections.clone());
        let pages: Vec<&[u8]> = arrivals.rows.chunks(layout.stride() << PAGE_SHIFT).collect();
        let table = RowTable::new(&pages, PAGE_SHIFT, layout);
        let mut items: Vec<Item<K>> = Vec::new();
        let base = K::default();
        sort_rows(table, base, &mut SortScratch::default(), |key, slot| {
            items.push(Item { key, slot });
        });
        let rules = TreeRules {
            root_bits: metadata.root_bits,
            levels: metadata.depth,
            threshold: metadata.threshold as usize,
            representative: self.options.representative,
            encoding: Encoding {
                schema: &schema,
                sections: &sections,
                color_bits: metadata.color_bits,
            },
        };
        let subtree_bytes = subtree_bytes(store);
        let growth = Growth { store, rules: &rules, layout, arrivals: table };
        metadata.points += items.len() as u64;
        if items.is_empty() {
            return Ok(0);
        }
        let root = Task {
            depth: 0,
            code: K::default(),
            node: Some(NodeId(0)),
            carried: Vec::new(),
            items,
        };
        let mut tally = Tally { metadata, appender, nodes: 0, progress: self.progress };
        let weigh = |task: &Task<K>| {
            let old = task.node.map_or(0, |node| subtree_bytes[node.index()]);
            let rows = task.carried.len() + task.items.len() * layout.stride();
            rows as u64 + 2 * old.min(TASK_BYTES)
        };
        let mut tasks = VecDeque::from([root]);
        while !tasks.is_empty() {
            if self.cancelled.load(Ordering::Relaxed) {
                return Err(BuildError::Interrupted);
            }
            let mut wave = Vec::new();
            let mut weight = 0;
            while let Some(task) = tasks.pop_front() {
                if !wave.is_empty() && weight + weigh(&task) > self.options.memory_bytes / 8 {
                    tasks.push_front(task);
                    break;
                }
                weight += weigh(&task);
                wave.push(task);
            }
            let run = |builder: &mut NodeBuilder<K>, task: Task<K>| {
                let (grown, later) = (Vec::new(), Vec::new());
                let mut results = Results { grown, later, subtree_bytes: &subtree_bytes };
                growth.grow(task, builder, &mut results)?;
                Ok::<_, BuildError>((results.grown, results.later))
            };
            let done: Vec<_> = wave.into_par_iter().map_init(NodeBuilder::default, run).collect();
            for results in done {
                let (grown, later) = results?;
                grown.into_iter().try_for_each(|node| tally.add(node))?;
                tasks.extend(later);
            }
        }
        Ok(tally.nodes)
    }

    /// Keeps the store's reference system; tells of another.
    fn join_crs(&self, metadata: &mut Metadata, found: CrsInfo) -> Option<String> {
        let is_told = |crs: &CrsInfo| crs.epsg.is_some() || crs.wkt.is_some();
        if !is_told(&metadata.crs) {
            metadata.crs = found;
            return None;
        }
        let differs = match (metadata.crs.epsg, found.epsg) {
            (Some(a), Some(b)) => a != b,
            _ => is_told(&found) && found.wkt != metadata.crs.wkt,
        };
        differs.then(|| "the new scans have another reference system than the store".into())
    }
}

/// Stored bytes of each node and all below it.
fn subtree_bytes(store: &Store) -> Vec<u64> {
    let nodes = store.octree().nodes();
    let ids = (0..nodes.len() as u32).map(NodeId);
    let mut bytes: Vec<u64> = ids.map(|id| store.node_extent(id).1).collect();
    for (i, node) in nodes.iter().enumerate().rev() {
        if let Some(parent) = node.parent {
            bytes[parent.index()] += bytes[i];
        }
    }
    bytes
}

/// Writes nodes and counts what they change.
struct Tally<'a, 'w> {
    metadata: &'a mut Metadata,
    appender: &'a mut StoreAppender<'w>,
    nodes: u64,
    progress: &'a dyn Progress,
}

impl Tally<'_, '_> {
    fn add(&mut self, node: Grown) -> Result<(), BuildError> {
        let Grown { finished, old_overflow, new_points } = node;
        join_ranges(&mut self.metadata.attribute_ranges, &finite(finished.ranges));
        self.metadata.overflow_points -= old_overflow;
        self.metadata.overflow_points += finished.overflow_points;
        self.nodes += 1;
        self.progress.advance(new_points);
        Ok(self.appender.put(finished.node)?)
    }
}

/// Ranges as the metadata has them: what is infinite says nothing.
fn finite(mut ranges: Vec<Vec<ValueRange>>) -> Vec<Vec<ValueRange>> {
    for range in ranges.iter_mut().flatten() {
        range.min = range.min.max(f64::MIN);
        range.max = range.max.min(f64::MAX);
    }
    ranges
}

/// What comes out of a task.
struct Results<'a, K> {
    grown: Vec<Grown>,
    later: Vec<Task<K>>,
    subtree_bytes: &'a [u64],
}

impl<K> Sink<K> for Results<'_, K> {
    fn grown(&mut self, node: Grown) {
        self.grown.push(node);
    }

    /// Cells in which there is much to do are tasks of their own.
    fn child(&mut self, task: Task<K>) -> Option<Task<K>> {
        let old = task.node.map_or(0, |node| self.subtree_bytes[node.index()]);
        if task.items.len() <= TASK_POINTS && old <= TASK_BYTES {
            return Some(task);
        }
        self.later.push(task);
        None
    }
}
