//! A question is put only where it is expected to pay: a stand-in for near optimal hierarchical
//! culling.
//!
//! The paper's formulas are not at hand; what is known of it is a cost model of the hardware, an
//! occlusion probability from screen coverage corrected by coherence, and a rule whether a question
//! is reasonable. Here: the costs of [`CullingCosts`]; the mean of the node's own history and the
//! share of its rectangle that drawn boxes cover on a grid of 64 x 64 cells; a question if the
//! expected saving exceeds its cost. Every hidden node still costs a question of its own.
//!
//! After: Guthe, Balazs and Klein, "Near Optimal Hierarchical Culling", 2006, as described by
//! Mattausch et al. 2008.

use crate::hierarchy::BoundingHierarchy;
use crate::ids::TreeNodeId;
use crate::visibility::CullingCosts;
use crate::visibility::coherence::{CoherenceTable, KeepRule};
use crate::visibility::cost::screen_rectangle;
use crate::visibility::history::LONGEST_PERSISTENCE;
use crate::visibility::walk::Walk;

const CELLS: usize = 64;

/// Decides question by question.
#[derive(Clone, Debug)]
pub(super) struct Judge {
    costs: CullingCosts,
    /// Cells under a drawn box, a row in each number.
    covered: [u64; CELLS],
    hidden: CoherenceTable,
    visible: CoherenceTable,
}

impl Judge {
    pub fn new(costs: CullingCosts) -> Self {
        Judge {
            costs,
            covered: [0; CELLS],
            hidden: CoherenceTable::default(),
            visible: CoherenceTable::default(),
        }
    }

    pub fn set_costs(&mut self, costs: CullingCosts) {
        self.costs = costs;
    }

    pub fn begin_frame(&mut self) {
        self.covered = [0; CELLS];
        self.hidden.end_frame();
        self.visible.end_frame();
    }

    /// Takes in a test.
    pub fn tested<H: BoundingHierarchy>(
        &mut self,
        walk: &mut Walk<H>,
        node: TreeNodeId,
        was_visible: bool,
        visible: bool,
    ) {
        let history = walk.history.node(node);
        let kept = was_visible == visible;
        let table = if was_visible { &mut self.visible } else { &mut self.hidden };
        table.record(history.persistence, kept);
        history.persistence =
            if kept { (history.persistence + 1).min(LONGEST_PERSISTENCE) } else { 0 };
    }

    /// Whether a question about a node is expected to pay.
    pub fn pays<H: BoundingHierarchy>(
        &mut self,
        walk: &mut Walk<H>,
        node: TreeNodeId,
        was_visible: bool,
    ) -> bool {
        let Some((low, high)) = screen_rectangle(walk.view, &walk.proxy(node)) else {
            return true;
        };
        let pixels = (high[0] - low[0]) * (high[1] - low[1]);
        let persistence = walk.history.node(node).persistence;
        let table = if was_visible { &self.visible } else { &self.hidden };
        let keep = table.keep(persistence, KeepRule::Measured);
        let by_history = if was_visible { 1.0 - keep } else { keep };
        let hidden = 0.5 * (by_history + self.coverage(walk, low, high));
        hidden * self.costs.of_drawing(walk.tree.cost(node), pixels) > self.costs.of_query(pixels)
    }

    /// Remembers the box of something drawn.
    pub fn drew<H: BoundingHierarchy>(&mut self, walk: &Walk<H>, node: TreeNodeId) {
        if let Some((low, high)) = screen_rectangle(walk.view, &walk.proxy(node)) {
            let (columns, rows) = cells(walk, low, high, true);
            self.covered[rows.0..rows.1].iter_mut().for_each(|row| *row |= bits(columns));
        }
    }

    fn coverage<H: BoundingHierarchy>(&self, walk: &Walk<H>, low: [f64; 2], high: [f64; 2]) -> f64 {
        let (columns, rows) = cells(walk, low, high, false);
        let mask = bits(columns);
        let covered: u32 =
            self.covered[rows.0..rows.1].iter().map(|row| (row & mask).count_ones()).sum();
        let all = (columns.1 - columns.0) * (rows.1 - rows.0);
        if all == 0 { 0.0 } else { f64::from(covered) / all as f64 }
    }
}

/// Half-open ranges of the grid's columns and rows: those fully inside a rectangle, or all touched.
fn cells<H>(
    walk: &Walk<H>,
    low: [f64; 2],
    high: [f64; 2],
    inside: bool,
) -> ((usize, usize), (usize, usize)) {
    let size = [f64::from(walk.view.width_px), f64::from(walk.view.height_px)];
    let range = |axis: usize| {
        let scale = CELLS as f64 / size[axis];
        let (from, to) = (low[axis] * scale, high[axis] * scale);
        let (from, to) = if inside { (from.ceil(), to.floor()) } else { (from.floor(), to.ceil()) };
        let from = (from.max(0.0) as usize).min(CELLS);
        (from, (to.max(0.0) as usize).min(CELLS).max(from))
    };
    (range(0), range(1))
}

fn bits((from, to): (usize, usize)) -> u64 {
    let below = |n: usize| if n >= 64 { u64::MAX } else { (1u64 << n) - 1 };
    below(to) & !below(from)
}
