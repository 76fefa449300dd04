//! Without a device nothing is asked whether it shows, and nothing is concealed.

use crate::frame::{FrameSettings, Renderer};
use crate::geometry::View;
use crate::stream::SceneNode;

impl Renderer {
    pub(super) fn begin_culling(&mut self, _: &View, _: &FrameSettings) {}

    pub(super) fn is_concealed(&self, _: SceneNode) -> bool {
        false
    }

    pub(super) fn concealment(&self) -> u64 {
        0
    }

    pub(super) fn nodes_missing(&self) -> u32 {
        0
    }

    pub(super) fn is_culling_unsettled(&self) -> bool {
        false
    }
}
