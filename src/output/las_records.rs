//! Points of any schema as records of a LAS point format.
//!
//! Attributes go where the format has a field of their meaning that takes every value, and into
//! extra bytes under their own name and type where it has none. Nothing is rounded. A scan of the
//! formats 0 to 5 becomes one of 6 to 8 where the file asks for that: the packed bytes are taken
//! apart, angles in degrees become steps of 0.006 degrees.
//!
//! Source: ASPRS, "LAS Specification 1.4 - R15", tables 7 to 17, 24 and 25.

use std::collections::HashSet;

use super::extra_bytes::{Entry, NAME_BYTES, ScanDescriptions, number_entry, schema_of};
use super::names::component_names;
use crate::input::{LasTemplate, PointFormat};
use crate::points::{Attribute, COORDINATE_BYTES, Scalar, Schema, names};

/// Which point formats a file may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FormatChoice {
    /// The scan's own where its header is at hand, else 6, 7 or 8.
    Own,
    /// 6, 7 or 8: what COPC allows.
    Extended,
}

/// Smallest and largest value of each component of each attribute.
pub type AttributeRanges = [Vec<[f64; 2]>];

/// How points of a schema become records of a point format.
#[derive(Clone, Debug)]
pub struct LasRecords {
    format: PointFormat,
    schema: Schema,
    from_bytes: usize,
    steps: Vec<Step>,
    /// Whether the scan's own descriptions of extra bytes hold.
    keeps_descriptions: bool,
    entries: Vec<Entry>,
    notes: Vec<String>,
}

impl LasRecords {
    /// Finds a place for every attribute of a schema.
    ///
    /// `template` is the scan's own header where there is one. `ranges` are those of the points to
    /// be written or wider; an attribute without any is taken to have no values.
    pub fn new(
        schema: &Schema,
        ranges: &AttributeRanges,
        template: Option<&LasTemplate>,
        choice: FormatChoice,
    ) -> Result<Self, String> {
        let own = template.map(|template| (template, template.header().point_format));
        let own = own.filter(|(_, format)| match choice {
            FormatChoice::Own => begins_with(schema, *format),
            FormatChoice::Extended => {
                begins_with(schema, *format) && (6..=8).contains(&format.number())
            }
        });
        let leaves_source = own.is_some() && choice == FormatChoice::Own;
        if let Some((template, format)) = own {
            let described = schema_of(template);
            let is_new = |a: &&Attribute| {
                !(a.name == names::SOURCE && leaves_source) && a.name != names::COORDINATE_RESIDUAL
            };
            // What the store added stands behind the scan's own.
            if schema.attributes.iter().filter(is_new).eq(&described.attributes) {
                return Ok(LasRecords::of_scan(schema, described, format));
            }
        }
        let described = template.map(ScanDescriptions::of).unwrap_or_default();
        let plan = match own {
            Some((_, format)) => Plan::with_own_format(schema, format, described, leaves_source),
            None => Plan::extended(schema, ranges, described),
        };
        plan.finish(schema)
    }

    /// The scan's own layout, of rows that begin with it.
    fn of_scan(rows: &Schema, schema: Schema, format: PointFormat) -> Self {
        let (from_bytes, bytes) = (rows.record_bytes as usize, schema.record_bytes as usize);
        let has = |name| rows.find(name).is_some() && schema.find(name).is_none();
        let notes = [(names::SOURCE, NO_SOURCE), (names::COORDINATE_RESIDUAL, NO_RESIDUAL)];
        let notes = notes.into_iter().filter(|(name, _)| has(name));
        let notes = notes.map(|(_, note)| note.to_string()).collect();
        LasRecords {
            format,
            schema,
            from_bytes,
            steps: vec![Step::Copy { from: 0, to: 0, bytes }],
            keeps_descriptions: true,
            entries: Vec::new(),
            notes,
        }
    }

    /// The point format.
    pub fn format(&self) -> PointFormat {
        self.format
    }

    /// Layout of the records.
    pub fn schema(&self) -> &Schema {
        &self.schema
    }

    /// Whether records are those of the scan, which its header describes.
    pub(super) fn are_of_scan(&self) -> bool {
        self.keeps_descriptions
    }

    /// Data of the record that describes the extra bytes; empty without any, and where the
    /// template describes them.
    pub(super) fn descriptions(&self) -> Vec<u8> {
        self.entries.concat()
    }

    /// What the file cannot say, in words.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Replaces `out` by the records of whole rows of the schema.
    pub fn convert(&self, rows: &[u8], out: &mut Vec<u8>) {
        out.clear();
        if self.from_bytes == self.schema.record_bytes as usize && self.keeps_descriptions {
            return out.extend_from_slice(rows);
        }
        let to_bytes = self.schema.record_bytes as usize;
        out.resize(rows.len() / self.from_bytes * to_bytes, 0);
        let pairs = rows.chunks_exact(self.from_bytes).zip(out.chunks_exact_mut(to_bytes));
        for (row, record) in pairs {
            self.steps.iter().for_each(|step| step.apply(row, record));
        }
    }
}

const NO_SOURCE: &str =
    "left out, since the scans had no such thing: which file each point came from (source)";
const NO_RESIDUAL: &str = "coordinates are those of the store's lattice; the file's exact floats, \
    which lie between its steps, come back in PLY and text only";

/// Whether the attributes after the coordinates begin with a point format's.
fn begins_with(schema: &Schema, format: PointFormat) -> bool {
    schema.attributes.starts_with(&format.schema(format.base_bytes(), &[]).0.attributes)
}

/// One piece of a record; places are bytes from a record's start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    /// Bytes as they are.
    Copy { from: usize, to: usize, bytes: usize },
    /// A single-precision number where a double one stands.
    Widen { from: usize, to: usize },
    /// Returns and class as formats 0 to 5 pack them.
    LegacyBits { returns: usize, class: usize },
    /// An angle in whole degrees.
    Degrees { from: usize },
    /// The first of one return.
    OnlyReturn,
}

/// Places of the fields of formats 6 to 8.
mod place {
    pub const INTENSITY: usize = 12;
    pub const RETURNS: usize = 14;
    pub const FLAGS: usize = 15;
    pub const CLASS: usize = 16;
    pub const USER_DATA: usize = 17;
    pub const SCAN_ANGLE: usize = 18;
    pub const POINT_SOURCE_ID: usize = 20;
    pub const GPS_TIME: usize = 22;
    pub const RGB: usize = 30;
    pub const NIR: usize = 36;
}

/// Steps of the scan angle in formats 6 to 10, degrees.
const ANGLE_STEP: f64 = 0.006;

impl Step {
    fn apply(self, row: &[u8], record: &mut [u8]) {
        match self {
            Step::Copy { from, to, bytes } => {
                record[to..to + bytes].copy_from_slice(&row[from..from + bytes]);
            }
            Step::Widen { from, to } => {
                let value = Scalar::F32.read(&row[from..]);
                record[to..to + 8].copy_from_slice(&value.to_le_bytes());
            }
            Step::LegacyBits { returns, class } => {
                let (packed, class) = (row[returns], row[class]);
                record[place::RETURNS] = packed & 0x07 | (packed & 0x38) << 1;
                record[place::FLAGS] = class >> 5 | packed & 0xc0;
                record[place::CLASS] = class & 0x1f;
            }
            Step::Degrees { from } => {
                let steps = (f64::from(row[from] as i8) / ANGLE_STEP).round() as i16;
                record[place::SCAN_ANGLE..place::SCAN_ANGLE + 2]
                    .copy_from_slice(&steps.to_le_bytes());
            }
            Step::OnlyReturn => record[place::RETURNS] = 0x11,
        }
    }
}

/// What becomes a [`LasRecords`].
struct Plan {
    format: PointFormat,
    /// Of the records; its size grows with the attributes.
    schema: Schema,
    steps: Vec<Step>,
    described: ScanDescriptions,
    entries: Vec<Entry>,
    names: HashSet<String>,
    notes: Vec<String>,
}

/// Names under which readers know fields of the formats 6 to 10 that a schema keeps packed.
const FIELD_NAMES: [&str; 17] = [
    "x",
    "y",
    "z",
    "red",
    "green",
    "blue",
    "return_number",
    "number_of_returns",
    "synthetic",
    "key_point",
    "withheld",
    "overlap",
    "scanner_channel",
    "scan_direction_flag",
    "edge_of_flight_line",
    "scan_angle_rank",
    "classification_flags",
];

/// The numbers of a wave packet.
const WAVE_PACKET: [(&str, Scalar); 7] = [
    ("wavepacket_index", Scalar::U8),
    ("wavepacket_offset", Scalar::U64),
    ("wavepacket_size", Scalar::U32),
    ("return_point_wave_location", Scalar::F32),
    ("x_t", Scalar::F32),
    ("y_t", Scalar::F32),
    ("z_t", Scalar::F32),
];

impl Plan {
    fn new(format: PointFormat, described: ScanDescriptions) -> Self {
        let (schema, _) = format.schema(format.base_bytes(), &[]);
        let fields = schema.attributes.iter().map(|attribute| attribute.name.as_str());
        Plan {
            names: fields.chain(FIELD_NAMES).map(str::to_string).collect(),
            format,
            schema,
            steps: Vec::new(),
            described,
            entries: Vec::new(),
            notes: Vec::new(),
        }
    }

    /// The format's fields as they are; everything after them into extra bytes.
    fn with_own_format(
        schema: &Schema,
        format: PointFormat,
        described: ScanDescriptions,
        leaves_source: bool,
    ) -> Self {
        let mut plan = Plan::new(format, described);
        let base = plan.schema.attributes.len();
        plan.copy(0, 0, plan.schema.record_bytes as usize);
        for attribute in &schema.attributes[base..] {
            if attribute.name == names::SOURCE && leaves_source {
                plan.notes.push(NO_SOURCE.to_string());
            } else {
                plan.add_extra(attribute);
            }
        }
        plan
    }

    /// Attributes by their names into format 6, 7 or 8.
    fn extended(schema: &Schema, ranges: &AttributeRanges, described: ScanDescriptions) -> Self {
        let find = |name: &str, scalar: Scalar, components: u16| {
            let found = schema.find(name).map(|(_, attribute)| attribute);
            found.filter(|a| a.scalar == scalar && a.components == components)
        };
        let has_rgb = find(names::RGB, Scalar::U16, 3).is_some();
        let has_nir = find(names::NIR, Scalar::U16, 1).is_some();
        let number = if has_nir { 8 } else { 6 + u8::from(has_rgb) };
        let mut plan = Plan::new(PointFormat::new(number).expect("a format"), described);
        plan.copy(0, 0, COORDINATE_BYTES);
        let returns = find(names::RETURNS, Scalar::U8, 1);
        let class = find(names::CLASSIFICATION, Scalar::U8, 1);
        let has_flags = find(names::FLAGS, Scalar::U8, 1).is_some();
        let packed = returns.zip(class).filter(|_| !has_flags);
        match packed {
            Some((returns, class)) => {
                let [returns, class] = [returns, class].map(|a| a.record_offset as usize);
                plan.steps.push(Step::LegacyBits { returns, class });
            }
            None if returns.is_none() => plan.steps.push(Step::OnlyReturn),
            None => {}
        }
        for (index, attribute) in schema.attributes.iter().enumerate() {
            let is_packed = [names::RETURNS, names::CLASSIFICATION].contains(&&*attribute.name);
            if packed.is_some() && is_packed {
                continue;
            }
            let range = ranges.get(index).and_then(|ranges| ranges.first()).copied();
            match field_step(attribute, range) {
                Some(Step::Copy { from, to, bytes }) => plan.copy(from, to, bytes),
                Some(step) => plan.steps.push(step),
                None => plan.add_extra(attribute),
            }
        }
        plan
    }

    /// A step that copies; one with the step before where they meet in both layouts.
    fn copy(&mut self, from: usize, to: usize, bytes: usize) {
        if let Some(Step::Copy { from: last_from, to: last_to, bytes: last }) =
            self.steps.last_mut()
            && (*last_from + *last, *last_to + *last) == (from, to)
        {
            *last += bytes;
        } else {
            self.steps.push(Step::Copy { from, to, bytes });
        }
    }

    /// Puts an attribute behind what the record has so far.
    fn add_extra(&mut self, attribute: &Attribute) {
        if attribute.name == names::COORDINATE_RESIDUAL {
            return self.notes.push(NO_RESIDUAL.to_string());
        }
        let from = attribute.record_offset as usize;
        self.copy(from, self.schema.record_bytes as usize, attribute.bytes());
        let Attribute { scalar, components, .. } = *attribute;
        if let Some(entry) = self.described.take(attribute) {
            self.names.insert(attribute.name.clone());
            self.push(attribute.name.clone(), scalar, components, entry);
        } else if attribute.name == names::WAVE_PACKET && attribute.bytes() == 29 {
            for (name, scalar) in WAVE_PACKET {
                let name = self.free_name(name, scalar);
                let entry = number_entry(&name, scalar);
                self.push(name, scalar, 1, entry);
            }
        } else {
            for component in component_names(attribute) {
                let name = self.free_name(&component, scalar);
                let entry = number_entry(&name, scalar);
                self.push(name, scalar, 1, entry);
            }
        }
    }

    fn push(&mut self, name: String, scalar: Scalar, components: u16, entry: Entry) {
        let record_offset = self.schema.record_bytes;
        let attribute = Attribute { name, scalar, components, record_offset };
        self.schema.record_bytes += attribute.bytes() as u32;
        self.schema.attributes.push(attribute);
        self.entries.push(entry);
    }

    /// The name, cut to what a description holds, or one like it that is not taken.
    fn free_name(&mut self, name: &str, scalar: Scalar) -> String {
        let cut = |bytes: usize| {
            let mut end = name.len().min(bytes);
            while !name.is_char_boundary(end) {
                end -= 1;
            }
            &name[..end]
        };
        let typed = format!("{}_{}", cut(NAME_BYTES - 4), format!("{scalar:?}").to_lowercase());
        let numbered = (2..).map(|number: u32| format!("{}_{number}", cut(NAME_BYTES - 11)));
        let mut candidates = [cut(NAME_BYTES).to_string(), typed].into_iter().chain(numbered);
        candidates.find(|name| self.names.insert(name.clone())).expect("numbers do not end")
    }

    fn finish(self, schema: &Schema) -> Result<LasRecords, String> {
        if self.schema.record_bytes > u32::from(u16::MAX) {
            let bytes = self.schema.record_bytes;
            return Err(format!("a record would have {bytes} bytes, LAS allows 65535"));
        }
        Ok(LasRecords {
            format: self.format,
            schema: self.schema,
            from_bytes: schema.record_bytes as usize,
            steps: self.steps,
            keeps_descriptions: false,
            entries: self.entries,
            notes: self.notes,
        })
    }
}

/// How an attribute fills the field of formats 6 to 8 that has its meaning; `None` without one
/// that takes all its values.
fn field_step(attribute: &Attribute, range: Option<[f64; 2]>) -> Option<Step> {
    use Scalar::{F32, F64, I8, I16, U8, U16};
    let Attribute { scalar, components, record_offset, .. } = *attribute;
    let from = record_offset as usize;
    let as_it_is = |to: usize, wanted: Scalar, count: u16| {
        let bytes = wanted.bytes() * usize::from(count);
        ((scalar, components) == (wanted, count)).then_some(Step::Copy { from, to, bytes })
    };
    // The low bytes of a non-negative integer are the integer, if it is small enough.
    let number = |to: usize, wanted: Scalar| {
        let limit = if wanted == U8 { 255.0 } else { 65_535.0 };
        let fits = range.is_none_or(|[low, high]| low >= 0.0 && high <= limit);
        let is_number = !matches!(scalar, F32 | F64) && components == 1 && fits;
        let bytes = scalar.bytes().min(wanted.bytes());
        is_number.then_some(Step::Copy { from, to, bytes })
    };
    match attribute.name.as_str() {
        names::INTENSITY => number(place::INTENSITY, U16),
        names::RETURNS => as_it_is(place::RETURNS, U8, 1),
        names::FLAGS => as_it_is(place::FLAGS, U8, 1),
        names::CLASSIFICATION => number(place::CLASS, U8),
        names::USER_DATA => number(place::USER_DATA, U8),
        names::POINT_SOURCE_ID => number(place::POINT_SOURCE_ID, U16),
        names::SCAN_ANGLE if scalar == I8 && components == 1 => Some(Step::Degrees { from }),
        names::SCAN_ANGLE => as_it_is(place::SCAN_ANGLE, I16, 1),
        names::GPS_TIME if scalar == F32 && components == 1 => {
            Some(Step::Widen { from, to: place::GPS_TIME })
        }
        names::GPS_TIME => as_it_is(place::GPS_TIME, F64, 1),
        names::RGB => as_it_is(place::RGB, U16, 3),
        names::NIR => as_it_is(place::NIR, U16, 1),
        _ => None,
    }
}
