//! Decides which nodes are drawn, how many points of each, and what to ask for.
//!
//! Pure arithmetic over the octree in memory: no files, no GPU, no clock.
