//! The box that is drawn in place of what a node holds.
//!
//! It must cover at least the pixels that the content covers, at no greater distance. Corners of
//! both are rounded to the sub-pixel grid and to f32, each by itself, so the box is widened by an
//! eighth of a pixel: with the coarsest grid that devices may have, of a sixteenth, two corners are
//! at most 0.09 pixels farther apart than they should. More would let boxes show in front of what
//! hides them closely. Splats reach over the box of their centres by up to their size on screen.

use crate::geometry::{Aabb, View};
use crate::hierarchy::BoundingHierarchy;
use crate::ids::TreeNodeId;
use glam::DVec3;

/// Rounding to f32 relative to the eye, and a margin.
const ROUNDING: f64 = 1e-6;
/// Pixels by which box and content may be apart on screen.
const SNAPPING_PX: f64 = 0.125;

/// The rule for one view.
#[derive(Clone, Copy, Debug)]
pub struct Proxies {
    eye: DVec3,
    /// Length of a pixel at distance 1, at the edge of the picture, where it is longest.
    pixel: f64,
}

impl Proxies {
    /// The rule for a view.
    pub fn new(view: &View) -> Self {
        // A pixel off the axis is seen from farther away than its distance along the axis; boxes'
        // distances are measured to the eye, so the axis gives the larger length.
        Proxies { eye: view.camera.eye, pixel: 1.0 / view.focal_px() }
    }

    /// The widened box of a node.
    pub fn of<H: BoundingHierarchy>(&self, tree: &H, node: TreeNodeId) -> Aabb {
        self.widened(&tree.bounds(node), tree.overhang_px(node))
    }

    /// A box widened so that it covers content that sticks out by `overhang_px` pixels.
    pub fn widened(&self, bounds: &Aabb, overhang_px: f64) -> Aabb {
        if bounds.is_empty() {
            return *bounds;
        }
        let reach = (bounds.min - self.eye).abs().max((bounds.max - self.eye).abs());
        let on_screen = (SNAPPING_PX + overhang_px) * self.pixel * reach.length();
        let by = on_screen + ROUNDING * reach.max_element();
        Aabb::new(bounds.min - by, bounds.max + by)
    }
}

/// Whether any corner of a box lies nearer than the near plane, so that drawing the box would lose
/// its front.
pub fn meets_near_plane(view: &View, bounds: &Aabb) -> bool {
    let camera = &view.camera;
    let center = (bounds.center() - camera.eye).dot(camera.forward);
    let reach = camera.forward.abs().dot(0.5 * bounds.size());
    let nearest = center - reach;
    // A box that is not a number can't be asked about.
    nearest.is_nan() || nearest < camera.near * (1.0 + 1e-4)
}
