//! Points as they travel: records of a scan, their columns, and the lattice of their coordinates.

mod lattice;
mod schema;

pub use lattice::Lattice;
pub use schema::{Attribute, COORDINATE_BYTES, Scalar, Schema, names, record_coordinates};
