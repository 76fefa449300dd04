//! How far a conversion is, noted down so that a killed one can go on.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use crate::build::BuildError;
use crate::build::options::ConvertOptions;
use crate::build::pages::{DiskPlace, Page, PageStore};
use crate::build::partition::ChunkRowsState;
use crate::build::plan::Chunk;
use crate::build::spanning::PendingState;
use crate::build::survey::{HeldPage, Survey};
use crate::build::work::Work;
use crate::geometry::MortonKey;
use crate::store::{ValueRange, WriterState};

/// Everything that a conversion needs to go on.
#[derive(Debug, Serialize, Deserialize)]
pub struct State {
    /// Size of pages.
    pub page_bytes: usize,
    /// End of the file of pages.
    pub pages_end: u64,
    /// What has been found out about the points.
    pub survey: Survey,
    /// Where it is.
    pub step: Step,
}

/// A part of the work and what it has done so far.
#[derive(Debug, Serialize, Deserialize)]
pub enum Step {
    /// So many blocks have been read.
    Survey {
        /// Blocks.
        done: usize,
        /// Their records, if they are kept.
        held: Vec<HeldState>,
    },
    /// So many blocks or held pages have been brought into chunks.
    Partition {
        /// Blocks or held pages.
        done: usize,
        /// All held pages.
        held: Vec<HeldState>,
        /// The plan.
        chunks: Vec<ChunkState>,
        /// What is in the chunks.
        rows: Vec<ChunkRowsState>,
    },
    /// So many chunks have been built.
    Build {
        /// Chunks.
        done: usize,
        /// All chunks.
        chunks: Vec<ChunkState>,
        /// What is in the chunks; of those that are done only what they share.
        rows: Vec<ChunkRowsState>,
        /// Nodes that wait for more chunks.
        pending: Vec<PendingState>,
        /// What has been written.
        writer: WriterState,
        /// Coarse nodes that wait to be written.
        coarse: Vec<Vec<DiskPlace>>,
        /// Value ranges of their attributes.
        ranges: Vec<Vec<ValueRange>>,
        /// Points beyond one per finest cell in them.
        overflow_points: u64,
    },
}

/// Held records on disk.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct HeldState {
    block: usize,
    first: u64,
    place: DiskPlace,
}

/// Brings held records to disk.
pub fn held_state<'p>(
    held: &mut [HeldPage<'p>],
    pages: &PageStore<'p>,
) -> Result<Vec<HeldState>, BuildError> {
    let states = held.iter_mut().map(|page| {
        let place = pages.to_disk(&mut page.page)?;
        Ok(HeldState { block: page.block, first: page.first, place })
    });
    states.collect()
}

impl HeldState {
    /// The page.
    pub fn resume<'p>(self) -> HeldPage<'p> {
        HeldPage { block: self.block, first: self.first, page: Page::Disk(self.place) }
    }
}

/// A chunk; it ends where the next one starts.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct ChunkState {
    start: [u64; 2],
    level: u32,
}

/// All chunks as they can be noted down.
pub fn chunk_states<K: MortonKey>(chunks: &[Chunk<K>]) -> Vec<ChunkState> {
    let state = |chunk: &Chunk<K>| {
        let wide = chunk.start.widen();
        ChunkState { start: [wide as u64, (wide >> 64) as u64], level: chunk.level }
    };
    chunks.iter().map(state).collect()
}

/// The chunks of states.
pub fn resume_chunks<K: MortonKey>(states: &[ChunkState]) -> Vec<Chunk<K>> {
    let start = |state: &ChunkState| {
        K::narrow(u128::from(state.start[0]) | u128::from(state.start[1]) << 64)
    };
    let ends = states.iter().skip(1).map(|next| Some(start(next))).chain([None]);
    let chunk = |(state, end)| Chunk { start: start(state), end, level: state.level };
    states.iter().zip(ends).map(chunk).collect()
}

/// Notes down how far the work is, from time to time.
pub struct Checkpoints<'a> {
    work: &'a Work,
    job: String,
    every: Duration,
    last: Instant,
    page_bytes: usize,
}

impl<'a> Checkpoints<'a> {
    /// For a job in its work folder.
    pub fn new(work: &'a Work, job: String, every: Duration, page_bytes: usize) -> Self {
        Checkpoints { work, job, every, last: Instant::now(), page_bytes }
    }

    /// When the next one is due.
    pub fn next(&self) -> Option<Instant> {
        self.last.checked_add(self.every)
    }

    /// Whether one is due.
    pub fn is_due(&self) -> bool {
        self.next().is_some_and(|next| Instant::now() >= next)
    }

    /// Makes one. Everything it speaks of is on disk afterwards.
    pub fn make(
        &mut self,
        pages: &PageStore,
        survey: &Survey,
        step: Step,
    ) -> Result<(), BuildError> {
        pages.sync()?;
        let state = State {
            page_bytes: self.page_bytes,
            pages_end: pages.written_bytes(),
            survey: survey.clone(),
            step,
        };
        self.work.save_state(&self.job, &state)?;
        self.last = Instant::now();
        Ok(())
    }
}

/// What a conversion's output depends on, in one line.
pub fn job(inputs: &[PathBuf], options: &ConvertOptions) -> String {
    let file = |path: &PathBuf| {
        let facts = std::fs::metadata(path).ok();
        let modified = facts.as_ref().and_then(|facts| facts.modified().ok());
        let since = modified.and_then(|time| time.duration_since(std::time::UNIX_EPOCH).ok());
        serde_json::json!([
            std::fs::canonicalize(path).unwrap_or_else(|_| path.clone()),
            facts.map(|facts| facts.len()),
            since.map(|since| (since.as_secs(), since.subsec_nanos())),
        ])
    };
    let job = serde_json::json!({
        "program": env!("CARGO_PKG_VERSION"),
        "inputs": inputs.iter().map(file).collect::<Vec<_>>(),
        "depth": options.depth,
        "threshold": options.threshold,
        "representative": format!("{:?}", options.representative),
        "read": format!("{:?}", options.read),
    });
    job.to_string()
}
