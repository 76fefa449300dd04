//! The eleven point formats and the extra bytes after them, as a schema of columns.
//!
//! Fields that a format packs into one byte stay packed: a schema names bytes, it does not
//! interpret them.
//!
//! Source: ASPRS, "LAS Specification 1.4 - R15", tables 7 to 17 (formats) and 24, 25 (extra bytes).

use std::collections::HashSet;

use super::header::text;
use super::vlr::Vlr;
use crate::points::{Attribute, COORDINATE_BYTES, Scalar, Schema, names};

/// A point format, 0 to 10.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PointFormat(u8);

impl PointFormat {
    /// The format of that number, if there is one.
    pub fn new(number: u8) -> Option<Self> {
        (number <= 10).then_some(PointFormat(number))
    }

    /// Its number.
    pub fn number(self) -> u8 {
        self.0
    }

    /// Whether it is one of version 1.4's formats: 4-bit returns, flags of their own, 16-bit angle.
    pub fn is_extended(self) -> bool {
        self.0 >= 6
    }

    /// Whether records carry GPS time.
    pub fn has_gps_time(self) -> bool {
        !matches!(self.0, 0 | 2)
    }

    /// Whether records carry red, green and blue.
    pub fn has_rgb(self) -> bool {
        matches!(self.0, 2 | 3 | 5 | 7 | 8 | 10)
    }

    /// Whether records carry near infrared.
    pub fn has_nir(self) -> bool {
        matches!(self.0, 8 | 10)
    }

    /// Whether records describe wave packets.
    pub fn has_wave_packet(self) -> bool {
        matches!(self.0, 4 | 5 | 9 | 10)
    }

    /// Size of a record without extra bytes.
    pub fn base_bytes(self) -> u16 {
        let columns = self.columns();
        let bytes: usize = columns.iter().map(|&(_, scalar, n)| scalar.bytes() * n as usize).sum();
        (COORDINATE_BYTES + bytes) as u16
    }

    /// Return number of a record, 0 where none is told.
    pub fn return_number(self, record: &[u8]) -> u8 {
        record[14] & if self.is_extended() { 0x0f } else { 0x07 }
    }

    /// Columns after x, y, z in record order: name, type, components.
    fn columns(self) -> Vec<(&'static str, Scalar, u16)> {
        use Scalar::*;
        let mut columns = vec![(names::INTENSITY, U16, 1), (names::RETURNS, U8, 1)];
        if self.is_extended() {
            columns.extend([
                (names::FLAGS, U8, 1),
                (names::CLASSIFICATION, U8, 1),
                (names::USER_DATA, U8, 1),
                (names::SCAN_ANGLE, I16, 1),
                (names::POINT_SOURCE_ID, U16, 1),
            ]);
        } else {
            columns.extend([
                (names::CLASSIFICATION, U8, 1),
                (names::SCAN_ANGLE, I8, 1),
                (names::USER_DATA, U8, 1),
                (names::POINT_SOURCE_ID, U16, 1),
            ]);
        }
        let optional = [
            (self.has_gps_time(), (names::GPS_TIME, F64, 1)),
            (self.has_rgb(), (names::RGB, U16, 3)),
            (self.has_nir(), (names::NIR, U16, 1)),
            (self.has_wave_packet(), (names::WAVE_PACKET, U8, 29)),
        ];
        columns.extend(optional.into_iter().filter(|(present, _)| *present).map(|(_, c)| c));
        columns
    }

    /// The schema of records of `record_bytes` bytes, whose extra bytes the given descriptions
    /// name. Bytes that no description covers become the attribute `extra`.
    ///
    /// `record_bytes` is at least [`base_bytes`](Self::base_bytes). Descriptions that do not fit
    /// are left out and told in the second part.
    pub fn schema(self, record_bytes: u16, described: &[ExtraBytes]) -> (Schema, Option<String>) {
        let end = usize::from(record_bytes);
        let mut schema = Schema { record_bytes: end as u32, attributes: Vec::new() };
        let mut at = COORDINATE_BYTES;
        let mut taken = HashSet::new();
        let mut push = |name: &str, scalar: Scalar, components: u16, at: &mut usize| {
            let name = unique(name, &mut taken);
            let record_offset = *at as u32;
            *at += scalar.bytes() * usize::from(components);
            schema.attributes.push(Attribute { name, scalar, components, record_offset });
        };
        for (name, scalar, components) in self.columns() {
            push(name, scalar, components, &mut at);
        }
        let mut odd = None;
        for extra in described {
            let bytes = extra.scalar.bytes() * usize::from(extra.components);
            if at + bytes > end {
                odd = Some(format!(
                    "extra bytes \"{}\" and what follows do not fit the record of {end} bytes",
                    extra.name
                ));
                break;
            }
            push(&extra.name, extra.scalar, extra.components, &mut at);
        }
        if at < end {
            push("extra", Scalar::U8, (end - at) as u16, &mut at);
        }
        debug_assert!(schema.covers_record());
        (schema, odd)
    }
}

/// One description of extra bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExtraBytes {
    /// Its name; never empty.
    pub name: String,
    /// Type of each component.
    pub scalar: Scalar,
    /// Components, at least 1.
    pub components: u16,
}

const DESCRIPTION_BYTES: usize = 192;

/// The descriptions in the data of an extra bytes record, and what was odd about them.
///
/// A type that is reserved ends the list, since its size and so the place of the rest is unknown.
pub fn extra_bytes(data: &[u8]) -> (Vec<ExtraBytes>, Option<String>) {
    let mut described = Vec::new();
    for (index, entry) in data.chunks_exact(DESCRIPTION_BYTES).enumerate() {
        let name = Some(text(&entry[4..36])).filter(|name| !name.is_empty());
        let name = name.unwrap_or_else(|| "extra".to_string());
        let [data_type, options] = [entry[2], entry[3]];
        let (scalar, components) = match data_type {
            // Raw bytes: the options field counts them.
            0 if options == 0 => continue,
            0 => (Scalar::U8, u16::from(options)),
            // 11-20 and 21-30 are the deprecated pairs and triples of 1-10.
            1..=30 => (scalar((data_type - 1) % 10), u16::from((data_type - 1) / 10 + 1)),
            _ => {
                let odd = format!("extra bytes {index} \"{name}\" have unknown type {data_type}");
                return (described, Some(odd));
            }
        };
        described.push(ExtraBytes { name, scalar, components });
    }
    let odd = (!data.len().is_multiple_of(DESCRIPTION_BYTES))
        .then(|| format!("extra bytes record of {} bytes, expected a multiple of 192", data.len()));
    (described, odd)
}

/// Whether a record is the description of extra bytes.
pub fn describes_extra_bytes(vlr: &Vlr) -> bool {
    vlr.user_id == "LASF_Spec" && vlr.record_id == 4
}

fn scalar(index: u8) -> Scalar {
    use Scalar::*;
    [U8, I8, U16, I16, U32, I32, U64, I64, F32, F64][usize::from(index)]
}

/// The name, or the name with the first free number behind it.
pub(super) fn unique(name: &str, taken: &mut HashSet<String>) -> String {
    let mut candidate = name.to_string();
    let mut number = 2;
    while !taken.insert(candidate.clone()) {
        candidate = format!("{name}_{number}");
        number += 1;
    }
    candidate
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn record_sizes_are_the_specification_s() {
        let sizes = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];
        for (number, size) in sizes.into_iter().enumerate() {
            let format = PointFormat::new(number as u8).expect("0 to 10");
            assert_eq!(format.base_bytes(), size, "format {number}");
            assert!(format.schema(size, &[]).0.covers_record());
        }
        assert_eq!(PointFormat::new(11), None);
    }

    fn description(data_type: u8, options: u8, name: &str) -> Vec<u8> {
        let mut entry = vec![0; DESCRIPTION_BYTES];
        entry[2] = data_type;
        entry[3] = options;
        entry[4..4 + name.len()].copy_from_slice(name.as_bytes());
        entry
    }

    #[test]
    fn extra_bytes_get_unique_names_and_the_rest_is_kept() {
        let data = [
            description(4, 0, "intensity"),
            description(29, 0, "normal"),
            description(0, 3, ""),
            description(10, 0, "normal"),
        ]
        .concat();
        let (described, odd) = extra_bytes(&data);
        assert_eq!(odd, None);
        let format = PointFormat::new(0).expect("format 0");
        let (schema, odd) = format.schema(20 + 2 + 12 + 3 + 8 + 5, &described);
        assert_eq!(odd, None);
        let told: Vec<_> = schema.attributes[6..]
            .iter()
            .map(|a| (a.name.as_str(), a.scalar, a.components, a.record_offset))
            .collect();
        assert_eq!(
            told,
            [
                ("intensity_2", Scalar::I16, 1, 20),
                ("normal", Scalar::F32, 3, 22),
                ("extra", Scalar::U8, 3, 34),
                ("normal_2", Scalar::F64, 1, 37),
                ("extra_2", Scalar::U8, 5, 45),
            ]
        );
        assert!(schema.covers_record());
    }

    #[test]
    fn descriptions_beyond_the_record_are_told() {
        let (described, _) = extra_bytes(&description(10, 0, "height"));
        let format = PointFormat::new(0).expect("format 0");
        let (schema, odd) = format.schema(24, &described);
        assert!(odd.is_some_and(|text| text.contains("height")));
        assert_eq!(
            schema.attributes.last().map(|a| (a.name.as_str(), a.components)),
            Some(("extra", 4))
        );
        let (described, odd) = extra_bytes(&description(31, 0, "odd"));
        assert!(described.is_empty() && odd.is_some_and(|text| text.contains("31")));
    }
}
