//! A scene of models: shapes, what they are made of, and where they stand.

use glam::{DAffine3, DVec3};
use thiserror::Error;

use crate::geometry::Aabb;
use crate::ids::{MaterialId, MeshId, ObjectId, TextureId};
use crate::mesh::Mesh;

/// What a surface looks like.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Colour and opacity, sRGB; multiplied with texture and vertex colours.
    pub color: [u8; 4],
    /// Picture on the surface.
    pub texture: Option<TextureId>,
    /// Fragments less opaque than this are left out; `None`: all are drawn.
    pub alpha_cutoff: Option<f32>,
    /// Whether the back of a triangle is seen.
    pub double_sided: bool,
}

impl Default for Material {
    fn default() -> Self {
        Material {
            color: [200, 200, 200, 255],
            texture: None,
            alpha_cutoff: None,
            double_sided: true,
        }
    }
}

/// A picture, sRGB with opacity, rows from the top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Texture {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` pixels.
    pub pixels: Vec<[u8; 4]>,
}

/// A shape in its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Object {
    /// The shape.
    pub mesh: MeshId,
    /// What it is made of.
    pub material: MaterialId,
    /// Where it stands: world coordinates (metres, f64) from the shape's own.
    pub world_from_mesh: DAffine3,
}

/// Shapes, materials, pictures, and the objects made of them.
#[derive(Clone, Debug, Default)]
pub struct Model {
    /// Shapes.
    pub meshes: Vec<Mesh>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Pictures that materials name.
    pub textures: Vec<Texture>,
    /// What is drawn.
    pub objects: Vec<Object>,
}

/// Why a model is not sound.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum ModelError {
    /// A shape breaks its promises.
    #[error("mesh {mesh}: {reason}")]
    Mesh {
        /// Which shape.
        mesh: usize,
        /// What is wrong.
        reason: String,
    },
    /// An object or material names something that is not there.
    #[error("{owner} {index} names {what} {named}, there are {count}")]
    Missing {
        /// Kind of the one that names.
        owner: &'static str,
        /// Its number.
        index: usize,
        /// Kind of the one named.
        what: &'static str,
        /// Its number.
        named: u32,
        /// How many there are.
        count: usize,
    },
    /// An object's placement is not finite.
    #[error("object {object}: its placement is not finite")]
    Placement {
        /// Which object.
        object: usize,
    },
}

impl Model {
    /// Whether nothing would be drawn.
    pub fn is_empty(&self) -> bool {
        self.objects.is_empty()
    }

    /// Triangles of all objects; a shape counts once per object.
    pub fn triangle_count(&self) -> u64 {
        self.objects.iter().map(|object| self.mesh(object).triangles.len() as u64).sum()
    }

    /// The shape of an object.
    pub fn mesh(&self, object: &Object) -> &Mesh {
        &self.meshes[object.mesh.index()]
    }

    /// Ids of all objects.
    pub fn object_ids(&self) -> impl Iterator<Item = ObjectId> + use<> {
        (0..self.objects.len() as u32).map(ObjectId)
    }

    /// The world box of each object, in order of ids. Every vertex lies inside, with room for the
    /// rounding of the transform.
    pub fn object_bounds(&self) -> Vec<Aabb> {
        let shapes: Vec<Aabb> = self.meshes.iter().map(Mesh::bounds).collect();
        let place =
            |object: &Object| placed_bounds(&shapes[object.mesh.index()], &object.world_from_mesh);
        self.objects.iter().map(place).collect()
    }

    /// The world box of one object.
    pub fn bounds_of(&self, object: ObjectId) -> Aabb {
        let object = &self.objects[object.index()];
        placed_bounds(&self.mesh(object).bounds(), &object.world_from_mesh)
    }

    /// The smallest box around all objects.
    pub fn bounds(&self) -> Aabb {
        self.object_bounds().iter().fold(Aabb::EMPTY, |all, one| all.union(one))
    }

    /// Adds the objects of another model, with all they need.
    pub fn append(&mut self, other: Model) {
        let (meshes, materials, textures) =
            (self.meshes.len() as u32, self.materials.len() as u32, self.textures.len() as u32);
        self.meshes.extend(other.meshes);
        self.textures.extend(other.textures);
        self.materials.extend(other.materials.into_iter().map(|material| Material {
            texture: material.texture.map(|texture| TextureId(texture.0 + textures)),
            ..material
        }));
        self.objects.extend(other.objects.into_iter().map(|object| Object {
            mesh: MeshId(object.mesh.0 + meshes),
            material: MaterialId(object.material.0 + materials),
            ..object
        }));
    }

    /// Proves that every id names something and every number is finite.
    ///
    /// # Errors
    /// The first fault found, see [`ModelError`].
    pub fn check(&self) -> Result<(), ModelError> {
        for (mesh, shape) in self.meshes.iter().enumerate() {
            if let Some(reason) = shape.check() {
                return Err(ModelError::Mesh { mesh, reason });
            }
        }
        let missing = |owner, index, what, named: u32, count: usize| {
            if (named as usize) < count {
                return Ok(());
            }
            Err(ModelError::Missing { owner, index, what, named, count })
        };
        for (index, material) in self.materials.iter().enumerate() {
            if let Some(texture) = material.texture {
                missing("material", index, "texture", texture.0, self.textures.len())?;
            }
        }
        for (index, object) in self.objects.iter().enumerate() {
            missing("object", index, "mesh", object.mesh.0, self.meshes.len())?;
            missing("object", index, "material", object.material.0, self.materials.len())?;
            if !object.world_from_mesh.is_finite() {
                return Err(ModelError::Placement { object: index });
            }
        }
        Ok(())
    }
}

/// The world box of a box placed by a transform, widened by the rounding of the transform.
fn placed_bounds(shape: &Aabb, world_from_mesh: &DAffine3) -> Aabb {
    if shape.is_empty() {
        return Aabb::EMPTY;
    }
    let center = world_from_mesh.transform_point3(shape.center());
    let half = 0.5 * shape.size();
    let m = &world_from_mesh.matrix3;
    let reach = m.x_axis.abs() * half.x + m.y_axis.abs() * half.y + m.z_axis.abs() * half.z;
    let slack = DVec3::splat(8.0 * f64::EPSILON * (center.abs() + reach).max_element());
    Aabb::new(center - reach - slack, center + reach + slack)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    fn triangle() -> Mesh {
        Mesh {
            positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]],
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        }
    }

    fn model(world_from_mesh: DAffine3) -> Model {
        Model {
            meshes: vec![triangle()],
            materials: vec![Material::default()],
            textures: Vec::new(),
            objects: vec![Object { mesh: MeshId(0), material: MaterialId(0), world_from_mesh }],
        }
    }

    #[test]
    fn boxes_hold_their_vertices_at_utm_coordinates() {
        for turn in 0..16 {
            let place = DAffine3::from_rotation_translation(
                DQuat::from_rotation_z(0.4 * f64::from(turn)),
                DVec3::new(4.5e5, 5.2e6, 300.0),
            );
            let model = model(place);
            let bounds = model.object_bounds()[0];
            for corner in model.meshes[0].corners(0) {
                assert!(bounds.contains(place.transform_point3(corner)));
            }
            assert!(bounds.diagonal() < 3.5, "no wider than a turned box");
        }
    }

    #[test]
    fn faults_are_named() {
        let sound = model(DAffine3::IDENTITY);
        assert_eq!(sound.check(), Ok(()));
        let mut broken = sound.clone();
        broken.meshes[0].triangles.push([0, 1, 3]);
        assert!(matches!(broken.check(), Err(ModelError::Mesh { mesh: 0, .. })));
        let mut broken = sound.clone();
        broken.meshes[0].positions[1][2] = f32::NAN;
        assert!(matches!(broken.check(), Err(ModelError::Mesh { mesh: 0, .. })));
        let mut broken = sound.clone();
        broken.objects[0].material = MaterialId(1);
        assert!(matches!(broken.check(), Err(ModelError::Missing { owner: "object", .. })));
        let mut broken = sound.clone();
        broken.objects[0].world_from_mesh.translation.x = f64::INFINITY;
        assert_eq!(broken.check(), Err(ModelError::Placement { object: 0 }));
    }

    #[test]
    fn appended_objects_keep_what_they_are_made_of() {
        let mut all = model(DAffine3::IDENTITY);
        let mut other = model(DAffine3::from_translation(DVec3::X));
        other.textures.push(Texture { width: 1, height: 1, pixels: vec![[1, 2, 3, 4]] });
        other.materials[0].texture = Some(TextureId(0));
        all.textures.push(Texture::default());
        all.append(other);
        assert_eq!(all.check(), Ok(()));
        assert_eq!(all.objects[1].mesh, MeshId(1));
        assert_eq!(all.materials[1].texture, Some(TextureId(1)));
        assert_eq!(all.triangle_count(), 2);
    }
}
