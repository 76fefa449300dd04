//! Seeded samples: points of made-up scenes and shapes, for benchmarks and tests.
//!
//! Everything here is a function of a seed and a point's number, so that any part can be made by
//! any thread at any time and comes out the same. Points are records of LAS point formats or
//! integer coordinates; files are not written here.

mod random;
pub mod records;
pub mod scene;
pub mod shapes;

pub use random::Random;
