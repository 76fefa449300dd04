//! Lists of objects as draws: instances of one shape together, surfaces of one kind together.

use std::ops::Range;

use crate::ids::ObjectId;
use crate::passes::mesh_tables::Surface;

/// In which order objects are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DrawOrder {
    /// By surface, shape and number: as few draws as there are shapes, the same for every order of
    /// the list.
    Grouped,
    /// As they stand in the list, a draw each.
    Kept,
}

/// What recordings drew.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MeshCounts {
    /// Calls.
    pub draw_calls: u32,
    /// Objects.
    pub objects: u32,
    /// Triangles of these.
    pub triangles: u64,
}

impl std::ops::AddAssign for MeshCounts {
    fn add_assign(&mut self, other: Self) {
        self.draw_calls += other.draw_calls;
        self.objects += other.objects;
        self.triangles += other.triangles;
    }
}

/// Instances of one shape.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct MeshDraw {
    pub surface: Surface,
    /// The buffers that hold the shape.
    pub shelf: usize,
    pub shape: u32,
    /// Triangles of the shape.
    pub triangles: u32,
    /// Places in the list of drawn objects.
    pub instances: Range<u32>,
}

/// The draws of objects, which stand in the order of drawing. `key` gives surface, shelf and shape.
pub(super) fn draws_of(
    objects: &[ObjectId],
    order: DrawOrder,
    key: impl Fn(ObjectId) -> (Surface, usize, u32),
    triangles_of: impl Fn(u32) -> u32,
) -> Vec<MeshDraw> {
    let mut draws: Vec<MeshDraw> = Vec::new();
    for (&object, at) in objects.iter().zip(0u32..) {
        let (surface, shelf, shape) = key(object);
        match draws.last_mut() {
            Some(last)
                if order == DrawOrder::Grouped
                    && (last.surface, last.shape) == (surface, shape) =>
            {
                last.instances.end = at + 1;
            }
            _ => {
                let triangles = triangles_of(shape);
                draws.push(MeshDraw { surface, shelf, shape, triangles, instances: at..at + 1 });
            }
        }
    }
    draws
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAIN: Surface = Surface { single_sided: false, mirrored: false, cut_out: false };
    const MIRRORED: Surface = Surface { mirrored: true, ..PLAIN };

    fn key(object: ObjectId) -> (Surface, usize, u32) {
        (if object.0 == 4 { MIRRORED } else { PLAIN }, 0, object.0 % 2)
    }

    #[test]
    fn instances_that_follow_each_other_are_drawn_together() {
        let ids = |list: &[u32]| list.iter().map(|&id| ObjectId(id)).collect::<Vec<_>>();
        let draws = draws_of(&ids(&[0, 2, 1, 3, 4]), DrawOrder::Grouped, key, |_| 7);
        let instances: Vec<_> = draws.iter().map(|draw| draw.instances.clone()).collect();
        assert_eq!(instances, [0..2, 2..4, 4..5]);
        assert_eq!(draws_of(&ids(&[4, 2, 0]), DrawOrder::Kept, key, |_| 7).len(), 3);
    }
}
