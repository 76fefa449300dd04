//! What points look like: the options that `render` and `view` share.

use std::time::Duration;

use clap::{Args, ValueEnum};

use crate::frame::{CullingAnswers, FrameSettings};
use crate::passes::{EyeDome, FinishSettings, MAX_FINISH_RADIUS_PX};
use crate::select::{SplatPolicy, SplatShape, SplatSize};
use crate::visibility::Algorithm;

/// Options of how points look.
#[derive(Clone, Debug, Args)]
pub(super) struct PictureOptions {
    /// What decides how large a point is
    #[arg(long, value_enum, default_value = "adaptive")]
    size_mode: SizeChoice,
    /// Size of a point: pixels with --size-mode fixed [default: 2], world length with attenuated
    /// [default: the mean spacing of the points]
    #[arg(long, value_name = "SIZE", value_parser = parse_positive)]
    point_size: Option<f64>,
    /// What a point larger than a pixel looks like
    #[arg(long, value_enum, default_value = "square")]
    point_shape: ShapeChoice,
    /// Largest point, pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 24.0, value_parser = parse_max_px)]
    max_point_size: f64,
    /// Which level sets the size of a point, with --size-mode adaptive
    #[arg(long, value_enum, default_value = "per-point")]
    splat: SplatChoice,
    /// Factor on the size of points, 0.5 to 4
    #[arg(long, default_value_t = 1.0, value_parser = parse_splat_scale)]
    splat_scale: f64,
    /// Let nodes come and go by shares of their points as the camera moves, instead of at once
    #[arg(long)]
    continuous: bool,
    /// Eye-dome lighting: edges darken, without normals; 0.2 is faint, 4 is strong
    #[arg(long, value_name = "STRENGTH", num_args = 0..=1, default_missing_value = "1",
        value_parser = parse_strength)]
    eye_dome: Option<f32>,
    /// How far apart the pixels are that eye-dome lighting compares
    #[arg(long, value_name = "PIXELS", default_value_t = 1, value_parser = parse_radius)]
    eye_dome_radius: u32,
    /// Fill gaps in surfaces, up to twice that wide
    #[arg(long, value_name = "PIXELS", num_args = 0..=1, default_missing_value = "2",
        value_parser = parse_radius)]
    fill_gaps: Option<u32>,
    /// Let nodes that arrive appear over that time, milliseconds (in the window)
    #[arg(long, value_name = "MS", default_value_t = 0, value_parser = parse_appear)]
    appear_ms: u32,
    /// How hidden objects of models are found; the picture is the same. Without an adapter: by the
    /// view frustum, or not at all
    #[arg(long, value_enum, default_value = "auto")]
    culling: CullingChoice,
    /// What answers whether a box shows: occlusion queries of the device, or a depth pyramid tested
    /// by compute
    #[arg(long, value_enum, default_value = "queries")]
    culling_answers: AnswerChoice,
    /// Draw models as depth alone first and shade them when all of it is there; without effect where
    /// points are drawn too
    #[arg(long)]
    culling_depth_first: bool,
    /// Draw boxes over the picture: what was drawn green, drawn without being asked about yellow,
    /// hidden red, outside of the view blue. `above` shows it from a second camera above
    #[arg(long, value_enum, value_name = "WHERE", num_args = 0..=1, default_missing_value = "boxes")]
    show_culling: Option<CullingShow>,
}

/// Where what is culled is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum CullingShow {
    /// Over the picture
    Boxes,
    /// From a second camera above, while what is drawn stays as the first one chose it
    Above,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum AnswerChoice {
    /// Occlusion queries
    Queries,
    /// A depth pyramid
    Pyramid,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum CullingChoice {
    /// CHC++ while it pays, the view frustum alone otherwise
    Auto,
    /// Not at all: everything is drawn
    None,
    /// Whatever is outside of the view is left out
    Frustum,
    /// Each object in view is asked about and waited for
    Naive,
    /// Each box on the way down is asked about and waited for
    StopAndWait,
    /// Coherent hierarchical culling
    Chc,
    /// Coherent hierarchical culling with batches, multiqueries, jittered tests and tight bounds
    #[value(name = "chc++")]
    ChcPlus,
    /// What was visible in the last frame first, then what a test on the device finds: nothing is
    /// waited for
    TwoPass,
}

impl CullingChoice {
    fn algorithm(self) -> Algorithm {
        // In the same order.
        Algorithm::usual()[self as usize]
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum SizeChoice {
    /// The spacing of the points drawn around it
    Adaptive,
    /// The same on screen everywhere
    Fixed,
    /// The same in the world everywhere
    Attenuated,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ShapeChoice {
    /// A square of whole pixels
    Square,
    /// A disc
    Round,
    /// A shaded ball
    Sphere,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum SplatChoice {
    /// The node's own
    Own,
    /// The deepest complete descendant
    Paper,
    /// The node's own unless all wanted children are drawn
    Conservative,
    /// The deepest drawn node around each point
    PerPoint,
}

/// Side of a point of fixed size, unless one is given, pixels.
const FIXED_PX: f64 = 2.0;

impl PictureOptions {
    /// Whether and where what is culled is shown.
    pub(super) fn show_culling(&self) -> Option<CullingShow> {
        self.show_culling
    }

    /// Writes them into the settings of a frame.
    pub(super) fn apply(&self, settings: &mut FrameSettings) {
        settings.culling = self.culling.algorithm();
        settings.depth_first = self.culling_depth_first;
        settings.answers = match self.culling_answers {
            AnswerChoice::Queries => CullingAnswers::Queries,
            AnswerChoice::Pyramid => CullingAnswers::Pyramid,
        };
        let splat = &mut settings.cut.splat;
        splat.size = match self.size_mode {
            SizeChoice::Adaptive => SplatSize::Adaptive,
            SizeChoice::Fixed => SplatSize::Fixed { px: self.point_size.unwrap_or(FIXED_PX) },
            SizeChoice::Attenuated => {
                SplatSize::Attenuated { length: self.point_size.unwrap_or(0.0) }
            }
        };
        splat.shape = match self.point_shape {
            ShapeChoice::Square => SplatShape::Square,
            ShapeChoice::Round => SplatShape::Round,
            ShapeChoice::Sphere => SplatShape::Sphere,
        };
        splat.policy = match self.splat {
            SplatChoice::Own => SplatPolicy::Own,
            SplatChoice::Paper => SplatPolicy::Paper,
            SplatChoice::Conservative => SplatPolicy::Conservative,
            SplatChoice::PerPoint => SplatPolicy::PerPoint,
        };
        splat.multiplier = self.splat_scale;
        splat.max_px = self.max_point_size;
        settings.cut.continuous = self.continuous;
        let eye_dome = |strength| EyeDome { strength, radius_px: self.eye_dome_radius };
        settings.finish = FinishSettings {
            gap_radius_px: self.fill_gaps.unwrap_or(0),
            eye_dome: self.eye_dome.map(eye_dome),
        };
        settings.appear = Duration::from_millis(self.appear_ms.into());
    }
}

/// A number of a range, or what is wrong with it.
pub(super) fn parse_in_range(text: &str, low: f64, high: f64) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("'{text}' is not a number"))?;
    // Written so that NaN fails too.
    match value >= low && value <= high {
        true => Ok(value),
        false => Err(format!("{text} is not in {low} to {high}")),
    }
}

fn parse_positive(text: &str) -> Result<f64, String> {
    parse_in_range(text, 1e-12, 1e12)
}

fn parse_max_px(text: &str) -> Result<f64, String> {
    parse_in_range(text, 1.0, 1024.0)
}

fn parse_splat_scale(text: &str) -> Result<f64, String> {
    parse_in_range(text, 0.5, 4.0)
}

fn parse_strength(text: &str) -> Result<f32, String> {
    parse_in_range(text, 0.0, 100.0).map(|strength| strength as f32)
}

fn parse_radius(text: &str) -> Result<u32, String> {
    let value: u32 = text.parse().map_err(|_| format!("'{text}' is not a whole number"))?;
    match (1..=MAX_FINISH_RADIUS_PX).contains(&value) {
        true => Ok(value),
        false => Err(format!("{text} is not in 1 to {MAX_FINISH_RADIUS_PX}")),
    }
}

fn parse_appear(text: &str) -> Result<u32, String> {
    parse_in_range(text, 0.0, 10_000.0).map(|ms| ms as u32)
}
