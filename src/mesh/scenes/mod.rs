//! Scenes from a seed, of any size, for culling and shadow benchmarks and for trying things out.
//!
//! Each is a [`Model`] with places to look from. Surfaces of different objects never coincide, so
//! pictures do not depend on the order of drawing. The same seed and size give the same scene.
//! Units: metres, z up.

mod city;
mod interiors;
mod landscape;
mod paths;
mod surface;
mod trials;

pub use paths::{CameraPath, camera_path};
pub use surface::{SurfacePoint, SurfaceSampler};

use glam::{DAffine3, DQuat, DVec3};

use crate::ids::{MaterialId, MeshId};
use crate::mesh::{Material, Mesh, Model, Object};

/// Which scene to make.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum SceneKind {
    /// Blocks of houses with street furniture; `size` blocks along each side.
    City,
    /// Stacked rooms with doors and furniture; `size` rooms along each axis.
    Rooms,
    /// Hills with forest; `size` patches along each side.
    Terrain,
    /// Pipes, tanks and floors in a frame; about 160 objects for each unit of `size`.
    Pipes,
    /// Random boxes; `size` of them.
    Boxes,
    /// Closed shells inside each other; `size` of them.
    Shells,
    /// A wall with one window and boxes behind it; `size` boxes.
    Window,
    /// A field of plates that each hide a block right behind; `size` of them along each side.
    Plates,
    /// Plates at many depths that each hide ten blocks; `size` of them along each side.
    Field,
    /// Pairs of cubes behind a wall with a slit: every box shows through it, and no cube; `size`
    /// pairs, their boxes inside each other.
    Slit,
}

impl SceneKind {
    /// All kinds.
    pub const ALL: [SceneKind; 10] = [
        SceneKind::City,
        SceneKind::Rooms,
        SceneKind::Terrain,
        SceneKind::Pipes,
        SceneKind::Boxes,
        SceneKind::Shells,
        SceneKind::Window,
        SceneKind::Plates,
        SceneKind::Field,
        SceneKind::Slit,
    ];

    /// The name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            SceneKind::City => "city",
            SceneKind::Rooms => "rooms",
            SceneKind::Terrain => "terrain",
            SceneKind::Pipes => "pipes",
            SceneKind::Boxes => "boxes",
            SceneKind::Shells => "shells",
            SceneKind::Window => "window",
            SceneKind::Plates => "plates",
            SceneKind::Field => "field",
            SceneKind::Slit => "slit",
        }
    }

    /// What there is to see, in a line.
    pub fn description(self) -> &'static str {
        match self {
            SceneKind::City => "Surfaces of a city: streets, houses, trees, lamps",
            SceneKind::Rooms => "Stacked rooms with doors and furniture",
            SceneKind::Terrain => "Hills with forest",
            SceneKind::Pipes => "A plant of pipes and tanks",
            SceneKind::Boxes => "Random boxes",
            SceneKind::Shells => "Closed shells inside each other",
            SceneKind::Window => "A wall with one window and boxes behind it",
            SceneKind::Plates => "Plates that each hide a block",
            SceneKind::Field => "Plates at many depths that each hide ten blocks",
            SceneKind::Slit => "Pairs of cubes behind a wall with a slit",
        }
    }

    /// A size that gives a scene of some thousand objects.
    pub fn usual_size(self) -> u32 {
        match self {
            SceneKind::City => 12,
            SceneKind::Rooms => 8,
            SceneKind::Terrain => 16,
            SceneKind::Pipes => 130,
            SceneKind::Boxes => 5000,
            SceneKind::Shells => 24,
            SceneKind::Window => 4000,
            SceneKind::Plates => 72,
            SceneKind::Field => 76,
            SceneKind::Slit => 2000,
        }
    }

    /// Makes the scene.
    pub fn make(self, size: u32, seed: u64) -> ModelScene {
        let size = size.max(1);
        match self {
            SceneKind::City => city::city(size, seed),
            SceneKind::Rooms => interiors::rooms(size, seed),
            SceneKind::Terrain => landscape::terrain(size, seed),
            SceneKind::Pipes => interiors::pipes(size, seed),
            SceneKind::Boxes => trials::boxes(size, seed),
            SceneKind::Shells => trials::shells(size),
            SceneKind::Window => trials::window(size, seed),
            SceneKind::Plates => trials::plates(size),
            SceneKind::Field => trials::field(size, seed),
            SceneKind::Slit => trials::slit(size),
        }
    }
}

/// A model, and where to stand in it.
#[derive(Clone, Debug)]
pub struct ModelScene {
    /// What is there.
    pub model: Model,
    /// Places one behind the other that a walk goes through, at eye height.
    pub walk: Vec<DVec3>,
    /// Height that is above everything.
    pub roof: f64,
}

/// Puts a scene together.
#[derive(Default)]
struct Maker {
    model: Model,
}

impl Maker {
    fn mesh(&mut self, mesh: Mesh) -> MeshId {
        self.model.meshes.push(mesh);
        MeshId(self.model.meshes.len() as u32 - 1)
    }

    fn material(&mut self, color: [u8; 3]) -> MaterialId {
        let [r, g, b] = color;
        self.model.materials.push(Material { color: [r, g, b, 255], ..Material::default() });
        MaterialId(self.model.materials.len() as u32 - 1)
    }

    fn place(&mut self, mesh: MeshId, material: MaterialId, world_from_mesh: DAffine3) {
        self.model.objects.push(Object { mesh, material, world_from_mesh });
    }

    fn finish(self, walk: Vec<DVec3>) -> ModelScene {
        let roof = self.model.bounds().max.z + 1.0;
        ModelScene { model: self.model, walk, roof }
    }
}

/// A placement: stretched, turned about the vertical, moved.
fn placed(size: DVec3, turn: f64, at: DVec3) -> DAffine3 {
    DAffine3::from_scale_rotation_translation(size, DQuat::from_rotation_z(turn), at)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_are_sound_and_repeat() {
        for kind in SceneKind::ALL {
            let size = kind.usual_size().clamp(4, 40) / 2;
            let scene = kind.make(size, 3);
            assert_eq!(scene.model.check(), Ok(()), "{}", kind.name());
            assert!(!scene.model.is_empty() && scene.walk.len() >= 2, "{}", kind.name());
            let again = kind.make(size, 3);
            assert_eq!(scene.model.objects, again.model.objects, "{}", kind.name());
            assert!(scene.model.bounds().max.z < scene.roof);
        }
    }

    #[test]
    fn usual_sizes_hold_thousands_of_objects() {
        for (kind, least) in [
            (SceneKind::City, 5_000),
            (SceneKind::Rooms, 3_000),
            (SceneKind::Terrain, 3_000),
            (SceneKind::Pipes, 20_000),
            (SceneKind::Field, 50_000),
        ] {
            let scene = kind.make(kind.usual_size(), 1);
            let (objects, triangles) = (scene.model.objects.len(), scene.model.triangle_count());
            assert!(objects >= least, "{}: {objects} objects", kind.name());
            assert!(triangles > 10 * objects as u64);
        }
    }
}
