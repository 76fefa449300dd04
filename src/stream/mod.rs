//! Nodes on their way from a store to the frame: what is read when, by whom, and what stays.
//!
//! Each frame gives the [`Loader`] a list of what it wants, best first, which takes the place of
//! the last one; wishes that are no longer wanted vanish with it. Threads of the loader read and
//! unpack the best that are not under way yet, a few at a time, into a cache in main memory with a
//! limit that holds; the frame takes from there what it has room for. The frame never waits: what
//! is not there is not there.
//!
//! What happens when is decided in [`Schedule`], which has no threads, no files and no clock, so
//! that tests can follow it step by step. Nodes come from behind [`NodeReader`], in two steps that
//! may happen on different threads: bytes, then words. Not here: what is wanted (`select`), and
//! where the words go (`frame`); this room never touches the GPU.
//!
//! Life of a node ([`Residency`]): absent, queued, reading, in main memory, uploading, resident.
//! Source: the Instant Points chapter, 6.5.4; our departures stand in `docs/streaming.md`.

mod loader;
mod lru;
mod motion;
mod node;
mod retry;
mod schedule;
mod settings;
mod stats;

pub use loader::{Exchange, Loader};
pub use lru::Lru;
pub use motion::Motion;
pub use node::{Fetched, LoadError, LoadedNode, NodeReader, NodeSize, Residency, SceneNode, Wish};
pub use retry::{MOST_RETRIES, read_with_retries, wait_before};
pub use schedule::{Job, JobKind, Schedule};
pub use settings::{StreamSettings, StreamWhen};
pub use stats::StreamStats;
