//! What the fields of a row mean: coordinates, and columns under their standard names.

use glam::DVec3;

use crate::input::foreign::{Column, ForeignFault};
use crate::points::{Scalar, names};

/// A field as a file declares it, in the order of the row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// Name as the file writes it.
    pub name: String,
    /// Type of each component.
    pub scalar: Scalar,
    /// Components, at least 1.
    pub count: u16,
}

impl Field {
    pub fn bytes(&self) -> usize {
        self.scalar.bytes() * usize::from(self.count)
    }
}

/// How one piece of an attribute row comes out of a packed row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    /// Bytes as they are: place and number.
    Copy(usize, usize),
    /// One byte as 16 bits.
    Widen(usize),
    /// Red, green and blue out of the bytes blue, green, red, which other files pack into a float.
    PackedRgb(usize),
}

/// Which bytes of a packed row are what.
#[derive(Clone, Debug)]
pub struct RowPlan {
    /// Size of a packed row.
    pub row_bytes: usize,
    /// Place and type of x, y, z.
    pub axes: [(usize, Scalar); 3],
    /// What a row of attributes holds.
    pub columns: Vec<Column>,
    /// Size of a row of attributes.
    pub attribute_bytes: usize,
    steps: Vec<Step>,
}

/// A field and where it stands.
#[derive(Clone)]
struct Placed {
    name: String,
    scalar: Scalar,
    count: u16,
    at: usize,
}

impl RowPlan {
    /// Finds the meaning of fields that stand one after the other. `packed_color` says whether
    /// `rgb` and `rgba` are colours in one word, as PCD files have them.
    pub fn new(fields: &[Field], packed_color: bool) -> Result<Self, ForeignFault> {
        let mut at = 0;
        let mut placed = Vec::with_capacity(fields.len());
        for field in fields {
            let (name, scalar, count) = (snake_case(&field.name), field.scalar, field.count);
            // The library's name for bytes that mean nothing.
            if !(packed_color && field.name == "_") {
                placed.push(Placed { name, scalar, count, at });
            }
            at += field.bytes();
        }
        let axis = |name: &str| {
            let found = placed.iter().find(|field| field.name == name && field.count == 1);
            found.map(|field| (field.at, field.scalar)).ok_or_else(|| {
                ForeignFault::at("header", format!("there is no field \"{name}\" of one number"))
            })
        };
        let axes = [axis("x")?, axis("y")?, axis("z")?];
        placed.retain(|field| !["x", "y", "z"].contains(&field.name.as_str()));
        let mut plan = RowPlan {
            row_bytes: at,
            axes,
            columns: Vec::new(),
            attribute_bytes: 0,
            steps: Vec::new(),
        };
        while let Some(first) = placed.first().cloned() {
            plan.take(&first, &mut placed, packed_color);
        }
        plan.attribute_bytes = plan.columns.iter().map(bytes_of).sum();
        Ok(plan)
    }

    /// Adds the column that a field begins, and removes its fields from those left.
    fn take(&mut self, first: &Placed, left: &mut Vec<Placed>, packed_color: bool) {
        const COLORS: [[&str; 3]; 3] = [
            ["red", "green", "blue"],
            ["r", "g", "b"],
            ["diffuse_red", "diffuse_green", "diffuse_blue"],
        ];
        const NORMALS: [[&str; 3]; 2] = [["nx", "ny", "nz"], ["normal_x", "normal_y", "normal_z"]];
        let is_color = packed_color && ["rgb", "rgba"].contains(&first.name.as_str());
        if is_color && first.scalar.bytes() == 4 && first.count == 1 {
            self.column(names::RGB, Scalar::U16, 3, vec![Step::PackedRgb(first.at)]);
            if first.name == "rgba" {
                self.column("alpha", Scalar::U8, 1, vec![Step::Copy(first.at + 3, 1)]);
            }
            left.remove(0);
            return;
        }
        if let Some(parts) = triple(&COLORS, first, left) {
            let step = match parts[0].scalar {
                Scalar::U8 => Some(Step::Widen as fn(usize) -> Step),
                Scalar::U16 => Some((|at| Step::Copy(at, 2)) as fn(usize) -> Step),
                _ => None,
            };
            if let Some(step) = step {
                let steps = parts.iter().map(|part| step(part.at)).collect();
                self.column(names::RGB, Scalar::U16, 3, steps);
                left.retain(|field| parts.iter().all(|part| part.at != field.at));
                return;
            }
        }
        if let Some(parts) = triple(&NORMALS, first, left) {
            let scalar = parts[0].scalar;
            if matches!(scalar, Scalar::F32 | Scalar::F64) {
                let steps = parts.iter().map(|part| Step::Copy(part.at, scalar.bytes())).collect();
                self.column(names::NORMAL, scalar, 3, steps);
                left.retain(|field| parts.iter().all(|part| part.at != field.at));
                return;
            }
        }
        let bytes = first.scalar.bytes() * usize::from(first.count);
        let name = standard_name(first);
        self.column(&name, first.scalar, first.count, vec![Step::Copy(first.at, bytes)]);
        left.remove(0);
    }

    fn column(&mut self, name: &str, scalar: Scalar, components: u16, steps: Vec<Step>) {
        self.columns.push(Column { name: name.to_string(), scalar, components });
        for step in steps {
            match (self.steps.last_mut(), step) {
                (Some(Step::Copy(from, bytes)), Step::Copy(next, more))
                    if *from + *bytes == next =>
                {
                    *bytes += more;
                }
                _ => self.steps.push(step),
            }
        }
    }

    /// The position of a packed row; not finite where the file has none.
    #[inline]
    pub fn position(&self, row: &[u8]) -> DVec3 {
        DVec3::from_array(self.axes.map(|(at, scalar)| scalar.read(&row[at..])))
    }

    /// Appends the attributes of a packed row.
    #[inline]
    pub fn append_attributes(&self, row: &[u8], attributes: &mut Vec<u8>) {
        for step in &self.steps {
            match *step {
                Step::Copy(from, bytes) => attributes.extend_from_slice(&row[from..from + bytes]),
                Step::Widen(from) => attributes.extend_from_slice(&[row[from], 0]),
                Step::PackedRgb(from) => {
                    let [b, g, r] = [row[from], row[from + 1], row[from + 2]];
                    attributes.extend_from_slice(&[r, 0, g, 0, b, 0]);
                }
            }
        }
    }
}

fn bytes_of(column: &Column) -> usize {
    column.scalar.bytes() * usize::from(column.components)
}

/// The three fields of one type that a set of names means, if the first of those left is one of
/// them.
fn triple(sets: &[[&str; 3]], first: &Placed, left: &[Placed]) -> Option<[Placed; 3]> {
    let set = sets.iter().find(|set| set.contains(&first.name.as_str()))?;
    let part = |name: &str| {
        let of_type = |f: &&Placed| f.name == name && f.count == 1 && f.scalar == first.scalar;
        left.iter().find(of_type).cloned()
    };
    Some([part(set[0])?, part(set[1])?, part(set[2])?])
}

/// The name of a column that keeps its field's type.
fn standard_name(field: &Placed) -> String {
    let is = |scalar: Scalar| field.scalar == scalar && field.count == 1;
    match field.name.as_str() {
        "scalar_intensity" | "reflectance" | "scalar_reflectance" => names::INTENSITY.into(),
        "class" | "label" | "scalar_classification" if is(Scalar::U8) => {
            names::CLASSIFICATION.into()
        }
        "gpstime" | "scalar_gpstime" if is(Scalar::F64) => names::GPS_TIME.into(),
        // Attributes with a shape and a meaning of their own.
        name @ (names::RGB
        | names::NORMAL
        | names::WAVE_PACKET
        | names::RETURNS
        | names::FLAGS
        | names::SCAN_ANGLE) => format!("{name}_column"),
        name => name.into(),
    }
}

/// Whether single precision holds every coordinate, by the types that a file declares. Names are
/// compared as [`RowPlan`] does, so that the axes are those that it finds.
pub fn is_single<'a>(fields: impl IntoIterator<Item = (&'a str, Scalar)>) -> bool {
    let axes = fields.into_iter().filter(|(name, _)| {
        let name = snake_case(name);
        ["x", "y", "z"].contains(&name.as_str())
    });
    axes.into_iter().all(|(_, scalar)| scalar == Scalar::F32 || scalar.bytes() <= 2)
}

/// A file's own name as a word of lower case letters, digits and low lines.
pub fn snake_case(name: &str) -> String {
    let mut word = String::new();
    let mut after_small = false;
    for letter in name.chars().take(64) {
        if letter.is_alphanumeric() {
            if letter.is_uppercase() && after_small {
                word.push('_');
            }
            word.extend(letter.to_lowercase());
            after_small = letter.is_lowercase() || letter.is_numeric();
        } else {
            if !word.is_empty() && !word.ends_with('_') {
                word.push('_');
            }
            after_small = false;
        }
    }
    let word = word.trim_end_matches('_');
    if word.is_empty() { "column".into() } else { word.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn doubles_are_seen_under_any_name_that_is_an_axis() {
        let single = |name, scalar| is_single([("x", Scalar::F32), (name, scalar)]);
        assert!(single("y", Scalar::F32) && single("Y", Scalar::I16));
        assert!(single("time", Scalar::F64));
        for name in ["y", "Y", "y ", "(y)"] {
            assert!(!single(name, Scalar::F64), "{name}");
        }
        assert!(!single("z", Scalar::I32), "f32 does not hold them all");
    }

    fn field(name: &str, scalar: Scalar) -> Field {
        Field { name: name.into(), scalar, count: 1 }
    }

    #[test]
    fn names_are_words() {
        let cases = [
            ("scalar_Intensity", "scalar_intensity"),
            ("GpsTime", "gps_time"),
            ("X", "x"),
            ("  weird -- name!", "weird_name"),
            ("f_dc_0", "f_dc_0"),
            ("", "column"),
        ];
        for (name, word) in cases {
            assert_eq!(snake_case(name), word, "{name}");
        }
    }

    #[test]
    fn fields_become_standard_columns() {
        use Scalar::*;
        let fields = [
            field("blue", U8),
            field("x", F32),
            field("y", F32),
            field("z", F64),
            field("red", U8),
            field("green", U8),
            field("nx", F32),
            field("ny", F32),
            field("nz", F32),
            field("quality", U16),
        ];
        let plan = RowPlan::new(&fields, false).unwrap();
        let told: Vec<_> =
            plan.columns.iter().map(|c| (c.name.as_str(), c.scalar, c.components)).collect();
        assert_eq!(told, [("rgb", U16, 3), ("normal", F32, 3), ("quality", U16, 1)]);
        assert_eq!(plan.attribute_bytes, 6 + 12 + 2);
        let mut row = vec![30];
        row.extend(1.5f32.to_le_bytes());
        row.extend(2.5f32.to_le_bytes());
        row.extend((-3.5f64).to_le_bytes());
        row.extend([10, 20]);
        row.extend([7; 12]);
        row.extend([1, 2]);
        assert_eq!(plan.position(&row), DVec3::new(1.5, 2.5, -3.5));
        let mut attributes = Vec::new();
        plan.append_attributes(&row, &mut attributes);
        assert_eq!(attributes[..6], [10, 0, 20, 0, 30, 0]);
        assert_eq!(attributes[6..], [[7; 12].to_vec(), vec![1, 2]].concat());
    }

    #[test]
    fn packed_colours_come_apart() {
        let fields = [
            field("x", Scalar::F32),
            field("y", Scalar::F32),
            field("z", Scalar::F32),
            field("rgba", Scalar::U32),
        ];
        let plan = RowPlan::new(&fields, true).unwrap();
        let row = [vec![0; 12], vec![3, 2, 1, 9]].concat();
        let mut attributes = Vec::new();
        plan.append_attributes(&row, &mut attributes);
        assert_eq!(attributes, [1, 0, 2, 0, 3, 0, 9]);
        assert!(RowPlan::new(&fields[..2], true).unwrap_err().reason.contains("\"z\""));
    }
}
