//! The reference picture of a source: every point, in the colours that frames have.

use crate::frame::color::{Coloring, NodeColumns, elevation_range};
use crate::frame::{ColorMode, NodeSource};
use crate::geometry::View;
use crate::passes::{self, Picture};
use crate::store::NodeReadError;

/// Draws every point of a source in f64, one pixel each; reads the whole source each time.
pub fn reference_picture(
    source: &dyn NodeSource,
    view: &View,
    color: &ColorMode,
    background: u32,
) -> Result<Picture, NodeReadError> {
    let coloring = Coloring::settle(color, source, elevation_range(source)?)?;
    passes::reference_picture(source.octree(), view, background, |node, positions, colors| {
        source.read_positions(node, positions)?;
        colors.clear();
        let columns = NodeColumns { source, node, fetched: None };
        coloring.append_colors(&columns, positions, colors)
    })
}
