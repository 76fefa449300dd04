//! Numbered pieces of work on all threads, handed out in order.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use crate::build::BuildError;

/// Runs `step` for every number below `count`, each of `workers` with a state of its own, and `finish`
/// for each state.
///
/// Of several errors the one of the smallest number is returned, whatever the number of threads.
pub fn for_each_in_order<S: Send>(
    count: usize,
    workers: usize,
    cancelled: &AtomicBool,
    begin: impl Fn() -> S + Sync,
    step: impl Fn(&mut S, usize) -> Result<(), BuildError> + Sync,
    finish: impl Fn(S) -> Result<(), BuildError> + Sync,
) -> Result<(), BuildError> {
    let next = AtomicUsize::new(0);
    let failed = AtomicUsize::new(usize::MAX);
    let failure: Mutex<Option<(usize, BuildError)>> = Mutex::new(None);
    let fail = |number: usize, error: BuildError| {
        failed.fetch_min(number, Ordering::Relaxed);
        let mut failure = failure.lock().expect("no holder of the lock panics");
        if failure.as_ref().is_none_or(|(earlier, _)| number < *earlier) {
            *failure = Some((number, error));
        }
    };
    let work = || {
        let mut state = begin();
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= count || number > failed.load(Ordering::Relaxed) {
                break;
            }
            if cancelled.load(Ordering::Relaxed) {
                return fail(number, BuildError::Interrupted);
            }
            if let Err(error) = step(&mut state, number) {
                return fail(number, error);
            }
        }
        if let Err(error) = finish(state) {
            fail(count, error);
        }
    };
    rayon::scope(|scope| {
        for _ in 1..workers.min(count) {
            scope.spawn(|_| work());
        }
        work();
    });
    match failure.into_inner().expect("no holder of the lock panics") {
        Some((_, error)) => Err(error),
        None => Ok(()),
    }
}
