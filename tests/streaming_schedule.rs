//! What the loader does in which order, followed step by step without threads.
//!
//! A tree of two levels, as the wishes name it (numbers are nodes, all of 100 bytes of words):
//!
//! ```text
//!         0
//!       /   \
//!      1     2
//!     / \   / \
//!    3   4 5   6
//! ```

use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use esker::ids::NodeId;
use esker::store::NodeReadError;
use esker::stream::{
    Fetched, Job, LoadError, LoadedNode, NodeReader, NodeSize, Residency, SceneNode, Schedule,
    StreamSettings, Wish,
};

const WORD_BYTES: u64 = 100;
const STORED_BYTES: u64 = 50;
/// What loading one node takes while it is under way: its bytes, and its words twice.
const LOADING_BYTES: u64 = STORED_BYTES + 2 * WORD_BYTES;

#[derive(Default)]
struct Fake {
    broken: HashSet<u32>,
    panicking: HashSet<u32>,
    /// Reading it times out so often.
    hesitates: Mutex<HashMap<u32, u32>>,
    fetched: Mutex<Vec<u32>>,
}

impl NodeReader for Fake {
    fn fetch(&self, (_, node): SceneNode) -> Result<Box<dyn Fetched>, LoadError> {
        self.fetched.lock().unwrap().push(node.0);
        assert!(!self.panicking.contains(&node.0), "a bug of the reader");
        if self.broken.contains(&node.0) {
            let section = "positions".into();
            return Err(LoadError::Read(NodeReadError::NoSuchSection { section }));
        }
        if let Some(left) = self.hesitates.lock().unwrap().get_mut(&node.0).filter(|n| **n > 0) {
            *left -= 1;
            return Err(LoadError::Read(NodeReadError::Io {
                node,
                level: 0,
                section: "positions".into(),
                source: std::io::ErrorKind::TimedOut.into(),
                start: 0,
                end: 1,
            }));
        }
        let words = vec![node.0; WORD_BYTES as usize / 4];
        Ok(Box::new(LoadedNode { words, position_words: 10 }))
    }
}

fn node(number: u32) -> SceneNode {
    (0, NodeId(number))
}

fn wish(number: u32) -> Wish {
    let depth = (number + 1).ilog2();
    let size = NodeSize { stored_bytes: STORED_BYTES, word_bytes: WORD_BYTES, depth };
    Wish { node: node(number), size, ahead: false }
}

fn ahead(number: u32) -> Wish {
    Wish { ahead: true, ..wish(number) }
}

fn wishes(numbers: &[u32]) -> Vec<Wish> {
    numbers.iter().map(|&number| wish(number)).collect()
}

fn settings(memory_bytes: u64, in_flight_nodes: u32) -> StreamSettings {
    StreamSettings { memory_bytes, in_flight_nodes, ..StreamSettings::default() }
}

fn schedule(reader: &Arc<Fake>, settings: StreamSettings) -> Schedule {
    let mut schedule = Schedule::new(settings);
    schedule.set_reader(reader.clone());
    schedule
}

/// Jobs as far as they come without any being finished.
fn begin_all(schedule: &mut Schedule) -> Vec<Job> {
    std::iter::from_fn(|| schedule.next_job()).collect()
}

/// Works until nothing is left to do.
fn settle(schedule: &mut Schedule) {
    while let Some(job) = schedule.next_job() {
        schedule.finish(job.run());
    }
    assert!(schedule.is_idle());
}

fn numbers(nodes: &[(SceneNode, Arc<LoadedNode>)]) -> Vec<u32> {
    nodes.iter().map(|((_, node), _)| node.0).collect()
}

fn take_all(schedule: &mut Schedule) -> Vec<u32> {
    numbers(&schedule.deliver(u64::MAX, |_| true))
}

#[test]
fn the_best_come_first_and_a_new_list_takes_the_place_of_the_old() {
    let reader = Arc::new(Fake::default());
    let mut schedule = schedule(&reader, settings(1 << 20, 2));
    schedule.replace(wishes(&[0, 1, 2, 3]));
    let under_way = begin_all(&mut schedule);
    assert_eq!(under_way.iter().map(|job| job.node().1.0).collect::<Vec<_>>(), [0, 1]);
    assert_eq!(schedule.residency(node(0)), Residency::Reading);
    assert_eq!(schedule.residency(node(2)), Residency::Queued);

    // The camera turned: 2 and 3 are no longer wanted, 1 is, and it is not read twice.
    schedule.replace(wishes(&[6, 1]));
    assert_eq!(schedule.residency(node(2)), Residency::Absent);
    for job in under_way {
        schedule.finish(job.run());
    }
    settle(&mut schedule);
    assert_eq!(*reader.fetched.lock().unwrap(), [0, 1, 6]);
    assert_eq!(take_all(&mut schedule), [6, 1], "in the order of the list");
    assert!(take_all(&mut schedule).is_empty(), "only once");
    assert_eq!(schedule.residency(node(0)), Residency::InRam, "what came is kept");
    assert_eq!(schedule.residency(node(3)), Residency::Absent);

    // What is kept is there at once when it is wanted again.
    schedule.replace(wishes(&[0]));
    assert!(schedule.next_job().is_none());
    assert_eq!(take_all(&mut schedule), [0]);
    let stats = schedule.stats();
    assert_eq!((stats.nodes_read, stats.nodes_read_again, stats.ram_hits), (3, 0, 1));
}

#[test]
fn what_is_under_way_stays_within_its_limits() {
    let reader = Arc::new(Fake::default());
    let by_count = settings(1 << 20, 3);
    let by_bytes = StreamSettings { in_flight_bytes: 4 * STORED_BYTES, ..settings(1 << 20, 8) };
    let none_fits = StreamSettings { in_flight_bytes: 1, ..settings(1 << 20, 8) };
    for (settings, expected) in [(by_count, 3), (by_bytes, 4), (none_fits, 1)] {
        let mut schedule = schedule(&reader, settings);
        schedule.replace(wishes(&[0, 1, 2, 3, 4, 5, 6]));
        let jobs = begin_all(&mut schedule);
        assert_eq!(jobs.len(), expected);
        assert_eq!(schedule.stats().nodes_in_flight, expected as u32);
        assert_eq!(schedule.stats().in_flight_bytes, expected as u64 * STORED_BYTES);
        // A node that was read but not unpacked is still under way.
        let mut jobs = jobs.into_iter();
        schedule.finish(jobs.next().expect("one").run());
        let next = schedule.next_job().expect("its unpacking");
        assert!(!next.reads() && next.node() == node(0));
        assert!(schedule.next_job().is_none(), "no room for another");
        schedule.finish(next.run());
        assert!(schedule.next_job().expect("now there is").reads());
    }
}

#[test]
fn no_more_are_unpacked_at_once_than_allowed_and_the_best_first() {
    let reader = Arc::new(Fake::default());
    let settings = StreamSettings { unpacking_nodes: 1, ..settings(1 << 20, 3) };
    let mut schedule = schedule(&reader, settings);
    schedule.replace(wishes(&[2, 5, 6]));
    let reading = begin_all(&mut schedule);
    // They come in another order than they were asked for.
    for job in reading.into_iter().rev() {
        schedule.finish(job.run());
    }
    let unpacking = begin_all(&mut schedule);
    assert_eq!(unpacking.iter().map(|job| job.node().1.0).collect::<Vec<_>>(), [2]);
}

#[test]
fn a_quota_gives_at_least_one_and_respects_who_may_go() {
    let reader = Arc::new(Fake::default());
    let mut schedule = schedule(&reader, settings(1 << 20, 8));
    schedule.replace(wishes(&[0, 1, 2, 3, 4]));
    settle(&mut schedule);
    assert_eq!(numbers(&schedule.deliver(1, |_| true)), [0]);
    assert_eq!(numbers(&schedule.deliver(2 * WORD_BYTES, |_| true)), [1, 2]);
    // A child waits for its parent.
    assert_eq!(numbers(&schedule.deliver(u64::MAX, |(_, node)| node.0 != 3)), [4]);
    assert_eq!(numbers(&schedule.deliver(u64::MAX, |_| true)), [3]);
}

/// The limit of main memory holds at each step, whatever is wanted; what is wanted now is not
/// dropped for what is wanted less.
#[test]
fn main_memory_stays_below_its_limit() {
    let reader = Arc::new(Fake::default());
    let limit = 2 * LOADING_BYTES + 3 * WORD_BYTES;
    let mut schedule = schedule(&reader, settings(limit, 2));
    let check = |schedule: &Schedule| {
        let stats = schedule.stats();
        assert!(stats.ram_peak_bytes <= limit, "{stats:?}");
    };
    schedule.replace(wishes(&[0, 1, 2, 3, 4, 5, 6]));
    settle(&mut schedule);
    check(&schedule);
    // The best fill the memory; the others wait for room instead of pushing them out.
    let fetched = reader.fetched.lock().unwrap().clone();
    assert_eq!(fetched, (0..fetched.len() as u32).collect::<Vec<_>>());
    assert!(fetched.len() >= 4 && fetched.len() < 7, "{fetched:?}");
    assert_eq!(schedule.stats().ram_evicted, 0);
    let first = take_all(&mut schedule);
    assert_eq!(first, fetched);

    // Once the frame has them the rest may come, in place of the longest unused.
    let rest: Vec<u32> = (fetched.len() as u32..7).collect();
    schedule.replace(wishes(&rest));
    settle(&mut schedule);
    check(&schedule);
    assert_eq!(take_all(&mut schedule), rest);
    assert!(schedule.stats().ram_evicted > 0);
    assert_eq!(schedule.stats().nodes_read_again, 0);

    // Something better comes while all that is held is still wanted: the last of the list goes.
    schedule.replace(wishes(&[10, 4, 5, 6]));
    settle(&mut schedule);
    check(&schedule);
    assert_eq!(schedule.residency(node(10)), Residency::InRam);
    assert!(take_all(&mut schedule).starts_with(&[10]));
}

/// A memory that is smaller than one node still serves one at a time.
#[test]
fn a_node_larger_than_memory_is_loaded_alone() {
    let reader = Arc::new(Fake::default());
    for limit in [0, 1, WORD_BYTES] {
        let mut schedule = schedule(&reader, settings(limit, 4));
        schedule.replace(wishes(&[0, 1, 2]));
        let mut seen = Vec::new();
        for _ in 0..3 {
            while let Some(job) = schedule.next_job() {
                assert!(schedule.stats().nodes_in_flight <= 1);
                schedule.finish(job.run());
            }
            let got = take_all(&mut schedule);
            assert_eq!(got.len(), 1);
            seen.extend(got);
            let left: Vec<u32> = (0..3).filter(|number| !seen.contains(number)).collect();
            schedule.replace(wishes(&left));
        }
        assert_eq!(seen, [0, 1, 2]);
    }
}

#[test]
fn what_is_read_ahead_comes_last_and_waits() {
    let reader = Arc::new(Fake::default());
    let mut schedule = schedule(&reader, settings(1 << 20, 1));
    let mut list = wishes(&[0, 1]);
    list.extend([ahead(5), ahead(6)]);
    schedule.replace(list);
    settle(&mut schedule);
    assert_eq!(*reader.fetched.lock().unwrap(), [0, 1, 5, 6]);
    assert_eq!(take_all(&mut schedule), [0, 1], "nothing of what is ahead");
    assert_eq!(schedule.stats().nodes_read_ahead, 2);
    schedule.replace(wishes(&[5]));
    assert_eq!(take_all(&mut schedule), [5]);
    assert_eq!(schedule.stats().ram_hits, 1);
}

#[test]
fn a_node_that_fails_is_told_once_and_not_tried_again() {
    let broken = HashSet::from([1]);
    let panicking = HashSet::from([2]);
    let reader = Arc::new(Fake { broken, panicking, ..Fake::default() });
    let mut schedule = schedule(&reader, settings(1 << 20, 2));
    for _ in 0..3 {
        schedule.replace(wishes(&[0, 1, 2, 3]));
        settle(&mut schedule);
    }
    assert_eq!(take_all(&mut schedule), [0, 3]);
    let failures = schedule.take_failures();
    assert_eq!(failures.iter().map(|((_, node), _)| node.0).collect::<Vec<_>>(), [1, 2]);
    assert!(failures[1].1.to_string().contains("a bug of the reader"), "{}", failures[1].1);
    assert!(schedule.take_failures().is_empty());
    assert_eq!(schedule.residency(node(1)), Residency::Failed);
    assert_eq!(*reader.fetched.lock().unwrap(), [0, 1, 2, 3]);
    assert_eq!(schedule.stats().ram_bytes, 2 * WORD_BYTES, "nothing is kept free for them");
}

/// A read that times out is tried again after 50 ms, 100 ms and so on, four times; meanwhile all
/// else goes on, and a new list does not make it forget.
#[test]
fn a_read_that_times_out_waits_for_another_try() {
    let reader = Arc::new(Fake::default());
    reader.hesitates.lock().unwrap().extend([(1, 2), (2, 99)]);
    let mut schedule = schedule(&reader, settings(1 << 20, 2));
    let read_at = |schedule: &mut Schedule, ms: u64| {
        schedule.set_time(Duration::from_millis(ms));
        while let Some(job) = schedule.next_job() {
            schedule.finish(job.run());
        }
        std::mem::take(&mut *reader.fetched.lock().unwrap())
    };
    schedule.replace(wishes(&[1, 0, 2, 3]));
    assert_eq!(read_at(&mut schedule, 1_000), [1, 0, 2, 3]);
    assert_eq!(schedule.next_retry(), Some(Duration::from_millis(50)));
    assert!(!schedule.is_idle() && schedule.take_failures().is_empty());
    assert_eq!(schedule.residency(node(1)), Residency::Queued);
    assert_eq!(schedule.stats().ram_bytes, 2 * WORD_BYTES, "nothing is kept free for them");
    assert_eq!(read_at(&mut schedule, 1_049), [0u32; 0], "too early");
    assert_eq!(read_at(&mut schedule, 1_050), [1, 2]);
    schedule.replace(wishes(&[2, 1]));
    assert_eq!(read_at(&mut schedule, 1_100), [0u32; 0]);
    assert_eq!(schedule.next_retry(), Some(Duration::from_millis(50)));
    assert_eq!(read_at(&mut schedule, 1_150), [2, 1]);
    assert_eq!(take_all(&mut schedule), [1], "it answered in the end");
    assert_eq!(read_at(&mut schedule, 1_350), [2]);
    assert!(schedule.take_failures().is_empty());
    assert_eq!(read_at(&mut schedule, 1_750), [2], "the fourth and last");
    let failures = schedule.take_failures();
    assert_eq!(failures.len(), 1);
    assert!(failures[0].1.to_string().contains("timed out"), "{}", failures[0].1);
    assert_eq!(schedule.residency(node(2)), Residency::Failed);
    assert_eq!((schedule.next_retry(), schedule.is_idle()), (None, true));
    // Twice for one, four times for the other.
    assert_eq!(schedule.stats().reads_retried, 6);
}

/// What is under way for one scene does not end up in the next, and its room is free again.
#[test]
fn a_new_scene_forgets_the_old_one() {
    let (old, new) = (Arc::new(Fake::default()), Arc::new(Fake::default()));
    let mut schedule = schedule(&old, settings(1 << 20, 3));
    schedule.replace(wishes(&[0, 1, 2]));
    let mut reading = begin_all(&mut schedule).into_iter();
    schedule.finish(reading.next().expect("three").run());
    let unpacking = schedule.next_job().expect("of the first");
    schedule.finish(reading.next().expect("three").run());

    schedule.set_reader(new.clone());
    schedule.replace(wishes(&[0]));
    schedule.finish(unpacking.run());
    schedule.finish(reading.next().expect("three").run());
    assert!(take_all(&mut schedule).is_empty());
    settle(&mut schedule);
    assert_eq!(take_all(&mut schedule), [0]);
    assert_eq!(*new.fetched.lock().unwrap(), [0]);
    let stats = schedule.stats();
    assert_eq!((stats.ram_bytes, stats.in_flight_bytes), (WORD_BYTES, 0), "{stats:?}");
}

#[test]
fn memory_shrinks_when_told() {
    let reader = Arc::new(Fake::default());
    let mut schedule = schedule(&reader, settings(1 << 20, 2));
    schedule.replace(wishes(&[0, 1, 2, 3]));
    settle(&mut schedule);
    schedule.replace(wishes(&[0]));
    schedule.shrink(2 * WORD_BYTES);
    assert_eq!(schedule.stats().ram_bytes, 2 * WORD_BYTES);
    assert_eq!(schedule.residency(node(0)), Residency::InRam, "what is wanted stays longest");
}
