//! Nodes of a scene as they are drawn: positions from the store, colours as a mode wants them.
//!
//! How a mode colours each cloud is settled when the first node is read, by whoever reads it: it
//! may need the root's columns, and a frame must not wait for these.

use std::sync::{Arc, OnceLock};

use crate::frame::color::{Coloring, elevation_range, shows_elevation};
use crate::frame::{ColorMode, NodeSource};
use crate::store::NodeReadError;
use crate::stream::{Fetched, LoadError, LoadedNode, NodeReader, SceneNode};

/// A mode and what it was settled to, of a scene that another takes the place of.
pub(super) type Former = (ColorMode, Vec<Coloring>);

/// Reads the nodes of one scene in the colours of one mode.
pub(super) struct SceneReader {
    sources: Vec<Arc<dyn NodeSource>>,
    mode: ColorMode,
    former: Option<Former>,
    settled: OnceLock<Settled>,
}

/// How each cloud is coloured.
pub(super) struct Settled {
    pub(super) coloring: Vec<Coloring>,
    /// What could not be read for it.
    pub(super) problems: Vec<String>,
}

impl SceneReader {
    /// A reader; ranges of colours that are nearly those of the `former` scene become those.
    pub(super) fn new(
        sources: Vec<Arc<dyn NodeSource>>,
        mode: ColorMode,
        former: Option<Former>,
    ) -> Self {
        SceneReader { sources, mode, former, settled: OnceLock::new() }
    }

    pub(super) fn mode(&self) -> &ColorMode {
        &self.mode
    }

    /// How the clouds are coloured, if it is settled yet.
    pub(super) fn settled(&self) -> Option<&Settled> {
        self.settled.get()
    }

    /// Reads and unpacks a node in this call.
    pub(super) fn read(&self, (cloud, node): SceneNode) -> Result<LoadedNode, NodeReadError> {
        let settled = self.settled.get_or_init(|| self.settle());
        let source = self.sources[cloud].as_ref();
        let mut positions = Vec::new();
        source.read_positions(node, &mut positions)?;
        let position_words = positions.len();
        let count = source.octree().node(node).point_count() as usize;
        let mut words = Vec::with_capacity(position_words + count);
        words.extend_from_slice(&positions);
        let coloring = &settled.coloring[cloud];
        coloring.append_colors(source, node, &positions, &mut words, &mut Vec::new())?;
        Ok(LoadedNode { words, position_words: position_words as u32 })
    }

    fn settle(&self) -> Settled {
        let mut problems = Vec::new();
        let mut noted = |result: Result<Option<(f64, f64)>, NodeReadError>| {
            result.unwrap_or_else(|error| {
                problems.push(error.to_string());
                None
            })
        };
        let shown = |source: &&Arc<dyn NodeSource>| shows_elevation(&self.mode, source.as_ref());
        let ranges = self.sources.iter().filter(shown);
        // One range for the whole scene, so that colours compare between clouds.
        let elevation = ranges
            .filter_map(|source| noted(elevation_range(source.as_ref())))
            .reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        let mut coloring = Vec::new();
        for source in &self.sources {
            let settled = Coloring::settle(&self.mode, source.as_ref(), elevation);
            coloring.push(settled.unwrap_or_else(|error| {
                problems.push(error.to_string());
                Coloring::Plain
            }));
        }
        if let Some((former_mode, former)) = &self.former
            && *former_mode == self.mode
        {
            for settled in &mut coloring {
                if let Some(near) = former.iter().find(|former| settled.is_near(former)) {
                    *settled = near.clone();
                }
            }
        }
        Settled { coloring, problems }
    }
}

impl NodeReader for SceneReader {
    fn fetch(&self, node: SceneNode) -> Result<Box<dyn Fetched>, LoadError> {
        Ok(Box::new(self.read(node)?))
    }
}
