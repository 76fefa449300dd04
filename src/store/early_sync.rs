//! Brings a growing file to disk while it is still being written, so that little is left to wait
//! for at the end.

use std::fs::File;
use std::io;
use std::thread::JoinHandle;

/// So many new bytes are worth a call.
const STEP_BYTES: u64 = 16 << 20;

/// At most one thread at a time, which ends when what was written before it began is on disk.
#[derive(Default)]
pub(super) struct EarlySync {
    new_bytes: u64,
    thread: Option<JoinHandle<io::Result<()>>>,
}

impl EarlySync {
    /// Hears of bytes that were written. Fails if those before could not be brought to disk: the
    /// system tells that once only.
    pub fn wrote(&mut self, file: &File, bytes: u64) -> io::Result<()> {
        self.new_bytes += bytes;
        if self.new_bytes < STEP_BYTES || self.thread.as_ref().is_some_and(|t| !t.is_finished()) {
            return Ok(());
        }
        self.finish()?;
        self.new_bytes = 0;
        let file = file.try_clone()?;
        let begun = std::thread::Builder::new().spawn(move || file.sync_data());
        // Without a thread everything waits for the end.
        self.thread = begun.ok();
        Ok(())
    }

    /// Waits for the thread, if there is one.
    pub fn finish(&mut self) -> io::Result<()> {
        let Some(thread) = self.thread.take() else { return Ok(()) };
        thread.join().unwrap_or_else(|_| Err(io::Error::other("bringing it to disk failed")))
    }
}
