//! Every struct that the GPU sees, field by field as in WGSL, and the constants both sides share.
//!
//! The WGSL side stands in `shaders/shared/structs.wgsl`; `tests/shader_layout.rs` compares names,
//! sizes and offsets. Constants reach shaders through [`prelude`], so each exists once. No wgpu
//! here: the CPU twins read the same structs. Lengths are metres unless a name says otherwise.

use bytemuck::{Pod, Zeroable};

/// Threads of one workgroup of the point pass.
pub const WORKGROUP_SIZE: u32 = 64;
/// Most bits per axis whose Morton code fits two words; nodes with more hold three coordinates.
pub const NARROW_BITS: u32 = 21;

/// Splats are squares of whole pixels.
pub const SQUARE: u32 = 0;
/// Splats are discs within their square.
pub const ROUND: u32 = 1;
/// Splats are shaded balls within their square, nearer in the middle.
pub const SPHERE: u32 = 2;
/// Binary logarithm of [`SHARE_BLOCK`].
pub const SHARE_BLOCK_BITS: u32 = 8;
/// Where only a share of a node's points is drawn, as many of each so many successive points.
pub const SHARE_BLOCK: u32 = 1 << SHARE_BLOCK_BITS;

/// Texels along each side up to which a box is tested at a finer level of a depth pyramid.
pub const MOST_TEXELS: u32 = 8;

/// Words before those of the objects in the state of culling without read-back: objects drawn first,
/// objects drawn second, triangles (two words).
pub const STATE_COUNTS: u32 = 4;

/// Words per position of a node whose local coordinates have `local_bits` bits.
pub const fn position_words(local_bits: u32) -> u32 {
    if local_bits <= NARROW_BITS { 2 } else { 3 }
}

/// Name, size and fields of a shared struct, for the test that holds both sides together.
#[derive(Clone, Copy, Debug)]
pub struct StructLayout {
    /// Name in Rust and in WGSL.
    pub name: &'static str,
    /// Size, bytes.
    pub size: usize,
    /// Field names and their offsets in bytes, in order.
    pub fields: &'static [(&'static str, usize)],
}

macro_rules! gpu_struct {
    ($(#[$doc:meta])* $name:ident, $size:literal { $($(#[$field_doc:meta])* $field:ident: $type:ty,)* }) => {
        $(#[$doc])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
        pub struct $name { $($(#[$field_doc])* pub $field: $type,)* }

        const _: () = assert!(size_of::<$name>() == $size);

        impl $name {
            /// The layout as Rust has it.
            pub const LAYOUT: StructLayout = StructLayout {
                name: stringify!($name),
                size: size_of::<$name>(),
                fields: &[$((stringify!($field), std::mem::offset_of!($name, $field)),)*],
            };
        }
    };
}

gpu_struct! {
    /// What all draws of a frame share.
    ///
    /// The three columns map a position relative to the eye (world axes) to `(x w, y w, w)`: pixels
    /// from the middle of the picture, x right and y down, and the distance `w` along the viewing
    /// direction.
    GpuFrame, 112 {
        /// Column for world x; the fourth lane is unused.
        screen_from_world_x: [f32; 4],
        /// Column for world y; the fourth lane is unused.
        screen_from_world_y: [f32; 4],
        /// Column for world z; the fourth lane is unused.
        screen_from_world_z: [f32; 4],
        /// The middle of the picture, in pixels of the target (which may show a part of it).
        center_px: [f32; 2],
        /// Width and height of the target.
        target_px: [u32; 2],
        /// Distance of the near plane.
        near: f32,
        /// Largest side of a splat, pixels.
        max_splat_px: f32,
        /// 1 if a point takes the splat size of the deepest drawn node around it, else 0.
        per_point_splats: u32,
        /// RGBA8 of pixels without a point, red in the lowest byte.
        background: u32,
        /// Smallest side of a splat, pixels; equal to the largest where all have one size.
        min_splat_px: f32,
        /// 1 if a splat's place follows from its pixel alone, so that a larger splat around the
        /// same pixel covers a smaller one; 0 if it is centred on the point.
        nested_splats: u32,
        /// What a splat looks like: [`SQUARE`], [`ROUND`] or [`SPHERE`].
        splat_shape: u32,
        /// Length of a pixel at a distance of 1 m.
        pixel_m: f32,
        /// Splat size on screen at a distance of 1 m that all points share, pixels; 0 if they
        /// share none.
        shared_splat_px_m: f32,
        /// Pixels around the picture that the grown pixels start from, so that points beside it
        /// reach in.
        grow_margin_px: u32,
        /// Unused.
        padding_0: u32,
        /// Unused.
        padding_1: u32,
    }
}

gpu_struct! {
    /// One drawn node. Drawn children of a node stand side by side in octant order.
    ///
    /// The eye is given in the node's lattice steps as `eye_cell + eye_fraction`, where `eye_cell`
    /// is clamped into the node; the difference of a point and `eye_cell` is exact, and where the
    /// eye is outside, both parts of the distance have the same sign, so nothing cancels.
    GpuNode, 80 {
        /// Integer part of the eye, clamped to the node's cell, lattice steps.
        eye_cell: [u32; 3],
        /// First position word, counted in words of the node's shard.
        positions_at: u32,
        /// The rest of the eye, lattice steps.
        eye_fraction: [f32; 3],
        /// First colour word, counted in words of the node's shard.
        colors_at: u32,
        /// World length of one lattice step per axis.
        scale: [f32; 3],
        /// Splat size on screen at a distance of 1 m, pixels.
        splat_px_m: f32,
        /// Local coordinates are below `2^local_bits`.
        local_bits: u32,
        /// One past the last point that may be drawn.
        drawn_count: u32,
        /// The lowest 8 bits: bit `o` is set if the child in octant `o` is drawn. Above them: slot
        /// of the first drawn child.
        drawn_children: u32,
        /// Most steps down from here to a drawn node that has no drawn child, or below which all
        /// splats are single pixels.
        drawn_levels_below: u32,
        /// Leading points that are drawn all; of the others a share is.
        whole_count: u32,
        /// How many of each [`SHARE_BLOCK`] successive ones of these are.
        kept_of_block: u32,
        /// Its inverse.
        kept_inverse: f32,
        /// Unused.
        padding_0: u32,
    }
}

gpu_struct! {
    /// What one workgroup draws: successive points of a node, or places of points where only a
    /// share of them is drawn.
    GpuBatch, 12 {
        /// Slot of the node.
        node_slot: u32,
        /// First point.
        first_point: u32,
        /// One past the last point.
        end_point: u32,
    }
}

gpu_struct! {
    /// What the passes over a drawn picture do.
    GpuFinish, 16 {
        /// Farthest pixel that counts around a gap.
        gap_radius_px: u32,
        /// How far the neighbours are that eye-dome lighting compares with.
        eye_dome_radius_px: u32,
        /// How much darker a pixel gets for neighbours that are nearer.
        eye_dome_strength: f32,
        /// Unused.
        padding_0: u32,
    }
}

gpu_struct! {
    /// A decision in the middle of a frame.
    GpuCheckpoint, 24 {
        /// Place of the frame's first stamp.
        first_stamp: u32,
        /// Place of its latest stamp.
        last_stamp: u32,
        /// Alternatives to choose from.
        alternative_count: u32,
        /// Dispatches that depend on the choice.
        dispatch_count: u32,
        /// Ticks that the frame may take: the low word.
        allowed_low: u32,
        /// The high word.
        allowed_high: u32,
    }
}

gpu_struct! {
    /// A dispatch that belongs to one alternative.
    GpuDispatch, 16 {
        /// The alternative.
        alternative: u32,
        /// Workgroups along x.
        x: u32,
        /// Workgroups along y.
        y: u32,
        /// Workgroups along z.
        z: u32,
    }
}

gpu_struct! {
    /// An object of a model in front of a camera.
    ///
    /// A vertex `p` is seen from the eye as `q = (p - eye_high) - eye_low`, in the shape's axes: the
    /// first difference is exact where the eye is near, so pictures do not tremble however far the
    /// shape's origin is. The columns then map `q` as those of [`GpuFrame`] do.
    GpuMeshObject, 128 {
        /// Column for the shape's x; the fourth lane is added to the first of the result.
        screen_from_mesh_x: [f32; 4],
        /// Column for the shape's y; the fourth lane is added to the second of the result.
        screen_from_mesh_y: [f32; 4],
        /// Column for the shape's z; the fourth lane is added to the third of the result.
        screen_from_mesh_z: [f32; 4],
        /// The eye in the shape's axes, rounded; 0 if the shape is placed flat.
        eye_high: [f32; 3],
        /// Its material.
        material: u32,
        /// What rounding left.
        eye_low: [f32; 3],
        /// Unused.
        padding_0: u32,
        /// Column of world normals for the shape's x, of any length; the fourth lane is unused.
        normal_x: [f32; 4],
        /// The same for y.
        normal_y: [f32; 4],
        /// The same for z.
        normal_z: [f32; 4],
    }
}

gpu_struct! {
    /// What a surface looks like.
    GpuMaterial, 32 {
        /// RGBA8, red in the lowest byte.
        color: u32,
        /// Fragments less opaque than this are left out.
        alpha_cutoff: f32,
        /// First texel of the texture's finest level.
        texture_at: u32,
        /// Texels in a row of that level.
        texture_width: u32,
        /// Its rows.
        texture_height: u32,
        /// Levels, each half as large as the one before; 0 without a texture.
        texture_levels: u32,
        /// Unused.
        padding_0: u32,
        /// Unused.
        padding_1: u32,
    }
}

gpu_struct! {
    /// A box relative to the eye, world axes.
    GpuBox, 32 {
        /// Corner with the smallest coordinates.
        low: [f32; 3],
        /// What it belongs to: the number of a question, or of an object.
        item: u32,
        /// Corner with the largest coordinates.
        high: [f32; 3],
        /// 1 if it is taken as visible, because it meets the near plane or is not finite.
        untested: u32,
    }
}

gpu_struct! {
    /// The levels of a depth pyramid; the picture is level 0.
    GpuPyramid, 80 {
        /// Width and height of the picture.
        size_px: [u32; 2],
        /// Levels, the picture counted; the last is one texel.
        level_count: u32,
        /// Unused.
        padding_0: u32,
        /// Where each level begins among the texels of those after the picture.
        offsets: [[u32; 4]; 4],
    }
}

impl GpuPyramid {
    /// Levels that there can be.
    pub const MOST_LEVELS: u32 = 16;

    /// The pyramid over a picture; sides beyond 32,768 pixels end it before one texel is left.
    pub fn over(width_px: u32, height_px: u32) -> Self {
        let longest = width_px.max(height_px).max(1);
        let level_count = (longest.next_power_of_two().ilog2() + 1).min(Self::MOST_LEVELS);
        let mut pyramid =
            GpuPyramid { size_px: [width_px, height_px], level_count, ..Zeroable::zeroed() };
        let mut offset = 0;
        for level in 1..level_count {
            pyramid.offsets[level as usize / 4][level as usize % 4] = offset;
            let [width, height] = pyramid.size_of(level);
            offset += width * height;
        }
        pyramid
    }

    /// Width and height of a level.
    pub fn size_of(&self, level: u32) -> [u32; 2] {
        self.size_px.map(|side| side.div_ceil(1 << level))
    }

    /// First texel of a level after the picture.
    pub fn offset_of(&self, level: u32) -> u32 {
        self.offsets[level as usize / 4][level as usize % 4]
    }

    /// Texels of all levels after the picture.
    pub fn texel_count(&self) -> u32 {
        (1..self.level_count).map(|level| self.size_of(level).iter().product::<u32>()).sum()
    }
}

/// All shared structs.
pub const STRUCTS: &[StructLayout] = &[
    GpuFrame::LAYOUT,
    GpuNode::LAYOUT,
    GpuBatch::LAYOUT,
    GpuFinish::LAYOUT,
    GpuCheckpoint::LAYOUT,
    GpuDispatch::LAYOUT,
    GpuMeshObject::LAYOUT,
    GpuMaterial::LAYOUT,
    GpuBox::LAYOUT,
    GpuPyramid::LAYOUT,
];

/// WGSL text that declares the shared constants; every shader starts with it.
pub fn prelude() -> String {
    [
        ("WORKGROUP_SIZE", WORKGROUP_SIZE),
        ("NARROW_BITS", NARROW_BITS),
        ("ROUND", ROUND),
        ("SPHERE", SPHERE),
        ("SHARE_BLOCK_BITS", SHARE_BLOCK_BITS),
        ("MOST_TEXELS", MOST_TEXELS),
        ("STATE_COUNTS", STATE_COUNTS),
    ]
    .map(|(name, value)| format!("const {name}: u32 = {value}u;\n"))
    .concat()
}
