//! A conversion from its inputs to the finished store, as a list of steps.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rayon::prelude::*;

use crate::build::BuildError;
use crate::build::encode::{Encoding, FinishedNode, join_ranges};
use crate::build::options::{ConvertOptions, DEPTH_RANGE};
use crate::build::out_of_core::{OutOfCore, RowBatch, RowSource, TakeBatches, least_region_points};
use crate::build::point_tree::Entry;
use crate::build::progress::{Progress, Stage};
use crate::build::rows::{INDEX_BYTES, Rows};
use crate::build::sources::{Batch, Sources, Survey};
use crate::build::spill::{SpillFile, StreamId};
use crate::build::subtree::{Subtree, TreeRules};
use crate::geometry::MortonKey;
use crate::points::Schema;
use crate::store::{Metadata, StoreWriter, ValueRange, sections_for};

/// What a conversion did.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct ConvertReport {
    /// Points of the input, all of them in the store.
    pub points: u64,
    /// Nodes of the octree.
    pub nodes: u64,
    /// Points in nodes beyond one per finest cell.
    pub overflow_points: u64,
    /// Size of the store.
    pub output_bytes: u64,
    /// Bytes written to temporary files.
    pub temporary_bytes: u64,
    /// Whether all points were held in memory at once.
    pub in_memory: bool,
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
    assert!(
        DEPTH_RANGE.contains(&options.depth),
        "depth {} is not in {DEPTH_RANGE:?}",
        options.depth
    );
    if output.exists() && !options.overwrite {
        return Err(BuildError::Exists { path: output.into() });
    }
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(options.threads)
        .build()
        .map_err(|error| temporary("cannot start threads", std::io::Error::other(error), output))?;
    pool.install(|| Conversion { output, options, progress, cancelled }.run(inputs))
}

struct Conversion<'a> {
    output: &'a Path,
    options: &'a ConvertOptions,
    progress: &'a dyn Progress,
    cancelled: &'a AtomicBool,
}

/// All points in memory, as records in input order.
struct HeldPoints {
    records: Vec<u8>,
    /// First row of each source.
    source_starts: Vec<usize>,
}

/// What the first pass leaves behind.
struct FirstPass {
    survey: Survey,
    points_of_source: Vec<u64>,
    held: Option<HeldPoints>,
    /// Decoded records of compressed input that does not fit memory, in input order.
    spooled: Option<(SpillFile, StreamId)>,
}

/// Memory for the program itself and for blocks being read, whatever the cap.
const FIXED_BYTES: u64 = 40 << 20;
/// Part of the memory cap for points and what is done to them; what the shares leave is for what
/// the allocator keeps.
const POINT_SHARE: f64 = 0.66;
/// Part of the memory cap for the counting grid.
const GRID_SHARE: f64 = 0.08;
/// Part of the memory cap for encoded nodes that wait to be written.
const NODE_SHARE: f64 = 0.10;
/// Part of the memory cap for tails of spilled streams.
const TAIL_SHARE: f64 = 0.06;

impl Conversion<'_> {
    fn run(&self, inputs: &[PathBuf]) -> Result<ConvertReport, BuildError> {
        let sources = Sources::open(inputs, &self.options.read)?;
        let schema = sources.schema();
        // In memory a point is its record and a sort entry, and its encoded bytes wait, too.
        let held_bytes =
            |entry: usize| (1.4 * f64::from(schema.record_bytes)) as u64 + entry as u64;
        let fits = sources.expected_points().saturating_mul(held_bytes(size_of::<Entry<u128>>()))
            <= self.share(POINT_SHARE + NODE_SHARE)
            && sources.expected_points() <= u64::from(u32::MAX);
        let first = self.first_pass(&sources, fits)?;
        let survey = &first.survey;
        let root_bits = survey.root_bits(self.options.depth);
        if root_bits > u128::MAX_BITS {
            let path = inputs.last().expect("sources have a file").clone();
            return Err(BuildError::TooWide { steps: 1 << (root_bits - 1), path });
        }
        let color_bits = crate::build::rows::color_offset(schema)
            .map(|_| if survey.color_union > 0xff { 16 } else { 8 });
        let sections = sections_for(schema, color_bits);
        let rules = TreeRules {
            root_bits,
            levels: self.options.depth,
            threshold: self.options.threshold.max(1) as usize,
            representative: self.options.representative,
            encoding: Encoding { schema, sections: &sections, color_bits },
            cancelled: self.cancelled,
        };
        let (survey, points_of_source) = (first.survey.clone(), first.points_of_source.clone());
        let in_memory = first.held.is_some();
        let built = if root_bits <= u64::MAX_BITS {
            self.build::<u64>(&sources, &rules, first)?
        } else {
            self.build::<u128>(&sources, &rules, first)?
        };
        self.progress.begin(Stage::Write, survey.points);
        let described = sources.describe(&points_of_source);
        let has_points = survey.points > 0;
        let lattice = sources.lattice();
        let metadata = Metadata {
            generator: concat!("esker ", env!("CARGO_PKG_VERSION")).into(),
            points: survey.points,
            dropped_points: described.dropped_points,
            scale: lattice.scale.to_array(),
            offset: lattice.offset.to_array(),
            root_min: if has_points { survey.min } else { [0; 3] },
            root_bits,
            depth: self.options.depth,
            threshold: self.options.threshold.max(1),
            overflow_points: built.overflow_points,
            bounds_min: if has_points { survey.min } else { [0; 3] },
            bounds_max: if has_points { survey.max } else { [0; 3] },
            color_bits,
            schema: schema.clone(),
            attribute_ranges: finite(built.ranges),
            sections: sections.clone(),
            crs: described.crs,
            sources: described.infos,
        };
        let nodes = built.nodes;
        let temporary_bytes = built.temporary_bytes + built.writer.spilled_bytes();
        let output_bytes = built.writer.finish(
            self.output,
            &metadata,
            &described.appendix,
            self.options.overwrite,
        )?;
        self.progress.advance(survey.points);
        let warnings = metadata
            .sources
            .iter()
            .flat_map(|source| source.warnings.iter().map(|w| format!("{}: {w}", source.name)))
            .collect();
        Ok(ConvertReport {
            points: survey.points,
            nodes,
            overflow_points: built.overflow_points,
            output_bytes,
            temporary_bytes,
            in_memory,
            warnings,
        })
    }

    /// Part of what the memory cap leaves for the points.
    fn share(&self, part: f64) -> u64 {
        let cap = self.options.memory_bytes;
        (cap.saturating_sub(FIXED_BYTES).max(cap / 4) as f64 * part) as u64
    }

    fn temp_dir(&self) -> PathBuf {
        let folder = self.options.temp_dir.clone().or_else(|| self.output.parent().map(Into::into));
        folder.filter(|f| !f.as_os_str().is_empty()).unwrap_or_else(|| PathBuf::from("."))
    }

    /// Reads every point once: bounds, colour depth, and the records where they must be kept.
    fn first_pass(&self, sources: &Sources, hold: bool) -> Result<FirstPass, BuildError> {
        self.progress.begin(Stage::Read, sources.expected_points());
        let schema = sources.schema();
        let mut survey = Survey::empty();
        let mut points_of_source = vec![0u64; sources.scans().len()];
        let mut held = hold.then(|| HeldPoints { records: Vec::new(), source_starts: Vec::new() });
        let mut spooled = (!hold && sources.are_compressed()).then(|| {
            let mut file = SpillFile::new(&self.temp_dir(), 1 << 20);
            let stream = file.add_stream();
            (file, stream)
        });
        sources.for_each_group(self.cancelled, &mut |batches: &[Batch]| {
            survey = batches
                .par_iter()
                .map(|batch| Survey::of(batch, schema))
                .collect::<Vec<_>>()
                .iter()
                .fold(survey.clone(), Survey::join);
            for batch in batches {
                points_of_source[batch.source] += batch.rows.len() as u64;
                if let Some(held) = &mut held {
                    held.records.extend_from_slice(batch.records);
                }
                if let Some((file, stream)) = &mut spooled {
                    file.append(*stream, batch.records)?;
                }
                self.progress.advance(batch.rows.len() as u64);
            }
            Ok(())
        })?;
        if let Some(held) = &mut held {
            let starts = points_of_source.iter().scan(0, |start, points| {
                let this = *start;
                *start += *points as usize;
                Some(this)
            });
            held.source_starts = starts.collect();
        }
        Ok(FirstPass { survey, points_of_source, held, spooled })
    }

    fn build<K: MortonKey>(
        &self,
        sources: &Sources,
        rules: &TreeRules,
        first: FirstPass,
    ) -> Result<Built, BuildError> {
        let node_memory = self.share(NODE_SHARE) as usize;
        let stages: &[Stage] = match first.held {
            Some(_) => &[Stage::Build],
            None => &[Stage::Count, Stage::Partition, Stage::Build],
        };
        let collected = Mutex::new(Built {
            writer: StoreWriter::new(&self.temp_dir(), node_memory),
            ranges: Vec::new(),
            nodes: 0,
            overflow_points: 0,
            temporary_bytes: 0,
        });
        let overflow = AtomicU64::new(0);
        let progress = StagedProgress::new(self.progress, stages, first.survey.points);
        let sink = |finished: FinishedNode| -> Result<(), BuildError> {
            let points = u64::from(finished.node.levels.point_count());
            let mut built = collected.lock().expect("no holder of the lock panics");
            join_ranges(&mut built.ranges, &finished.ranges);
            built.nodes += 1;
            built.writer.add(finished.node)?;
            drop(built);
            progress.advance(points);
            Ok(())
        };
        let FirstPass { survey, points_of_source, held, spooled } = first;
        let mut temporary_bytes = 0;
        if survey.points == 0 {
            // No nodes; the store says so.
        } else if let Some(held) = held {
            let rows = Rows::consecutive(&held.records, sources.schema(), 0);
            let mut entries = Vec::new();
            for (source, &start) in held.source_starts.iter().enumerate() {
                let rows_of_source = start as u32..(start as u64 + points_of_source[source]) as u32;
                let origin = origin_of(sources, source, &survey);
                let batch = RowBatch { rows, origin: Some(origin) };
                entries.par_extend(
                    rows_of_source
                        .into_par_iter()
                        .map(|row| Entry { key: batch.key::<K>(row), row }),
                );
            }
            Subtree::sort(&mut entries);
            Subtree { rules, rows, sink: &sink, overflow: &overflow }.grow(0, &mut entries)?;
        } else {
            temporary_bytes = self.build_out_of_core::<K>(
                sources,
                rules,
                &survey,
                &points_of_source,
                spooled,
                &sink,
                &overflow,
                &progress,
            )?;
        }
        let mut built = collected.into_inner().expect("no holder of the lock panics");
        built.overflow_points = overflow.into_inner();
        built.temporary_bytes = temporary_bytes;
        Ok(built)
    }

    #[allow(clippy::too_many_arguments, reason = "the parts of one step, used nowhere else")]
    fn build_out_of_core<K: MortonKey>(
        &self,
        sources: &Sources,
        rules: &TreeRules,
        survey: &Survey,
        points_of_source: &[u64],
        spooled: Option<(SpillFile, StreamId)>,
        sink: crate::build::subtree::NodeSink,
        overflow: &AtomicU64,
        progress: &dyn Progress,
    ) -> Result<u64, BuildError> {
        let row_bytes = INDEX_BYTES as u64 + u64::from(sources.schema().record_bytes);
        // A region is its rows, its sort entries, and the nodes being put together from them.
        let point_bytes = row_bytes + size_of::<Entry<K>>() as u64 + row_bytes;
        let max_points = (self.share(POINT_SHARE) / point_bytes).min(u64::from(u32::MAX) / 2);
        let least = least_region_points(rules.levels, rules.threshold);
        if max_points < least {
            let needed = (least as f64 * point_bytes as f64 / POINT_SHARE) as u64 + FIXED_BYTES + 1;
            return Err(BuildError::MemoryCap { cap: self.options.memory_bytes, needed });
        }
        let streams = 8 * (survey.points / max_points + 1);
        let tail = (self.share(TAIL_SHARE) / streams).clamp(4 << 10, 1 << 20) as usize;
        let mut spill = SpillFile::new(&self.temp_dir(), tail);
        let builder = OutOfCore {
            rules,
            schema: sources.schema(),
            max_points,
            grid_bytes: self.share(GRID_SHARE),
            sink,
            overflow,
            progress,
        };
        let schema = sources.schema();
        let mut written = 0;
        if let Some((mut spool, stream)) = spooled {
            written += spool.written_bytes();
            let mut source = SpooledRows {
                spool: &mut spool,
                stream,
                schema,
                sources: points_of_source
                    .iter()
                    .enumerate()
                    .map(|(i, points)| (*points, origin_of(sources, i, survey)))
                    .collect(),
            };
            builder.run::<K>(0, &mut source, &mut spill)?;
        } else {
            let mut source = ScannedRows { sources, survey, cancelled: self.cancelled };
            builder.run::<K>(0, &mut source, &mut spill)?;
        }
        Ok(written + spill.written_bytes())
    }
}

/// What building leaves for writing.
struct Built {
    writer: StoreWriter,
    ranges: Vec<Vec<ValueRange>>,
    nodes: u64,
    overflow_points: u64,
    temporary_bytes: u64,
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

/// What to subtract from a source's coordinates to get those of the root cube.
fn origin_of(sources: &Sources, source: usize, survey: &Survey) -> [i64; 3] {
    let shift = sources.shift(source);
    [0, 1, 2].map(|axis| survey.min[axis] - shift[axis])
}

/// Rows read from the input files again.
struct ScannedRows<'a> {
    sources: &'a Sources,
    survey: &'a Survey,
    cancelled: &'a AtomicBool,
}

impl RowSource for ScannedRows<'_> {
    fn for_each_group(
        &mut self,
        spill: &mut SpillFile,
        take: TakeBatches,
    ) -> Result<(), BuildError> {
        self.sources.for_each_group(self.cancelled, &mut |batches| {
            let batches: Vec<RowBatch> = batches
                .iter()
                .map(|batch| RowBatch {
                    rows: batch.rows,
                    origin: Some(origin_of(self.sources, batch.source, self.survey)),
                })
                .collect();
            take(spill, &batches)
        })
    }
}

/// Rows of compressed files, kept on disk as they were decoded.
struct SpooledRows<'a> {
    spool: &'a mut SpillFile,
    stream: StreamId,
    schema: &'a Schema,
    /// Points and origin of each source, in input order.
    sources: Vec<(u64, [i64; 3])>,
}

impl RowSource for SpooledRows<'_> {
    fn for_each_group(
        &mut self,
        spill: &mut SpillFile,
        take: TakeBatches,
    ) -> Result<(), BuildError> {
        let record_bytes = self.schema.record_bytes as usize;
        let batch_bytes = record_bytes << 15;
        let piece = batch_bytes * 2 * rayon::current_num_threads();
        let (schema, mut index) = (self.schema, 0u64);
        let mut left = self.sources.iter().copied();
        let mut current = left.next().unwrap_or_default();
        self.spool.visit(self.stream, record_bytes, piece, &mut |_, mut bytes| {
            let mut batches = Vec::new();
            while !bytes.is_empty() {
                while current.0 == 0 {
                    current = left.next().expect("sources add up to the spooled points");
                }
                let rows = (bytes.len() / record_bytes).min(1 << 15).min(current.0 as usize);
                let (part, rest) = bytes.split_at(rows * record_bytes);
                bytes = rest;
                let rows_of_part = Rows::consecutive(part, schema, index);
                batches.push(RowBatch { rows: rows_of_part, origin: Some(current.1) });
                index += rows as u64;
                current.0 -= rows as u64;
            }
            take(spill, &batches)
        })
    }
}

/// Turns a running count of points into stages that each pass over all of them.
struct StagedProgress<'a> {
    inner: &'a dyn Progress,
    stages: &'a [Stage],
    points: u64,
    done: AtomicU64,
}

impl<'a> StagedProgress<'a> {
    fn new(inner: &'a dyn Progress, stages: &'a [Stage], points: u64) -> Self {
        inner.begin(stages[0], points);
        StagedProgress { inner, stages, points, done: AtomicU64::new(0) }
    }
}

impl Progress for StagedProgress<'_> {
    fn begin(&self, stage: Stage, total: u64) {
        self.inner.begin(stage, total);
    }

    fn advance(&self, points: u64) {
        let before = self.done.fetch_add(points, Ordering::Relaxed);
        self.inner.advance(points);
        for (pass, stage) in (1..).zip(&self.stages[1..]) {
            let threshold = pass * self.points;
            if before < threshold && before + points >= threshold {
                self.inner.begin(*stage, self.points);
            }
        }
    }
}

fn temporary(action: &'static str, source: std::io::Error, path: &Path) -> BuildError {
    BuildError::Temporary { action, source, path: path.into() }
}
