//! How fast the device copies: the measure of passes that are bound by memory.

use std::time::Instant;

use crate::gpu::{Gpu, GpuError};

/// Copies whose best counts.
const TIMES: usize = 5;

/// Bytes per second that a copy of `bytes` between two buffers reads; it writes as many.
pub fn copy_bandwidth(gpu: &Gpu, bytes: u64) -> Result<f64, GpuError> {
    let buffer = |usage| {
        gpu.checked("hold the bytes that are copied", || {
            gpu.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some("copied"),
                size: bytes,
                usage: usage | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        })
    };
    let (from, to) = (buffer(wgpu::BufferUsages::COPY_SRC)?, buffer(wgpu::BufferUsages::empty())?);
    let mut least = f64::INFINITY;
    for _ in 0..TIMES {
        let start = Instant::now();
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(&from, 0, &to, 0, bytes);
        gpu.queue().submit([encoder.finish()]);
        gpu.wait()?;
        least = least.min(start.elapsed().as_secs_f64());
    }
    Ok(bytes as f64 / least)
}
