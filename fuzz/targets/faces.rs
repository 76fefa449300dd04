//! Bytes as `faces`; see `shared.rs`.
#![no_main]

#[path = "../shared.rs"]
mod shared;

libfuzzer_sys::fuzz_target!(init: shared::stay_on_this_thread(), |bytes: &[u8]| {
    shared::run("faces", bytes);
});
