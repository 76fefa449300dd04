//! Nodes of a scene as they are drawn: positions from the store, colours as a mode wants them.
//!
//! How a mode colours each cloud is settled when the first node is read, by whoever reads it: it
//! may need the root's columns, and a frame must not wait for these.

use std::sync::{Arc, OnceLock};

use crate::frame::color::{Coloring, NodeColumns, elevation_range, shows_elevation};
use crate::frame::{ColorMode, NodeSource};
use crate::gpu::layout::position_words;
use crate::store::{FetchedNode, NodeReadError, SectionContent};
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

    /// Bytes to be read for a node.
    pub(super) fn stored_bytes(&self, (cloud, node): SceneNode) -> Option<u64> {
        let columns = self.columns(self.settled()?, cloud);
        self.sources[cloud].fetch_bytes(node, &columns)
    }

    /// Whether reading a node waits for no disk.
    pub(super) fn is_at_hand(&self, (cloud, node): SceneNode) -> bool {
        let settled = self.settled.get_or_init(|| self.settle());
        self.sources[cloud].fetches_from_memory(node, &self.columns(settled, cloud))
    }

    /// Reads and unpacks a node in this call.
    pub(super) fn read(&self, (cloud, node): SceneNode) -> Result<LoadedNode, NodeReadError> {
        let settled = self.settled.get_or_init(|| self.settle());
        let source = self.sources[cloud].as_ref();
        let fetched = source.fetch(node, &self.columns(settled, cloud))?;
        self.unpack((cloud, node), fetched.as_ref(), settled)
    }

    fn unpack(
        &self,
        (cloud, node): SceneNode,
        fetched: Option<&FetchedNode>,
        settled: &Settled,
    ) -> Result<LoadedNode, NodeReadError> {
        let source = self.sources[cloud].as_ref();
        let columns = NodeColumns { source, node, fetched };
        let octree = source.octree();
        let count = octree.node(node).point_count() as usize;
        // Room for all from the start, so that words are not copied as they grow.
        let stride = position_words(octree.local_bits(node)) as usize + 1;
        let mut words = Vec::with_capacity(stride * count);
        columns.positions(&mut words)?;
        let position_words = words.len() as u32;
        let mut colors = Vec::with_capacity(count);
        settled.coloring[cloud].append_colors(&columns, &words, &mut colors)?;
        words.extend_from_slice(&colors);
        Ok(LoadedNode { words, position_words })
    }

    fn columns(&self, settled: &Settled, cloud: usize) -> Vec<SectionContent> {
        let color = settled.coloring[cloud].column();
        [Some(SectionContent::Positions), color].into_iter().flatten().collect()
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

/// A scene's reader as the loader takes it.
pub(super) struct SceneNodes(pub(super) Arc<SceneReader>);

/// The stored bytes of one node, and how it is to look.
struct FetchedColumns {
    reader: Arc<SceneReader>,
    node: SceneNode,
    fetched: Option<FetchedNode>,
}

impl NodeReader for SceneNodes {
    fn fetch(&self, (cloud, node): SceneNode) -> Result<Box<dyn Fetched>, LoadError> {
        let reader = self.0.clone();
        let settled = reader.settled.get_or_init(|| reader.settle());
        let columns = reader.columns(settled, cloud);
        let fetched = reader.sources[cloud].fetch(node, &columns)?;
        if fetched.is_none() {
            // Nothing to be unpacked elsewhere: all of it happens here.
            return Ok(Box::new(reader.unpack((cloud, node), None, settled)?));
        }
        Ok(Box::new(FetchedColumns { reader, node: (cloud, node), fetched }))
    }
}

impl Fetched for FetchedColumns {
    fn unpack(self: Box<Self>) -> Result<LoadedNode, LoadError> {
        let settled = self.reader.settled.get_or_init(|| self.reader.settle());
        Ok(self.reader.unpack(self.node, self.fetched.as_ref(), settled)?)
    }
}
