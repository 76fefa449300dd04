//! A cloud in memory that behaves like a bad disk: slow, and unreadable in places.

use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex};
use std::thread::ThreadId;
use std::time::Duration;

use esker::frame::NodeSource;
use esker::geometry::Aabb;
use esker::ids::NodeId;
use esker::octree::Octree;
use esker::points::Schema;
use esker::store::{NodeReadError, ValueRange};

use crate::memory_cloud::MemoryCloud;

/// Wraps a cloud and notes who read what.
pub struct SlowCloud {
    cloud: Arc<MemoryCloud>,
    delay: Duration,
    broken: HashSet<NodeId>,
    /// How often reading a node will still time out.
    pub hesitates: Mutex<HashMap<NodeId, u32>>,
    /// Nodes whose positions were read, in order, and by which thread.
    pub reads: Mutex<Vec<(NodeId, ThreadId)>>,
}

impl SlowCloud {
    pub fn new(cloud: Arc<MemoryCloud>, delay: Duration, broken: &[u32]) -> Arc<SlowCloud> {
        let broken = broken.iter().map(|&node| NodeId(node)).collect();
        Arc::new(SlowCloud {
            cloud,
            delay,
            broken,
            hesitates: Mutex::default(),
            reads: Mutex::default(),
        })
    }

    /// Nodes read so far, in order.
    pub fn read_nodes(&self) -> Vec<NodeId> {
        self.reads.lock().unwrap().iter().map(|&(node, _)| node).collect()
    }
}

impl NodeSource for SlowCloud {
    fn octree(&self) -> &Octree {
        self.cloud.octree()
    }
    fn bounds(&self) -> Aabb {
        self.cloud.bounds()
    }
    fn schema(&self) -> &Schema {
        self.cloud.schema()
    }
    fn has_colors(&self) -> bool {
        self.cloud.has_colors()
    }
    fn value_ranges(&self, attribute: usize) -> &[ValueRange] {
        self.cloud.value_ranges(attribute)
    }
    fn read_positions(&self, node: NodeId, words: &mut Vec<u32>) -> Result<(), NodeReadError> {
        self.reads.lock().unwrap().push((node, std::thread::current().id()));
        if !self.delay.is_zero() {
            std::thread::sleep(self.delay);
        }
        if let Some(left) = self.hesitates.lock().unwrap().get_mut(&node).filter(|left| **left > 0)
        {
            *left -= 1;
            return Err(NodeReadError::Io {
                node,
                level: self.octree().node(node).depth,
                section: "positions".into(),
                source: std::io::ErrorKind::TimedOut.into(),
                start: 0,
                end: 10,
            });
        }
        if self.broken.contains(&node) {
            return Err(NodeReadError::Checksum {
                node,
                level: self.octree().node(node).depth,
                section: "positions".into(),
                found: 1,
                expected: 2,
                start: 0,
                end: 10,
            });
        }
        self.cloud.read_positions(node, words)
    }
    fn read_colors(&self, node: NodeId, words: &mut Vec<u32>) -> Result<(), NodeReadError> {
        self.cloud.read_colors(node, words)
    }
    fn read_attribute(
        &self,
        node: NodeId,
        attribute: usize,
        bytes: &mut Vec<u8>,
    ) -> Result<(), NodeReadError> {
        self.cloud.read_attribute(node, attribute, bytes)
    }
    fn bytes_read(&self) -> u64 {
        self.cloud.bytes_read()
    }
}
