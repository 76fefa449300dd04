//! A conversion from its inputs to the finished store, as a list of steps.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use rayon::prelude::*;

use crate::build::BuildError;
use crate::build::budget::Budget;
use crate::build::chunk::{ChunkScratch, ChunkSink, build_chunk};
use crate::build::encode::{Encoding, FinishedNode, join_ranges};
use crate::build::in_order::for_each_in_order;
use crate::build::node::TreeRules;
use crate::build::options::{ConvertOptions, DEPTH_RANGE};
use crate::build::pages::{Page, PageStore, Slab};
use crate::build::partition::{ChunkRows, Partition, PartitionShape, split, taken_by_shared_cells};
use crate::build::plan::{Chunk, Plan};
use crate::build::progress::{Progress, Stage};
use crate::build::rows::{RowLayout, RowTable, color_offset};
use crate::build::sources::Sources;
use crate::build::spanning::Spanning;
use crate::build::survey::{HeldPage, Survey, survey};
use crate::geometry::MortonKey;
use crate::input::BlockBuffer;
use crate::store::{Metadata, StoreWriter, ValueRange, sections_for};

/// How long a part of a conversion took.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct StageTime {
    /// Which part.
    pub stage: &'static str,
    /// Wall time.
    pub seconds: f64,
}

/// What a conversion did.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
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
    /// The parts of the work in order, with their times.
    pub stages: Vec<StageTime>,
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

/// What one step after the other needs to know of the input.
struct Input<'a, 'p> {
    sources: &'a Sources,
    survey: Survey<'p>,
}

impl Conversion<'_> {
    fn run(&self, inputs: &[PathBuf]) -> Result<ConvertReport, BuildError> {
        let mut clock = Clock::new(self.progress);
        let sources = Sources::open(inputs, &self.options.read)?;
        let schema = sources.schema();
        let budget = Budget::new(self.options, schema, sources.expected_points())?;
        let mut slab = Slab::reserve(budget.slab_bytes);
        let pages = PageStore::new(&self.temp_dir(), budget.page_bytes, &mut slab);
        clock.begin(Stage::Read, sources.expected_points());
        let hold = sources.are_compressed().then_some(&pages);
        let survey = survey(&sources, hold, budget.workers, self.progress, self.cancelled)?;
        let root_bits = survey.root_bits(self.options.depth);
        if root_bits > u128::MAX_BITS {
            let path = inputs.last().expect("sources have a file").clone();
            return Err(BuildError::TooWide { steps: 1 << (root_bits - 1), path });
        }
        let color_bits =
            color_offset(schema).map(|_| if survey.color_union > 0xff { 16 } else { 8 });
        let sections = sections_for(schema, color_bits);
        let rules = TreeRules {
            root_bits,
            levels: self.options.depth,
            threshold: self.options.threshold.max(1) as usize,
            representative: self.options.representative,
            encoding: Encoding { schema, sections: &sections, color_bits },
        };
        let mut input = Input { sources: &sources, survey };
        let built = if input.survey.points == 0 {
            Built::new(StoreWriter::new(&self.temp_dir(), 0))
        } else if root_bits <= u64::MAX_BITS {
            self.build::<u64>(&mut input, &rules, &budget, &pages, &mut clock)?
        } else {
            self.build::<u128>(&mut input, &rules, &budget, &pages, &mut clock)?
        };
        let survey = &input.survey;
        clock.begin(Stage::Write, survey.points);
        let mut points_of_source = vec![0; sources.scans().len()];
        for ((source, _), points) in sources.blocks().iter().zip(&survey.block_points) {
            points_of_source[*source] += points;
        }
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
        let temporary_bytes = pages.written_bytes() + built.writer.spilled_bytes();
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
            in_memory: pages.written_bytes() == 0,
            stages: clock.finish(),
            warnings,
        })
    }

    fn temp_dir(&self) -> PathBuf {
        let folder = self.options.temp_dir.clone().or_else(|| self.output.parent().map(Into::into));
        folder.filter(|f| !f.as_os_str().is_empty()).unwrap_or_else(|| PathBuf::from("."))
    }

    /// Sorts all points into chunks and builds these side by side.
    fn build<'p, K: MortonKey>(
        &self,
        input: &mut Input<'_, 'p>,
        rules: &TreeRules,
        budget: &Budget,
        pages: &PageStore<'p>,
        clock: &mut Clock,
    ) -> Result<Built, BuildError> {
        clock.begin(Stage::Partition, input.survey.points);
        let target = budget.chunk_points(input.survey.points);
        let plan = self.plan::<K>(&mut input.survey, rules, target);
        let layout = RowLayout::new::<K>(input.sources.schema(), input.survey.points);
        let shape = PartitionShape {
            layout,
            page_shift: budget.page_shift(layout.stride()),
            root_bits: rules.root_bits,
            levels: rules.levels,
        };
        let partition = Partition::new(&plan, shape, pages);
        self.fill_partition(input, budget, pages, &partition)?;
        let mut filled = partition.into_chunks();
        let mut chunks = plan.chunks().to_vec();
        let too_many = budget.most_chunk_points.min(4 * target);
        let is_too_large = |chunk: &Chunk<K>, rows: &ChunkRows| {
            rows.points > too_many && chunk.level < rules.root_bits
        };
        while let Some(i) = (0..chunks.len()).find(|&i| is_too_large(&chunks[i], &filled[i])) {
            let rows = std::mem::take(&mut filled[i]);
            let (parts, rows) = split(&chunks[i], rows, target, shape, pages)?;
            chunks.splice(i..=i, parts);
            filled.splice(i..=i, rows);
        }

        clock.begin(Stage::Build, input.survey.points);
        let taken = taken_by_shared_cells(&chunks, &filled, rules.root_bits, rules.levels);
        let ends = chunks.iter().map(|chunk| chunk.end).collect();
        let spanning = Mutex::new(Spanning::<K>::new(rules, ends));
        let writer = StoreWriter::new(&self.temp_dir(), budget.node_bytes as usize);
        let built = Mutex::new(Built::new(writer));
        let rows: Vec<Mutex<Vec<Page>>> = filled.into_iter().map(|c| Mutex::new(c.pages)).collect();
        let finished = |finished: FinishedNode| -> Result<(), BuildError> {
            self.progress.advance(u64::from(finished.node.levels.point_count()));
            built.lock().expect("no holder of the lock panics").add(finished)
        };
        for_each_in_order(
            chunks.len(),
            budget.workers,
            self.cancelled,
            ChunkScratch::<K>::default,
            |scratch, i| {
                let stored = std::mem::take(&mut *rows[i].lock().expect("each is locked once"));
                let loaded = stored
                    .into_iter()
                    .map(|page| pages.load(page))
                    .collect::<Result<Vec<_>, _>>()?;
                let slices: Vec<&[u8]> = loaded.iter().map(|page| &**page).collect();
                let table = RowTable::new(&slices, shape.page_shift, layout);
                let mut finish = |node| finished(node);
                let mut sink = ChunkSink { finished: &mut finish, contributions: Vec::new() };
                build_chunk(rules, &chunks[i], table, &taken[i], scratch, &mut sink)?;
                let contributions = sink.contributions;
                loaded.into_iter().for_each(|page| pages.give_back(page));
                let ready =
                    spanning.lock().expect("no holder of the lock panics").add(i, contributions);
                for node in ready {
                    finished(node.finish(rules, layout, &mut scratch.nodes))?;
                }
                Ok(())
            },
            |_| Ok(()),
        )?;
        Ok(built.into_inner().expect("no holder of the lock panics"))
    }

    fn plan<K: MortonKey>(
        &self,
        survey: &mut Survey<'_>,
        rules: &TreeRules,
        target: u64,
    ) -> Plan<K> {
        let sample = std::mem::take(&mut survey.sample);
        let origin = survey.min;
        let mut keys: Vec<K> = sample
            .par_iter()
            .map(|p| K::encode([0, 1, 2].map(|axis| (p[axis] - origin[axis]) as u32)))
            .collect();
        keys.par_sort_unstable();
        Plan::new(&keys, survey.sample_weight, target, rules.root_bits, rules.levels)
    }

    /// Brings all points of the input into their chunks.
    fn fill_partition<'p, K: MortonKey>(
        &self,
        input: &mut Input<'_, 'p>,
        budget: &Budget,
        pages: &PageStore<'p>,
        partition: &Partition<'_, 'p, K>,
    ) -> Result<(), BuildError> {
        let Input { sources, survey } = input;
        let record_bytes = sources.schema().record_bytes as usize;
        let blocks = sources.blocks();
        let first_indices = survey.first_indices();
        let origin = |source: usize| {
            let shift = sources.shift(source);
            [0, 1, 2].map(|axis| survey.min[axis] - shift[axis])
        };
        if sources.are_compressed() {
            let mut held = std::mem::take(&mut survey.held);
            held.sort_by_key(|page| (page.block, page.first));
            let held: Vec<Mutex<Option<HeldPage>>> =
                held.into_iter().map(|page| Mutex::new(Some(page))).collect();
            return for_each_in_order(
                held.len(),
                budget.workers,
                self.cancelled,
                || partition.open(),
                |open, i| {
                    let held = held[i].lock().expect("each is locked once").take();
                    let HeldPage { block, first, page } = held.expect("each is taken once");
                    let records = pages.load(page)?;
                    let first = first_indices[block] + first;
                    let origin = origin(blocks[block].0);
                    partition.add_records(open, &records, record_bytes, first, origin)?;
                    self.progress.advance((records.len() / record_bytes) as u64);
                    pages.give_back(records);
                    Ok(())
                },
                |open| partition.close(open),
            );
        }
        for_each_in_order(
            blocks.len(),
            budget.workers,
            self.cancelled,
            || (partition.open(), BlockBuffer::default()),
            |(open, buffer), i| {
                let (source, block) = blocks[i];
                let (origin, mut found) = (origin(source), 0);
                sources.read_block(source, block, buffer, &mut |records| {
                    let first = first_indices[i] + found;
                    partition.add_records(open, records, record_bytes, first, origin)?;
                    let count = (records.len() / record_bytes) as u64;
                    found += count;
                    self.progress.advance(count);
                    Ok(())
                })?;
                if found == survey.block_points[i] { Ok(()) } else { Err(BuildError::Changed) }
            },
            |(open, _)| partition.close(open),
        )
    }
}

/// What building leaves for writing.
struct Built {
    writer: StoreWriter,
    ranges: Vec<Vec<ValueRange>>,
    nodes: u64,
    overflow_points: u64,
}

impl Built {
    fn new(writer: StoreWriter) -> Self {
        Built { writer, ranges: Vec::new(), nodes: 0, overflow_points: 0 }
    }

    fn add(&mut self, finished: FinishedNode) -> Result<(), BuildError> {
        join_ranges(&mut self.ranges, &finished.ranges);
        self.nodes += 1;
        self.overflow_points += finished.overflow_points;
        Ok(self.writer.add(finished.node)?)
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

/// Tells which part of the work goes on, and how long each took.
struct Clock<'a> {
    progress: &'a dyn Progress,
    stages: Vec<StageTime>,
    began: Instant,
}

impl<'a> Clock<'a> {
    fn new(progress: &'a dyn Progress) -> Self {
        Clock { progress, stages: Vec::new(), began: Instant::now() }
    }

    fn begin(&mut self, stage: Stage, points: u64) {
        self.stop();
        self.stages.push(StageTime { stage: stage.name(), seconds: 0.0 });
        self.progress.begin(stage, points);
    }

    fn stop(&mut self) {
        let now = Instant::now();
        if let Some(stage) = self.stages.last_mut() {
            stage.seconds = (now - self.began).as_secs_f64();
        }
        self.began = now;
    }

    fn finish(mut self) -> Vec<StageTime> {
        self.stop();
        self.stages
    }
}

fn temporary(action: &'static str, source: std::io::Error, path: &Path) -> BuildError {
    BuildError::Temporary { action, source, path: path.into() }
}
