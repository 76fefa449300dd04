//! Time of each pass by the GPU's own clock.
//!
//! Results come frames later and are never waited for: a few read-backs are under way at a time,
//! and a frame that finds none free goes unmeasured. Without timestamp queries nothing is measured
//! and nothing is held.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use crate::gpu::{Gpu, GpuError};

/// Most passes of a frame that are timed.
const MAX_PASSES: u32 = 16;
const RESULT_BYTES: u64 = 2 * 8 * MAX_PASSES as u64;
/// Read-backs that may be under way.
const READ_BACKS: usize = 4;
/// Measured frames that wait to be taken.
const MAX_WAITING: usize = 16;
/// Spans that are longer tell of a clock that was set or stopped, not of a pass.
const LONGEST_MS: f64 = 10_000.0;

/// Milliseconds per pass, in the order of the frame.
pub type PassTimes = Vec<(&'static str, f64)>;

/// The passes of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredFrame {
    /// Its number, as [`PassTimer::frame`] told it.
    pub frame: u64,
    /// Its passes.
    pub passes: PassTimes,
    /// The alternative that was chosen in the middle of it, if there was a choice.
    pub choice: Option<u32>,
}

const IDLE: u8 = 0;
const IN_FLIGHT: u8 = 1;
const MAPPED: u8 = 2;
const FAILED: u8 = 3;

/// Queries for the passes of a frame.
#[derive(Debug)]
pub struct PassTimer {
    queries: Option<Queries>,
    passes: Vec<&'static str>,
    frame: u64,
    latest: PassTimes,
    measured: VecDeque<MeasuredFrame>,
    rejected: u64,
    /// Where the frame under way notes its choice.
    choice: Option<(wgpu::Buffer, u64)>,
}

#[derive(Debug)]
struct Queries {
    set: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    read_backs: Vec<ReadBack>,
    /// The read-back that takes the frame under way.
    chosen: Option<usize>,
    period_ns: f64,
}

#[derive(Debug)]
struct ReadBack {
    staging: wgpu::Buffer,
    state: Arc<AtomicU8>,
    frame: u64,
    passes: Vec<&'static str>,
    has_choice: bool,
}

impl PassTimer {
    /// A timer; it measures nothing where the device has no timestamps.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        let queries = match gpu.has_timestamps() {
            true => Some(gpu.checked("create timestamp queries", || Queries::new(gpu))?),
            false => None,
        };
        Ok(PassTimer {
            queries,
            passes: Vec::new(),
            frame: 0,
            latest: Vec::new(),
            measured: VecDeque::new(),
            rejected: 0,
            choice: None,
        })
    }

    /// Whether passes are measured at all.
    pub fn measures(&self) -> bool {
        self.queries.is_some()
    }

    /// Number of the frame under way, or of the last one.
    pub fn frame(&self) -> u64 {
        self.frame
    }

    /// Frames whose stamps made no sense.
    pub fn rejected(&self) -> u64 {
        self.rejected
    }

    /// Starts a frame: collects results that have arrived.
    pub fn begin_frame(&mut self) {
        self.collect();
        self.passes.clear();
        self.choice = None;
        self.frame += 1;
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

    /// Copies the stamps that were written so far into a buffer on the device, for shaders; the
    /// places (in stamps of 8 bytes) of the frame's first and its last.
    pub fn resolve_into(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        buffer: &wgpu::Buffer,
    ) -> Option<(u32, u32)> {
        let queries = self.queries.as_ref().filter(|_| !self.passes.is_empty())?;
        let stamps = 2 * self.passes.len() as u32;
        encoder.resolve_query_set(&queries.set, 0..stamps, buffer, 0);
        Some((0, stamps - 1))
    }

    /// Nanoseconds per tick of the stamps.
    pub fn period_ns(&self) -> Option<f64> {
        self.queries.as_ref().map(|queries| queries.period_ns)
    }

    /// Bytes that [`resolve_into`](Self::resolve_into) may write.
    pub const RESOLVED_BYTES: u64 = RESULT_BYTES;

    /// Says where this frame notes which alternative it chose (a word, at that byte).
    pub fn note_choice(&mut self, buffer: &wgpu::Buffer, offset: u64) {
        self.choice = Some((buffer.clone(), offset));
    }

    /// Ends the frame's commands: copies the stamps out, if a read-back is free.
    pub fn end_frame(&mut self, encoder: &mut wgpu::CommandEncoder) {
        let Some(queries) = &mut self.queries else { return };
        let is_idle = |read: &ReadBack| read.state.load(Ordering::Acquire) == IDLE;
        queries.chosen = queries.read_backs.iter().position(is_idle);
        let Some(chosen) = queries.chosen.filter(|_| !self.passes.is_empty()) else {
            queries.chosen = None;
            return;
        };
        let stamps = 2 * self.passes.len() as u32;
        encoder.resolve_query_set(&queries.set, 0..stamps, &queries.resolved, 0);
        let read = &mut queries.read_backs[chosen];
        encoder.copy_buffer_to_buffer(&queries.resolved, 0, &read.staging, 0, RESULT_BYTES);
        read.has_choice = self.choice.is_some();
        if let Some((buffer, offset)) = &self.choice {
            encoder.copy_buffer_to_buffer(buffer, *offset, &read.staging, RESULT_BYTES, 4);
        }
        read.frame = self.frame;
        read.passes.clone_from(&self.passes);
    }

    /// After the frame was submitted: asks for the results.
    pub fn after_submit(&mut self) {
        let Some(queries) = &mut self.queries else { return };
        let Some(chosen) = queries.chosen.take() else { return };
        let read = &queries.read_backs[chosen];
        read.state.store(IN_FLIGHT, Ordering::Release);
        let state = read.state.clone();
        read.staging.map_async(wgpu::MapMode::Read, .., move |result| {
            state.store(if result.is_ok() { MAPPED } else { FAILED }, Ordering::Release);
        });
    }

    /// Takes in results that have arrived and returns the latest, of this or an earlier frame.
    pub fn collect(&mut self) -> &PassTimes {
        let Some(queries) = &mut self.queries else { return &self.latest };
        let mut arrived: Vec<(u64, Option<u32>, Option<PassTimes>)> = Vec::new();
        for read in &mut queries.read_backs {
            match read.state.load(Ordering::Acquire) {
                MAPPED => {
                    if let Ok(view) = read.staging.get_mapped_range(..) {
                        let ticks: &[u64] = bytemuck::cast_slice(&view);
                        let span = |pair: &[u64]| span_ms(pair[0], pair[1], queries.period_ns);
                        let named = read.passes.iter().zip(ticks.chunks_exact(2).map(span));
                        let choice = ticks[RESULT_BYTES as usize / 8] as u32;
                        arrived.push((
                            read.frame,
                            read.has_choice.then_some(choice),
                            named.map(|(&pass, time)| Some((pass, time?))).collect(),
                        ));
                    }
                    read.staging.unmap();
                }
                FAILED => {}
                _ => continue,
            }
            read.state.store(IDLE, Ordering::Release);
        }
        arrived.sort_by_key(|(frame, ..)| *frame);
        for (frame, choice, passes) in arrived {
            let Some(passes) = passes else {
                self.rejected += 1;
                continue;
            };
            self.latest.clone_from(&passes);
            if self.measured.len() == MAX_WAITING {
                self.measured.pop_front();
            }
            self.measured.push_back(MeasuredFrame { frame, passes, choice });
        }
        &self.latest
    }

    /// The measured frames since the last call, oldest first.
    pub fn take_measured(&mut self) -> Vec<MeasuredFrame> {
        self.collect();
        self.measured.drain(..).collect()
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

/// Time between two stamps of a clock that may wrap around; `None` if they make no sense (the
/// later one earlier, a clock that was reset or stopped, no period).
fn span_ms(begin: u64, end: u64, period_ns: f64) -> Option<f64> {
    let span_ms = end.wrapping_sub(begin) as f64 * period_ns * 1e-6;
    (span_ms.is_finite() && (0.0..=LONGEST_MS).contains(&span_ms)).then_some(span_ms)
}

impl Queries {
    fn new(gpu: &Gpu) -> Self {
        let buffer = |label, size, usage| {
            gpu.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage,
                mapped_at_creation: false,
            })
        };
        let read_back = |_| ReadBack {
            staging: buffer(
                "pass times, read back",
                // Behind the stamps stands the choice.
                RESULT_BYTES + 8,
                wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            ),
            state: Arc::default(),
            frame: 0,
            passes: Vec::new(),
            has_choice: false,
        };
        Queries {
            set: gpu.device().create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("pass times"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * MAX_PASSES,
            }),
            resolved: buffer(
                "pass times",
                RESULT_BYTES,
                wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            ),
            read_backs: (0..READ_BACKS).map(read_back).collect(),
            chosen: None,
            period_ns: f64::from(gpu.queue().get_timestamp_period()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_wrap_and_senseless_ones_are_dropped() {
        assert_eq!(span_ms(1_000_000, 3_500_000, 1.0), Some(2.5));
        assert_eq!(span_ms(u64::MAX - 999_999, 1_000_000, 1.0), Some(2.0), "it wrapped");
        assert_eq!(span_ms(2_000_000, 1_000_000, 1.0), None, "negative");
        assert_eq!(span_ms(0, 20_000_000_000, 1.0), None, "the counter was reset between them");
        assert_eq!(span_ms(0, 1, f64::NAN), None);
        assert_eq!(span_ms(7, 7, 40.0), Some(0.0));
    }
}
