//! New points of a batch, read into rows.

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use crate::build::BuildError;
use crate::build::progress::Progress;
use crate::build::rows::{RowLayout, color_offset, read_color};
use crate::build::sources::Sources;
use crate::geometry::MortonKey;
use crate::input::{Block, BlockBuffer};
use crate::points::{COORDINATE_BYTES, record_coordinates};
use crate::store::Metadata;

/// What was read.
pub struct Arrivals {
    /// Rows in order of arrival.
    pub rows: Vec<u8>,
    /// Points of each block.
    pub block_points: Vec<u64>,
    /// Smallest and largest lattice coordinates.
    pub bounds: [[i64; 3]; 2],
}

/// Rows of one block.
struct BlockRows {
    rows: Vec<u8>,
    points: u64,
    bounds: [[i64; 3]; 2],
}

const NO_BOUNDS: [[i64; 3]; 2] = [[i64::MAX; 3], [i64::MIN; 3]];

/// Reads blocks into rows; the first point has that index. What the store has no room for is an
/// error.
pub fn read_arrivals<K: MortonKey>(
    sources: &Sources,
    blocks: &[(usize, &Block)],
    store: &Metadata,
    layout: RowLayout,
    first_index: u64,
    progress: &dyn Progress,
    cancelled: &AtomicBool,
) -> Result<Arrivals, BuildError> {
    let read = |buffer: &mut BlockBuffer, &(source, block): &(usize, &Block)| {
        if cancelled.load(Ordering::Relaxed) {
            return Err(BuildError::Interrupted);
        }
        let mut found = BlockRows { rows: Vec::new(), points: 0, bounds: NO_BOUNDS };
        sources.read_block(source, block, buffer, &mut |records| {
            take::<K>(sources, source, records, store, layout, &mut found)?;
            progress.advance((records.len() / store.schema.record_bytes as usize) as u64);
            Ok(())
        })?;
        Ok(found)
    };
    // All of them, so that the first error in the order of blocks is told, whatever the threads do.
    let found: Vec<_> = blocks.par_iter().map_init(BlockBuffer::default, read).collect();
    let found = found.into_iter().collect::<Result<Vec<BlockRows>, BuildError>>()?;
    let mut arrivals = Arrivals {
        rows: Vec::with_capacity(found.iter().map(|block| block.rows.len()).sum()),
        block_points: Vec::with_capacity(found.len()),
        bounds: NO_BOUNDS,
    };
    let mut index = first_index;
    for mut block in found {
        for row in block.rows.chunks_exact_mut(layout.stride()) {
            layout.set_index::<K>(row, index);
            index += 1;
        }
        arrivals.rows.append(&mut block.rows);
        arrivals.block_points.push(block.points);
        arrivals.bounds = joined(arrivals.bounds, block.bounds);
    }
    Ok(arrivals)
}

/// The smallest box around two.
pub fn joined(a: [[i64; 3]; 2], b: [[i64; 3]; 2]) -> [[i64; 3]; 2] {
    let axes = [0, 1, 2];
    [axes.map(|i| a[0][i].min(b[0][i])), axes.map(|i| a[1][i].max(b[1][i]))]
}

fn take<K: MortonKey>(
    sources: &Sources,
    source: usize,
    records: &[u8],
    store: &Metadata,
    layout: RowLayout,
    found: &mut BlockRows,
) -> Result<(), BuildError> {
    let refused = |reason: String| BuildError::Outgrown {
        reason,
        path: sources.scans()[source].path().into(),
    };
    let (shift, edge) = (sources.shift(source), 1i64 << store.root_bits);
    let color = color_offset(&store.schema).filter(|_| store.color_bits == Some(8));
    let record_bytes = store.schema.record_bytes as usize;
    let stride = layout.stride();
    let start = found.rows.len();
    found.rows.resize(start + records.len() / record_bytes * stride, 0);
    let rows = found.rows[start..].chunks_exact_mut(stride);
    for (row, record) in rows.zip(records.chunks_exact(record_bytes)) {
        let position = record_coordinates(record);
        let mut cell = [0; 3];
        for axis in 0..3 {
            let steps = i64::from(position[axis]) + shift[axis];
            found.bounds[0][axis] = found.bounds[0][axis].min(steps);
            found.bounds[1][axis] = found.bounds[1][axis].max(steps);
            let local = steps - store.root_min[axis];
            if !(0..edge).contains(&local) {
                return Err(refused(format!(
                    "it has points outside of the store's cube (coordinate {} of axis {}, the cube \
                     reaches from {} to {})",
                    world(store, axis, steps),
                    ["x", "y", "z"][axis],
                    world(store, axis, store.root_min[axis]),
                    world(store, axis, store.root_min[axis] + edge - 1),
                )));
            }
            cell[axis] = local as u32;
        }
        if let Some(offset) = color {
            let [r, g, b] = read_color(&record[offset..]);
            if r | g | b > 0xff {
                return Err(refused("it has colours of 16 bits, the store of 8".into()));
            }
        }
        layout.write(row, K::encode(cell), 0, &record[COORDINATE_BYTES..]);
        found.points += 1;
    }
    Ok(())
}

fn world(store: &Metadata, axis: usize, steps: i64) -> f64 {
    store.offset[axis] + store.scale[axis] * steps as f64
}
