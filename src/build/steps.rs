//! The steps of a conversion, each from where it was left: reading, sorting into chunks, building.

use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

use rayon::prelude::*;

use crate::build::BuildError;
use crate::build::budget::Budget;
use crate::build::checkpoint::{Checkpoints, State, Step, chunk_states, held_state, resume_chunks};
use crate::build::chunk::{ChunkScratch, ChunkSink, build_chunk};
use crate::build::dense_chunk::build_dense_chunk;
use crate::build::encode::Encoding;
use crate::build::in_order::run_in_order;
use crate::build::node::{NodeBuilder, TreeRules, TreeShape};
use crate::build::ordered::{Built, DoneNode, OrderedNodes};
use crate::build::pages::{DiskPlace, Page, PageStore};
use crate::build::partition::{
    ChunkRows, ChunkRowsState, OpenPages, Partition, PartitionShape, split, taken_by_shared_cells,
};
use crate::build::plan::{Chunk, Plan};
use crate::build::progress::{Clock, Progress, Silent, Stage};
use crate::build::rows::{RowLayout, RowTable};
use crate::build::seen::Seen;
use crate::build::sources::Sources;
use crate::build::spanning::{ReadyNode, Spanning};
use crate::build::survey::{HeldPage, Part, Survey};
use crate::geometry::MortonKey;
use crate::input::{BlockBuffer, RUN_RECORDS};
use crate::store::{StoreWriter, ValueRange, WriteHook, sections_for};

/// What all steps work with.
pub struct Steps<'a, 'p, 'w> {
    /// Hears how it goes on.
    pub progress: &'a dyn Progress,
    /// Set when the user wants to stop.
    pub cancelled: &'a AtomicBool,
    /// The input.
    pub sources: &'a Sources,
    /// Shares of the memory cap.
    pub budget: Budget,
    /// Where rows go.
    pub pages: &'a PageStore<'p>,
    /// The store's place.
    pub output: &'a Path,
    /// Called before every write to the store.
    pub before_write: WriteHook<'w>,
    /// Notes of how far it is.
    pub checkpoints: Checkpoints<'a>,
}

/// What reading the input leaves behind.
pub struct Surveyed<'p> {
    /// What was found out.
    pub survey: Survey,
    /// Records of compressed inputs.
    held: Vec<HeldPage<'p>>,
    /// Whether headers' claims took the place of reading all points.
    pub read_once: bool,
    /// What is left of a killed run that was past reading.
    later: Option<Step>,
}

/// One worker that brings points into chunks.
struct Filler<'p> {
    open: OpenPages<'p>,
    buffer: BlockBuffer,
    /// What it saw of points whose bounds are only claimed.
    seen: Seen,
}

/// Most points of a sample of an input that is not read as a whole.
const MOST_SAMPLED: u64 = 1 << 17;
/// A run of the sample costs about as much as reading so many bytes in a row.
const BYTES_PER_RUN: u64 = 1 << 17;

/// The chunks of an input and what is in them.
struct Chunks<'p, K> {
    chunks: Vec<Chunk<K>>,
    rows: Vec<ChunkRows<'p>>,
}

impl<'p, 'w> Steps<'_, 'p, 'w> {
    /// What is known of the input before its points are sorted: what headers claim, if they may be
    /// trusted so far and claim enough, or what reading every point tells.
    pub fn survey(
        &mut self,
        resumed: Option<State>,
        claims: Option<Seen>,
    ) -> Result<Surveyed<'p>, BuildError> {
        if let (None, Some(claims)) = (&resumed, claims)
            && let Some(survey) = self.sample_claimed(claims)?
        {
            return Ok(Surveyed { survey, held: Vec::new(), read_once: true, later: None });
        }
        self.read_all(resumed)
    }

    /// A survey of what is claimed, with points of the input as a sample; none if one of these lies
    /// outside the bounds.
    fn sample_claimed(&self, claims: Seen) -> Result<Option<Survey>, BuildError> {
        let blocks = self.sources.blocks();
        let file_bytes: u64 = self.sources.scans().iter().map(|s| s.scan.file_bytes()).sum();
        let wanted = (file_bytes / BYTES_PER_RUN * RUN_RECORDS).clamp(RUN_RECORDS, MOST_SAMPLED);
        let sampled = self.sources.sampled(wanted);
        let runs = sampled.blocks();
        let every_point = Survey { sample_weight: 1, ..Survey::new(runs.len(), 0) };
        let mut parts: Vec<Part> = (0..self.budget.workers).map(|_| Part::new()).collect();
        run_in_order(0..runs.len(), None, self.cancelled, &mut parts, |part, i| {
            every_point.read_block(&sampled, runs[i], i, None, part, &Silent)
        })?;
        let mut sample = every_point;
        parts.iter_mut().for_each(|part| sample.join(part, &mut Vec::new(), self.pages));
        if sample.all.points == 0 || !claims.encloses(&sample.all) {
            return Ok(None);
        }
        Ok(Some(Survey {
            all: claims,
            verified: Some(Seen::default()),
            block_points: blocks.iter().map(|(_, block)| block.points).collect(),
            sample_weight: (claims.points / sample.all.points).max(1),
            ..sample
        }))
    }

    /// Reads every point once.
    fn read_all(&mut self, resumed: Option<State>) -> Result<Surveyed<'p>, BuildError> {
        let blocks = self.sources.blocks();
        let (mut survey, mut held, mut next) = match resumed {
            None => {
                let expected = self.sources.expected_points();
                let mut survey = Survey::new(blocks.len(), expected);
                survey.want_records(self.progress.wanted_points(), expected);
                (survey, Vec::new(), 0)
            }
            Some(State { survey, step: Step::Survey { done, held }, .. }) => {
                (survey, held.into_iter().map(|page| page.resume()).collect(), done)
            }
            Some(State { survey, step, .. }) => {
                let read_once = survey.verified.is_some();
                return Ok(Surveyed { survey, held: Vec::new(), read_once, later: Some(step) });
            }
        };
        self.progress.advance(survey.all.points);
        let hold = self.sources.are_compressed().then_some(self.pages);
        let mut parts: Vec<Part> = (0..self.budget.workers).map(|_| Part::new()).collect();
        while next < blocks.len() {
            let until = self.checkpoints.next();
            next =
                run_in_order(next..blocks.len(), until, self.cancelled, &mut parts, |part, i| {
                    survey.read_block(self.sources, blocks[i], i, hold, part, self.progress)
                })?;
            parts.iter_mut().for_each(|part| survey.join(part, &mut held, self.pages));
            if self.checkpoints.is_due() && next < blocks.len() {
                let held = held_state(&mut held, self.pages)?;
                let step = Step::Survey { done: next, held };
                self.checkpoints.make(self.pages, &survey, step)?;
            }
        }
        held.sort_by_key(|page| (page.block, page.first));
        Ok(Surveyed { survey, held, read_once: false, later: None })
    }

    /// Sorts all points into chunks and builds these side by side. None if the points do not bear
    /// out what headers claim; nothing is left then of what was done.
    pub fn build<K: MortonKey>(
        &mut self,
        surveyed: &mut Surveyed<'p>,
        tree: TreeShape,
        clock: &mut Clock,
    ) -> Result<Option<Built<'w>>, BuildError> {
        let points = surveyed.survey.all.points;
        let layout = RowLayout::new::<K>(self.sources.schema(), points);
        let shape = PartitionShape {
            layout,
            page_shift: self.budget.page_shift(layout.stride()),
            root_bits: tree.root_bits,
            levels: tree.levels,
        };
        clock.begin(Stage::Partition, points);
        let schema = self.sources.schema();
        let chunks = match surveyed.later.take() {
            Some(Step::Build {
                done,
                chunks,
                rows,
                pending,
                writer,
                coarse,
                ranges,
                overflow_points,
            }) => {
                let color_bits = surveyed.survey.color_bits(schema);
                let sections = sections_for(schema, color_bits);
                let rules = tree.rules(Encoding { schema, sections: &sections, color_bits });
                let mut spanning = self.spanning::<K>(&rules, layout, &resume_chunks(&chunks));
                spanning.resume(done, pending, self.pages)?;
                let coarse = coarse.into_iter().map(|places| self.pages.read_pieces(places));
                let coarse = coarse.collect::<Result<_, _>>()?;
                let writer = StoreWriter::resume(self.output, self.before_write, writer, coarse)?;
                let built = Built { writer, ranges, overflow_points };
                let rows = rows.into_iter().map(ChunkRows::resume).collect();
                let chunks = Chunks { chunks: resume_chunks(&chunks), rows };
                clock.begin(Stage::Build, points);
                return self
                    .build_chunks(chunks, done, spanning, built, surveyed, &rules, shape)
                    .map(Some);
            }
            Some(Step::Partition { done, held, chunks, rows }) => {
                let plan = Plan::of_starts(resume_chunks(&chunks), tree.root_bits);
                let rows = rows.into_iter().map(ChunkRows::resume).collect();
                let partition = Partition::new(&plan, shape, self.pages).resume(rows);
                surveyed.held = held.into_iter().map(|page| page.resume()).collect();
                self.fill(surveyed, &plan, partition, done, tree.levels)?
            }
            _ => {
                let plan = self.plan::<K>(&mut surveyed.survey, tree);
                let partition = Partition::new(&plan, shape, self.pages);
                self.fill(surveyed, &plan, partition, 0, tree.levels)?
            }
        };
        let Some(chunks) = chunks else { return Ok(None) };
        let chunks = self.split_large(chunks, points, shape)?;
        clock.begin(Stage::Build, points);
        let color_bits = surveyed.survey.color_bits(schema);
        let sections = sections_for(schema, color_bits);
        let rules = tree.rules(Encoding { schema, sections: &sections, color_bits });
        let spanning = self.spanning(&rules, layout, &chunks.chunks);
        let writer = StoreWriter::create(self.output, self.before_write)?;
        let built = Built::new(writer);
        self.build_chunks(chunks, 0, spanning, built, surveyed, &rules, shape).map(Some)
    }

    fn spanning<K: MortonKey>(
        &self,
        rules: &TreeRules,
        layout: RowLayout,
        chunks: &[Chunk<K>],
    ) -> Spanning<'p, K> {
        Spanning::new(rules, layout, chunks.iter().map(|chunk| chunk.end).collect())
    }

    fn plan<K: MortonKey>(&self, survey: &mut Survey, tree: TreeShape) -> Plan<K> {
        let sample = std::mem::take(&mut survey.sample);
        let origin = survey.all.min;
        let mut keys: Vec<K> = sample
            .par_iter()
            .map(|p| K::encode([0, 1, 2].map(|axis| (p[axis] - origin[axis]) as u32)))
            .collect();
        keys.par_sort_unstable();
        let target = self.budget.chunk_points(survey.all.points);
        Plan::new(&keys, survey.sample_weight, target, tree.root_bits, tree.levels)
    }

    /// Brings all points of the input into their chunks. None if they are not what headers claim.
    fn fill<K: MortonKey>(
        &mut self,
        surveyed: &mut Surveyed<'p>,
        plan: &Plan<K>,
        mut partition: Partition<'_, 'p, K>,
        mut next: usize,
        levels: u32,
    ) -> Result<Option<Chunks<'p, K>>, BuildError> {
        let (sources, survey) = (self.sources, &mut surveyed.survey);
        let schema = sources.schema();
        let record_bytes = schema.record_bytes as usize;
        let blocks = sources.blocks();
        let first_indices = survey.first_indices();
        let least = survey.all.min;
        let origin = |source: usize| {
            let shift = sources.shift(source);
            [0, 1, 2].map(|axis| least[axis] - shift[axis])
        };
        let is_claimed = survey.verified.is_some();
        let block_points = std::mem::take(&mut survey.block_points);
        let is_held = sources.are_compressed();
        let held: Vec<Mutex<Option<HeldPage>>> = std::mem::take(&mut surveyed.held)
            .into_iter()
            .map(|page| Mutex::new(Some(page)))
            .collect();
        let count = if is_held { held.len() } else { blocks.len() };
        let new_states = |partition: &Partition<'_, 'p, K>| -> Vec<Filler<'p>> {
            (0..self.budget.workers)
                .map(|_| Filler {
                    open: partition.open(),
                    buffer: BlockBuffer::default(),
                    seen: Seen::default(),
                })
                .collect()
        };
        let mut states = new_states(&partition);
        while next < count {
            let add_held = |open: &mut OpenPages<'p>, i: usize| {
                let page = held[i].lock().expect("each is locked once").take();
                let HeldPage { block, first, page } = page.expect("each is taken once");
                let records = self.pages.load(page)?;
                let first = first_indices[block] + first;
                let origin = origin(blocks[block].0);
                partition.add_records(open, &records, record_bytes, first, origin)?;
                self.progress.advance((records.len() / record_bytes) as u64);
                self.pages.give_back(records);
                Ok(())
            };
            let add_block = |Filler { open, buffer, seen }: &mut Filler<'p>, i: usize| {
                let (source, block) = blocks[i];
                let (origin, mut found) = (origin(source), 0);
                sources.read_block(source, block, buffer, &mut |records| {
                    if is_claimed {
                        seen.look(records, schema, sources.shift(source));
                    }
                    let first = first_indices[i] + found;
                    partition.add_records(open, records, record_bytes, first, origin)?;
                    let count = (records.len() / record_bytes) as u64;
                    found += count;
                    self.progress.advance(count);
                    Ok(())
                })?;
                if found == block_points[i] { Ok(()) } else { Err(BuildError::Changed) }
            };
            let outcome = run_in_order(
                next..count,
                self.checkpoints.next(),
                self.cancelled,
                &mut states,
                |state, i| if is_held { add_held(&mut state.open, i) } else { add_block(state, i) },
            );
            next = match outcome {
                // A point outside of the bounds.
                Err(BuildError::Changed) if is_claimed => {
                    partition.abandon(states.into_iter().map(|state| state.open));
                    return Ok(None);
                }
                outcome => outcome?,
            };
            if self.checkpoints.is_due() && next < count {
                for state in std::mem::replace(&mut states, new_states(&partition)) {
                    survey.verified.iter_mut().for_each(|verified| verified.join(&state.seen));
                    partition.close(state.open)?;
                }
                let rows = partition.state()?;
                let mut left = Vec::new();
                for page in &held {
                    // Those that are done need no place, only their number.
                    let mut page = page.lock().expect("no holder of the lock panics");
                    let page = page.get_or_insert(HeldPage {
                        block: 0,
                        first: 0,
                        page: Page::Disk(DiskPlace::default()),
                    });
                    left.extend(held_state(std::slice::from_mut(page), self.pages)?);
                }
                let chunks = chunk_states(plan.chunks());
                let step = Step::Partition { done: next, held: left, chunks, rows };
                let whole = Survey { block_points: block_points.clone(), ..survey.clone() };
                self.checkpoints.make(self.pages, &whole, step)?;
            }
        }
        survey.block_points = block_points;
        for state in &states {
            survey.verified.iter_mut().for_each(|verified| verified.join(&state.seen));
        }
        let open = states.into_iter().map(|state| state.open);
        if !survey.settle(levels) {
            partition.abandon(open);
            return Ok(None);
        }
        open.into_iter().try_for_each(|open| partition.close(open))?;
        Ok(Some(Chunks { chunks: plan.chunks().to_vec(), rows: partition.into_chunks() }))
    }

    /// Divides chunks that hold far more points than planned.
    fn split_large<K: MortonKey>(
        &self,
        chunks: Chunks<'p, K>,
        points: u64,
        shape: PartitionShape,
    ) -> Result<Chunks<'p, K>, BuildError> {
        let Chunks { mut chunks, mut rows } = chunks;
        let target = self.budget.chunk_points(points);
        let too_many = self.budget.most_chunk_points.min(4 * target);
        let is_too_large = |chunk: &Chunk<K>, rows: &ChunkRows| {
            rows.points > too_many && chunk.level < shape.root_bits
        };
        let mut i = 0;
        while i < chunks.len() {
            if !is_too_large(&chunks[i], &rows[i]) {
                i += 1;
                continue;
            }
            let large = std::mem::take(&mut rows[i]);
            let (parts, part_rows) = split(&chunks[i], large, target, shape, self.pages)?;
            chunks.splice(i..=i, parts);
            rows.splice(i..=i, part_rows);
        }
        Ok(Chunks { chunks, rows })
    }

    #[allow(clippy::too_many_arguments, reason = "what a killed run left, part by part")]
    fn build_chunks<K: MortonKey>(
        &mut self,
        chunks: Chunks<'p, K>,
        mut next: usize,
        spanning: Spanning<'p, K>,
        built: Built<'w>,
        surveyed: &Surveyed<'p>,
        rules: &TreeRules,
        shape: PartitionShape,
    ) -> Result<Built<'w>, BuildError> {
        let Chunks { chunks, rows } = chunks;
        let taken = taken_by_shared_cells(&chunks, &rows, rules.root_bits, rules.levels);
        let mut rows: Vec<Mutex<ChunkRows>> = rows.into_iter().map(Mutex::new).collect();
        let mut spanning = Mutex::new(spanning);
        let limit = self.budget.node_bytes;
        let mut ordered = OrderedNodes::new(built, next, rules, self.pages, limit, self.cancelled);
        let most_points = self.budget.most_node_points(shape.layout.stride());
        let mut scratches: Vec<ChunkScratch<K>> = Vec::new();
        scratches.resize_with(self.budget.workers, ChunkScratch::default);
        while next < chunks.len() {
            let build = |scratch: &mut ChunkScratch<K>, i: usize| -> Result<(), BuildError> {
                ordered.wait_for_room(i)?;
                let (points, stored) = {
                    let mut rows = rows[i].lock().expect("each is locked once");
                    (rows.points, std::mem::take(&mut rows.pages))
                };
                let add = |contributions| {
                    let mut spanning = spanning.lock().expect("no holder of the lock panics");
                    spanning.add(i, contributions, self.pages)
                };
                let finish_spanning = |ready: Vec<(usize, Vec<ReadyNode<'p>>)>,
                                       builder: &mut NodeBuilder<K>|
                 -> Result<(), BuildError> {
                    for (chunk, nodes) in ready {
                        let finish = |node: ReadyNode<'p>| {
                            let done =
                                node.finish(rules, shape.layout, self.pages, most_points, builder)?;
                            self.progress.advance(done.points());
                            Ok(done)
                        };
                        let nodes = nodes.into_iter().map(finish);
                        ordered.add::<K>(chunk, nodes.collect::<Result<_, BuildError>>()?)?;
                    }
                    Ok(())
                };
                let is_dense = chunks[i].level == rules.root_bits;
                if is_dense && points > self.budget.most_chunk_points {
                    let run_rows = self.budget.most_chunk_points as usize;
                    let contributions = build_dense_chunk(
                        rules,
                        stored,
                        run_rows,
                        &taken[i],
                        shape.layout,
                        self.pages,
                    )?;
                    finish_spanning(add(contributions)?, &mut scratch.nodes)?;
                    return ordered.add::<K>(i, Vec::new());
                }
                let loaded = stored.into_iter().map(|page| self.pages.load(page));
                let loaded = loaded.collect::<Result<Vec<_>, _>>()?;
                let slices: Vec<&[u8]> = loaded.iter().map(|page| &**page).collect();
                let table = RowTable::new(&slices, shape.page_shift, shape.layout);
                let mut sink = ChunkSink::new(self.progress);
                build_chunk(rules, &chunks[i], table, &taken[i], scratch, &mut sink);
                let ChunkSink { finished, contributions, .. } = sink;
                loaded.into_iter().for_each(|page| self.pages.give_back(page));
                finish_spanning(add(contributions)?, &mut scratch.nodes)?;
                ordered.add::<K>(i, finished.into_iter().map(DoneNode::Finished).collect())
            };
            let step = |scratch: &mut ChunkScratch<K>, i: usize| {
                build(scratch, i).inspect_err(|_| ordered.give_up())
            };
            next = run_in_order(
                next..chunks.len(),
                self.checkpoints.next(),
                self.cancelled,
                &mut scratches,
                step,
            )?;
            if self.checkpoints.is_due() && next < chunks.len() {
                let pending = inner(&mut spanning).state(self.pages)?;
                let built = ordered.built();
                let (writer, coarse) = built.writer.state()?;
                let coarse = coarse.into_iter().map(|bytes| self.pages.write_pieces(bytes));
                let rows = rows.iter_mut().map(|rows| inner(rows).state(self.pages));
                let step = Step::Build {
                    done: next,
                    chunks: chunk_states(&chunks),
                    rows: rows.collect::<Result<Vec<ChunkRowsState>, _>>()?,
                    pending,
                    writer,
                    coarse: coarse.collect::<Result<_, _>>()?,
                    ranges: finite_ranges(&built.ranges),
                    overflow_points: built.overflow_points,
                };
                self.checkpoints.make(self.pages, &surveyed.survey, step)?;
            }
        }
        Ok(ordered.into_built())
    }
}

fn inner<T>(mutex: &mut Mutex<T>) -> &mut T {
    mutex.get_mut().expect("no holder of the lock panics")
}

/// Ranges of attributes without any number are infinite, which JSON cannot say: they are noted down
/// by the largest numbers instead.
fn finite_ranges(ranges: &[Vec<ValueRange>]) -> Vec<Vec<ValueRange>> {
    let finite = |range: &ValueRange| ValueRange {
        min: range.min.clamp(f64::MIN, f64::MAX),
        max: range.max.clamp(f64::MIN, f64::MAX),
    };
    ranges.iter().map(|ranges| ranges.iter().map(finite).collect()).collect()
}
