//! The facts about a store that are not per node, kept as JSON in the file.
//!
//! Nothing here depends on the machine, the time, thread counts or paths: the same input gives the
//! same bytes. Numbers are written so that they read back exactly.

use glam::{DVec3, I64Vec3};
use serde::{Deserialize, Serialize};

use crate::geometry::Aabb;
use crate::octree::RootCube;
use crate::points::{Lattice, Schema, names};
use crate::store::codec::{ElementShape, Filter};

/// What a section of a node holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SectionContent {
    /// Local coordinates, in the words that the GPU reads.
    Positions,
    /// RGBA8 words; the high bytes of 16-bit colour, the values of 8-bit colour.
    Color,
    /// For 16-bit colour: low byte xor high byte of red, green, blue.
    ColorLow,
    /// The attribute of that index in the schema.
    Attribute(u32),
}

/// One column as every node stores it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Section {
    /// What it holds.
    pub content: SectionContent,
    /// How its elements look. For positions, those of narrow nodes; see [`position_shape`].
    pub shape: ElementShape,
}

/// Local coordinates of up to this many bits per axis are stored as Morton codes of two words.
pub const NARROW_BITS: u32 = 21;

/// How the positions of a node with that many local bits are stored.
pub fn position_shape(local_bits: u32) -> ElementShape {
    if local_bits <= NARROW_BITS {
        ElementShape { component_bytes: 8, components: 1, filter: Filter::DeltaPlanes }
    } else {
        ElementShape { component_bytes: 4, components: 3, filter: Filter::ZigzagDeltaPlanes }
    }
}

/// The sections that nodes of such points have, in file order.
///
/// What a picture needs stands first: positions, then colour.
pub fn sections_for(schema: &Schema, color_bits: Option<u8>) -> Vec<Section> {
    let bytes = |components, filter| ElementShape { component_bytes: 1, components, filter };
    let mut sections =
        vec![Section { content: SectionContent::Positions, shape: position_shape(NARROW_BITS) }];
    if let Some(bits) = color_bits {
        sections.push(Section {
            content: SectionContent::Color,
            shape: bytes(4, Filter::ZigzagDeltaPlanes),
        });
        if bits > 8 {
            sections.push(Section {
                content: SectionContent::ColorLow,
                shape: bytes(3, Filter::Planes),
            });
        }
    }
    for (i, attribute) in schema.attributes.iter().enumerate() {
        if attribute.name == names::RGB && color_bits.is_some() {
            continue;
        }
        let component_bytes = attribute.scalar.bytes() as u32;
        let filter = if component_bytes >= 4 { Filter::ZigzagDeltaPlanes } else { Filter::Planes };
        let components = u32::from(attribute.components);
        sections.push(Section {
            content: SectionContent::Attribute(i as u32),
            shape: ElementShape { component_bytes, components, filter },
        });
    }
    sections
}

/// Smallest and largest value of one component of an attribute over all points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ValueRange {
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
}

/// Coordinate reference system, as far as the input tells.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CrsInfo {
    /// EPSG code, where it could be read.
    pub epsg: Option<u32>,
    /// Well-known text, as in the input.
    pub wkt: Option<String>,
}

/// One source: an input file, or one scan of a file that holds several.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SourceInfo {
    /// File name without folders.
    pub name: String,
    /// Format and version, such as `laz 1.4`.
    pub format: String,
    /// LAS point format of the file's records; none for other formats.
    pub point_format: Option<u8>,
    /// Points read from it, dropped ones included.
    pub points: u64,
    /// What its header said and the points did not bear out, in words.
    pub warnings: Vec<String>,
    /// Bytes of its header, records before and records after the points, in the appendix.
    pub header_bytes: u64,
    /// See `header_bytes`.
    pub vlr_bytes: u64,
    /// See `header_bytes`.
    pub evlr_bytes: u64,
    /// What the file calls this scan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scan: Option<String>,
    /// Place of the scan in its file, where that holds several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scan_index: Option<u32>,
    /// Where the scanner stood.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pose: Option<PoseInfo>,
    /// Attributes of the schema that are its own; all of them without a list. The others are 0 in
    /// its points.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub attributes: Option<Vec<String>>,
    /// Points that are not in the store, by reason.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub dropped: Vec<DroppedPoints>,
    /// What else the file holds and the store does not.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub skipped: Vec<SkippedItems>,
}

impl SourceInfo {
    /// Points of it that are not in the store.
    pub fn dropped_points(&self) -> u64 {
        self.dropped.iter().map(|dropped| dropped.points).fold(0, u64::saturating_add)
    }
}

/// Points left out for one reason.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DroppedPoints {
    /// Why.
    pub reason: String,
    /// How many.
    pub points: u64,
}

/// Parts of a file that are no points, such as faces or images.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SkippedItems {
    /// What they are.
    pub what: String,
    /// How many.
    pub count: u64,
}

/// Scan coordinates to world coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseInfo {
    /// Unit quaternion w, x, y, z, applied first.
    pub rotation: [f64; 4],
    /// Position of the scanner, applied second.
    pub translation: [f64; 3],
    /// Whether the points have it applied; if not, the file keeps it for information.
    pub applied: bool,
}

/// All metadata of a store.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Metadata {
    /// Program and version that wrote the store.
    pub generator: String,
    /// Points in the store.
    pub points: u64,
    /// Points of the input that are not in the store.
    pub dropped_points: u64,
    /// World length of a lattice step per axis.
    pub scale: [f64; 3],
    /// World position of the lattice origin.
    pub offset: [f64; 3],
    /// Lattice coordinates of the root cube's lowest corner.
    pub root_min: [i64; 3],
    /// The root cube's edge is `2^root_bits` lattice steps.
    pub root_bits: u32,
    /// Levels within a node beyond its coarsest.
    pub depth: u32,
    /// Fewest points that made a child.
    pub threshold: u32,
    /// Points kept in nodes beyond one per finest cell.
    pub overflow_points: u64,
    /// Smallest lattice coordinates of all points.
    pub bounds_min: [i64; 3],
    /// Largest lattice coordinates of all points.
    pub bounds_max: [i64; 3],
    /// Significant bits of colour: 8 or 16; none without colour.
    pub color_bits: Option<u8>,
    /// Columns of a record.
    pub schema: Schema,
    /// Value ranges per attribute of the schema, per component. Empty in an empty store.
    pub attribute_ranges: Vec<Vec<ValueRange>>,
    /// Columns as nodes store them.
    pub sections: Vec<Section>,
    /// Reference system.
    pub crs: CrsInfo,
    /// Input files in the order in which their points count as inserted.
    pub sources: Vec<SourceInfo>,
}

impl Metadata {
    /// World positions from lattice coordinates.
    pub fn lattice(&self) -> Lattice {
        Lattice { scale: DVec3::from(self.scale), offset: DVec3::from(self.offset) }
    }

    /// The root cube.
    pub fn root_cube(&self) -> RootCube {
        RootCube { min: I64Vec3::from(self.root_min), bits: self.root_bits }
    }

    /// The box of all points in the world; empty in an empty store.
    pub fn bounds(&self) -> Aabb {
        if self.points == 0 {
            return Aabb::EMPTY;
        }
        let lattice = self.lattice();
        Aabb::new(
            lattice.world(I64Vec3::from(self.bounds_min)),
            lattice.world(I64Vec3::from(self.bounds_max)),
        )
    }

    /// The section with that content and its place.
    pub fn find_section(&self, content: SectionContent) -> Option<(usize, &Section)> {
        self.sections.iter().enumerate().find(|(_, section)| section.content == content)
    }

    /// Human name of a section, for messages.
    pub fn section_name(&self, index: usize) -> String {
        match self.sections[index].content {
            SectionContent::Positions => "positions".into(),
            SectionContent::Color => "color".into(),
            SectionContent::ColorLow => "low color bytes".into(),
            SectionContent::Attribute(i) => {
                format!("attribute {}", self.schema.attributes[i as usize].name)
            }
        }
    }

    /// Checks what other code relies on; says what is wrong.
    pub(crate) fn validate(&self) -> Result<(), String> {
        if !(1..=32).contains(&self.root_bits) {
            return Err(format!("root_bits {} is not in 1..=32", self.root_bits));
        }
        if !(1..=16).contains(&self.depth) || self.depth >= self.root_bits {
            return Err(format!("depth {} does not fit {} bits", self.depth, self.root_bits));
        }
        let usable = |v: &[f64; 3]| v.iter().all(|x| x.is_finite());
        if !usable(&self.scale) || !usable(&self.offset) || self.scale.iter().any(|s| *s <= 0.0) {
            return Err("scale or offset is not usable".into());
        }
        if !self.schema.covers_record() {
            return Err("the attributes do not cover the record".into());
        }
        if self.sections != sections_for(&self.schema, self.color_bits) {
            return Err("the sections are not those of the schema".into());
        }
        if self.points > 0 && self.attribute_ranges.len() != self.schema.attributes.len() {
            return Err("the value ranges are not those of the schema".into());
        }
        Ok(())
    }
}
