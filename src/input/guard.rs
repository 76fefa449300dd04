//! A fence around code of others that panics on bad input.
//!
//! The crate `laz` decodes trusting its input: a damaged chunk may end in an index out of bounds
//! or, with overflow checks, in an arithmetic panic. Behind this fence that becomes a value, and
//! nothing is printed. It is not for panics of our own.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Once;

thread_local! {
    static FENCED: Cell<bool> = const { Cell::new(false) };
}

/// Runs `work`; a panic in it becomes an error with the panic's message.
///
/// What `work` changed before it panicked must not be used afterwards, except for plain counters.
pub fn without_panic<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let previous = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |panic| {
            if !FENCED.get() {
                previous(panic);
            }
        }));
    });
    let outer = FENCED.replace(true);
    let result = catch_unwind(AssertUnwindSafe(work));
    FENCED.set(outer);
    result.map_err(|payload| {
        let text = payload.downcast_ref::<&str>().map(|text| (*text).to_string());
        let text = text.or_else(|| payload.downcast_ref::<String>().cloned());
        text.unwrap_or_else(|| "no message".to_string())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_its_message_and_the_fence_comes_down() {
        assert_eq!(without_panic(|| 7), Ok(7));
        assert_eq!(without_panic(|| -> u8 { panic!("seven") }), Err("seven".to_string()));
        let three = 3;
        assert_eq!(without_panic(|| -> u8 { panic!("{three}") }), Err("3".to_string()));
        assert!(!FENCED.get());
    }
}
