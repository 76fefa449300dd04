//! A chunk of single lattice steps with more points than fit the memory of a worker: millions of
//! points that coincide.
//!
//! Its rows are sorted in runs that fit, the runs merged. At these cells no node takes more than
//! one point, so all but a few belong to the deepest node beyond one per cell.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use crate::build::BuildError;
use crate::build::chunk::{ContributedRows, Contribution, Taken};
use crate::build::node::TreeRules;
use crate::build::paged_rows::{PagedRows, marked_stride};
use crate::build::pages::{Page, PageBuffer, PageStore};
use crate::build::rows::RowLayout;
use crate::geometry::MortonKey;

/// What the chunk gives to the nodes above it.
pub fn build_dense_chunk<'p, K: MortonKey>(
    rules: &TreeRules,
    chunk_pages: Vec<Page<'p>>,
    run_rows: usize,
    taken: &[Taken],
    layout: RowLayout,
    pages: &PageStore<'p>,
) -> Result<Vec<Contribution<'p, K>>, BuildError> {
    let runs = sorted_runs::<K>(chunk_pages, run_rows, layout, pages)?;
    let taken: HashMap<u64, u32> = taken.iter().copied().collect();
    let deepest = rules.max_depth();
    let stride = layout.stride();
    let mut rows: Vec<PagedRows> = (0..=deepest).map(|_| PagedRows::default()).collect();
    let (mut last, mut cell) = (None, K::default());
    merge::<K>(runs, layout, pages, &mut |row| {
        let (key, index) = (K::read(row), layout.index(row));
        cell = key;
        if let Some(&depth) = taken.get(&index) {
            return rows[depth as usize].push(pages, &row[..stride], true);
        }
        let is_first = last != Some(key);
        last = Some(key);
        rows[deepest as usize].push(pages, &row[..stride], is_first)
    })?;
    let mut entering = 0;
    let contributions = rows.into_iter().enumerate().rev().map(|(depth, rows)| {
        entering += rows.len();
        let depth = depth as u32;
        let code = cell.ancestor(rules.root_bits - depth);
        Contribution { depth, code, entering, rows: ContributedRows::Paged(rows) }
    });
    Ok(contributions.filter(|part| part.entering > 0).collect())
}

/// Sorts as many rows at a time as are given, by code and input index.
fn sorted_runs<'p, K: MortonKey>(
    chunk_pages: Vec<Page<'p>>,
    run_rows: usize,
    layout: RowLayout,
    pages: &PageStore<'p>,
) -> Result<Vec<PagedRows<'p>>, BuildError> {
    let stride = layout.stride();
    let mut runs = Vec::new();
    let mut batch: Vec<u8> = Vec::new();
    let mut order: Vec<(K, u64, u32)> = Vec::new();
    let mut put_away = |batch: &mut Vec<u8>| -> Result<(), BuildError> {
        order.clear();
        let rows = batch.chunks_exact(stride).zip(0..);
        order.extend(rows.map(|(row, i)| (K::read(row), layout.index(row), i)));
        order.sort_unstable();
        let mut run = PagedRows::default();
        for &(.., i) in &order {
            run.push(pages, &batch[i as usize * stride..][..stride], false)?;
        }
        run.close(pages)?;
        runs.push(run);
        batch.clear();
        Ok(())
    };
    for page in chunk_pages {
        let loaded = pages.load(page)?;
        batch.extend_from_slice(&loaded);
        pages.give_back(loaded);
        if batch.len() / stride >= run_rows {
            put_away(&mut batch)?;
        }
    }
    if !batch.is_empty() {
        put_away(&mut batch)?;
    }
    Ok(runs)
}

/// A run being read.
struct Reader<'p> {
    rest: std::vec::IntoIter<Page<'p>>,
    page: PageBuffer<'p>,
    at: usize,
}

/// Hands out the rows of all runs in order, and gives their pages back.
fn merge<'p, K: MortonKey>(
    runs: Vec<PagedRows<'p>>,
    layout: RowLayout,
    pages: &PageStore<'p>,
    take: &mut dyn FnMut(&[u8]) -> Result<(), BuildError>,
) -> Result<(), BuildError> {
    let stride = marked_stride(layout);
    let mut readers = Vec::with_capacity(runs.len());
    let mut heads = BinaryHeap::new();
    let head = |reader: &Reader, i: usize| {
        let row = &reader.page[reader.at..reader.at + stride];
        Reverse((K::read(row), layout.index(row), i))
    };
    for (i, run) in runs.into_iter().enumerate() {
        let mut rest = run.into_pages(pages)?.into_iter();
        let first = rest.next().expect("a run has rows");
        let reader = Reader { page: pages.load(first)?, rest, at: 0 };
        heads.push(head(&reader, i));
        readers.push(Some(reader));
    }
    while let Some(Reverse((.., i))) = heads.pop() {
        let mut reader = readers[i].take().expect("runs with heads have readers");
        take(&reader.page[reader.at..reader.at + stride])?;
        reader.at += stride;
        if reader.at + stride > reader.page.len() {
            pages.give_back(reader.page);
            let Some(next) = reader.rest.next() else { continue };
            reader = Reader { page: pages.load(next)?, rest: reader.rest, at: 0 };
        }
        heads.push(head(&reader, i));
        readers[i] = Some(reader);
    }
    Ok(())
}
