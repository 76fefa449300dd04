//! Time of each pass by the GPU's own clock.
//!
//! Results come frames later and are never waited for, unless asked. Without timestamp queries
//! nothing is measured and nothing is held.

use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use crate::gpu::{Gpu, GpuError};

/// Most passes of a frame that are timed.
const MAX_PASSES: u32 = 8;
const RESULT_BYTES: u64 = 2 * 8 * MAX_PASSES as u64;

/// Milliseconds per pass, in the order of the frame.
pub type PassTimes = Vec<(&'static str, f64)>;

const IDLE: u8 = 0;
const IN_FLIGHT: u8 = 1;
const MAPPED: u8 = 2;
const FAILED: u8 = 3;

/// Queries for the passes of one frame at a time.
#[derive(Debug)]
pub struct PassTimer {
    queries: Option<Queries>,
    passes: Vec<&'static str>,
    latest: PassTimes,
}

#[derive(Debug)]
struct Queries {
    set: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    staging: wgpu::Buffer,
    state: Arc<AtomicU8>,
    measured: Mutex<Vec<&'static str>>,
    period_ns: f64,
}

impl PassTimer {
    /// A timer; it measures nothing where the device has no timestamps.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let queries = match gpu.has_timestamps() {
            true => Some(gpu.checked("create timestamp queries", || Queries::new(gpu))?),
            false => None,
        };
        Ok(PassTimer { queries, passes: Vec::new(), latest: Vec::new() })
    }

    /// Starts a frame: collects results that have arrived.
    pub fn begin_frame(&mut self) {
        self.collect();
        self.passes.clear();
    }

    /// The timestamps of a compute pass named `pass`.
    pub fn compute_pass(
        &mut self,
        pass: &'static str,
    ) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        let (query_set, first) = self.next(pass)?;
        Some(wgpu::ComputePassTimestampWrites {
            query_set,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        })
    }

    /// The timestamps of a render pass named `pass`.
    pub fn render_pass(
        &mut self,
        pass: &'static str,
    ) -> Option<wgpu::RenderPassTimestampWrites<'_>> {
        let (query_set, first) = self.next(pass)?;
        Some(wgpu::RenderPassTimestampWrites {
            query_set,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        })
    }

    /// Ends the frame's commands: copies the timestamps out, unless older ones are on their way.
    pub fn end_frame(&mut self, encoder: &mut wgpu::CommandEncoder) {
        let Some(queries) = &self.queries else { return };
        if self.passes.is_empty() || queries.state.load(Ordering::Acquire) != IDLE {
            return;
        }
        encoder.resolve_query_set(
            &queries.set,
            0..2 * self.passes.len() as u32,
            &queries.resolved,
            0,
        );
        encoder.copy_buffer_to_buffer(&queries.resolved, 0, &queries.staging, 0, RESULT_BYTES);
        *queries.measured.lock().unwrap_or_else(PoisonError::into_inner) = self.passes.clone();
    }

    /// After the frame was submitted: asks for the results.
    pub fn after_submit(&mut self) {
        let Some(queries) = &self.queries else { return };
        let idle = queries.state.load(Ordering::Acquire) == IDLE;
        if self.passes.is_empty() || !idle {
            return;
        }
        queries.state.store(IN_FLIGHT, Ordering::Release);
        let state = queries.state.clone();
        queries.staging.map_async(wgpu::MapMode::Read, .., move |result| {
            state.store(if result.is_ok() { MAPPED } else { FAILED }, Ordering::Release);
        });
    }

    /// Takes in results that have arrived and returns the latest, of this or an earlier frame.
    pub fn collect(&mut self) -> &PassTimes {
        if let Some(queries) = &self.queries
            && queries.state.load(Ordering::Acquire) == MAPPED
        {
            if let Ok(view) = queries.staging.get_mapped_range(..) {
                let ticks: &[u64] = bytemuck::cast_slice(&view);
                let measured = queries.measured.lock().unwrap_or_else(PoisonError::into_inner);
                let pass_ms = |pair: &[u64]| {
                    pair[1].saturating_sub(pair[0]) as f64 * queries.period_ns * 1e-6
                };
                let times = ticks.chunks(2).map(pass_ms);
                self.latest = measured.iter().copied().zip(times).collect();
            }
            queries.staging.unmap();
            queries.state.store(IDLE, Ordering::Release);
        }
        &self.latest
    }

    fn next(&mut self, pass: &'static str) -> Option<(&wgpu::QuerySet, u32)> {
        let queries = self.queries.as_ref()?;
        let index = self.passes.len() as u32;
        if index == MAX_PASSES {
            return None;
        }
        self.passes.push(pass);
        Some((&queries.set, 2 * index))
    }
}

impl Queries {
    fn new(gpu: &Gpu) -> Self {
        let buffer = |label, usage| {
            gpu.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: RESULT_BYTES,
                usage,
                mapped_at_creation: false,
            })
        };
        Queries {
            set: gpu.device().create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("pass times"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * MAX_PASSES,
            }),
            resolved: buffer(
                "pass times",
                wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            ),
            staging: buffer(
                "pass times, read back",
                wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            ),
            state: Arc::default(),
            measured: Mutex::default(),
            period_ns: f64::from(gpu.queue().get_timestamp_period()),
        }
    }
}
