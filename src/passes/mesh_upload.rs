//! Shapes in few large buffers of the device.

use rayon::prelude::*;

use crate::gpu::{Gpu, GpuError, HeldBuffer};
use crate::mesh::Mesh;
use crate::passes::mesh_tables::MeshVertex;

/// Vertices and indices of many shapes.
#[derive(Debug)]
pub(super) struct Shelf {
    pub vertices: HeldBuffer,
    pub indices: HeldBuffer,
}

impl Shelf {
    pub fn bytes(&self) -> u64 {
        self.vertices.size() + self.indices.size()
    }
}

/// Where a shape stands.
#[derive(Clone, Copy, Debug)]
pub(super) struct ShapeRange {
    pub shelf: usize,
    pub first_index: u32,
    pub index_count: u32,
    pub base_vertex: i32,
}

/// Bytes that are sent at a time.
const PIECE_BYTES: usize = 16 << 20;

/// Puts shapes on the device, in order, with a new shelf where a buffer would become too large.
pub(super) fn stock(
    gpu: &Gpu,
    meshes: &[Mesh],
    vertices_of: impl Fn(&Mesh) -> Vec<MeshVertex> + Sync,
) -> Result<(Vec<Shelf>, Vec<ShapeRange>), GpuError> {
    let vertex_bytes = size_of::<MeshVertex>() as u64;
    let most_bytes = gpu.device().limits().max_buffer_size.min(u64::from(i32::MAX as u32));
    let mut shapes: Vec<ShapeRange> = Vec::with_capacity(meshes.len());
    // Vertices and indices of each shelf.
    let mut sums: Vec<[u64; 2]> = Vec::new();
    for mesh in meshes {
        let added = [mesh.positions.len() as u64, 3 * mesh.triangles.len() as u64];
        let fits = sums.last().is_some_and(|&[vertices, indices]| {
            (vertices + added[0]) * vertex_bytes <= most_bytes
                && (indices + added[1]) * 4 <= most_bytes
        });
        if !fits {
            sums.push([0, 0]);
        }
        let sum = sums.last_mut().expect("there is one now");
        shapes.push(ShapeRange {
            shelf: 0,
            first_index: sum[1] as u32,
            index_count: added[1] as u32,
            base_vertex: sum[0] as i32,
        });
        let shelf = sums.len() - 1;
        shapes.last_mut().expect("it was just added").shelf = shelf;
        let sum = &mut sums[shelf];
        (sum[0], sum[1]) = (sum[0] + added[0], sum[1] + added[1]);
    }
    let buffer = |label, bytes: u64, usage| {
        gpu.create_buffer(
            "hold the shapes of models",
            &wgpu::BufferDescriptor {
                label: Some(label),
                size: bytes.max(4),
                usage: usage | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            },
        )
    };
    let mut shelves = Vec::with_capacity(sums.len());
    for [vertices, indices] in sums {
        shelves.push(Shelf {
            vertices: buffer("mesh vertices", vertices * vertex_bytes, wgpu::BufferUsages::VERTEX)?,
            indices: buffer("mesh indices", 4 * indices, wgpu::BufferUsages::INDEX)?,
        });
    }
    let (mut first, mut bytes) = (0, 0);
    for at in 0..meshes.len() {
        bytes += meshes[at].positions.len() * size_of::<MeshVertex>();
        let is_last = at + 1 == meshes.len() || shapes[at + 1].shelf != shapes[at].shelf;
        if bytes < PIECE_BYTES && !is_last {
            continue;
        }
        let part = &meshes[first..=at];
        let vertices: Vec<MeshVertex> = part.par_iter().flat_map_iter(&vertices_of).collect();
        let indices: Vec<[u32; 3]> =
            part.iter().flat_map(|mesh| mesh.triangles.iter().copied()).collect();
        let (shelf, start) = (&shelves[shapes[first].shelf], &shapes[first]);
        let offset = start.base_vertex as u64 * vertex_bytes;
        gpu.queue().write_buffer(&shelf.vertices, offset, bytemuck::cast_slice(&vertices));
        let offset = 4 * u64::from(start.first_index);
        gpu.queue().write_buffer(&shelf.indices, offset, bytemuck::cast_slice(&indices));
        (first, bytes) = (at + 1, 0);
    }
    Ok((shelves, shapes))
}
