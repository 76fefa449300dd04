//! Bytes back from the device, on demand; the call waits for the GPU.

use std::sync::mpsc;
use std::time::Duration;

use crate::gpu::{Gpu, GpuError};

/// The bytes `offset..offset + size` of a buffer with `COPY_SRC`; both multiples of 4.
pub fn read_buffer(
    gpu: &Gpu,
    buffer: &wgpu::Buffer,
    offset: u64,
    size: u64,
) -> Result<Vec<u8>, GpuError> {
    read_through(gpu, size, |encoder, staging| {
        encoder.copy_buffer_to_buffer(buffer, offset, staging, 0, size);
    })
}

/// All texels of a two-dimensional texture with `COPY_SRC` and 4 bytes per texel, row by row.
pub fn read_texture(gpu: &Gpu, texture: &wgpu::Texture) -> Result<Vec<u8>, GpuError> {
    let (width, height) = (texture.width() as usize, texture.height() as usize);
    let row_bytes = 4 * width;
    let padded_row_bytes = row_bytes.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize);
    let size = (padded_row_bytes * height) as u64;
    let padded = read_through(gpu, size, |encoder, staging| {
        let layout = wgpu::TexelCopyBufferLayout {
            offset: 0,
            bytes_per_row: Some(padded_row_bytes as u32),
            rows_per_image: None,
        };
        encoder.copy_texture_to_buffer(
            texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo { buffer: staging, layout },
            texture.size(),
        );
    })?;
    if padded_row_bytes == row_bytes {
        return Ok(padded);
    }
    Ok(padded.chunks(padded_row_bytes).flat_map(|row| &row[..row_bytes]).copied().collect())
}

/// How long another thread may take to run a callback before the device counts as lost.
const CALLBACK_LIMIT: Duration = Duration::from_secs(10);

fn read_through(
    gpu: &Gpu,
    size: u64,
    copy: impl FnOnce(&mut wgpu::CommandEncoder, &wgpu::Buffer),
) -> Result<Vec<u8>, GpuError> {
    let descriptor = wgpu::BufferDescriptor {
        label: Some("read back"),
        size,
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    };
    let staging = gpu.create_buffer("read back", &descriptor)?;
    gpu.checked("read back", || {
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        copy(&mut encoder, &staging);
        gpu.queue().submit([encoder.finish()]);
    })?;
    let (sender, receiver) = mpsc::channel();
    staging.map_async(wgpu::MapMode::Read, .., move |result| {
        // The receiver stands in the frame below and outlives the wait.
        let _ = sender.send(result);
    });
    gpu.wait()?;
    let lost = |reason: &str| GpuError::Lost { reason: reason.to_owned() };
    // The work is done, but whichever thread polls the device runs the callback: with several, it
    // may be another one that is just about to.
    match receiver.recv_timeout(CALLBACK_LIMIT) {
        Ok(Ok(())) => {}
        Ok(Err(error)) => return Err(lost(&error.to_string())),
        Err(_) => return Err(lost("a read-back never came")),
    }
    let view = staging.get_mapped_range(..).map_err(|error| lost(&error.to_string()))?;
    Ok(view.to_vec())
}
