//! Building from points that do not fit memory.
//!
//! A job is a cell of the outer octree and the points that enter its node, on disk in input order.
//! Points are counted on a grid below the cell; regions of the grid that fit memory are written
//! out and built one after the other, in Morton order.
//! * A region at outer depth `c` first gives up the points that the nodes above it take. Those
//!   nodes' finest cells are not larger than the region (the grid is at most as deep as a node has
//!   levels), so what they take is decided within the region.
//! * Regions above were split because they hold more points than all nodes above them can take
//!   plus the threshold, so their nodes exist; only the region's own node may not.
//! * A grid cell that alone is too much is streamed past the nodes above it, point by point as in
//!   the paper, and what they reject becomes a job of its own.
//!
//! The result is the same octree that building in memory gives.
//! After: Wimmer and Scheiblauer 2006, section 6.5.2 of the dissertation chapter.

use std::collections::HashSet;
use std::sync::atomic::Ordering;

use rayon::prelude::*;

use crate::build::BuildError;
use crate::build::point_tree::Entry;
use crate::build::progress::Progress;
use crate::build::rows::{INDEX_BYTES, Rows};
use crate::build::spill::{SpillFile, StreamId};
use crate::build::subtree::{NodeSink, Subtree, TreeRules};
use crate::geometry::MortonKey;
use crate::points::{COORDINATE_BYTES, Schema, record_coordinates};

/// Finest counting grid: 2^7 cells along each axis.
const GRID_LEVELS: u32 = 7;

/// Bytes before the record of a point that a node above its region took: Morton code, whether it
/// is a first arrival, input index.
const TAKEN_PREFIX: usize = 16 + 1 + INDEX_BYTES;

/// Points on their way into a job: rows and how their coordinates are to be read.
pub struct RowBatch<'a> {
    /// The rows.
    pub rows: Rows<'a>,
    /// What to subtract from a record's coordinates to get those of the root cube; none for
    /// spilled rows, whose coordinates are those (unsigned) already.
    pub origin: Option<[i64; 3]>,
}

impl RowBatch<'_> {
    /// A row's coordinates within the root cube.
    fn root_coordinates(&self, row: u32) -> [u32; 3] {
        let position = record_coordinates(self.rows.record(row));
        match self.origin {
            Some(origin) => [0, 1, 2].map(|i| (i64::from(position[i]) - origin[i]) as u32),
            None => position.map(|c| c as u32),
        }
    }

    /// Morton code of a row's position.
    pub fn key<K: MortonKey>(&self, row: u32) -> K {
        K::encode(self.root_coordinates(row))
    }
}

/// Takes some batches of a job's points; may append to other streams of the spill file.
pub type TakeBatches<'a> = &'a mut dyn FnMut(&mut SpillFile, &[RowBatch]) -> Result<(), BuildError>;

/// Hands out the points of a job, in input order, as often as asked.
pub trait RowSource {
    /// Calls `take` with batches that may be looked at in parallel.
    fn for_each_group(
        &mut self,
        spill: &mut SpillFile,
        take: TakeBatches,
    ) -> Result<(), BuildError>;
}

/// Rows of a job that stand in the spill file.
struct SpilledRows<'a> {
    stream: StreamId,
    schema: &'a Schema,
}

impl RowSource for SpilledRows<'_> {
    fn for_each_group(
        &mut self,
        spill: &mut SpillFile,
        take: TakeBatches,
    ) -> Result<(), BuildError> {
        let row_bytes = INDEX_BYTES + self.schema.record_bytes as usize;
        spill.visit(self.stream, row_bytes, PIECE_BYTES, &mut |spill, bytes| {
            let piece = bytes.len().div_ceil(row_bytes).div_ceil(rayon::current_num_threads());
            let batches: Vec<RowBatch> = bytes
                .chunks(piece * row_bytes)
                .map(|part| RowBatch { rows: Rows::indexed(part, self.schema), origin: None })
                .collect();
            take(spill, &batches)
        })
    }
}

/// Bytes of spilled rows looked at together.
const PIECE_BYTES: usize = 4 << 20;

/// A part of the counting grid that becomes one chunk of work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Region {
    depth: u32,
    /// First cell of the finest grid, in Morton order.
    first_cell: usize,
    points: u64,
}

/// A node above the region at work, waiting for points of the regions to come.
struct OpenNode<K> {
    depth: u32,
    code: K,
    taken: StreamId,
}

/// Building with a bound on the points in memory.
pub struct OutOfCore<'a> {
    /// The rules.
    pub rules: &'a TreeRules<'a>,
    /// Columns of a record.
    pub schema: &'a Schema,
    /// Most points to hold at once.
    pub max_points: u64,
    /// Most memory for the counting grid.
    pub grid_bytes: u64,
    /// Where nodes go.
    pub sink: NodeSink<'a>,
    /// Counts points beyond one per finest cell.
    pub overflow: &'a std::sync::atomic::AtomicU64,
    /// Hears of points counted and partitioned.
    pub progress: &'a dyn Progress,
}

/// Fewest points that a region must be allowed to hold, so that the nodes above a split region
/// cannot take so many that its own node misses the threshold.
pub fn least_region_points(levels: u32, threshold: usize) -> u64 {
    (1u64 << (3 * levels)) / 7 + threshold as u64 + 1
}

impl OutOfCore<'_> {
    /// Builds the node at `depth` that all points of `source` enter, and everything below.
    pub fn run<K: MortonKey>(
        &self,
        depth: u32,
        source: &mut dyn RowSource,
        spill: &mut SpillFile,
    ) -> Result<(), BuildError> {
        let most = GRID_LEVELS.min(self.rules.levels).min(self.rules.max_depth() - depth);
        // A count and a region per cell, and the sums above them: about 24 bytes.
        let fits = |levels: &u32| 24u64 << (3 * levels) <= self.grid_bytes;
        let grid_levels = (1..=most).rev().find(fits).unwrap_or(most.min(1));
        let counts = self.count::<K>(depth, grid_levels, source, spill)?;
        let regions = plan_regions(depth, grid_levels, counts, self.max_points);
        let streams = self.partition::<K>(depth, grid_levels, &regions, source, spill)?;
        let mut open: Vec<OpenNode<K>> = Vec::new();
        for (region, stream) in regions.iter().zip(streams) {
            if self.rules.cancelled.load(Ordering::Relaxed) {
                return Err(BuildError::Interrupted);
            }
            self.build_region(depth, grid_levels, *region, stream, &mut open, spill)?;
        }
        while let Some(node) = open.pop() {
            self.close(node, spill)?;
        }
        Ok(())
    }

    fn grid_shift(&self, depth: u32, grid_levels: u32) -> u32 {
        self.rules.root_bits - depth - grid_levels
    }

    fn grid_cell<K: MortonKey>(&self, key: K, depth: u32, grid_levels: u32) -> usize {
        let local = key.local(self.rules.root_bits - depth);
        local.ancestor(self.grid_shift(depth, grid_levels)).low_u64() as usize
    }

    fn count<K: MortonKey>(
        &self,
        depth: u32,
        grid_levels: u32,
        source: &mut dyn RowSource,
        spill: &mut SpillFile,
    ) -> Result<Vec<u64>, BuildError> {
        use std::sync::atomic::AtomicU64;
        let counts: Vec<AtomicU64> =
            std::iter::repeat_with(|| AtomicU64::new(0)).take(1 << (3 * grid_levels)).collect();
        source.for_each_group(spill, &mut |_, batches| {
            batches.par_iter().for_each(|batch| {
                // Neighbours in the input mostly share a cell: one addition per run.
                let mut run = (usize::MAX, 0u64);
                for row in 0..batch.rows.len() as u32 {
                    let cell = self.grid_cell(batch.key::<K>(row), depth, grid_levels);
                    if cell != run.0 {
                        if run.1 > 0 {
                            counts[run.0].fetch_add(run.1, Ordering::Relaxed);
                        }
                        run = (cell, 0);
                    }
                    run.1 += 1;
                }
                if run.1 > 0 {
                    counts[run.0].fetch_add(run.1, Ordering::Relaxed);
                }
                self.progress.advance(batch.rows.len() as u64);
            });
            Ok(())
        })?;
        Ok(counts.into_iter().map(AtomicU64::into_inner).collect())
    }

    fn partition<K: MortonKey>(
        &self,
        depth: u32,
        grid_levels: u32,
        regions: &[Region],
        source: &mut dyn RowSource,
        spill: &mut SpillFile,
    ) -> Result<Vec<StreamId>, BuildError> {
        let streams: Vec<StreamId> = regions.iter().map(|_| spill.add_stream()).collect();
        let mut region_of_cell = vec![u32::MAX; 1 << (3 * grid_levels)];
        for (i, region) in regions.iter().enumerate() {
            let cells = 1usize << (3 * (depth + grid_levels - region.depth));
            region_of_cell[region.first_cell..region.first_cell + cells].fill(i as u32);
        }
        source.for_each_group(spill, &mut |spill, batches| {
            let routed: Vec<RoutedRows> = batches
                .par_iter()
                .map(|batch| {
                    let region = |key: K| region_of_cell[self.grid_cell(key, depth, grid_levels)];
                    let route = route_rows(batch, self.schema, region);
                    self.progress.advance(batch.rows.len() as u64);
                    route
                })
                .collect();
            for (region, rows) in routed.iter().flat_map(RoutedRows::parts) {
                // Only a file that changed since it was counted can have points elsewhere.
                let stream = streams.get(region as usize).ok_or(BuildError::Changed)?;
                spill.append(*stream, rows)?;
            }
            Ok(())
        })?;
        Ok(streams)
    }

    fn build_region<K: MortonKey>(
        &self,
        base: u32,
        grid_levels: u32,
        region: Region,
        stream: StreamId,
        open: &mut Vec<OpenNode<K>>,
        spill: &mut SpillFile,
    ) -> Result<(), BuildError> {
        let is_deepest = region.depth == base + grid_levels;
        let can_go_on = region.depth < self.rules.max_depth() && grid_levels > 0;
        if region.points > self.max_points && is_deepest && can_go_on {
            return self.stream_past(base, region, stream, open, spill);
        }
        let mut bytes = Vec::new();
        spill.take_all(stream, &mut bytes)?;
        let rows = Rows::indexed(&bytes, self.schema);
        let batch = RowBatch { rows, origin: None };
        let mut entries: Vec<Entry<K>> = (0..rows.len() as u32)
            .into_par_iter()
            .map(|row| Entry { key: batch.key(row), row })
            .collect();
        let Some(any) = entries.first().copied() else { return Ok(()) };
        self.open_path(base, region.depth, any.key, open, spill)?;
        Subtree::sort(&mut entries);
        for node in open.iter().filter(|node| node.depth < region.depth) {
            let shift = self.rules.grid(node.depth).shift(self.rules.levels);
            take_first_arrivals(&mut entries, shift, rows, node.taken, spill)?;
        }
        let subtree = Subtree { rules: self.rules, rows, sink: self.sink, overflow: self.overflow };
        let has_node = region.depth == base || entries.len() >= self.rules.threshold.max(1);
        if has_node {
            subtree.grow(region.depth, &mut entries)?;
        } else if let Some(parent) = open.last() {
            self.overflow.fetch_add(entries.len() as u64, Ordering::Relaxed);
            for entry in &entries {
                append_taken(*entry, false, rows, parent.taken, spill)?;
            }
        }
        Ok(())
    }

    /// Makes `open` the nodes at depths `base..depth` above a key, closing others.
    fn open_path<K: MortonKey>(
        &self,
        base: u32,
        depth: u32,
        key: K,
        open: &mut Vec<OpenNode<K>>,
        spill: &mut SpillFile,
    ) -> Result<(), BuildError> {
        let code_at = |depth: u32| key.ancestor(self.rules.root_bits - depth);
        while open
            .last()
            .is_some_and(|node| node.depth >= depth || node.code != code_at(node.depth))
        {
            let node = open.pop().expect("it was looked at");
            self.close(node, spill)?;
        }
        let next = open.last().map_or(base, |node| node.depth + 1);
        for depth in next..depth {
            open.push(OpenNode { depth, code: code_at(depth), taken: spill.add_stream() });
        }
        Ok(())
    }

    /// Finishes a node whose regions are all done.
    fn close<K: MortonKey>(
        &self,
        node: OpenNode<K>,
        spill: &mut SpillFile,
    ) -> Result<(), BuildError> {
        let mut bytes = Vec::new();
        spill.take_all(node.taken, &mut bytes)?;
        let taken =
            Rows::with_prefix(&bytes, self.schema, TAKEN_PREFIX - INDEX_BYTES, TAKEN_PREFIX);
        // Rows stand in input order wherever points are compared by row.
        let mut order: Vec<u32> = (0..taken.len() as u32).collect();
        order.sort_unstable_by_key(|&row| taken.input_index(row));
        let mut sorted = Vec::with_capacity(bytes.len());
        order.iter().for_each(|&row| sorted.extend_from_slice(taken.row(row)));
        drop((bytes, order));
        let rows =
            Rows::with_prefix(&sorted, self.schema, TAKEN_PREFIX - INDEX_BYTES, TAKEN_PREFIX);
        let mut points: Vec<(Entry<K>, bool)> = (0..rows.len() as u32)
            .map(|row| {
                let prefix = rows.row(row);
                let code =
                    u128::from_le_bytes(prefix[..16].try_into().expect("a code has 16 bytes"));
                (Entry { key: K::narrow(code), row }, prefix[16] == 1)
            })
            .collect();
        points.par_sort_unstable();
        let (entries, kept): (Vec<_>, Vec<_>) = points.into_iter().unzip();
        let subtree = Subtree { rules: self.rules, rows, sink: self.sink, overflow: self.overflow };
        subtree.finish_node(node.depth, entries, kept)
    }

    /// Offers a region's points, one after the other, to the nodes above it, and makes a job of
    /// those that none takes.
    fn stream_past<K: MortonKey>(
        &self,
        base: u32,
        region: Region,
        stream: StreamId,
        open: &mut Vec<OpenNode<K>>,
        spill: &mut SpillFile,
    ) -> Result<(), BuildError> {
        let rest = spill.add_stream();
        let mut occupied: Vec<HashSet<K>> = vec![HashSet::new(); (region.depth - base) as usize];
        let row_bytes = INDEX_BYTES + self.schema.record_bytes as usize;
        spill.visit(stream, row_bytes, PIECE_BYTES, &mut |spill, bytes| {
            let rows = Rows::indexed(bytes, self.schema);
            let batch = RowBatch { rows, origin: None };
            for row in 0..rows.len() as u32 {
                let key: K = batch.key(row);
                self.open_path(base, region.depth, key, open, spill)?;
                let taker = open.iter().zip(&mut occupied).find_map(|(node, cells)| {
                    let shift = self.rules.grid(node.depth).shift(self.rules.levels);
                    cells.insert(key.ancestor(shift)).then_some(node.taken)
                });
                match taker {
                    Some(taken) => append_taken(Entry { key, row }, true, rows, taken, spill)?,
                    None => spill.append(rest, rows.row(row))?,
                }
            }
            Ok(())
        })?;
        drop(occupied);
        spill.forget(stream);
        let mut source = SpilledRows { stream: rest, schema: self.schema };
        self.run::<K>(region.depth, &mut source, spill)?;
        spill.forget(rest);
        Ok(())
    }
}

/// A batch's rows sorted by region: all bytes, and where each region's end.
struct RoutedRows {
    bytes: Vec<u8>,
    /// Region and one past its last byte, in the order of `bytes`.
    ends: Vec<(u32, usize)>,
}

impl RoutedRows {
    /// Each region with its rows.
    fn parts(&self) -> impl Iterator<Item = (u32, &[u8])> {
        let starts = std::iter::once(0).chain(self.ends.iter().map(|(_, end)| *end));
        self.ends
            .iter()
            .zip(starts)
            .map(|(&(region, end), start)| (region, &self.bytes[start..end]))
    }
}

/// Sorts a batch's rows by region, each with its input index before it and its coordinates
/// replaced by those within the root cube.
fn route_rows<K: MortonKey>(
    batch: &RowBatch,
    schema: &Schema,
    region: impl Fn(K) -> u32,
) -> RoutedRows {
    let row_bytes = INDEX_BYTES + schema.record_bytes as usize;
    let mut order: Vec<(u32, u32)> =
        (0..batch.rows.len() as u32).map(|row| (region(batch.key(row)), row)).collect();
    // Scanners write neighbours together, so this mostly finds what is sorted already.
    order.sort();
    let mut bytes = Vec::with_capacity(order.len() * row_bytes);
    let mut ends = Vec::new();
    for rows in order.chunk_by(|a, b| a.0 == b.0) {
        for &(_, row) in rows {
            bytes.extend_from_slice(&batch.rows.input_index(row).to_le_bytes());
            for coordinate in batch.root_coordinates(row) {
                bytes.extend_from_slice(&coordinate.to_le_bytes());
            }
            bytes.extend_from_slice(&batch.rows.record(row)[COORDINATE_BYTES..]);
        }
        ends.push((rows[0].0, bytes.len()));
    }
    RoutedRows { bytes, ends }
}

/// Moves the first arrival of each cell from `entries` (sorted by key, row) to a node's stream and
/// compacts the rest.
fn take_first_arrivals<K: MortonKey>(
    entries: &mut Vec<Entry<K>>,
    shift: u32,
    rows: Rows,
    taken: StreamId,
    spill: &mut SpillFile,
) -> Result<(), BuildError> {
    let (mut start, mut end) = (0, 0);
    while start < entries.len() {
        let cell = entries[start].key.ancestor(shift);
        let length = entries[start..].iter().take_while(|e| e.key.ancestor(shift) == cell).count();
        let stop = start + length;
        let first = (start..stop).min_by_key(|&i| entries[i].row).expect("a cell has an entry");
        for i in start..stop {
            let entry = entries[i];
            if i == first {
                append_taken(entry, true, rows, taken, spill)?;
            } else {
                entries[end] = entry;
                end += 1;
            }
        }
        start = stop;
    }
    entries.truncate(end);
    Ok(())
}

fn append_taken<K: MortonKey>(
    entry: Entry<K>,
    is_first_arrival: bool,
    rows: Rows,
    taken: StreamId,
    spill: &mut SpillFile,
) -> Result<(), BuildError> {
    let mut prefix = [0; TAKEN_PREFIX];
    prefix[..16].copy_from_slice(&entry.key.widen().to_le_bytes());
    prefix[16] = u8::from(is_first_arrival);
    prefix[17..].copy_from_slice(&rows.input_index(entry.row).to_le_bytes());
    spill.append(taken, &prefix)?;
    spill.append(taken, rows.record(entry.row))
}

/// Cuts the grid into regions of at most `max_points`, or single cells, in Morton order.
fn plan_regions(depth: u32, grid_levels: u32, counts: Vec<u64>, max_points: u64) -> Vec<Region> {
    // sums[l] holds the points of each cell l levels above the finest.
    let mut sums = vec![counts];
    for level in 0..grid_levels as usize {
        sums.push(sums[level].chunks_exact(8).map(|cells| cells.iter().sum()).collect());
    }
    let mut regions = Vec::new();
    let mut pending = vec![(grid_levels as usize, 0usize)];
    while let Some((level, cell)) = pending.pop() {
        let points = sums[level][cell];
        if points == 0 {
            continue;
        }
        if points <= max_points || level == 0 {
            let region_depth = depth + grid_levels - level as u32;
            regions.push(Region { depth: region_depth, first_cell: cell << (3 * level), points });
        } else {
            pending.extend((0..8).rev().map(|octant| (level - 1, 8 * cell + octant)));
        }
    }
    regions
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_cover_all_points_in_order_and_respect_the_bound() {
        let mut counts = vec![0u64; 512];
        for (i, count) in counts.iter_mut().enumerate() {
            *count = [0, 3, 50, 0, 7][i % 5] * u64::from(i % 64 < 20);
        }
        counts[100] = 5000;
        let regions = plan_regions(2, 3, counts.clone(), 400);
        assert_eq!(regions.iter().map(|r| r.points).sum::<u64>(), counts.iter().sum::<u64>());
        assert!(regions.windows(2).all(|w| w[0].first_cell < w[1].first_cell));
        for region in &regions {
            let cells = 1usize << (3 * (2 + 3 - region.depth));
            let inside: u64 = counts[region.first_cell..region.first_cell + cells].iter().sum();
            assert_eq!(inside, region.points);
            assert!(region.points <= 400 || region.depth == 5);
        }
    }

    #[test]
    fn everything_that_fits_is_one_region() {
        let regions = plan_regions(3, 1, vec![1, 0, 0, 9, 0, 0, 0, 2], 12);
        assert_eq!(regions, [Region { depth: 3, first_cell: 0, points: 12 }]);
    }
}
