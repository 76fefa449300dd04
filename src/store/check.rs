//! Verifies a store: every byte against its checksum, and the invariants of the octree.
//!
//! Per node: points lie in their cell, each level is in Morton order, the box is tight, and level
//! `i` shows exactly one point per occupied cell (checked over the node's own points, which
//! include one for each cell that was ever occupied). Over the tree: no child below the threshold.

use std::path::Path;

use glam::UVec3;
use rayon::prelude::*;

use crate::geometry::MortonKey;
use crate::ids::NodeId;
use crate::store::account::account;
use crate::store::metadata::{Metadata, NARROW_BITS, SectionContent};
use crate::store::{Store, StoreError};

/// One thing that is wrong with a store.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Finding {
    /// The damaged node, or none if the damage is elsewhere.
    pub node: Option<u32>,
    /// What is wrong and where.
    pub message: String,
}

/// What a check looked at and what it found.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct CheckReport {
    /// Nodes read.
    pub nodes: u64,
    /// Points read.
    pub points: u64,
    /// Bytes of the file, all of them read.
    pub bytes: u64,
    /// All that is wrong, in node order.
    pub findings: Vec<Finding>,
}

/// Reads all of a store. An error means that it could not even be opened.
pub fn check(path: &Path) -> Result<CheckReport, StoreError> {
    let store = Store::open(path)?;
    let mut report = CheckReport { bytes: store.header().file_bytes, ..CheckReport::default() };
    let node_ids: Vec<NodeId> = (0..store.octree().nodes().len() as u32).map(NodeId).collect();
    let found: Vec<Vec<String>> =
        node_ids.par_iter().map(|&node| check_node(&store, node)).collect();
    for (id, messages) in node_ids.iter().zip(found) {
        report.nodes += 1;
        report.points += u64::from(store.octree().node(*id).point_count());
        let finding = |message| Finding { node: Some(id.0), message };
        report.findings.extend(messages.into_iter().map(finding));
    }
    for message in check_tree(&store) {
        report.findings.push(message);
    }
    let of_sources = account(&store).into_iter().chain(check_appendix(&store));
    for message in of_sources.chain(store.leftovers()) {
        report.findings.push(Finding { node: None, message });
    }
    Ok(report)
}

fn check_node(store: &Store, id: NodeId) -> Vec<String> {
    let mut wrong = Vec::new();
    let mut bytes = Vec::new();
    for (i, section) in store.metadata().sections.iter().enumerate() {
        if section.content == SectionContent::Positions {
            continue;
        }
        if let Err(error) = store.read_section(id, i, &mut bytes) {
            wrong.push(error.to_string());
        }
    }
    let mut words = Vec::new();
    match store.read_positions(id, &mut words) {
        Err(error) => wrong.push(error.to_string()),
        Ok(()) => {
            let bits = store.octree().local_bits(id);
            let codes = local_codes(&words, bits);
            if let Err(what) = check_points(store, id, &codes) {
                wrong.push(format!("node {id} (level {}): {what}", store.octree().node(id).depth));
            }
        }
    }
    wrong
}

/// Local Morton codes of positions as stored.
fn local_codes(words: &[u32], local_bits: u32) -> Vec<u128> {
    if local_bits <= NARROW_BITS {
        let code = |w: &[u32]| u128::from(w[0]) | u128::from(w[1]) << 32;
        words.chunks_exact(2).map(code).collect()
    } else {
        words.chunks_exact(3).map(|w| u128::encode([w[0], w[1], w[2]])).collect()
    }
}

fn check_points(store: &Store, id: NodeId, codes: &[u128]) -> Result<(), String> {
    let octree = store.octree();
    let (node, bits, depth) = (octree.node(id), octree.local_bits(id), octree.depth());
    if let Some(outside) = codes.iter().position(|code| code.ancestor(bits) != 0) {
        return Err(format!("point {outside} lies outside its cell"));
    }
    let mut tight = [UVec3::MAX, UVec3::ZERO];
    for code in codes {
        let local = UVec3::from(code.decode());
        tight = [tight[0].min(local), tight[1].max(local)];
    }
    if tight != [node.tight_min, node.tight_max] {
        return Err("the box of its points is not what the directory says".into());
    }
    let mut start = 0;
    for &total in node.levels.totals() {
        let level = &codes[start as usize..total as usize];
        if !level.is_sorted() {
            return Err("a level is not in Morton order".into());
        }
        start = total;
    }
    let mut sorted = codes.to_vec();
    sorted.sort_unstable();
    for level in 0..depth {
        let distinct = |sorted: &[u128]| {
            let cells =
                sorted.chunk_by(|a, b| a.ancestor(bits - level) == b.ancestor(bits - level));
            cells.count()
        };
        let shown = node.levels.prefix_len(level) as usize;
        let mut prefix = codes[..shown].to_vec();
        prefix.sort_unstable();
        let (in_prefix, in_node) = (distinct(&prefix), distinct(&sorted));
        if in_prefix != shown || in_node != shown {
            return Err(format!(
                "level {level} shows {shown} points in {in_prefix} cells, {in_node} are occupied"
            ));
        }
    }
    Ok(())
}

fn check_tree(store: &Store) -> Vec<Finding> {
    let (octree, metadata): (_, &Metadata) = (store.octree(), store.metadata());
    let mut subtree: Vec<u64> =
        octree.nodes().iter().map(|node| u64::from(node.point_count())).collect();
    let mut findings = Vec::new();
    for (i, node) in octree.nodes().iter().enumerate().rev() {
        if let Some(parent) = node.parent {
            subtree[parent.index()] += subtree[i];
            if subtree[i] < u64::from(metadata.threshold) {
                findings.push(Finding {
                    node: Some(i as u32),
                    message: format!(
                        "node {i} (level {}): {} points below it, {} make a child",
                        node.depth, subtree[i], metadata.threshold
                    ),
                });
            }
        }
    }
    findings.reverse();
    findings
}

fn check_appendix(store: &Store) -> Option<String> {
    let part = store.header().appendix;
    let sources = &store.metadata().sources;
    let stated: u64 = sources.iter().map(|s| s.header_bytes + s.vlr_bytes + s.evlr_bytes).sum();
    let place = format!("appendix (bytes {}..{})", part.offset, part.offset + part.bytes);
    match store.checksum_of(part) {
        Err(error) => Some(format!("{place}: {error}")),
        Ok(found) if found != part.checksum => {
            Some(format!("{place}: checksum {found:08x}, header says {:08x}", part.checksum))
        }
        Ok(_) if stated != part.bytes => {
            Some(format!("{place}: the sources' records have {stated} bytes"))
        }
        Ok(_) => None,
    }
}
