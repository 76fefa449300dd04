//! Proves from the file where the points of each source went: in = kept + dropped.

use rayon::prelude::*;

use crate::ids::NodeId;
use crate::points::{Scalar, names};
use crate::store::{NodeReadError, Store};

/// What does not add up, in words; nothing where everything does.
///
/// With several sources the points of each are counted by the attribute `source`. Stores without
/// it (version 1 of several files) are only checked as a whole.
pub(super) fn account(store: &Store) -> Vec<String> {
    let metadata = store.metadata();
    let mut wrong = Vec::new();
    let sum = |of: fn(&crate::store::SourceInfo) -> u64| -> u64 {
        metadata.sources.iter().map(of).fold(0, u64::saturating_add)
    };
    let (came_in, dropped) = (sum(|s| s.points), sum(|s| s.dropped_points()));
    if came_in != metadata.points.saturating_add(metadata.dropped_points) {
        wrong.push(format!(
            "{came_in} points came in, {} are here and {} were dropped",
            metadata.points, metadata.dropped_points
        ));
    }
    if dropped != metadata.dropped_points {
        wrong.push(format!(
            "{} points were dropped, the sources give reasons for {dropped}",
            metadata.dropped_points
        ));
    }
    match kept_of_sources(store) {
        None => {}
        // A section that cannot be read was told with its node.
        Some(Err(_)) => {}
        Some(Ok(kept)) => {
            let (kept, unknown) = kept.split_at(metadata.sources.len());
            for (i, (source, kept)) in metadata.sources.iter().zip(kept).enumerate() {
                let dropped = source.dropped_points();
                if source.points != kept.saturating_add(dropped) {
                    wrong.push(format!(
                        "source {i} ({}): {} points came in, {kept} are here and {dropped} were \
                         dropped",
                        source.name, source.points
                    ));
                }
            }
            if unknown.iter().any(|&points| points > 0) {
                wrong.push(format!("{} points are of no source", unknown.iter().sum::<u64>()));
            }
        }
    }
    wrong
}

/// Points of each source, and last those of none; nothing where points do not tell.
fn kept_of_sources(store: &Store) -> Option<Result<Vec<u64>, NodeReadError>> {
    let metadata = store.metadata();
    let sources = metadata.sources.len();
    let (index, attribute) = metadata.schema.find(names::SOURCE)?;
    let is_index = matches!(attribute.scalar, Scalar::U16 | Scalar::U32);
    if sources < 2 || attribute.components != 1 || !is_index {
        return None;
    }
    let nodes: Vec<NodeId> = (0..store.octree().nodes().len() as u32).map(NodeId).collect();
    let none = || vec![0u64; sources + 1];
    // Few pieces, because each has counts of its own.
    let piece = nodes.len().div_ceil(4 * rayon::current_num_threads()).max(1);
    let counted = nodes.par_chunks(piece).map(|nodes| {
        let (mut kept, mut column) = (none(), Vec::new());
        for &node in nodes {
            store.read_attribute(node, index, &mut column)?;
            for value in column.chunks_exact(attribute.scalar.bytes()) {
                let source = attribute.scalar.read(value) as usize;
                kept[source.min(sources)] += 1;
            }
        }
        Ok(kept)
    });
    let join = |a: Vec<u64>, b: Vec<u64>| Ok(a.iter().zip(&b).map(|(a, b)| a + b).collect());
    Some(counted.try_reduce(none, join))
}
