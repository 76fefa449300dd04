//! Numbered pieces of work on all threads, handed out in order.

use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

use crate::build::BuildError;

/// Runs `step` for the numbers of a range, on as many threads as there are states, each with one.
/// After `until`, no more numbers are handed out but one to each.
///
/// Returns the first number that was not run; all before it were. Of several errors the one of
/// the smallest number is returned, whatever the number of threads.
pub fn run_in_order<S: Send>(
    numbers: Range<usize>,
    until: Option<Instant>,
    cancelled: &AtomicBool,
    states: &mut [S],
    step: impl Fn(&mut S, usize) -> Result<(), BuildError> + Sync,
) -> Result<usize, BuildError> {
    let next = AtomicUsize::new(numbers.start);
    let failed = AtomicUsize::new(usize::MAX);
    let failure: Mutex<Option<(usize, BuildError)>> = Mutex::new(None);
    let fail = |number: usize, error: BuildError| {
        failed.fetch_min(number, Ordering::Relaxed);
        let mut failure = failure.lock().expect("no holder of the lock panics");
        if failure.as_ref().is_none_or(|(earlier, _)| number < *earlier) {
            *failure = Some((number, error));
        }
    };
    let work = |state: &mut S| {
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= numbers.end || number > failed.load(Ordering::Relaxed) {
                break;
            }
            if cancelled.load(Ordering::Relaxed) {
                return fail(number, BuildError::Interrupted);
            }
            if let Err(error) = step(state, number) {
                return fail(number, error);
            }
            if until.is_some_and(|until| Instant::now() >= until) {
                break;
            }
        }
    };
    rayon::scope(|scope| {
        let (first, others) = states.split_first_mut().expect("there is a worker");
        let count = numbers.len();
        for state in others.iter_mut().take(count.saturating_sub(1)) {
            let work = &work;
            scope.spawn(move |_| work(state));
        }
        work(first);
    });
    match failure.into_inner().expect("no holder of the lock panics") {
        Some((_, error)) => Err(error),
        None => Ok(next.into_inner().min(numbers.end)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_runs_once_and_pauses_are_clean() {
        let cancelled = AtomicBool::new(false);
        for workers in [1, 3] {
            let ran = Mutex::new(vec![0; 50]);
            let mut states = vec![0; workers];
            let mut next = 0;
            let mut pauses = 0;
            while next < 50 {
                let until = Some(Instant::now());
                next = run_in_order(next..50, until, &cancelled, &mut states, |state, i| {
                    *state += 1;
                    ran.lock().expect("it is whole")[i] += 1;
                    Ok(())
                })
                .expect("nothing fails");
                let ran = ran.lock().expect("it is whole");
                assert!(ran[..next].iter().all(|&n| n == 1) && ran[next..].iter().all(|&n| n == 0));
                pauses += 1;
            }
            assert!(pauses >= 50 / workers);
            assert_eq!(states.iter().sum::<i32>(), 50);
        }
    }

    #[test]
    fn the_earliest_failure_is_told() {
        let cancelled = AtomicBool::new(false);
        let outcome = run_in_order(0..40, None, &cancelled, &mut [(); 4], |(), i| {
            if i == 7 || i == 23 { Err(BuildError::Changed) } else { Ok(()) }
        });
        assert!(matches!(outcome, Err(BuildError::Changed)));
    }
}
