//! What the window has done so far: counters for the overlay, and as JSON for scripts and tests.

use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::Serialize;

use crate::frame::FrameStats;
use crate::viewer::culling_view::CullingViewStatistics;
use crate::viewer::opening::KeptIn;

/// Something that was waited for, and when it was there.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Milestone {
    /// `window` when it was first painted; `preview` or `scene` when these were first drawn.
    pub what: &'static str,
    /// Points of the scene.
    pub points: u64,
    /// Time since the program began.
    pub seconds: f64,
}

/// A snapshot of the window's counters.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Statistics {
    /// The adapter, in words.
    pub adapter: String,
    /// How points are drawn: `compute`, `raster` or `cpu`.
    pub renderer: &'static str,
    /// Files on view.
    pub files: Vec<PathBuf>,
    /// Where the store of each is.
    pub stores: Vec<KeptIn>,
    /// Models on view.
    pub models: Vec<PathBuf>,
    /// Triangles of all objects of these models.
    pub triangles: u64,
    /// Their objects.
    pub objects: u64,
    /// Points of the files.
    pub points: u64,
    /// Nodes of these files.
    pub nodes: u64,
    /// Frames of points drawn.
    pub frames_drawn: u64,
    /// Times the window was painted with the picture it had.
    pub frames_skipped: u64,
    /// Times the window was painted, with or without a new picture.
    pub paints: u64,
    /// Size of the picture, pixels.
    pub width_px: u32,
    /// Size of the picture, pixels.
    pub height_px: u32,
    /// What points are coloured by.
    pub color: String,
    /// Setting.
    pub point_budget: u64,
    /// Setting.
    pub error_px: f64,
    /// Setting.
    pub splat: &'static str,
    /// Setting.
    pub rule: &'static str,
    /// Where the eye is.
    pub eye: [f64; 3],
    /// Unit viewing direction.
    pub forward: [f64; 3],
    /// Bytes read from disk by all frames.
    pub bytes_read: u64,
    /// Bytes sent to the device by all frames.
    pub bytes_uploaded: u64,
    /// Most bytes of points held for drawing.
    pub node_limit_bytes: u64,
    /// Whether a file is being opened or converted.
    pub is_opening: bool,
    /// The first things that happened, in order.
    pub milestones: Vec<Milestone>,
    /// How hidden objects are found.
    pub culling: &'static str,
    /// The view of what is culled; absent while it is off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub culling_view: Option<CullingViewStatistics>,
    /// The last frame that was drawn.
    pub frame: FrameStats,
    /// What went wrong so far.
    pub notices: Vec<String>,
}

impl Statistics {
    /// Writes them as JSON; the file is whole or not there.
    pub fn write(&self, path: &Path) -> anyhow::Result<()> {
        let attempt = || -> anyhow::Result<()> {
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
            let mut builder = tempfile::Builder::new();
            builder.prefix(".esker-");
            #[cfg(unix)]
            {
                use std::os::unix::fs::PermissionsExt;
                // Narrowed by the umask, as for any file.
                builder.permissions(std::fs::Permissions::from_mode(0o666));
            }
            let mut file = builder.tempfile_in(folder.unwrap_or(Path::new(".")))?;
            serde_json::to_writer_pretty(&mut file, self)?;
            file.persist(path)?;
            Ok(())
        };
        attempt().with_context(|| format!("{}: cannot write", path.display()))
    }
}
