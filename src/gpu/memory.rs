//! How much memory of the device is held, and a limit to it.
//!
//! Buffers and textures that grow with scenes and pictures are made here, so that what is held is
//! known and running out is the same error whether the driver says so or a limit does. Small ones
//! of fixed size are not counted.

use std::ops::Deref;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::gpu::{Gpu, GpuError};

/// Bytes held on one device, and how many may be.
#[derive(Debug)]
pub(super) struct Account {
    held_bytes: AtomicU64,
    limit_bytes: AtomicU64,
}

impl Default for Account {
    fn default() -> Self {
        Account { held_bytes: AtomicU64::new(0), limit_bytes: AtomicU64::new(u64::MAX) }
    }
}

/// Bytes of a device's memory, given back when this is dropped.
#[derive(Debug)]
pub struct HeldBytes {
    bytes: u64,
    account: Arc<Account>,
}

impl Drop for HeldBytes {
    fn drop(&mut self) {
        self.account.held_bytes.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

/// A buffer whose bytes are counted.
#[derive(Debug)]
pub struct HeldBuffer {
    buffer: wgpu::Buffer,
    _bytes: HeldBytes,
}

impl Deref for HeldBuffer {
    type Target = wgpu::Buffer;

    fn deref(&self) -> &wgpu::Buffer {
        &self.buffer
    }
}

impl Gpu {
    /// Refuses to hold more than so many bytes from now on, as a device with less memory would;
    /// what is held already stays.
    pub fn limit_memory(&self, limit_bytes: u64) {
        self.account().limit_bytes.store(limit_bytes, Ordering::Relaxed);
    }

    /// Bytes that are held in buffers and pictures.
    pub fn held_bytes(&self) -> u64 {
        self.account().held_bytes.load(Ordering::Relaxed)
    }

    /// Counts bytes that are about to be held.
    pub fn hold(&self, doing: &'static str, bytes: u64) -> Result<HeldBytes, GpuError> {
        let account = self.account().clone();
        let before = account.held_bytes.fetch_add(bytes, Ordering::Relaxed);
        let held = HeldBytes { bytes, account };
        let limit_bytes = held.account.limit_bytes.load(Ordering::Relaxed);
        match before.saturating_add(bytes) > limit_bytes {
            true => Err(GpuError::OutOfMemory { doing }),
            false => Ok(held),
        }
    }

    /// Makes a buffer.
    pub fn create_buffer(
        &self,
        doing: &'static str,
        descriptor: &wgpu::BufferDescriptor,
    ) -> Result<HeldBuffer, GpuError> {
        let bytes = self.hold(doing, descriptor.size)?;
        let buffer = self.checked(doing, || self.device().create_buffer(descriptor))?;
        Ok(HeldBuffer { buffer, _bytes: bytes })
    }
}
