//! The fields of an E57 scan: coordinates, and columns that all scans of the file share.

use ::e57::{Record, RecordDataType, RecordName};
use glam::DVec3;

use super::bits::Coding;
use super::packets::Stream;
use crate::input::foreign::{Column, CoordinateKind, ForeignFault};
use crate::input::table::snake_case;
use crate::points::{Lattice, Scalar, names};

/// Most fields of a point that are accepted.
const MOST_FIELDS: usize = 1024;

/// One field as the file declares it.
#[derive(Clone, Copy, Debug)]
struct Source {
    stream: usize,
    coding: Coding,
    /// Value of a step and of 0, for integers that stand for fractions.
    scaled: Option<(f64, f64)>,
}

/// The columns of all scans, in the order in which they were met.
#[derive(Clone, Debug, Default)]
pub struct Columns {
    /// Name, type and components.
    pub list: Vec<Column>,
}

impl Columns {
    /// The place of a column, wide enough for that type.
    fn place(&mut self, name: &str, scalar: Scalar, components: u16) -> usize {
        let known = self.list.iter().position(|c| c.name == name && c.components == components);
        match known {
            Some(place) => {
                self.list[place].scalar = self.list[place].scalar.wider(scalar);
                place
            }
            None => {
                self.list.push(Column { name: name.to_string(), scalar, components });
                self.list.len() - 1
            }
        }
    }

    fn offset(&self, place: usize) -> usize {
        self.list[..place].iter().map(bytes_of).sum()
    }

    /// Size of a row.
    fn row_bytes(&self) -> usize {
        self.list.iter().map(bytes_of).sum()
    }
}

fn bytes_of(column: &Column) -> usize {
    column.scalar.bytes() * usize::from(column.components)
}

/// The fields of one scan.
#[derive(Clone, Debug)]
pub struct ScanFields {
    codings: Vec<Coding>,
    axes: [Source; 3],
    is_spherical: bool,
    /// Marks of invalid coordinates.
    state: Option<Source>,
    /// Source, column and component.
    targets: Vec<(Source, usize, usize)>,
}

impl ScanFields {
    /// Finds the meaning of a scan's fields and adds its columns to those of the file.
    pub fn new(prototype: &[Record], columns: &mut Columns) -> Result<Self, ForeignFault> {
        if prototype.len() > MOST_FIELDS {
            let reason = format!("{} fields, at most {MOST_FIELDS} are read", prototype.len());
            return Err(ForeignFault::at("fields", reason));
        }
        let sources: Vec<Source> = prototype
            .iter()
            .enumerate()
            .map(|(stream, record)| source_of(stream, &record.data_type))
            .collect();
        let find = |name: RecordName| {
            prototype.iter().position(|record| record.name == name).map(|i| sources[i])
        };
        let all = |names: [RecordName; 3]| {
            let [a, b, c] = names.map(find);
            Some([a?, b?, c?])
        };
        use RecordName::*;
        let cartesian = all([CartesianX, CartesianY, CartesianZ]);
        let spherical = all([SphericalRange, SphericalAzimuth, SphericalElevation]);
        let is_spherical = cartesian.is_none();
        let axes = cartesian.or(spherical).ok_or_else(|| {
            ForeignFault::at("fields", "neither Cartesian nor spherical coordinates")
        })?;
        let state = find(if is_spherical { SphericalInvalidState } else { CartesianInvalidState });
        let mut fields = ScanFields {
            codings: sources.iter().map(|source| source.coding).collect(),
            axes,
            is_spherical,
            state,
            targets: Vec::new(),
        };
        fields.find_columns(prototype, &sources, columns);
        Ok(fields)
    }

    fn find_columns(&mut self, prototype: &[Record], sources: &[Source], columns: &mut Columns) {
        use RecordName::*;
        let own_state =
            if self.is_spherical { SphericalInvalidState } else { CartesianInvalidState };
        let used = self.axes.map(|axis| axis.stream);
        let integral = |name: RecordName| {
            let of_name = |record: &&Record| record.name == name;
            let range = prototype.iter().find(of_name).map(|record| range_of(&record.data_type));
            range.flatten().is_some_and(|(min, max)| min >= 0 && max <= i64::from(u16::MAX))
        };
        let has_color = [ColorRed, ColorGreen, ColorBlue].into_iter().all(integral);
        for (record, &source) in prototype.iter().zip(sources) {
            let color = [ColorRed, ColorGreen, ColorBlue].iter().position(|c| *c == record.name);
            let own = record.name == own_state;
            if used.contains(&source.stream) || own {
                continue;
            }
            let scalar = scalar_of(&record.data_type);
            let (place, component) = match (color, normal_of(&record.name)) {
                (Some(component), _) if has_color => {
                    (columns.place(names::RGB, Scalar::U16, 3), component)
                }
                (_, Some(component)) if matches!(scalar, Scalar::F32 | Scalar::F64) => {
                    (columns.place(names::NORMAL, scalar, 3), component)
                }
                _ => (columns.place(&name_of(&record.name), scalar, 1), 0),
            };
            self.targets.push((source, place, component));
        }
    }

    /// Bits of a record, per stream.
    pub fn widths(&self) -> Vec<u32> {
        self.codings.iter().map(|coding| coding.width()).collect()
    }

    /// How the coordinates are written.
    pub fn coordinates(&self) -> CoordinateKind {
        if self.is_spherical {
            return CoordinateKind::Computed;
        }
        let steps = self.axes.map(|axis| match (axis.coding, axis.scaled) {
            (Coding::Integer { .. }, scaled) => Some(scaled.unwrap_or((1.0, 0.0))),
            _ => None,
        });
        if let [Some(x), Some(y), Some(z)] = steps {
            let scale = DVec3::new(x.0, y.0, z.0);
            let offset = DVec3::new(x.1, y.1, z.1);
            let usable = scale.to_array().iter().all(|s| s.is_normal() && *s > 0.0);
            return match usable && offset.is_finite() {
                true => CoordinateKind::Lattice(Lattice { scale, offset }),
                false => CoordinateKind::F64,
            };
        }
        match self.axes.iter().all(|axis| axis.coding == Coding::Single) {
            true => CoordinateKind::F32,
            false => CoordinateKind::F64,
        }
    }

    /// Replaces positions and attributes by those of the records with valid coordinates, before
    /// any pose.
    pub fn decode(
        &self,
        streams: &[Stream],
        columns: &Columns,
        positions: &mut Vec<DVec3>,
        attributes: &mut Vec<u8>,
    ) -> Result<(), ForeignFault> {
        let records = streams.first().map_or(0, |stream| stream.records);
        positions.clear();
        positions.resize(records, DVec3::ZERO);
        for (axis, source) in self.axes.iter().enumerate() {
            source.each(&streams[source.stream], |row, value| positions[row][axis] = value);
        }
        if self.is_spherical {
            positions.iter_mut().for_each(|position| *position = cartesian(*position));
        }
        if let Some(state) = self.state {
            let not_valid = |row: usize, value: i64| {
                if value != 0 {
                    positions[row] = DVec3::NAN;
                }
            };
            state.coding.each_integer(&streams[state.stream], not_valid);
        }
        let row_bytes = columns.row_bytes();
        attributes.clear();
        attributes.resize(records * row_bytes, 0);
        for &(source, place, component) in &self.targets {
            let scalar = columns.list[place].scalar;
            let at = columns.offset(place) + component * scalar.bytes();
            source.write(&streams[source.stream], scalar, row_bytes, at, attributes);
        }
        keep_finite(positions, attributes, row_bytes);
        Ok(())
    }
}

/// Removes the rows whose position is not finite.
fn keep_finite(positions: &mut Vec<DVec3>, attributes: &mut Vec<u8>, row_bytes: usize) {
    if positions.iter().all(|position| position.is_finite()) {
        return;
    }
    let mut kept = 0;
    for row in 0..positions.len() {
        if positions[row].is_finite() {
            positions[kept] = positions[row];
            attributes.copy_within(row * row_bytes..(row + 1) * row_bytes, kept * row_bytes);
            kept += 1;
        }
    }
    positions.truncate(kept);
    attributes.truncate(kept * row_bytes);
}

/// Range, azimuth and elevation as x, y, z.
fn cartesian(spherical: DVec3) -> DVec3 {
    let [range, azimuth, elevation] = spherical.to_array();
    let flat = range * elevation.cos();
    DVec3::new(flat * azimuth.cos(), flat * azimuth.sin(), range * elevation.sin())
}

impl Source {
    /// Calls `take` with each value.
    fn each(&self, stream: &Stream, mut take: impl FnMut(usize, f64)) {
        match self.scaled {
            Some((scale, offset)) => {
                self.coding.each_float(stream, |row, value| take(row, value * scale + offset));
            }
            None => self.coding.each_float(stream, take),
        }
    }

    /// Writes each value into rows, at a place in the row.
    fn write(&self, stream: &Stream, to: Scalar, row_bytes: usize, at: usize, rows: &mut [u8]) {
        let size = to.bytes();
        let mut put = |row: usize, bytes: &[u8]| {
            let start = row * row_bytes + at;
            rows[start..start + size].copy_from_slice(&bytes[..size]);
        };
        match to {
            Scalar::F32 => self.each(stream, |row, v| put(row, &(v as f32).to_le_bytes())),
            Scalar::F64 => self.each(stream, |row, v| put(row, &v.to_le_bytes())),
            _ => self.coding.each_integer(stream, |row, v| put(row, &v.to_le_bytes())),
        }
    }
}

fn source_of(stream: usize, data_type: &RecordDataType) -> Source {
    let integer = |min: i64, max: i64| {
        let range = (i128::from(max) - i128::from(min)).max(0) as u128;
        Coding::Integer { min, bits: u128::BITS - range.leading_zeros() }
    };
    let (coding, scaled) = match *data_type {
        RecordDataType::Single { .. } => (Coding::Single, None),
        RecordDataType::Double { .. } => (Coding::Double, None),
        RecordDataType::ScaledInteger { min, max, scale, offset } => {
            (integer(min, max), Some((scale, offset)))
        }
        RecordDataType::Integer { min, max } => (integer(min, max), None),
    };
    Source { stream, coding, scaled }
}

/// All values that the bits of an integer can give.
fn range_of(data_type: &RecordDataType) -> Option<(i64, i64)> {
    let RecordDataType::Integer { min, .. } = *data_type else { return None };
    let bits = source_of(0, data_type).coding.width();
    let largest = i128::from(min) + ((1i128 << bits) - 1);
    Some((min, i64::try_from(largest).unwrap_or(i64::MAX)))
}

/// The type of a column that holds all values of a field.
fn scalar_of(data_type: &RecordDataType) -> Scalar {
    match data_type {
        RecordDataType::Single { .. } => Scalar::F32,
        RecordDataType::Double { .. } | RecordDataType::ScaledInteger { .. } => Scalar::F64,
        RecordDataType::Integer { .. } => {
            let (min, max) = range_of(data_type).expect("the type is an integer");
            match (min, max) {
                (0.., ..=0xff) => Scalar::U8,
                (0.., ..=0xffff) => Scalar::U16,
                (0.., ..=0xffff_ffff) => Scalar::U32,
                (-0x80.., ..=0x7f) => Scalar::I8,
                (-0x8000.., ..=0x7fff) => Scalar::I16,
                (-0x8000_0000.., ..=0x7fff_ffff) => Scalar::I32,
                _ => Scalar::I64,
            }
        }
    }
}

/// Which component of a normal a field of the extension for normals is.
fn normal_of(name: &RecordName) -> Option<usize> {
    let RecordName::Unknown { name, .. } = name else { return None };
    ["normalX", "normalY", "normalZ"].iter().position(|normal| name == normal)
}

fn name_of(name: &RecordName) -> String {
    use RecordName::*;
    match name {
        Intensity => names::INTENSITY,
        IsIntensityInvalid => "is_intensity_invalid",
        ColorRed => "red",
        ColorGreen => "green",
        ColorBlue => "blue",
        IsColorInvalid => "is_color_invalid",
        RowIndex => "row_index",
        ColumnIndex => "column_index",
        ReturnCount => "return_count",
        ReturnIndex => "return_index",
        TimeStamp => "time_stamp",
        IsTimeStampInvalid => "is_time_stamp_invalid",
        CartesianX => "cartesian_x",
        CartesianY => "cartesian_y",
        CartesianZ => "cartesian_z",
        CartesianInvalidState => "cartesian_invalid_state",
        SphericalRange => "spherical_range",
        SphericalAzimuth => "spherical_azimuth",
        SphericalElevation => "spherical_elevation",
        SphericalInvalidState => "spherical_invalid_state",
        Unknown { name, .. } => {
            let word = snake_case(name);
            // Attributes with a shape and a meaning of their own.
            let reserved = [names::RGB, names::NORMAL, names::RETURNS, names::FLAGS];
            return if reserved.contains(&word.as_str()) { format!("{word}_column") } else { word };
        }
    }
    .to_string()
}
