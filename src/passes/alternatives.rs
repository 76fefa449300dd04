//! A draw table with a coarser alternative, so that a frame can decide half-way what it still has
//! time for.
//!
//! Nodes that look the same in both cuts, with all below them, are drawn in any case; of the others
//! either the full cut's or the coarser cut's are drawn. Either way the picture is exactly that of
//! its cut: nothing is drawn twice and no splat is too small for what is missing.

use std::collections::HashMap;

use crate::ids::NodeId;
use crate::passes::DrawTable;

/// Which of a frame's alternatives a draw belongs to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum DrawPart {
    /// To all of them.
    #[default]
    Always,
    /// To the full cut.
    Full,
    /// To the coarser one.
    Coarse,
}

/// When which alternative is drawn. Times are milliseconds of the GPU's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CheckpointPlan {
    /// What the frame may take from its first pass on.
    pub allowed_ms: f64,
    /// What the full and the coarser alternative need, with the passes after them.
    pub needs_ms: [f64; 2],
}

impl DrawTable {
    /// Adds the coarser cut's table as an alternative. Returns the points of the parts: always,
    /// full, coarse.
    pub fn add_alternative(&mut self, coarser: &DrawTable) -> [u64; 3] {
        let slots: HashMap<(usize, NodeId), u32> =
            coarser.draws.iter().map(|draw| ((draw.cloud, draw.node), draw.slot)).collect();
        let mut twin = vec![None; self.nodes.len()];
        for draw in &self.draws {
            twin[draw.slot as usize] = slots.get(&(draw.cloud, draw.node)).copied();
        }
        // Children stand after their parents.
        let mut is_same = vec![false; self.nodes.len()];
        for slot in (0..self.nodes.len()).rev() {
            let Some(other) = twin[slot] else { continue };
            let (mine, theirs) = (&self.nodes[slot], &coarser.nodes[other as usize]);
            let mask = mine.drawn_children & 0xff;
            let first = mine.drawn_children >> 8;
            let mut without_places = *theirs;
            without_places.drawn_children = mine.drawn_children;
            let children = first..first + mask.count_ones();
            is_same[slot] = without_places == *mine
                && theirs.drawn_children & 0xff == mask
                && (mask == 0 || children.into_iter().all(|child| is_same[child as usize]));
        }
        let mut points = [0u64; 3];
        let mut in_both: Vec<bool> = vec![false; coarser.nodes.len()];
        for draw in &mut self.draws {
            let slot = draw.slot as usize;
            draw.part = if is_same[slot] { DrawPart::Always } else { DrawPart::Full };
            points[usize::from(!is_same[slot])] += u64::from(draw.count);
            if let Some(other) = twin[slot].filter(|_| is_same[slot]) {
                in_both[other as usize] = true;
            }
        }
        let offset = self.nodes.len() as u32;
        self.nodes.extend(coarser.nodes.iter().map(|node| {
            let mut node = *node;
            node.drawn_children += offset << 8;
            node
        }));
        for draw in coarser.draws.iter().filter(|draw| !in_both[draw.slot as usize]) {
            let mut draw = *draw;
            draw.slot += offset;
            draw.part = DrawPart::Coarse;
            points[2] += u64::from(draw.count);
            self.draws.push(draw);
        }
        points
    }
}
