//! Normals for shapes that have none: smooth over bends, sharp at edges.

use glam::{DVec3, Vec3};

use crate::mesh::Mesh;

/// Cosine of the angle between faces (30 degrees) from which on an edge is seen as one.
const CREASE_COS: f64 = 0.866;
const NONE: u32 = u32::MAX;

impl Mesh {
    /// The shape with normals: itself if it has some, else with those of its faces, averaged by
    /// area around a vertex over faces within 30 degrees of each other. Vertices at sharper edges
    /// are doubled; triangles keep their order, and positions their values.
    pub fn with_normals(&self) -> Mesh {
        if !self.normals.is_empty() {
            return self.clone();
        }
        let mut shaded = self.clone();
        // Per vertex the first of the vertices that stand in its place, chained by `next`.
        let mut next = vec![NONE; self.positions.len()];
        let mut is_taken = vec![false; self.positions.len()];
        // The direction of the first face decides which others join; the sum is what is seen.
        let mut direction = vec![DVec3::ZERO; self.positions.len()];
        let mut sum = vec![DVec3::ZERO; self.positions.len()];
        for triangle in 0..self.triangles.len() {
            let [a, b, c] = self.corners(triangle);
            let area = (b - a).cross(c - a);
            let unit = area.normalize_or_zero();
            for corner in 0..3 {
                let mut at = self.triangles[triangle][corner] as usize;
                loop {
                    if !is_taken[at] {
                        (is_taken[at], direction[at]) = (true, unit);
                        break;
                    }
                    if direction[at].dot(unit) >= CREASE_COS {
                        break;
                    }
                    if next[at] == NONE {
                        next[at] = shaded.positions.len() as u32;
                        shaded.repeat_vertex(at);
                        next.push(NONE);
                        is_taken.push(false);
                        direction.push(DVec3::ZERO);
                        sum.push(DVec3::ZERO);
                    }
                    at = next[at] as usize;
                }
                sum[at] += area;
                shaded.triangles[triangle][corner] = at as u32;
            }
        }
        shaded.normals = sum
            .into_iter()
            .map(|sum| sum.try_normalize().unwrap_or(DVec3::Z).as_vec3().to_array())
            .collect();
        shaded
    }

    fn repeat_vertex(&mut self, vertex: usize) {
        self.positions.push(self.positions[vertex]);
        if !self.uvs.is_empty() {
            self.uvs.push(self.uvs[vertex]);
        }
        if !self.colors.is_empty() {
            self.colors.push(self.colors[vertex]);
        }
    }

    /// Makes normals unit vectors; those that have no direction point up.
    pub fn normalize_normals(&mut self) {
        for normal in &mut self.normals {
            *normal = Vec3::from(*normal).try_normalize().unwrap_or(Vec3::Z).to_array();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two triangles that share an edge; the second is tilted by `angle` about it.
    fn folded(angle: f32) -> Mesh {
        Mesh {
            positions: vec![
                [0.0, 0.0, 0.0],
                [0.0, 1.0, 0.0],
                [-1.0, 0.0, 0.0],
                [angle.cos(), 0.0, -angle.sin()],
            ],
            triangles: vec![[0, 1, 2], [1, 0, 3]],
            ..Mesh::default()
        }
    }

    #[test]
    fn bends_are_smooth_and_edges_sharp() {
        let bend = folded(0.3).with_normals();
        assert_eq!(bend.positions.len(), 4);
        assert!((Vec3::from(bend.normals[0]).dot(Vec3::Z) - 0.15f32.cos()).abs() < 1e-3);
        let edge = folded(1.2).with_normals();
        assert_eq!(edge.positions.len(), 6, "two vertices stand there twice");
        for (triangle, shown) in edge.triangles.iter().enumerate() {
            let [a, b, c] = edge.corners(triangle);
            let face = (b - a).cross(c - a).normalize();
            for &vertex in shown {
                let normal = Vec3::from(edge.normals[vertex as usize]).as_dvec3();
                assert!(normal.dot(face) > 0.999_99, "{normal} of {face}");
            }
            let before = folded(1.2);
            assert_eq!(before.corners(triangle), edge.corners(triangle));
        }
        assert_eq!(edge.check(), None);
    }

    #[test]
    fn three_faces_of_a_corner_have_a_normal_each() {
        let corner = Mesh {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2]],
            ..Mesh::default()
        };
        let shaded = corner.with_normals();
        let first: Vec<_> =
            shaded.triangles.iter().map(|t| shaded.normals[t[0] as usize]).collect();
        assert_eq!(first, [[0.0, 0.0, -1.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0]]);
    }
}
