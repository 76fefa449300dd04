//! What the loader does next, and what it keeps: the state behind the threads.
//!
//! Invariants, upheld by every method: the words held and the room kept for nodes under way stay
//! within `memory_bytes` (a node larger than that is loaded only while nothing else is held); no
//! node is under way twice; what the current list wants is not dropped for what comes later in it.

use std::collections::{HashMap, HashSet, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;

use crate::stream::{
    Fetched, LoadError, LoadedNode, Lru, MOST_RETRIES, NodeReader, NodeSize, Residency, SceneNode,
    StreamSettings, StreamStats, Wish, wait_before,
};

/// One step of loading one node, for any thread.
pub struct Job {
    node: SceneNode,
    size: NodeSize,
    scene: u64,
    kind: JobKind,
}

/// Which step.
pub enum JobKind {
    /// Read its bytes.
    Fetch(Arc<dyn NodeReader>),
    /// Make words of them.
    Unpack(Box<dyn Fetched>),
}

/// A job that was done.
pub struct Done {
    node: SceneNode,
    size: NodeSize,
    scene: u64,
    was_unpacking: bool,
    result: Result<Step, LoadError>,
}

enum Step {
    Fetched(Box<dyn Fetched>),
    Unpacked(LoadedNode),
}

impl Job {
    /// The node.
    pub fn node(&self) -> SceneNode {
        self.node
    }

    /// Whether bytes are to be read, not unpacked.
    pub fn reads(&self) -> bool {
        matches!(self.kind, JobKind::Fetch(_))
    }

    /// Does it; may wait for a disk.
    pub fn run(self) -> Done {
        let Job { node, size, scene, kind } = self;
        let was_unpacking = matches!(kind, JobKind::Unpack(_));
        let work = || match kind {
            JobKind::Fetch(reader) => reader.fetch(node).map(Step::Fetched),
            JobKind::Unpack(fetched) => fetched.unpack().map(Step::Unpacked),
        };
        // A reader that panics must not leave its node under way for ever.
        let result = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
            let said = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
            let said = said.or_else(|| panic.downcast_ref::<String>().cloned());
            Err(LoadError::Broken { node: node.1, reason: said.unwrap_or_default() })
        });
        Done { node, size, scene, was_unpacking, result }
    }
}

/// The state of the loader.
pub struct Schedule {
    settings: StreamSettings,
    reader: Option<Arc<dyn NodeReader>>,
    /// Counts the scenes; what is under way for an earlier one is dropped when it comes.
    scene: u64,
    /// Counts the lists.
    list: u64,
    wishes: Vec<Wish>,
    place: HashMap<SceneNode, usize>,
    /// Handed out since the list came.
    delivered: HashSet<SceneNode>,
    /// Wishes that were in memory when they were made.
    hits: HashSet<SceneNode>,
    /// Every wish before it is held, under way, handed out or failed.
    next: usize,
    under_way: HashMap<SceneNode, NodeSize>,
    to_unpack: VecDeque<(SceneNode, NodeSize, Box<dyn Fetched>)>,
    unpacking: u32,
    /// Jobs of all scenes.
    jobs: u32,
    job_bytes: u64,
    reserved_bytes: u64,
    held: HashMap<SceneNode, Arc<LoadedNode>>,
    lru: Lru<SceneNode>,
    failed: HashSet<SceneNode>,
    failures: Vec<(SceneNode, LoadError)>,
    /// Nodes whose last read failed for a passing reason.
    retries: HashMap<SceneNode, Retry>,
    /// What it is told.
    now: Duration,
    read_before: HashSet<SceneNode>,
    stats: StreamStats,
}

/// A read that is to be tried again.
#[derive(Clone, Copy)]
struct Retry {
    /// Tries after the first, this one included.
    number: u32,
    due: Duration,
}

impl Schedule {
    /// Nothing to do yet.
    pub fn new(settings: StreamSettings) -> Self {
        Schedule {
            settings,
            reader: None,
            scene: 0,
            list: 0,
            wishes: Vec::new(),
            place: HashMap::new(),
            delivered: HashSet::new(),
            hits: HashSet::new(),
            next: 0,
            under_way: HashMap::new(),
            to_unpack: VecDeque::new(),
            unpacking: 0,
            jobs: 0,
            job_bytes: 0,
            reserved_bytes: 0,
            held: HashMap::new(),
            lru: Lru::default(),
            failed: HashSet::new(),
            failures: Vec::new(),
            retries: HashMap::new(),
            now: Duration::ZERO,
            read_before: HashSet::new(),
            stats: StreamStats::default(),
        }
    }

    /// Takes another scene, or the same in other colours: all that is held is dropped, and what is
    /// under way will be.
    pub fn set_reader(&mut self, reader: Arc<dyn NodeReader>) {
        let former = std::mem::replace(self, Schedule::new(self.settings));
        self.reader = Some(reader);
        self.scene = former.scene + 1;
        self.now = former.now;
        self.unpacking = former.unpacking;
        self.jobs = former.jobs;
        self.job_bytes = former.job_bytes;
        self.reserved_bytes = former.reserved_bytes;
        for (_, size, _) in former.to_unpack {
            self.release(size);
        }
        self.note_memory();
    }

    /// Takes a list of wishes, best first, in place of the last one.
    pub fn replace(&mut self, wishes: Vec<Wish>) {
        self.list += 1;
        self.stats.lists += 1;
        let former = std::mem::take(&mut self.place);
        for (index, wish) in wishes.iter().enumerate() {
            self.place.insert(wish.node, index);
            let is_held = self.lru.touch(wish.node, self.list);
            let was_wished = former.get(&wish.node).is_some_and(|&at| !self.wishes[at].ahead);
            if is_held && !wish.ahead && !was_wished {
                self.hits.insert(wish.node);
            }
        }
        self.hits.retain(|node| self.place.contains_key(node));
        self.wishes = wishes;
        self.delivered.clear();
        self.next = 0;
    }

    /// Hands out what is there of the list, best first, up to about `quota_bytes` but at least one
    /// node; only what `may_go`, which is asked in the order of the list.
    pub fn deliver(
        &mut self,
        quota_bytes: u64,
        mut may_go: impl FnMut(SceneNode) -> bool,
    ) -> Vec<(SceneNode, Arc<LoadedNode>)> {
        let (mut out, mut sum_bytes) = (Vec::new(), 0u64);
        // What was handed out may go when room is needed, after all that is older.
        let before = self.list.saturating_sub(1);
        for wish in self.wishes.iter().filter(|wish| !wish.ahead) {
            let Some(words) = self.held.get(&wish.node) else { continue };
            if !out.is_empty() && sum_bytes + words.bytes() > quota_bytes {
                break;
            }
            if self.delivered.contains(&wish.node) || !may_go(wish.node) {
                continue;
            }
            sum_bytes += words.bytes();
            self.delivered.insert(wish.node);
            self.lru.touch(wish.node, before);
            self.stats.nodes_delivered += 1;
            self.stats.ram_hits += u64::from(self.hits.remove(&wish.node));
            out.push((wish.node, words.clone()));
        }
        out
    }

    /// What failed since it was last asked.
    pub fn take_failures(&mut self) -> Vec<(SceneNode, LoadError)> {
        std::mem::take(&mut self.failures)
    }

    /// Tells the time, on any clock that does not go back.
    pub fn set_time(&mut self, now: Duration) {
        self.now = self.now.max(now);
    }

    /// Time until a read is to be tried again; `None` if none is.
    pub fn next_retry(&self) -> Option<Duration> {
        let wanted = self.retries.iter().filter(|(node, _)| self.place.contains_key(node));
        let waits = wanted.map(|(_, retry)| retry.due.saturating_sub(self.now));
        waits.filter(|wait| !wait.is_zero()).min()
    }

    /// The next thing to do; `None` until something changes.
    pub fn next_job(&mut self) -> Option<Job> {
        self.next_unpacking().or_else(|| self.next_reading())
    }

    /// Takes in what a job brought. Whether a frame may want to know.
    pub fn finish(&mut self, done: Done) -> bool {
        let Done { node, size, scene, was_unpacking, result } = done;
        self.unpacking -= u32::from(was_unpacking);
        if scene != self.scene {
            self.release(size);
            return false;
        }
        match result {
            Ok(Step::Fetched(fetched)) => {
                self.to_unpack.push_back((node, size, fetched));
                false
            }
            Ok(Step::Unpacked(words)) => {
                self.under_way.remove(&node);
                self.retries.remove(&node);
                self.release(size);
                self.keep(node, size, words)
            }
            Err(error) if error.is_transient() && self.tries_again(node) => {
                self.under_way.remove(&node);
                self.release(size);
                false
            }
            Err(error) => {
                self.under_way.remove(&node);
                self.retries.remove(&node);
                self.release(size);
                self.failed.insert(node);
                self.failures.push((node, error));
                self.stats.nodes_unreadable += 1;
                true
            }
        }
    }

    /// Lowers the limit of main memory and drops what is above it.
    pub fn shrink(&mut self, memory_bytes: u64) {
        self.settings.memory_bytes = self.settings.memory_bytes.min(memory_bytes);
        while self.lru.bytes() + self.reserved_bytes > self.settings.memory_bytes {
            let Some(victim) = self.lru.oldest_before(u64::MAX) else { break };
            self.drop_words(victim);
        }
    }

    /// Where a node is, as far as it is known here.
    pub fn residency(&self, node: SceneNode) -> Residency {
        if self.held.contains_key(&node) {
            Residency::InRam
        } else if self.under_way.contains_key(&node) {
            Residency::Reading
        } else if self.failed.contains(&node) {
            Residency::Failed
        } else if self.place.contains_key(&node) {
            Residency::Queued
        } else {
            Residency::Absent
        }
    }

    /// Whether nothing is under way and nothing can begin before the list changes.
    pub fn is_idle(&mut self) -> bool {
        self.jobs == 0
            && self.next_retry().is_none()
            && self.find_next().is_none_or(|(index, _)| !self.makes_room(index, false))
    }

    /// Counters.
    pub fn stats(&self) -> StreamStats {
        let queued = self.wishes.iter().filter(|wish| self.is_to_read(wish.node));
        StreamStats {
            nodes_queued: queued.count() as u32,
            nodes_in_flight: self.jobs,
            in_flight_bytes: self.job_bytes,
            ram_nodes: self.lru.len() as u32,
            ram_bytes: self.lru.bytes() + self.reserved_bytes,
            ram_limit_bytes: self.settings.memory_bytes,
            ..self.stats
        }
    }

    fn next_unpacking(&mut self) -> Option<Job> {
        if self.unpacking >= self.settings.unpacking_nodes.max(1) {
            return None;
        }
        let place = |node: &SceneNode| self.place.get(node).copied().unwrap_or(usize::MAX);
        let (best, _) =
            self.to_unpack.iter().enumerate().min_by_key(|(_, (node, ..))| place(node))?;
        let (node, size, fetched) = self.to_unpack.remove(best)?;
        self.unpacking += 1;
        Some(Job { node, size, scene: self.scene, kind: JobKind::Unpack(fetched) })
    }

    fn next_reading(&mut self) -> Option<Job> {
        let reader = self.reader.clone()?;
        let (index, wish) = self.find_next()?;
        let is_full = self.jobs >= self.settings.in_flight_nodes.max(1)
            || self.job_bytes + wish.size.stored_bytes > self.settings.in_flight_bytes;
        if self.jobs > 0 && is_full || !self.makes_room(index, true) {
            return None;
        }
        self.under_way.insert(wish.node, wish.size);
        self.jobs += 1;
        self.job_bytes += wish.size.stored_bytes;
        self.reserved_bytes += wish.size.loading_bytes();
        self.note_memory();
        self.stats.most_nodes_in_flight = self.stats.most_nodes_in_flight.max(self.jobs);
        self.stats.nodes_read += 1;
        self.stats.nodes_read_ahead += u64::from(wish.ahead);
        self.stats.nodes_read_again += u64::from(!self.read_before.insert(wish.node));
        Some(Job {
            node: wish.node,
            size: wish.size,
            scene: self.scene,
            kind: JobKind::Fetch(reader),
        })
    }

    /// Notes that a node is to be read again later; `false` if that was done often enough.
    fn tries_again(&mut self, node: SceneNode) -> bool {
        let number = self.retries.get(&node).map_or(0, |retry| retry.number);
        if number >= MOST_RETRIES {
            return false;
        }
        let due = self.now.saturating_add(wait_before(number));
        self.retries.insert(node, Retry { number: number + 1, due });
        self.stats.reads_retried += 1;
        // It may be looked for again.
        self.next = self.place.get(&node).map_or(self.next, |&place| place.min(self.next));
        true
    }

    fn is_to_read(&self, node: SceneNode) -> bool {
        !self.held.contains_key(&node)
            && !self.under_way.contains_key(&node)
            && !self.failed.contains(&node)
            && !self.delivered.contains(&node)
    }

    fn find_next(&mut self) -> Option<(usize, Wish)> {
        let mut index = self.next;
        // Those that wait for another try are passed over, but not for good.
        let mut passes_over = false;
        while let Some(wish) = self.wishes.get(index) {
            let waits = self.retries.get(&wish.node).is_some_and(|retry| retry.due > self.now);
            if self.is_to_read(wish.node) {
                if !waits {
                    return Some((index, *wish));
                }
                passes_over = true;
            }
            index += 1;
            if !passes_over {
                self.next = index;
            }
        }
        None
    }

    /// Drops what must go for a wish (if it is to be `done`), and tells whether there is room then.
    fn makes_room(&mut self, index: usize, done: bool) -> bool {
        let needed_bytes = self.wishes[index].size.loading_bytes();
        let limit_bytes = self.settings.memory_bytes;
        let mut free_bytes = limit_bytes.saturating_sub(self.lru.bytes() + self.reserved_bytes);
        let mut victims = Vec::new();
        // What this list does not want, then what it wants less: from its end.
        let is_unwanted = |&key: &SceneNode| self.lru.last_use(key) < Some(self.list);
        let later = self.wishes[index + 1..].iter().rev().map(|wish| wish.node);
        let is_later = |node: &SceneNode| self.held.contains_key(node) && !is_unwanted(node);
        let later = later.filter(is_later);
        for victim in self.lru.keys().take_while(is_unwanted).chain(later) {
            if free_bytes >= needed_bytes {
                break;
            }
            free_bytes += self.held[&victim].bytes();
            victims.push(victim);
        }
        let is_alone = self.reserved_bytes == 0 && victims.len() == self.held.len();
        let fits = free_bytes >= needed_bytes || is_alone;
        if fits && done {
            victims.into_iter().for_each(|victim| self.drop_words(victim));
        }
        fits
    }

    /// Takes in words that arrived; whether this list wants them now.
    fn keep(&mut self, node: SceneNode, size: NodeSize, words: LoadedNode) -> bool {
        let place = self.place.get(&node).copied();
        // What nobody wants any more leaves before what is wanted.
        let last_use = if place.is_some() { self.list } else { self.list.saturating_sub(1) };
        self.lru.insert(node, words.bytes(), size.depth, last_use);
        self.held.insert(node, Arc::new(words));
        self.note_memory();
        place.is_some_and(|at| !self.wishes[at].ahead)
    }

    fn drop_words(&mut self, node: SceneNode) {
        self.lru.remove(node);
        self.held.remove(&node);
        self.stats.ram_evicted += 1;
    }

    fn release(&mut self, size: NodeSize) {
        self.jobs -= 1;
        self.job_bytes -= size.stored_bytes;
        self.reserved_bytes -= size.loading_bytes();
    }

    fn note_memory(&mut self) {
        let now_bytes = self.lru.bytes() + self.reserved_bytes;
        self.stats.ram_peak_bytes = self.stats.ram_peak_bytes.max(now_bytes);
    }
}
