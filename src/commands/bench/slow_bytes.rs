//! A store's bytes as a slower disk or a network would bring them.
//!
//! Each read waits for its delay, as many at once as there are readers; the bytes of all reads
//! share one bandwidth, one read after the other. The file itself is read first, so what the
//! machine's own disk takes comes on top.

use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use crate::store::StoreBytes;

/// How slow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disk {
    /// Its name in tables.
    pub name: &'static str,
    /// Time until the first byte of each read.
    pub delay: Duration,
    /// Bytes per second of all reads together; infinite for no limit.
    pub bytes_per_second: f64,
}

impl Disk {
    /// The machine's own.
    pub const LOCAL: Disk =
        Disk { name: "local", delay: Duration::ZERO, bytes_per_second: f64::INFINITY };
    /// A spinning disk.
    pub const SPINNING: Disk =
        Disk { name: "8 ms, 150 MB/s", delay: Duration::from_millis(8), bytes_per_second: 150e6 };
    /// A server at the other end of a line.
    pub const DISTANT: Disk =
        Disk { name: "50 ms, 25 MB/s", delay: Duration::from_millis(50), bytes_per_second: 25e6 };

    /// The least time in which `reads` reads of `bytes` together can be done, `readers` at once.
    pub fn least_seconds(&self, reads: u64, bytes: u64, readers: u32) -> f64 {
        let waits = reads.div_ceil(u64::from(readers.max(1))) as f64 * self.delay.as_secs_f64();
        waits.max(bytes as f64 / self.bytes_per_second + self.delay.as_secs_f64())
    }
}

/// A file behind such a disk.
#[derive(Debug)]
pub struct SlowBytes {
    file: File,
    disk: Disk,
    /// When the line is free again.
    free_at: Mutex<Instant>,
}

impl SlowBytes {
    /// Opens a file.
    pub fn open(path: &Path, disk: Disk) -> io::Result<SlowBytes> {
        Ok(SlowBytes { file: File::open(path)?, disk, free_at: Mutex::new(Instant::now()) })
    }
}

impl StoreBytes for SlowBytes {
    fn byte_count(&self) -> io::Result<u64> {
        self.file.byte_count()
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        self.file.read_exact_at(buffer, offset)?;
        if self.disk == Disk::LOCAL {
            return Ok(());
        }
        let takes = Duration::from_secs_f64(buffer.len() as f64 / self.disk.bytes_per_second);
        let arrives = {
            let mut free_at = self.free_at.lock().unwrap_or_else(PoisonError::into_inner);
            *free_at = (*free_at).max(Instant::now() + self.disk.delay) + takes;
            *free_at
        };
        std::thread::sleep(arrives.saturating_duration_since(Instant::now()));
        Ok(())
    }
}
