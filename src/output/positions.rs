//! World positions of rows, as exact as the scan's file had them.

use glam::{DVec3, I64Vec3};

use super::decimal::{DecimalAxis, append_double};
use crate::points::{Lattice, Scalar, Schema, exact_position, names, record_coordinates};

/// Where the points of rows are.
#[derive(Clone, Debug)]
pub struct Positions {
    lattice: Lattice,
    origin: I64Vec3,
    /// Place and type of what is missing to the exact floats.
    residual: Option<(usize, Scalar)>,
    /// All three, or none.
    decimals: Option<[DecimalAxis; 3]>,
    is_single: bool,
}

impl Positions {
    /// For rows of a schema whose coordinates count from `origin` on the lattice and lie within
    /// `bounds` on it.
    pub fn new(lattice: Lattice, origin: I64Vec3, schema: &Schema, bounds: [I64Vec3; 2]) -> Self {
        let residual = schema.find(names::COORDINATE_RESIDUAL).map(|(_, attribute)| attribute);
        let residual = residual.map(|a| (a.record_offset as usize, a.scalar));
        let axes = [0, 1, 2].map(|i| DecimalAxis::new(lattice.scale[i], lattice.offset[i]));
        let decimals = match (residual, axes) {
            (None, [Some(x), Some(y), Some(z)]) => Some([x, y, z]),
            _ => None,
        };
        let is_single = match residual {
            Some((_, scalar)) => scalar == Scalar::I32,
            None => (0..3).all(|axis| singles_suffice(&lattice, bounds, axis)),
        };
        Positions { lattice, origin, residual, decimals, is_single }
    }

    /// Whether single precision tells every position exactly.
    pub fn is_single(&self) -> bool {
        self.is_single
    }

    /// The position of a row.
    pub fn of(&self, row: &[u8]) -> DVec3 {
        let world = self.lattice.world(self.steps(row));
        match self.residual {
            Some((at, scalar)) => exact_position(scalar, world, &row[at..]),
            None => world,
        }
    }

    /// Appends the three coordinates of a row as text.
    pub(super) fn append(&self, row: &[u8], separator: u8, out: &mut Vec<u8>) {
        let steps = self.steps(row);
        let world = if self.decimals.is_some() { DVec3::ZERO } else { self.of(row) };
        for axis in 0..3 {
            if axis > 0 {
                out.push(separator);
            }
            match &self.decimals {
                Some(decimals) => decimals[axis].append(steps[axis], out),
                None => append_double(world[axis], out),
            }
        }
    }

    fn steps(&self, row: &[u8]) -> I64Vec3 {
        I64Vec3::from_array(record_coordinates(row).map(i64::from)) + self.origin
    }
}

/// Whether all coordinates of an axis are multiples of a power of two and have at most 24 bits.
fn singles_suffice(lattice: &Lattice, bounds: [I64Vec3; 2], axis: usize) -> bool {
    let (scale, offset) = (lattice.scale[axis], lattice.offset[axis]);
    let is_power_of_two = scale.to_bits() & ((1 << 52) - 1) == 0;
    let whole = offset / scale;
    let is_single_range = (1e-30..1e30).contains(&scale);
    let fits = |steps: i64| (steps as f64 + whole).abs() <= f64::from(1 << 24);
    is_power_of_two
        && is_single_range
        && whole.fract() == 0.0
        && bounds.iter().all(|b| fits(b[axis]))
}
