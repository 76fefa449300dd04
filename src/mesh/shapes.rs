//! Simple solids for made-up scenes: closed, outward facing, flat shaded.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use crate::mesh::Mesh;

/// Collects faces of a solid.
#[derive(Default)]
pub(crate) struct Solid {
    mesh: Mesh,
}

impl Solid {
    /// The finished shape.
    pub fn into_mesh(self) -> Mesh {
        self.mesh
    }

    fn vertex(&mut self, position: DVec3) -> u32 {
        self.mesh.positions.push(position.as_vec3().to_array());
        self.mesh.positions.len() as u32 - 1
    }

    /// A four-cornered face, counter-clockwise seen from outside.
    pub fn quad(&mut self, corners: [DVec3; 4]) {
        let [a, b, c, d] = corners.map(|corner| self.vertex(corner));
        self.mesh.triangles.extend([[a, b, c], [a, c, d]]);
    }

    /// A block between two corners.
    pub fn block(&mut self, low: DVec3, high: DVec3) {
        let at = |x: usize, y: usize, z: usize| {
            DVec3::new([low.x, high.x][x], [low.y, high.y][y], [low.z, high.z][z])
        };
        for face in [
            [at(0, 0, 0), at(0, 1, 0), at(1, 1, 0), at(1, 0, 0)],
            [at(0, 0, 1), at(1, 0, 1), at(1, 1, 1), at(0, 1, 1)],
            [at(0, 0, 0), at(1, 0, 0), at(1, 0, 1), at(0, 0, 1)],
            [at(1, 0, 0), at(1, 1, 0), at(1, 1, 1), at(1, 0, 1)],
            [at(1, 1, 0), at(0, 1, 0), at(0, 1, 1), at(1, 1, 1)],
            [at(0, 1, 0), at(0, 0, 0), at(0, 0, 1), at(0, 1, 1)],
        ] {
            self.quad(face);
        }
    }

    /// A solid of revolution about the vertical: a closed profile of (radius, height) from bottom
    /// to top, with `sides` faces around. Ends with a radius above 0 are closed with a disc.
    pub fn revolve(&mut self, profile: &[(f64, f64)], sides: u32) {
        let ring = |side: u32, (radius, height): (f64, f64)| {
            let angle = TAU * f64::from(side % sides) / f64::from(sides);
            let around = DVec2::from_angle(angle) * radius;
            DVec3::new(around.x, around.y, height)
        };
        for side in 0..sides {
            let next = side + 1;
            for pair in profile.windows(2) {
                let (below, above) = (pair[0], pair[1]);
                match (below.0 > 0.0, above.0 > 0.0) {
                    (true, true) => self.quad([
                        ring(side, below),
                        ring(next, below),
                        ring(next, above),
                        ring(side, above),
                    ]),
                    (true, false) => {
                        self.triangle([ring(side, below), ring(next, below), ring(0, above)]);
                    }
                    (false, true) => {
                        self.triangle([ring(0, below), ring(next, above), ring(side, above)]);
                    }
                    (false, false) => {}
                }
            }
            let (bottom, top) = (profile[0], profile[profile.len() - 1]);
            if bottom.0 > 0.0 {
                self.triangle([ring(0, (0.0, bottom.1)), ring(next, bottom), ring(side, bottom)]);
            }
            if top.0 > 0.0 {
                self.triangle([ring(0, (0.0, top.1)), ring(side, top), ring(next, top)]);
            }
        }
    }

    fn triangle(&mut self, corners: [DVec3; 3]) {
        let corners = corners.map(|corner| self.vertex(corner));
        self.mesh.triangles.push(corners);
    }

    /// Takes in another solid's faces, moved.
    pub fn add(&mut self, other: Solid, offset: DVec3) {
        let from = self.mesh.positions.len() as u32;
        for position in other.mesh.positions {
            self.vertex(glam::Vec3::from(position).as_dvec3() + offset);
        }
        self.mesh.triangles.extend(other.mesh.triangles.iter().map(|t| t.map(|v| v + from)));
    }
}

/// A block centred on the origin.
pub(crate) fn block(size: DVec3) -> Mesh {
    let mut solid = Solid::default();
    solid.block(-0.5 * size, 0.5 * size);
    solid.into_mesh()
}

/// A cylinder of radius 1 standing on the origin, 1 high.
pub(crate) fn cylinder(sides: u32) -> Mesh {
    let mut solid = Solid::default();
    solid.revolve(&[(1.0, 0.0), (1.0, 1.0)], sides);
    solid.into_mesh()
}

/// A sphere of radius 1 about the origin.
pub(crate) fn sphere(rings: u32, sides: u32) -> Mesh {
    let mut solid = Solid::default();
    solid.revolve(&sphere_profile(rings), sides);
    solid.into_mesh()
}

/// Profile of a unit sphere for [`Solid::revolve`].
pub(crate) fn sphere_profile(rings: u32) -> Vec<(f64, f64)> {
    let step = std::f64::consts::PI / f64::from(rings);
    (0..=rings)
        .map(|ring| {
            let angle = step * f64::from(ring);
            let radius = if ring == 0 || ring == rings { 0.0 } else { angle.sin() };
            (radius, -angle.cos())
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six times the enclosed volume: positive when faces look outward.
    fn volume(mesh: &Mesh) -> f64 {
        let of = |t| {
            let [a, b, c] = mesh.corners(t);
            a.dot(b.cross(c)) / 6.0
        };
        (0..mesh.triangles.len()).map(of).sum()
    }

    #[test]
    fn solids_are_closed_and_look_outward() {
        assert!((volume(&block(DVec3::new(1.0, 2.0, 3.0))) - 6.0).abs() < 1e-5);
        let round = volume(&cylinder(64));
        assert!((round - std::f64::consts::PI).abs() < 0.01, "{round}");
        let ball = volume(&sphere(32, 64));
        assert!((ball - 4.0 / 3.0 * std::f64::consts::PI).abs() < 0.03, "{ball}");
        for mesh in [block(DVec3::ONE), cylinder(7), sphere(5, 9)] {
            assert_eq!(mesh.check(), None);
            let balance: DVec3 = (0..mesh.triangles.len())
                .map(|t| {
                    let [a, b, c] = mesh.corners(t);
                    (b - a).cross(c - a)
                })
                .sum();
            assert!(balance.length() < 1e-5, "areas of a closed surface cancel");
        }
    }
}
