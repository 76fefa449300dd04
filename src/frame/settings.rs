//! What a frame shall be, and why one was not drawn.

use std::time::Duration;

use crate::frame::ColorMode;
use crate::geometry::View;
#[cfg(feature = "gpu")]
use crate::gpu::GpuError;
use crate::passes::FinishSettings;
use crate::select::CutSettings;
use crate::visibility::Algorithm;

/// Why a frame was not drawn.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FrameError {
    /// The view cannot be drawn.
    #[error("the view cannot be drawn: {reason}")]
    View {
        /// What is wrong with it.
        reason: String,
    },
    /// The device failed.
    #[cfg(feature = "gpu")]
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

impl FrameError {
    /// Whether it is for want of memory on the device.
    pub fn is_out_of_memory(&self) -> bool {
        match self {
            #[cfg(feature = "gpu")]
            FrameError::Gpu(GpuError::OutOfMemory { .. }) => true,
            _ => false,
        }
    }
}

/// How points are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RasterPath {
    /// Compute shaders with 64-bit atomics.
    Compute,
    /// Compute shaders with 32-bit atomics, in two passes.
    Compute32,
    /// The rasterizer.
    Raster,
    /// All cores of the CPU.
    Cpu,
}

impl RasterPath {
    /// The ways that a device can draw, the best first.
    #[cfg(feature = "gpu")]
    pub fn offered_by(gpu: &crate::gpu::Gpu) -> Vec<RasterPath> {
        let ways = [
            (RasterPath::Compute, gpu.draws_by_compute()),
            (RasterPath::Compute32, gpu.draws_by_narrow_compute()),
            (RasterPath::Raster, gpu.draws_by_raster()),
        ];
        ways.into_iter().filter_map(|(path, offered)| offered.then_some(path)).collect()
    }

    /// The path in one word, for options and reports.
    pub fn name(self) -> &'static str {
        match self {
            RasterPath::Compute => "compute",
            RasterPath::Compute32 => "compute32",
            RasterPath::Raster => "raster",
            RasterPath::Cpu => "cpu",
        }
    }
}

/// How much a frame loads before it draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loading {
    /// Everything that the view wants.
    All,
    /// Nodes up to about that many bytes; until all is there parents are drawn instead.
    Quota {
        /// Bytes of words per frame; at least one node is loaded.
        bytes: u64,
    },
}

/// What a frame shall be.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameSettings {
    /// What may be drawn and how exact it shall be.
    pub cut: CutSettings,
    /// What points are coloured by.
    pub color: ColorMode,
    /// RGBA8 word of pixels without a point. Default: a dark grey.
    pub background: u32,
    /// How much is loaded before drawing. Default: all.
    pub loading: Loading,
    /// What is done to the picture after its points are drawn. Default: nothing.
    pub finish: FinishSettings,
    /// Time that a frame may take, milliseconds: fewer points are drawn where the budget's would
    /// take longer. Default: none. The first frame with a target measures the adapter, which takes
    /// about a second in software.
    pub target_ms: Option<f64>,
    /// Whether a frame with a target decides half-way, on the device, between all of its points
    /// and a coarser cut. Default: on GPUs that have a clock; software adapters, whose clock counts
    /// what their neighbours take too, only if asked.
    pub checkpoint: InFrameCheckpoint,
    /// Whether the frame's depth is wanted as a texture, so that other things can be drawn into the
    /// same picture. Default off: it takes time to write.
    pub depth: bool,
    /// Over what time a node appears whose points arrive after the scene was first drawn. Default
    /// zero: at once.
    pub appear: Duration,
    /// Whether further frames follow that look much like this one, so that culling may ask for their
    /// sake. Default: yes. Without, a frame that has no last one asks nothing.
    pub more_follow: bool,
    /// How hidden objects of models are found. Default: by the view frustum alone. The CPU renderer
    /// knows only that, and everything.
    pub culling: Algorithm,
    /// What answers the questions of culling. Default: occlusion queries.
    pub answers: CullingAnswers,
    /// Whether models are drawn as depth alone first and shaded when all of it is there, so that each
    /// pixel is shaded once: for dear shading. More triangles are drawn for it. Default off; without
    /// effect where points are drawn too.
    pub depth_first: bool,
}

/// What answers whether a box would show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CullingAnswers {
    /// Occlusion queries of the device.
    #[default]
    Queries,
    /// A depth pyramid, tested by compute: somewhat fewer boxes count as hidden.
    Pyramid,
}

/// When a frame with a target time may decide half-way what is still drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum InFrameCheckpoint {
    /// On GPUs.
    #[default]
    Auto,
    /// Wherever the device can.
    On,
    /// Never.
    Off,
}

impl Default for FrameSettings {
    fn default() -> Self {
        FrameSettings {
            cut: CutSettings::default(),
            color: ColorMode::default(),
            background: 0xff20_1c1a,
            loading: Loading::All,
            finish: FinishSettings::default(),
            target_ms: None,
            depth: false,
            appear: Duration::ZERO,
            checkpoint: InFrameCheckpoint::Auto,
            more_follow: true,
            culling: Algorithm::Frustum,
            answers: CullingAnswers::Queries,
            depth_first: false,
        }
    }
}

/// Refuses views that have no picture.
pub(super) fn check_view(view: &View) -> Result<(), FrameError> {
    let camera = &view.camera;
    let wrong = |reason: &str| Err(FrameError::View { reason: reason.into() });
    let vectors = [camera.eye, camera.forward, camera.up];
    if vectors.iter().any(|v| !v.is_finite()) || !camera.near.is_finite() {
        return wrong("the camera has a number that is not finite");
    }
    if !(camera.fov_y_rad > 0.0 && camera.fov_y_rad < std::f64::consts::PI) {
        return wrong("the field of view is not between 0 and 180 degrees");
    }
    if camera.near <= 0.0 {
        return wrong("the near plane is not in front of the eye");
    }
    if view.width_px == 0 || view.height_px == 0 {
        return wrong("the picture has no pixels");
    }
    Ok(())
}
