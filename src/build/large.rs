//! A node with more points than fit the memory of a worker.
//!
//! The same node as `node` makes, from rows that come in order: representatives are chosen in one
//! sweep that holds a group of at most eight candidates per level; the rows are dealt out by level,
//! which is their final order; columns are encoded block by block. Beside a page per level, a byte
//! a point is in memory.

use glam::UVec3;

use crate::build::BuildError;
use crate::build::encode::{BlockEncoder, join_ranges};
use crate::build::node::{Candidate, TreeRules, pick};
use crate::build::paged_rows::{PagedRows, marked_stride};
use crate::build::pages::{Page, PageStore};
use crate::build::rows::RowLayout;
use crate::geometry::MortonKey;
use crate::octree::LevelIndex;
use crate::store::{NodeRow, StoreWriter, ValueRange};

/// A node that is to be written block by block.
pub struct LargeNode<'p> {
    /// What the directory says of it.
    pub row: NodeRow,
    /// Points beyond one per finest cell.
    pub overflow_points: u64,
    /// Marked rows by level, Morton order within.
    pages: Vec<Page<'p>>,
    layout: RowLayout,
    local_bits: u32,
}

/// Rows in Morton order, equal codes by input index: one long sequence and a few beside it.
pub struct SortedRows<'p> {
    /// The sequence.
    pub main: PagedRows<'p>,
    /// Marked rows that belong in between, sorted.
    pub between: Vec<u8>,
}

impl<'p> SortedRows<'p> {
    /// Hands out all marked rows in order.
    fn visit<K: MortonKey>(
        &mut self,
        pages: &PageStore<'p>,
        layout: RowLayout,
        visit: &mut dyn FnMut(&[u8]) -> Result<(), BuildError>,
    ) -> Result<(), BuildError> {
        let stride = marked_stride(layout);
        let order = |row: &[u8]| (K::read(row), layout.index(row));
        let mut between = self.between.chunks_exact(stride).peekable();
        self.main.visit(pages, &mut |rows| {
            rows.chunks_exact(stride).try_for_each(|row| {
                while let Some(other) = between.next_if(|other| order(other) < order(row)) {
                    visit(other)?;
                }
                visit(row)
            })
        })?;
        between.try_for_each(visit)
    }
}

impl<'p> LargeNode<'p> {
    /// Orders and levels the points of the node at `depth`.
    pub fn new<K: MortonKey>(
        rules: &TreeRules,
        depth: u32,
        mut rows: SortedRows<'p>,
        layout: RowLayout,
        pages: &PageStore<'p>,
    ) -> Result<Self, BuildError> {
        let stride = layout.stride();
        let local_bits = rules.root_bits - depth;
        let mut sweep = LevelSweep::<K>::new(rules, depth, layout.has_color());
        let mut cell = None;
        rows.visit::<K>(pages, layout, &mut |row| {
            cell.get_or_insert(K::read(row).ancestor(local_bits));
            let candidate = (row[stride] == 1).then(|| {
                (K::read(row), Candidate { color: layout.color(row), index: layout.index(row) })
            });
            sweep.push(candidate);
            Ok(())
        })?;
        let levels = sweep.finish();
        let mut totals = vec![0u32; rules.levels as usize + 1];
        levels.iter().for_each(|&level| totals[usize::from(level)] += 1);
        for level in 1..totals.len() {
            totals[level] += totals[level - 1];
        }
        let mut runs: Vec<PagedRows> = (0..=rules.levels).map(|_| PagedRows::default()).collect();
        let mut next = levels.iter();
        let mut tight = [UVec3::MAX, UVec3::ZERO];
        let mut kept = 0;
        rows.visit::<K>(pages, layout, &mut |row| {
            let level = *next.next().expect("every row has a level");
            let is_kept = row[stride] == 1;
            kept += u64::from(is_kept);
            let local = UVec3::from(K::read(row).local(local_bits).decode());
            tight = [tight[0].min(local), tight[1].max(local)];
            runs[usize::from(level)].push(pages, &row[..stride], is_kept)
        })?;
        rows.main.discard(pages)?;
        let mut ordered = Vec::new();
        for run in runs {
            ordered.append(&mut run.into_pages(pages)?);
        }
        let cell = cell.expect("a node has points").decode();
        let overflow_points = levels.len() as u64 - kept;
        let levels = LevelIndex::new(totals).expect("level totals of a node rise from 1");
        let row = NodeRow { depth, cell: cell.into(), levels, tight };
        Ok(LargeNode { row, overflow_points, pages: ordered, layout, local_bits })
    }

    /// Encodes the node into a writer; returns the value ranges of its attributes.
    pub fn write<K: MortonKey>(
        self,
        rules: &TreeRules,
        pages: &PageStore<'p>,
        writer: &mut StoreWriter,
    ) -> Result<Vec<Vec<ValueRange>>, BuildError> {
        let mut encoder = BlockEncoder::new(&rules.encoding, self.layout, self.local_bits);
        let shapes = encoder.shapes();
        let stride = marked_stride(self.layout);
        let mut ranges = Vec::new();
        let mut cursor = Cursor { page: 0, row: 0 };
        let mut rows = Vec::new();
        writer.add_in_blocks(self.row.clone(), &shapes, |section, first, count, column| {
            if first == 0 {
                cursor = Cursor { page: 0, row: 0 };
            }
            rows.clear();
            cursor.take(&self.pages, pages, stride, count, &mut rows)?;
            join_ranges(&mut ranges, &encoder.block::<K>(section, &rows, column));
            Ok::<(), BuildError>(())
        })?;
        for page in self.pages {
            if let Page::Memory(buffer) = page {
                pages.give_back(buffer);
            }
        }
        Ok(ranges)
    }
}

/// Where the next row is.
struct Cursor {
    page: usize,
    row: usize,
}

impl Cursor {
    /// Appends the next rows, without their marks.
    fn take<'p>(
        &mut self,
        from: &[Page<'p>],
        pages: &PageStore<'p>,
        stride: usize,
        count: usize,
        rows: &mut Vec<u8>,
    ) -> Result<(), BuildError> {
        let mut left = count;
        while left > 0 {
            let taken = pages.look(&from[self.page], |bytes| {
                let (start, end) = (self.row, (self.row + left).min(bytes.len() / stride));
                for row in bytes[start * stride..end * stride].chunks_exact(stride) {
                    rows.extend_from_slice(&row[..stride - 1]);
                }
                Ok((end - start, end == bytes.len() / stride))
            })?;
            left -= taken.0;
            *self = match taken.1 {
                true => Cursor { page: self.page + 1, row: 0 },
                false => Cursor { page: self.page, row: self.row + taken.0 },
            };
        }
        Ok(())
    }
}

/// Chooses representatives while candidates come in Morton order.
struct LevelSweep<'a, K> {
    rules: &'a TreeRules<'a>,
    depth: u32,
    has_color: bool,
    /// Per point its level so far.
    levels: Vec<u8>,
    /// Per level above the finest the cell at work and the candidates of its child cells.
    groups: Vec<Group<K>>,
}

#[derive(Default)]
struct Group<K> {
    cell: K,
    members: Vec<Member<K>>,
}

#[derive(Clone, Copy)]
struct Member<K> {
    ordinal: u32,
    key: K,
    candidate: Candidate,
}

impl<'a, K: MortonKey> LevelSweep<'a, K> {
    fn new(rules: &'a TreeRules<'a>, depth: u32, has_color: bool) -> Self {
        let mut groups = Vec::new();
        groups.resize_with(rules.levels as usize, || Group { cell: K::default(), members: vec![] });
        LevelSweep { rules, depth, has_color, levels: Vec::new(), groups }
    }

    /// The next point, a candidate if a cell takes it.
    fn push(&mut self, candidate: Option<(K, Candidate)>) {
        let ordinal = self.levels.len() as u32;
        self.levels.push(self.rules.levels as u8);
        if let Some((key, candidate)) = candidate {
            self.join(self.rules.levels - 1, Member { ordinal, key, candidate });
        }
    }

    /// A candidate for the cell at a level.
    fn join(&mut self, level: u32, member: Member<K>) {
        let cell = member.key.ancestor(self.rules.root_bits - self.depth - level);
        let group = &mut self.groups[level as usize];
        if !group.members.is_empty() && group.cell != cell {
            self.decide(level);
        }
        let group = &mut self.groups[level as usize];
        group.cell = cell;
        group.members.push(member);
    }

    /// Takes the best of a group, which is a candidate of the level above, too.
    fn decide(&mut self, level: u32) {
        let mut members = std::mem::take(&mut self.groups[level as usize].members);
        if members.is_empty() {
            return;
        }
        let group: Vec<u32> = (0..members.len() as u32).collect();
        let candidates: Vec<Candidate> = members.iter().map(|member| member.candidate).collect();
        let keys: Vec<K> = members.iter().map(|member| member.key).collect();
        let shift = self.rules.root_bits - self.depth - level;
        let best =
            pick(&group, &candidates, &keys, shift, self.rules.representative, self.has_color);
        let winner = members[best as usize];
        self.levels[winner.ordinal as usize] = level as u8;
        members.clear();
        self.groups[level as usize].members = members;
        if level > 0 {
            self.join(level - 1, winner);
        }
    }

    fn finish(mut self) -> Vec<u8> {
        (0..self.rules.levels).rev().for_each(|level| self.decide(level));
        self.levels
    }
}
