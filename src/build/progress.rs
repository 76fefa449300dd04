//! How a conversion tells what it is doing.

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

/// Hears how a conversion goes on; called from several threads.
pub trait Progress: Sync {
    /// A part begins that will advance by `total` points.
    fn begin(&self, stage: Stage, total: u64);
    /// So many more points are done.
    fn advance(&self, points: u64);
}

/// Hears nothing.
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _: Stage, _: u64) {}
    fn advance(&self, _: u64) {}
}
