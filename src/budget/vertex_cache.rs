//! How many vertices of an index list a GPU really transforms.
//!
//! The index list is replayed through the cache between vertex shader and triangles; a vertex
//! counts each time it is not found there.

use std::collections::HashMap;

/// What is known of vertices that were transformed already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VertexCache {
    /// The last so many transformed vertices, first in, first out (the paper's hardware; 16 to
    /// 32).
    Fifo(u32),
    /// The indices of one batch with at most so many different ones; nothing is kept from batch to
    /// batch (current hardware; 32, after Kerbl, Kenzel et al., "Revisiting the Vertex Cache",
    /// 2018).
    Batch(u32),
}

/// Vertices transformed for an index list. `restart` is the index that ends a strip; it counts for
/// nothing.
pub fn transformed_vertices(indices: &[u32], restart: Option<u32>, cache: VertexCache) -> u64 {
    let drawn = indices.iter().filter(|&&index| Some(index) != restart);
    match cache {
        VertexCache::Fifo(size) => {
            // A vertex is still there if fewer than `size` others came in after it; `misses` has
            // moved on by one for the vertex itself.
            let mut entered: HashMap<u32, u64> = HashMap::new();
            let mut misses = 0u64;
            for &index in drawn {
                let is_there =
                    entered.get(&index).is_some_and(|&at| misses - at <= u64::from(size));
                if !is_there {
                    entered.insert(index, misses);
                    misses += 1;
                }
            }
            misses
        }
        VertexCache::Batch(size) => {
            let mut batch: Vec<u32> = Vec::new();
            let mut transformed = 0u64;
            for &index in drawn {
                if batch.contains(&index) {
                    continue;
                }
                if batch.len() as u64 >= u64::from(size.max(1)) {
                    batch.clear();
                }
                batch.push(index);
                transformed += 1;
            }
            transformed
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::Random;
    use std::collections::VecDeque;

    fn brute_force(indices: &[u32], size: usize) -> u64 {
        let mut fifo = VecDeque::new();
        let mut misses = 0;
        for index in indices {
            if !fifo.contains(index) {
                misses += 1;
                fifo.push_back(*index);
                if fifo.len() > size {
                    fifo.pop_front();
                }
            }
        }
        misses
    }

    /// Two strips over six vertices: 9 indices, 5 triangles, 6 transformed vertices.
    #[test]
    fn the_strip_of_the_paper_transforms_each_vertex_once() {
        const R: u32 = u32::MAX;
        let strip = [0, 1, 2, 3, 4, 5, R, 5, 4, 2];
        assert_eq!(strip.iter().filter(|&&index| index != R).count(), 9);
        for cache in [VertexCache::Fifo(16), VertexCache::Fifo(32), VertexCache::Batch(32)] {
            assert_eq!(transformed_vertices(&strip, Some(R), cache), 6);
        }
    }

    /// Row by row, a cache that holds two rows transforms each vertex of a grid once; one that is
    /// smaller than a row transforms nearly all of them twice.
    #[test]
    fn grids_transform_once_or_twice() {
        let (columns, rows) = (12u32, 9u32);
        let mut triangles = Vec::new();
        for (y, x) in (0..rows).flat_map(|y| (0..columns).map(move |x| (y, x))) {
            let corner = y * (columns + 1) + x;
            let below = corner + columns + 1;
            triangles.extend([corner, corner + 1, below, corner + 1, below + 1, below]);
        }
        let vertices = u64::from((columns + 1) * (rows + 1));
        assert_eq!(transformed_vertices(&triangles, None, VertexCache::Fifo(32)), vertices);
        let twice = vertices + u64::from((columns + 1) * (rows - 1));
        assert_eq!(transformed_vertices(&triangles, None, VertexCache::Fifo(8)), twice);
    }

    #[test]
    fn random_lists_agree_with_a_real_queue() {
        for case in 0..200 {
            let mut random = Random::new(1, case);
            let vertices = 1 + random.below(80);
            let count = random.below(600);
            let indices: Vec<u32> = (0..count).map(|_| random.below(vertices) as u32).collect();
            for size in [1, 3, 16, 24, 32] {
                let counted = transformed_vertices(&indices, None, VertexCache::Fifo(size));
                assert_eq!(counted, brute_force(&indices, size as usize), "{size}: {indices:?}");
            }
        }
    }

    #[test]
    fn lists_without_triangles_and_caches_without_room_are_fine() {
        assert_eq!(transformed_vertices(&[], None, VertexCache::Fifo(16)), 0);
        assert_eq!(transformed_vertices(&[7, 7], Some(7), VertexCache::Batch(32)), 0);
        assert_eq!(transformed_vertices(&[1, 1, 1], None, VertexCache::Fifo(0)), 3);
        assert_eq!(transformed_vertices(&[1, 1, 1], None, VertexCache::Batch(0)), 1);
    }
}
