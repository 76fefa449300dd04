//! A GPU of two stages with a queue between them, triangle by triangle: the truth that formulas are
//! judged by where no GPU is at hand.
//!
//! The first stage (vertices) hands triangles to the second (pixels) through a queue of a given
//! depth and waits while that is full. Whatever the depth, the time lies between the maximum and
//! the sum of the stages' own times; where, depends on how evenly both are loaded within as many
//! triangles as the queue holds.

use std::collections::VecDeque;

/// One triangle's time in each stage, milliseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triangle {
    /// Vertex work.
    pub vertex_ms: f64,
    /// Pixel work.
    pub pixel_ms: f64,
}

/// The pipeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TwoStagePipeline {
    /// Triangles between the stages, the one under way in the second stage included, at least 1;
    /// `None` for any number.
    pub queue: Option<u32>,
}

impl TwoStagePipeline {
    /// Time from the first vertex to the last pixel.
    pub fn time_ms(&self, triangles: impl IntoIterator<Item = Triangle>) -> f64 {
        // When each of the last `queue` triangles was done and gave up its place.
        let mut done_at: VecDeque<f64> = VecDeque::new();
        let (mut vertices_at, mut pixels_at) = (0.0f64, 0.0f64);
        for triangle in triangles {
            vertices_at += triangle.vertex_ms;
            if let Some(depth) = self.queue {
                // There is room once the triangle `depth` places ahead is done.
                if done_at.len() >= depth.max(1) as usize {
                    let room_at = done_at.pop_front().unwrap_or(0.0);
                    vertices_at = vertices_at.max(room_at);
                }
            }
            pixels_at = vertices_at.max(pixels_at) + triangle.pixel_ms;
            if self.queue.is_some() {
                done_at.push_back(pixels_at);
            }
        }
        vertices_at.max(pixels_at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Random;

    /// Every triangle takes 1 ms in both stages: the last one's pixels come one after its vertices.
    #[test]
    fn even_work_overlaps_but_for_the_first_triangle() {
        let triangles = [Triangle { vertex_ms: 1.0, pixel_ms: 1.0 }; 10];
        for queue in [Some(1), Some(4), None] {
            assert_eq!(TwoStagePipeline { queue }.time_ms(triangles), 11.0, "{queue:?}");
        }
    }

    /// One large triangle, then small ones: without room to wait, the vertices stall behind it.
    #[test]
    fn a_short_queue_stalls_behind_a_large_triangle() {
        let mut triangles = vec![Triangle { vertex_ms: 1.0, pixel_ms: 10.0 }];
        triangles.extend([Triangle { vertex_ms: 1.0, pixel_ms: 0.0 }; 10]);
        assert_eq!(TwoStagePipeline { queue: None }.time_ms(triangles.clone()), 11.0);
        // The second triangle's vertices are done at 2 and handed over at 11; then nine more.
        assert_eq!(TwoStagePipeline { queue: Some(1) }.time_ms(triangles), 20.0);
    }

    #[test]
    fn the_time_lies_between_the_maximum_and_the_sum() {
        for case in 0..1000 {
            let mut random = Random::new(2, case);
            let count = 1 + random.below(60);
            let spread = random.between(0.0, 4.0);
            let triangles: Vec<Triangle> = (0..count)
                .map(|_| Triangle {
                    vertex_ms: random.unit(),
                    pixel_ms: (spread * random.bell()).exp() * 0.5,
                })
                .collect();
            let vertices: f64 = triangles.iter().map(|t| t.vertex_ms).sum();
            let pixels: f64 = triangles.iter().map(|t| t.pixel_ms).sum();
            let mut last = f64::INFINITY;
            for queue in [Some(1), Some(2), Some(4), Some(16), Some(1000), None] {
                let time_ms = TwoStagePipeline { queue }.time_ms(triangles.iter().copied());
                let hair = 1e-9 * (vertices + pixels);
                assert!(time_ms >= vertices.max(pixels) - hair, "{case} {queue:?}");
                assert!(time_ms <= vertices + pixels + hair, "{case} {queue:?}");
                assert!(time_ms <= last + hair, "a deeper queue is never slower");
                last = time_ms;
            }
        }
    }

    #[test]
    fn nothing_takes_no_time() {
        assert_eq!(TwoStagePipeline { queue: Some(0) }.time_ms([]), 0.0);
    }
}
