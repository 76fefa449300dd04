//! Processor time of this process: what a piece of work took, whatever else the machine did.

use std::fs;

/// Time that all threads of this process spent on processors so far, milliseconds; none where the
/// system does not tell. Threads that have ended do not count.
pub fn processor_ms() -> Option<f64> {
    let tasks = fs::read_dir("/proc/self/task").ok()?;
    let nanoseconds = tasks.filter_map(|task| {
        let text = fs::read_to_string(task.ok()?.path().join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse::<u64>().ok()
    });
    let total: u64 = nanoseconds.sum();
    (total > 0).then_some(total as f64 * 1e-6)
}
