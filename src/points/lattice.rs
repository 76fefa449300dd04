//! The integer grid that a scan's coordinates lie on.
//!
//! Scan files of the LAS family store integers; the world position is `offset + scale * integer`.
//! Everything in a store is kept as those integers, so coordinates come back exactly.

use glam::{DVec3, I64Vec3};

/// A lattice: world position from integer coordinates, per axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// World length of one step, finite and above 0.
    pub scale: DVec3,
    /// World position of the integer origin, finite.
    pub offset: DVec3,
}

impl Lattice {
    /// World position of integer coordinates, computed as LAS readers do.
    pub fn world(&self, integers: I64Vec3) -> DVec3 {
        integers.as_dvec3() * self.scale + self.offset
    }

    /// Real-valued lattice coordinates of a world position.
    pub fn lattice(&self, world: DVec3) -> DVec3 {
        (world - self.offset) / self.scale
    }
}
