//! A frame as tasks of the system, the CPU and the GPU.
//!
//! `frame = system + max(cpu, gpu)` holds where CPU and GPU work beside each other. On a software
//! adapter they share the cores, so the smaller part counts too, by a share that is fitted:
//! `frame = system + max(cpu, gpu) + (1 - overlap) * min(cpu, gpu)`.

use crate::budget::{Design, FitError};

/// Tasks of the CPU in one frame, milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CpuTime {
    /// What is not drawing: input, panels.
    pub other_ms: f64,
    /// Selection, tables, commands.
    pub drawing_ms: f64,
    /// Bytes brought to the GPU.
    pub memory_ms: f64,
    /// Waiting for room in the command queue.
    pub waiting_ms: f64,
}

impl CpuTime {
    /// All of them.
    pub fn total_ms(&self) -> f64 {
        self.other_ms + self.drawing_ms + self.memory_ms + self.waiting_ms
    }
}

/// Tasks of the GPU in one frame, milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GpuTime {
    /// Clearing, resolving, showing.
    pub setup_ms: f64,
    /// Points and triangles.
    pub drawing_ms: f64,
    /// Copies.
    pub memory_ms: f64,
    /// Without commands; 0 in a balanced frame.
    pub starved_ms: f64,
}

impl GpuTime {
    /// All of them.
    pub fn total_ms(&self) -> f64 {
        self.setup_ms + self.drawing_ms + self.memory_ms + self.starved_ms
    }
}

/// A frame whose parts and whole were timed, milliseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OverlapSample {
    /// CPU part.
    pub cpu_ms: f64,
    /// GPU part.
    pub gpu_ms: f64,
    /// The whole frame.
    pub frame_ms: f64,
}

/// How the parts make a whole on one adapter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameModel {
    /// What the system may take beside the frame, see
    /// [`SystemNoise`](crate::budget::SystemNoise), milliseconds.
    pub system_ms: f64,
    /// Share of the smaller part that runs beside the larger: 1 on a GPU of its own, towards 0
    /// where CPU and GPU are the same cores.
    pub overlap: f64,
}

impl FrameModel {
    /// CPU and GPU beside each other, no noise: the paper's form.
    pub const PARALLEL: FrameModel = FrameModel { system_ms: 0.0, overlap: 1.0 };

    /// Time of a frame with these parts.
    pub fn frame_ms(&self, cpu: &CpuTime, gpu: &GpuTime) -> f64 {
        self.system_ms + self.parts_ms(cpu.total_ms(), gpu.total_ms())
    }

    /// Time of both parts together, without the system.
    pub fn parts_ms(&self, cpu_ms: f64, gpu_ms: f64) -> f64 {
        cpu_ms.max(gpu_ms) + (1.0 - self.overlap) * cpu_ms.min(gpu_ms)
    }

    /// The longest GPU part that, beside this CPU part, ends within `frame_ms`; 0 if none does.
    pub fn gpu_ms_within(&self, frame_ms: f64, cpu_ms: f64) -> f64 {
        let left = frame_ms - self.system_ms;
        let both = 1.0 - self.overlap;
        let as_larger = left - both * cpu_ms;
        let gpu_ms = if as_larger >= cpu_ms {
            as_larger
        } else if left >= cpu_ms && both > 0.0 {
            (left - cpu_ms) / both
        } else if left >= cpu_ms {
            cpu_ms
        } else {
            0.0
        };
        if gpu_ms > 0.0 { gpu_ms } else { 0.0 }
    }

    /// Fits the overlap to timed frames.
    pub fn fit(system_ms: f64, samples: &[OverlapSample]) -> Result<FrameModel, FitError> {
        let mut design = Design::new(1);
        for OverlapSample { cpu_ms, gpu_ms, frame_ms } in samples {
            let rest = frame_ms - system_ms - cpu_ms.max(*gpu_ms);
            design.push(&[cpu_ms.min(*gpu_ms)], rest, 1.0 / frame_ms);
        }
        let serial = design.solve_robust()?.prices[0];
        Ok(FrameModel { system_ms, overlap: (1.0 - serial).clamp(0.0, 1.0) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Random;

    #[test]
    fn the_parts_add_up_as_in_the_paper() {
        let cpu = CpuTime { other_ms: 1.0, drawing_ms: 2.0, memory_ms: 0.5, waiting_ms: 0.5 };
        let gpu = GpuTime { setup_ms: 1.0, drawing_ms: 6.0, memory_ms: 0.5, starved_ms: 0.5 };
        let model = FrameModel { system_ms: 1.5, ..FrameModel::PARALLEL };
        assert_eq!(model.frame_ms(&cpu, &gpu), 1.5 + 8.0);
        let shared = FrameModel { overlap: 0.25, ..model };
        assert_eq!(shared.frame_ms(&cpu, &gpu), 1.5 + 8.0 + 3.0);
    }

    #[test]
    fn the_overlap_of_an_adapter_is_found() {
        for known in [0.0, 0.3, 1.0] {
            let model = FrameModel { system_ms: 0.4, overlap: known };
            let sample = |index| {
                let mut random = Random::new(17, index);
                let (cpu_ms, gpu_ms) = (random.between(0.5, 6.0), random.between(0.5, 20.0));
                let noise = 1.0 + 0.01 * random.bell();
                let frame_ms = noise * (0.4 + model.parts_ms(cpu_ms, gpu_ms));
                OverlapSample { cpu_ms, gpu_ms, frame_ms }
            };
            let samples: Vec<OverlapSample> = (0..500).map(sample).collect();
            let fitted = FrameModel::fit(0.4, &samples).expect("well posed");
            assert!((fitted.overlap - known).abs() < 0.03, "{known}: {fitted:?}");
        }
        assert!(FrameModel::fit(0.0, &[]).is_err());
    }

    #[test]
    fn the_gpu_gets_what_the_frame_has_left() {
        for overlap in [0.0, 0.4, 1.0] {
            let model = FrameModel { system_ms: 1.0, overlap };
            for (frame_ms, cpu_ms) in [(16.0, 3.0), (16.0, 10.0), (16.0, 15.0), (5.0, 3.0)] {
                let gpu_ms = model.gpu_ms_within(frame_ms, cpu_ms);
                assert!(1.0 + model.parts_ms(cpu_ms, gpu_ms) <= frame_ms + 1e-9);
                let more = 1.0 + model.parts_ms(cpu_ms, gpu_ms + 0.1);
                assert!(more > frame_ms, "{overlap} {frame_ms} {cpu_ms}");
            }
            assert_eq!(model.gpu_ms_within(0.0, 3.0), 0.0);
            assert_eq!(model.gpu_ms_within(f64::NAN, 3.0), 0.0);
        }
    }
}
