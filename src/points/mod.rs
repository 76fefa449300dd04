//! Points as they travel: records of a scan, their columns, and the lattice of their coordinates.

mod lattice;
mod residual;
mod schema;

pub use lattice::Lattice;
pub use residual::{exact_position, residual_bytes, write_residual};
pub use schema::{Attribute, COORDINATE_BYTES, Scalar, Schema, names, record_coordinates};
