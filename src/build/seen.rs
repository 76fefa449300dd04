//! Bounds, colours and number of some points.

use serde::{Deserialize, Serialize};

use crate::build::rows::{color_offset, read_color};
use crate::points::{Schema, record_coordinates};

/// What was seen of points.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Seen {
    /// How many they are.
    pub points: u64,
    /// Smallest coordinates on the store's lattice.
    pub min: [i64; 3],
    /// Largest coordinates on the store's lattice.
    pub max: [i64; 3],
    /// All colour channels or-ed: above 255 in 16-bit files.
    pub color_union: u16,
}

impl Default for Seen {
    /// Of no points.
    fn default() -> Self {
        Seen { points: 0, min: [i64::MAX; 3], max: [i64::MIN; 3], color_union: 0 }
    }
}

impl Seen {
    /// Looks at records; `shift` brings their coordinates to the store's lattice.
    pub fn look(&mut self, records: &[u8], schema: &Schema, shift: [i64; 3]) {
        let record_bytes = schema.record_bytes as usize;
        if records.is_empty() {
            return;
        }
        let (mut low, mut high) = ([i32::MAX; 3], [i32::MIN; 3]);
        for record in records.chunks_exact(record_bytes) {
            let position = record_coordinates(record);
            for axis in 0..3 {
                low[axis] = low[axis].min(position[axis]);
                high[axis] = high[axis].max(position[axis]);
            }
        }
        if let Some(offset) = color_offset(schema) {
            for record in records.chunks_exact(record_bytes) {
                let [r, g, b] = read_color(&record[offset..]);
                self.color_union |= r | g | b;
            }
        }
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(i64::from(low[axis]) + shift[axis]);
            self.max[axis] = self.max[axis].max(i64::from(high[axis]) + shift[axis]);
        }
        self.points += (records.len() / record_bytes) as u64;
    }

    /// Takes over what was seen of others.
    pub fn join(&mut self, other: &Seen) {
        self.points += other.points;
        self.color_union |= other.color_union;
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(other.min[axis]);
            self.max[axis] = self.max[axis].max(other.max[axis]);
        }
    }

    /// Whether all of the other's points lie within these bounds.
    pub fn encloses(&self, other: &Seen) -> bool {
        (0..3).all(|axis| self.min[axis] <= other.min[axis] && other.max[axis] <= self.max[axis])
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
