//! Bytes as `e57`; see `shared.rs`.
#![no_main]

#[path = "../shared.rs"]
mod shared;

libfuzzer_sys::fuzz_target!(init: shared::stay_on_this_thread(), |bytes: &[u8]| {
    shared::run("e57", bytes);
});
