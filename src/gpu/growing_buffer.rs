//! A buffer that is written anew each frame and grows when the frame does.

use crate::gpu::{Gpu, GpuError, HeldBuffer};

/// A buffer of bytes that the CPU writes and shaders read.
#[derive(Debug)]
pub struct GrowingBuffer {
    label: &'static str,
    usage: wgpu::BufferUsages,
    buffer: Option<HeldBuffer>,
}

impl GrowingBuffer {
    /// Holds nothing until something is written.
    pub fn new(label: &'static str, usage: wgpu::BufferUsages) -> Self {
        GrowingBuffer { label, usage, buffer: None }
    }

    /// Makes room for at least `bytes`, rounded up so that growth is rare. Contents are lost when
    /// the buffer moves.
    pub fn reserve(&mut self, gpu: &Gpu, bytes: u64) -> Result<&wgpu::Buffer, GpuError> {
        if self.buffer.as_ref().is_none_or(|buffer| buffer.size() < bytes) {
            // The smaller buffer goes first: both may not fit.
            self.buffer = None;
            let size = bytes.next_power_of_two().max(256);
            let limit = gpu.device().limits().max_buffer_size;
            let descriptor = wgpu::BufferDescriptor {
                label: Some(self.label),
                size: if size > limit { bytes } else { size },
                usage: self.usage | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            };
            self.buffer = Some(gpu.create_buffer("hold a frame's tables", &descriptor)?);
        }
        Ok(self.buffer.as_ref().expect("it was just made"))
    }

    /// Writes values from the start on; they are there when the next submission runs.
    pub fn write<T: bytemuck::NoUninit>(
        &mut self,
        gpu: &Gpu,
        values: &[T],
    ) -> Result<&wgpu::Buffer, GpuError> {
        let bytes: &[u8] = bytemuck::cast_slice(values);
        let buffer = self.reserve(gpu, bytes.len() as u64)?;
        gpu.queue().write_buffer(buffer, 0, bytes);
        Ok(buffer)
    }

    /// The buffer, if anything was ever written.
    pub fn get(&self) -> Option<&wgpu::Buffer> {
        self.buffer.as_deref()
    }

    /// Bytes held.
    pub fn held_bytes(&self) -> u64 {
        self.buffer.as_ref().map_or(0, |buffer| buffer.size())
    }
}
