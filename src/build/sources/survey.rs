//! What one pass over all points tells.

use crate::build::rows::{color_offset, read_color};
use crate::build::sources::Batch;
use crate::points::{Schema, record_coordinates};

/// What one pass over all points tells.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Survey {
    /// Points seen.
    pub points: u64,
    /// Smallest coordinates on the store's lattice.
    pub min: [i64; 3],
    /// Largest coordinates on the store's lattice.
    pub max: [i64; 3],
    /// All colour channels or-ed: above 255 in 16-bit files.
    pub color_union: u16,
}

impl Survey {
    /// Of nothing.
    pub fn empty() -> Self {
        Survey { points: 0, min: [i64::MAX; 3], max: [i64::MIN; 3], color_union: 0 }
    }

    /// Of one batch.
    pub fn of(batch: &Batch, schema: &Schema) -> Self {
        let (mut low, mut high) = ([i32::MAX; 3], [i32::MIN; 3]);
        let mut color_union = 0;
        let color = color_offset(schema);
        for record in batch.records.chunks_exact(schema.record_bytes as usize) {
            let position = record_coordinates(record);
            for axis in 0..3 {
                low[axis] = low[axis].min(position[axis]);
                high[axis] = high[axis].max(position[axis]);
            }
            if let Some(offset) = color {
                let [r, g, b] = read_color(&record[offset..]);
                color_union |= r | g | b;
            }
        }
        if batch.rows.len() == 0 {
            return Survey::empty();
        }
        let shifted = |v: [i32; 3]| [0, 1, 2].map(|axis| i64::from(v[axis]) + batch.shift[axis]);
        Survey {
            points: batch.rows.len() as u64,
            min: shifted(low),
            max: shifted(high),
            color_union,
        }
    }

    /// Of both.
    pub fn join(self, other: &Survey) -> Survey {
        Survey {
            points: self.points + other.points,
            min: [0, 1, 2].map(|axis| self.min[axis].min(other.min[axis])),
            max: [0, 1, 2].map(|axis| self.max[axis].max(other.max[axis])),
            color_union: self.color_union | other.color_union,
        }
    }

    /// Bits per axis of a cube that holds all points and has at least `depth + 1` levels.
    pub fn root_bits(&self, depth: u32) -> u32 {
        let extent = (0..3)
            .map(|axis| i128::from(self.max[axis]) - i128::from(self.min[axis]))
            .max()
            .unwrap_or(0)
            .max(0);
        (128 - extent.leading_zeros()).max(depth + 1)
    }
}
