//! From counts of what is drawn to the time it takes: the four formulas of the literature and one
//! that lies between two of them.
//!
//! None is right. Of a pipeline of two stages the maximum of the stages' times is a lower bound and
//! their sum an upper one, whatever waits between them; the fifth formula has an exponent that
//! moves from the one to the other and is chosen by measurement.

use crate::budget::FitError;
use crate::budget::fit;

/// What is drawn, in numbers that predict its time. For points, `triangles`, `polygons`,
/// `vertices` and `transformed` are all the number of points.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Workload {
    /// Draws: nodes of points, objects of triangles.
    pub draws: f64,
    /// Triangles.
    pub triangles: f64,
    /// Polygons as they were sent (a strip's triangles are polygons too).
    pub polygons: f64,
    /// Vertices of all polygons, shared ones each time.
    pub vertices: f64,
    /// Vertices that were really transformed, see
    /// [`transformed_vertices`](crate::budget::transformed_vertices).
    pub transformed: f64,
    /// Pixels touched: projected area times depth complexity, or the sum of splat areas.
    pub pixels: f64,
    /// Changes of state.
    pub switches: f64,
}

impl Workload {
    /// Points in `nodes` draws that touch that many pixels.
    pub fn points(nodes: f64, points: f64, pixels: f64) -> Workload {
        Workload {
            draws: nodes,
            triangles: points,
            polygons: points,
            vertices: points,
            transformed: points,
            pixels,
            switches: 0.0,
        }
    }

    /// Both together.
    pub fn with(&self, other: &Workload) -> Workload {
        Workload {
            draws: self.draws + other.draws,
            triangles: self.triangles + other.triangles,
            polygons: self.polygons + other.polygons,
            vertices: self.vertices + other.vertices,
            transformed: self.transformed + other.transformed,
            pixels: self.pixels + other.pixels,
            switches: self.switches + other.switches,
        }
    }

    /// Whether all counts are numbers of at least zero.
    pub fn is_sound(&self) -> bool {
        let Workload { draws, triangles, polygons, vertices, transformed, pixels, switches } =
            *self;
        let counts = [draws, triangles, polygons, vertices, transformed, pixels, switches];
        counts.iter().all(|count| count.is_finite() && *count >= 0.0)
    }
}

/// A formula.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Heuristic {
    /// H1: triangles (Aliaga and Lastra).
    Triangles,
    /// H2: transformed vertices (Hoppe).
    Transformed,
    /// H3: the larger of polygons and vertices, and pixels (Funkhouser and Sequin).
    Bottleneck,
    /// H4: transformed vertices plus pixels (Wimmer and Wonka).
    Sum,
    /// H5, ours: a norm of the two with an exponent from 1 (H4) to 8 (nearly the maximum).
    Blend,
}

impl Heuristic {
    /// All of them, H1 to H5.
    pub const ALL: [Heuristic; 5] = [
        Heuristic::Triangles,
        Heuristic::Transformed,
        Heuristic::Bottleneck,
        Heuristic::Sum,
        Heuristic::Blend,
    ];

    /// Its short name, for tables.
    pub fn name(self) -> &'static str {
        match self {
            Heuristic::Triangles => "H1",
            Heuristic::Transformed => "H2",
            Heuristic::Bottleneck => "H3",
            Heuristic::Sum => "H4",
            Heuristic::Blend => "H5",
        }
    }
}

/// A frame or an object that was timed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// What was drawn.
    pub work: Workload,
    /// How long it took.
    pub time_ms: f64,
}

/// A formula with its prices, none of them negative.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CostModel {
    /// The formula.
    pub heuristic: Heuristic,
    /// Per draw.
    pub draw_ms: f64,
    /// Per triangle (H1), transformed vertex (H2, H4, H5) or polygon (H3).
    pub vertex_ms: f64,
    /// Per vertex of a polygon; H3 only.
    pub corner_ms: f64,
    /// Per pixel; not in H1 and H2.
    pub pixel_ms: f64,
    /// Per change of state.
    pub switch_ms: f64,
    /// Exponent of H5, 1 to 8; 1 for the others.
    pub exponent: f64,
}

impl CostModel {
    /// A model without prices.
    pub fn free(heuristic: Heuristic) -> CostModel {
        CostModel {
            heuristic,
            draw_ms: 0.0,
            vertex_ms: 0.0,
            corner_ms: 0.0,
            pixel_ms: 0.0,
            switch_ms: 0.0,
            exponent: 1.0,
        }
    }

    /// Fits the formula's prices to samples by squared relative error, with little weight on
    /// outliers. Samples that are not finite or took no time are left out.
    pub fn fit(heuristic: Heuristic, samples: &[Sample]) -> Result<CostModel, FitError> {
        fit::fit(heuristic, samples)
    }

    /// Predicted time, milliseconds. Nothing costs nothing; counts that are no numbers cost
    /// infinity, so that nobody draws them for free.
    pub fn predict(&self, work: &Workload) -> f64 {
        if !work.is_sound() {
            return f64::INFINITY;
        }
        let (vertices, pixels) = self.stages(work);
        let shared = self.draw_ms * work.draws + self.switch_ms * work.switches;
        shared + blend(vertices, pixels, self.heuristic, self.exponent)
    }

    /// Times of the vertex stage and of the pixel stage by themselves.
    pub fn stages(&self, work: &Workload) -> (f64, f64) {
        let vertices = match self.heuristic {
            Heuristic::Triangles => self.vertex_ms * work.triangles,
            Heuristic::Bottleneck => {
                self.vertex_ms * work.polygons + self.corner_ms * work.vertices
            }
            _ => self.vertex_ms * work.transformed,
        };
        (vertices, self.pixel_ms * work.pixels)
    }

    /// The model of the same machine at another speed.
    pub fn scaled(&self, factor: f64) -> CostModel {
        CostModel {
            draw_ms: self.draw_ms * factor,
            vertex_ms: self.vertex_ms * factor,
            corner_ms: self.corner_ms * factor,
            pixel_ms: self.pixel_ms * factor,
            switch_ms: self.switch_ms * factor,
            ..*self
        }
    }
}

fn blend(vertices: f64, pixels: f64, heuristic: Heuristic, exponent: f64) -> f64 {
    match heuristic {
        Heuristic::Bottleneck => vertices.max(pixels),
        Heuristic::Blend => norm(vertices, pixels, exponent),
        _ => vertices + pixels,
    }
}

/// `(a^p + b^p)^(1/p)`, without overflow.
pub(super) fn norm(a: f64, b: f64, p: f64) -> f64 {
    let (most, least) = (a.max(b), a.min(b));
    if most <= 0.0 { 0.0 } else { most * (1.0 + (least / most).powf(p)).powf(1.0 / p) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_blend_lies_between_the_sum_and_the_maximum() {
        assert_eq!(norm(3.0, 4.0, 1.0), 7.0);
        assert!((norm(3.0, 4.0, 2.0) - 5.0).abs() < 1e-12);
        assert!((4.0..4.1).contains(&norm(3.0, 4.0, 8.0)));
        assert_eq!(norm(0.0, 0.0, 3.0), 0.0);
        assert_eq!(norm(0.0, 2.0, 3.0), 2.0);
        assert!(norm(1e300, 1e300, 8.0).is_finite());
    }

    #[test]
    fn nothing_costs_nothing_and_what_is_no_number_is_never_free() {
        let model = CostModel { draw_ms: 1.0, vertex_ms: 1.0, ..CostModel::free(Heuristic::Sum) };
        assert_eq!(model.predict(&Workload::default()), 0.0);
        assert_eq!(model.predict(&Workload { draws: 1.0, ..Workload::default() }), 1.0);
        let wrong = Workload { pixels: f64::NAN, ..Workload::default() };
        assert_eq!(model.predict(&wrong), f64::INFINITY);
        let wrong = Workload { transformed: -1.0, ..Workload::default() };
        assert_eq!(model.predict(&wrong), f64::INFINITY);
    }

    /// Many objects of one triangle: the constant per draw is most of the time.
    #[test]
    fn a_million_single_triangles_cost_their_draws() {
        let model = CostModel {
            draw_ms: 1e-3,
            vertex_ms: 1e-6,
            pixel_ms: 1e-6,
            ..CostModel::free(Heuristic::Sum)
        };
        let one = Workload { draws: 1.0, transformed: 3.0, ..Workload::default() };
        let all = (0..1_000_000).fold(Workload::default(), |sum, _| sum.with(&one));
        assert!((model.predict(&all) - 1003.0).abs() < 1e-3);
    }
}
