//! How a conversion tells what it is doing.

use std::time::Instant;

use crate::points::{Lattice, Schema};

/// The parts of a conversion, in order. Parts that a conversion does not need are left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Reading points and finding bounds.
    Read,
    /// Sorting points into chunks of neighbours.
    Partition,
    /// Building and encoding nodes.
    Build,
    /// Writing the store.
    Write,
}

impl Stage {
    /// One word for messages.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Read => "read",
            Stage::Partition => "partition",
            Stage::Build => "build",
            Stage::Write => "write",
        }
    }
}

/// Some of the points of an input.
#[derive(Clone, Debug)]
pub struct PointSample {
    /// Their records.
    pub records: Vec<u8>,
    /// How these are laid out.
    pub schema: Schema,
    /// The lattice of their coordinates.
    pub lattice: Lattice,
}

/// Hears how a conversion goes on; called from several threads.
pub trait Progress: Sync {
    /// A part begins that will advance by `total` points.
    fn begin(&self, stage: Stage, total: u64);
    /// So many more points are done.
    fn advance(&self, points: u64);
    /// About how many points, spread evenly over the input, it wants to have as soon as all of it
    /// has been read; 0 for none.
    fn wanted_points(&self) -> u64 {
        0
    }
    /// Those points. The conversion goes on when this returns.
    fn take_points(&self, _: PointSample) {}
}

/// Hears nothing.
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _: Stage, _: u64) {}
    fn advance(&self, _: u64) {}
}

/// How long a part of a conversion took.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct StageTime {
    /// Which part.
    pub stage: &'static str,
    /// Wall time.
    pub seconds: f64,
}

/// Tells which part of the work goes on, and how long each took.
pub(super) struct Clock<'a> {
    progress: &'a dyn Progress,
    stages: Vec<StageTime>,
    /// Which of them goes on.
    current: usize,
    began: Instant,
}

impl<'a> Clock<'a> {
    pub fn new(progress: &'a dyn Progress) -> Self {
        Clock { progress, stages: Vec::new(), current: 0, began: Instant::now() }
    }

    /// A part begins, or begins again, that will advance by so many points.
    pub fn begin(&mut self, stage: Stage, points: u64) {
        self.stop();
        let known = self.stages.iter().position(|known| known.stage == stage.name());
        self.current = known.unwrap_or_else(|| {
            self.stages.push(StageTime { stage: stage.name(), seconds: 0.0 });
            self.stages.len() - 1
        });
        self.progress.begin(stage, points);
    }

    fn stop(&mut self) {
        let now = Instant::now();
        if let Some(stage) = self.stages.get_mut(self.current) {
            stage.seconds += (now - self.began).as_secs_f64();
        }
        self.began = now;
    }

    /// All parts with their times.
    pub fn finish(mut self) -> Vec<StageTime> {
        self.stop();
        self.stages
    }
}
