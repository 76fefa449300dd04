//! The threads, and the one lock between them and the frame.
//!
//! The lock is held for the time of a few look-ups, never while bytes are read or unpacked. A frame
//! that finds it taken goes on without an exchange and counts that; it never waits. Threads start
//! with the loader and end by themselves when it is dropped: nobody waits for a slow disk then
//! either.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::{Duration, Instant};

use crate::stream::{
    LoadError, LoadedNode, NodeReader, Residency, SceneNode, Schedule, StreamSettings, StreamStats,
    Wish,
};

/// For how long a frame tries to get the lock.
const LONGEST_TRY: Duration = Duration::from_micros(200);

/// Called when something came that the list wants; from a thread of the loader.
pub type Wake = Arc<dyn Fn() + Send + Sync>;

/// Loads nodes for one scene at a time.
pub struct Loader {
    shared: Arc<Shared>,
    threads: u32,
    skipped: u64,
    last_stats: StreamStats,
}

struct Shared {
    state: Mutex<State>,
    began: Instant,
    changed: Condvar,
    wake: Wake,
}

struct State {
    schedule: Schedule,
    is_closed: bool,
}

/// What a frame gets for its list.
#[derive(Debug, Default)]
pub struct Exchange {
    /// Nodes that are there, best first.
    pub ready: Vec<(SceneNode, Arc<LoadedNode>)>,
    /// Nodes that will never come.
    pub failed: Vec<(SceneNode, LoadError)>,
    /// Whether the lock was taken, so that nothing was given or got.
    pub was_skipped: bool,
}

impl Loader {
    /// Starts the threads; fewer if the system gives no more, an error if it gives none.
    pub fn start(settings: StreamSettings, wake: Wake) -> std::io::Result<Loader> {
        let state = State { schedule: Schedule::new(settings), is_closed: false };
        let shared = Arc::new(Shared {
            state: Mutex::new(state),
            began: Instant::now(),
            changed: Condvar::new(),
            wake,
        });
        let mut threads = 0;
        for number in 0..settings.in_flight_nodes {
            let shared = shared.clone();
            let thread = std::thread::Builder::new().name(format!("esker loader {number}"));
            match thread.spawn(move || shared.serve()) {
                Ok(_) => threads += 1,
                Err(_) if threads > 0 => break,
                Err(error) => return Err(error),
            }
        }
        Ok(Loader { shared, threads, skipped: 0, last_stats: StreamStats::default() })
    }

    /// Takes another scene, or the same in other colours.
    pub fn set_reader(&mut self, reader: Arc<dyn NodeReader>) {
        self.shared.lock().schedule.set_reader(reader);
        self.shared.changed.notify_all();
    }

    /// Puts a list of wishes in place of the last one, and takes what is there of it: up to about
    /// `quota_bytes`, at least one node, and only what `may_go`.
    pub fn exchange(
        &mut self,
        wishes: Vec<Wish>,
        quota_bytes: u64,
        may_go: impl FnMut(SceneNode) -> bool,
    ) -> Exchange {
        let Some(mut state) = self.shared.try_lock() else {
            self.skipped += 1;
            return Exchange { was_skipped: true, ..Exchange::default() };
        };
        state.schedule.replace(wishes);
        let ready = state.schedule.deliver(quota_bytes, may_go);
        let failed = state.schedule.take_failures();
        self.last_stats = state.schedule.stats();
        drop(state);
        self.shared.changed.notify_one();
        Exchange { ready, failed, was_skipped: false }
    }

    /// Lowers the limit of main memory.
    pub fn shrink(&mut self, memory_bytes: u64) {
        self.shared.lock().schedule.shrink(memory_bytes);
    }

    /// Counters as of now; as of the last exchange if a thread has the lock.
    pub fn stats(&mut self) -> StreamStats {
        if let Some(state) = self.shared.try_lock() {
            self.last_stats = state.schedule.stats();
        }
        StreamStats {
            loader_threads: self.threads,
            exchanges_skipped: self.skipped,
            ..self.last_stats
        }
    }

    /// Where a node is; waits for the lock.
    pub fn residency(&self, node: SceneNode) -> Residency {
        self.shared.lock().schedule.residency(node)
    }

    /// Does the next step on this thread; `false` if there is none. For a loader without threads.
    pub fn work(&self) -> bool {
        self.shared.work()
    }

    /// Whether nothing is under way and nothing can begin.
    pub fn is_idle(&self) -> bool {
        self.shared.lock().schedule.is_idle()
    }
}

impl Drop for Loader {
    fn drop(&mut self) {
        self.shared.lock().is_closed = true;
        self.shared.changed.notify_all();
    }
}

impl Shared {
    /// A thread that panicked left a whole state: jobs run outside of the lock.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn try_lock(&self) -> Option<MutexGuard<'_, State>> {
        // The lock is held for microseconds; a thread that was stopped while it had it is not
        // waited for.
        let start = Instant::now();
        loop {
            match self.state.try_lock() {
                Ok(state) => return Some(state),
                Err(TryLockError::Poisoned(error)) => return Some(error.into_inner()),
                Err(TryLockError::WouldBlock) if start.elapsed() > LONGEST_TRY => return None,
                Err(TryLockError::WouldBlock) => std::thread::yield_now(),
            }
        }
    }

    fn serve(&self) {
        loop {
            let mut state = self.lock();
            let job = loop {
                if state.is_closed {
                    return;
                }
                state.schedule.set_time(self.began.elapsed());
                if let Some(job) = state.schedule.next_job() {
                    break job;
                }
                state = match state.schedule.next_retry() {
                    Some(wait) => {
                        let waited = self.changed.wait_timeout(state, wait);
                        waited.unwrap_or_else(PoisonError::into_inner).0
                    }
                    None => {
                        let waited = self.changed.wait(state);
                        waited.unwrap_or_else(PoisonError::into_inner)
                    }
                };
            };
            drop(state);
            // Where there was one there may be another.
            self.changed.notify_one();
            self.take_in(job.run());
        }
    }

    fn work(&self) -> bool {
        let job = {
            let mut state = self.lock();
            state.schedule.set_time(self.began.elapsed());
            state.schedule.next_job()
        };
        let Some(job) = job else { return false };
        self.take_in(job.run());
        true
    }

    fn take_in(&self, done: crate::stream::schedule::Done) {
        let matters = {
            let mut state = self.lock();
            state.schedule.set_time(self.began.elapsed());
            state.schedule.finish(done)
        };
        self.changed.notify_one();
        if matters {
            (self.wake)();
        }
    }
}
