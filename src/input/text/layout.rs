//! Where each column of a text goes in the rows that a reader hands out.

use super::columns::{AXES, COLORS, NORMALS, SKIP};
use super::number::{Form, Number};
use super::row::RowFormat;
use super::stats::{ColumnStats, whole};
use crate::input::foreign::Column;
use crate::points::{Scalar, names};

/// Rows of one width, and what was seen in them.
#[derive(Clone, Debug)]
pub struct RowClass {
    /// How they are split.
    pub format: RowFormat,
    /// Which fields are x, y and z.
    pub axes: [usize; 3],
    /// What the columns are called, if somebody told; coordinates included.
    pub names: Option<Vec<String>>,
    /// What was seen, per field.
    pub stats: Vec<ColumnStats>,
    /// Rows of this class.
    pub rows: u64,
}

/// What becomes of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// Nothing.
    Skip,
    /// A coordinate.
    Axis(u8),
    /// A value at a byte of the packed row.
    Value(u32, Stored),
}

/// How a number is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names are Rust's own")]
pub enum Stored {
    U8,
    I16,
    U16,
    I32,
    I64,
    F32,
    F64,
    /// A colour between 0 and 1 as u16, multiplied by this.
    Scaled(u16),
}

/// The columns of a file and how its rows fill them.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Columns besides the coordinates.
    pub columns: Vec<Column>,
    /// Bytes of a packed row.
    pub row_bytes: usize,
    /// Per row class, what becomes of each field.
    pub targets: Vec<Vec<Target>>,
    /// What is worth telling about the choice.
    pub warnings: Vec<String>,
}

/// Lays out the columns of all classes; those without rows do not count. `intensity` of PTX is a
/// fraction whatever values occur.
pub fn lay_out(classes: &[RowClass], intensity_is_fraction: bool) -> Layout {
    let mut seen: Vec<(&str, ColumnStats)> = Vec::new();
    let filled = || classes.iter().filter(|class| class.rows > 0);
    let names_of = |class: &RowClass| class.names.clone().expect("classes are named by now");
    let names: Vec<Vec<String>> = classes.iter().map(names_of).collect();
    for (class, names) in classes.iter().zip(&names).filter(|(class, _)| class.rows > 0) {
        for (name, stats) in names.iter().zip(&class.stats) {
            if name == SKIP || AXES.contains(&name.as_str()) {
                continue;
            }
            match seen.iter_mut().find(|(other, _)| other == name) {
                Some((_, joined)) => *joined = joined.join(stats),
                None => seen.push((name, *stats)),
            }
        }
    }
    for (name, stats) in &mut seen {
        let has = |names: &[String]| names.iter().any(|other| other == name);
        let everywhere =
            classes.iter().zip(&names).all(|(class, names)| class.rows == 0 || has(names));
        if !everywhere {
            *stats = stats.or_missing();
        }
    }
    let mut plan = Plan { is_mixed: filled().count() > 1, ..Plan::default() };
    plan.place_all(&seen, intensity_is_fraction);
    if plan.is_mixed {
        plan.warnings.push(
            "scans have different columns: what a scan lacks is 0 in colours, else not a number"
                .to_string(),
        );
    }
    let targets = classes.iter().zip(&names).map(|(class, names)| {
        let target = |(field, name): (usize, &String)| {
            if let Some(axis) = class.axes.iter().position(|axis| *axis == field) {
                return Target::Axis(axis as u8);
            }
            let place = plan.places.iter().find(|(other, ..)| other == name);
            place.map_or(Target::Skip, |(_, offset, stored)| Target::Value(*offset, *stored))
        };
        names.iter().enumerate().map(target).collect()
    });
    let targets = targets.collect();
    let Plan { columns, row_bytes, warnings, .. } = plan;
    Layout { columns, row_bytes, targets, warnings }
}

/// A layout in the making.
#[derive(Default)]
struct Plan {
    columns: Vec<Column>,
    row_bytes: usize,
    /// Name of a field, where it goes and as what.
    places: Vec<(String, u32, Stored)>,
    warnings: Vec<String>,
    /// Whether scans have different columns.
    is_mixed: bool,
}

impl Plan {
    fn place_all(&mut self, seen: &[(&str, ColumnStats)], intensity_is_fraction: bool) {
        let of = |words: [&str; 3]| -> Option<[ColumnStats; 3]> {
            let stats = words.map(|word| seen.iter().find(|(name, _)| *name == word));
            let [Some(a), Some(b), Some(c)] = stats else { return None };
            Some([a.1, b.1, c.1])
        };
        let color = of(COLORS).and_then(|stats| self.color_kind(&stats));
        let has_normal = of(NORMALS).is_some();
        for &(name, ref stats) in seen {
            if COLORS.contains(&name) && color.is_some() {
                self.place_vector(names::RGB, Scalar::U16, COLORS, color.unwrap_or(Stored::U16));
            } else if NORMALS.contains(&name) && has_normal {
                self.place_vector("normal", Scalar::F32, NORMALS, Stored::F32);
            } else {
                self.place_single(name, stats, intensity_is_fraction);
            }
        }
    }

    /// How three colour columns are stored as one; `None` if they are no colour.
    fn color_kind(&mut self, stats: &[ColumnStats; 3]) -> Option<Stored> {
        if !self.is_mixed && stats.iter().any(ColumnStats::has_missing) {
            self.warnings.push("colours that are not numbers are stored as 0".to_string());
        }
        if stats.iter().all(|s| s.is_whole_within(0, i64::from(u16::MAX))) {
            return Some(Stored::U16);
        }
        if stats.iter().all(|s| s.is_fraction_within(0, 1) || s.is_whole_within(0, 1)) {
            let most = if stats.iter().all(ColumnStats::is_of_255) { 255 } else { u16::MAX };
            self.warnings.push(format!("colours between 0 and 1 are stored as 0 to {most}"));
            return Some(Stored::Scaled(most));
        }
        self.warnings.push(
            "red, green and blue are kept as columns of their own: not all lie in 0 to 65535"
                .to_string(),
        );
        None
    }

    /// One column of three components; called once per component, placed at the first.
    fn place_vector(&mut self, name: &str, scalar: Scalar, words: [&str; 3], stored: Stored) {
        if self.columns.iter().any(|column| column.name == name) {
            return;
        }
        for word in words {
            self.places.push((word.to_string(), self.row_bytes as u32, stored));
            self.row_bytes += scalar.bytes();
        }
        self.columns.push(Column { name: name.to_string(), scalar, components: 3 });
    }

    fn place_single(&mut self, name: &str, stats: &ColumnStats, intensity_is_fraction: bool) {
        let standard = match name {
            names::CLASSIFICATION | names::USER_DATA | names::RETURNS | names::FLAGS => {
                Some((Stored::U8, stats.is_whole_within(0, 255)))
            }
            names::SCAN_ANGLE => {
                let fits = stats.is_whole_within(i64::from(i16::MIN), i64::from(i16::MAX));
                Some((Stored::I16, fits))
            }
            names::POINT_SOURCE_ID | names::NIR => {
                Some((Stored::U16, stats.is_whole_within(0, i64::from(u16::MAX))))
            }
            names::GPS_TIME => Some((Stored::F64, true)),
            _ => None,
        };
        let general = match stats.scalar() {
            Scalar::U16 | Scalar::I32 if name == names::INTENSITY && intensity_is_fraction => {
                Stored::F32
            }
            Scalar::U16 => Stored::U16,
            Scalar::I32 => Stored::I32,
            Scalar::I64 => Stored::I64,
            Scalar::F32 => Stored::F32,
            _ => Stored::F64,
        };
        let (mut own_name, stored) = match standard {
            Some((stored, true)) if stored == Stored::F64 || !stats.has_missing() => {
                (name.to_string(), stored)
            }
            // The standard name is for values of the standard type.
            Some(_) => (format!("{name}_column"), general),
            None => (name.to_string(), general),
        };
        while self.columns.iter().any(|column| column.name == own_name) {
            own_name.push_str("_2");
        }
        if stats.is_rounded() {
            self.warnings.push(format!("{own_name}: whole numbers beyond 64 bits are rounded"));
        }
        let scalar = stored.scalar();
        self.places.push((name.to_string(), self.row_bytes as u32, stored));
        self.row_bytes += scalar.bytes();
        self.columns.push(Column { name: own_name, scalar, components: 1 });
    }
}

impl Stored {
    fn scalar(self) -> Scalar {
        match self {
            Stored::U8 => Scalar::U8,
            Stored::I16 => Scalar::I16,
            Stored::U16 | Stored::Scaled(_) => Scalar::U16,
            Stored::I32 => Scalar::I32,
            Stored::I64 => Scalar::I64,
            Stored::F32 => Scalar::F32,
            Stored::F64 => Scalar::F64,
        }
    }

    /// Writes a number to its place. A number that the type does not hold (none occurs unless the
    /// file changes after it was looked through) becomes the nearest that it does.
    #[inline(always)]
    pub fn write(self, number: &Number, to: &mut [u8]) {
        let integer = || {
            if number.form == Form::Decimal && number.digits == 0 && number.value >= 0.0 {
                number.mantissa.min(i64::MAX as u64) as i64
            } else {
                whole(number).unwrap_or(number.value as i64)
            }
        };
        match self {
            Stored::U8 => to[0] = integer().clamp(0, 255) as u8,
            Stored::I16 => {
                let value = integer().clamp(i64::from(i16::MIN), i64::from(i16::MAX)) as i16;
                to[..2].copy_from_slice(&value.to_le_bytes());
            }
            Stored::U16 => {
                let value = integer().clamp(0, i64::from(u16::MAX)) as u16;
                to[..2].copy_from_slice(&value.to_le_bytes());
            }
            Stored::I32 => {
                let value = integer().clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32;
                to[..4].copy_from_slice(&value.to_le_bytes());
            }
            Stored::I64 => to[..8].copy_from_slice(&integer().to_le_bytes()),
            Stored::F32 => to[..4].copy_from_slice(&(number.value as f32).to_le_bytes()),
            Stored::F64 => to[..8].copy_from_slice(&number.value.to_le_bytes()),
            Stored::Scaled(most) => {
                // Casting turns what is not a number into 0.
                let value = (number.value * f64::from(most)).round() as u16;
                to[..2].copy_from_slice(&value.to_le_bytes());
            }
        }
    }

    /// Writes what stands for a value that a scan lacks.
    pub fn write_missing(self, to: &mut [u8]) {
        self.write(&Number::EMPTY, to);
    }
}

impl Layout {
    /// A packed row of values that are all missing, for the fields that a class does not have.
    pub fn blank_row(&self, class: usize) -> Vec<u8> {
        let mut row = vec![0; self.row_bytes];
        let mut offset = 0;
        for column in &self.columns {
            for _ in 0..column.components {
                let is_there = self.targets[class]
                    .iter()
                    .any(|target| matches!(target, Target::Value(at, _) if *at as usize == offset));
                let to = &mut row[offset..];
                match column.scalar {
                    Scalar::F32 if !is_there => Stored::F32.write_missing(to),
                    Scalar::F64 if !is_there => Stored::F64.write_missing(to),
                    _ => {}
                }
                offset += column.scalar.bytes();
            }
        }
        row
    }
}
