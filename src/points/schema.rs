//! Which values each point carries and where they stand in a scan's record.
//!
//! Points travel through conversion as the raw records of the scan file, rows of `record_bytes`
//! bytes, so nothing is reinterpreted on the way. The schema names the columns of such a row. A
//! store keeps each column apart; together they give the record back, byte for byte.

use serde::{Deserialize, Serialize};

/// The type of one component of an attribute; little-endian in records and columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs, reason = "the names are Rust's own")]
pub enum Scalar {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

impl Scalar {
    /// Size of one component, bytes.
    pub fn bytes(self) -> usize {
        match self {
            Scalar::U8 | Scalar::I8 => 1,
            Scalar::U16 | Scalar::I16 => 2,
            Scalar::U32 | Scalar::I32 | Scalar::F32 => 4,
            Scalar::U64 | Scalar::I64 | Scalar::F64 => 8,
        }
    }

    /// The component that starts at `bytes[0]`, as a number (64-bit integers rounded to f64).
    pub fn read(self, bytes: &[u8]) -> f64 {
        fn take<const N: usize>(bytes: &[u8]) -> [u8; N] {
            bytes[..N].try_into().expect("the slice has N bytes")
        }
        match self {
            Scalar::U8 => f64::from(bytes[0]),
            Scalar::I8 => f64::from(bytes[0] as i8),
            Scalar::U16 => f64::from(u16::from_le_bytes(take(bytes))),
            Scalar::I16 => f64::from(i16::from_le_bytes(take(bytes))),
            Scalar::U32 => f64::from(u32::from_le_bytes(take(bytes))),
            Scalar::I32 => f64::from(i32::from_le_bytes(take(bytes))),
            Scalar::U64 => u64::from_le_bytes(take(bytes)) as f64,
            Scalar::I64 => i64::from_le_bytes(take(bytes)) as f64,
            Scalar::F32 => f64::from(f32::from_le_bytes(take(bytes))),
            Scalar::F64 => f64::from_le_bytes(take(bytes)),
        }
    }

    /// The smallest type that holds all values of both; f64 where there is none.
    pub fn wider(self, other: Scalar) -> Scalar {
        use Scalar::*;
        let (a, b) = (self, other);
        if a == b {
            return a;
        }
        let integer = |scalar| match scalar {
            U8 => Some((8, false)),
            I8 => Some((8, true)),
            U16 => Some((16, false)),
            I16 => Some((16, true)),
            U32 => Some((32, false)),
            I32 => Some((32, true)),
            U64 => Some((64, false)),
            I64 => Some((64, true)),
            F32 | F64 => None,
        };
        match (integer(a), integer(b)) {
            (Some((a_bits, a_signed)), Some((b_bits, b_signed))) => {
                let signed = a_signed || b_signed;
                let need = |bits: u32, is_signed: bool| bits + u32::from(signed && !is_signed);
                match (signed, need(a_bits, a_signed).max(need(b_bits, b_signed))) {
                    (false, 0..=8) => U8,
                    (false, 9..=16) => U16,
                    (false, 17..=32) => U32,
                    (false, _) => U64,
                    (true, 0..=8) => I8,
                    (true, 9..=16) => I16,
                    (true, 17..=32) => I32,
                    (true, 33..=64) => I64,
                    (true, _) => F64,
                }
            }
            (Some((bits, _)), None) if bits <= 16 && b == F32 => F32,
            (None, Some((bits, _))) if bits <= 16 && a == F32 => F32,
            _ => F64,
        }
    }
}

/// One value (or small vector) that every point carries, and its place in the record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Attribute {
    /// Unique name; the standard ones are in [`names`].
    pub name: String,
    /// Type of each component.
    pub scalar: Scalar,
    /// Number of components, at least 1.
    pub components: u16,
    /// First byte within the record.
    pub record_offset: u32,
}

impl Attribute {
    /// Size of the whole value, bytes.
    pub fn bytes(&self) -> usize {
        self.scalar.bytes() * usize::from(self.components)
    }
}

/// Names of the attributes that more than one room knows.
pub mod names {
    /// Return strength, u16.
    pub const INTENSITY: &str = "intensity";
    /// Class code, u8. In LAS point formats 0-5 the upper three bits are flags.
    pub const CLASSIFICATION: &str = "classification";
    /// Red, green, blue, 3 x u16 in records.
    pub const RGB: &str = "rgb";
    /// Near infrared, u16.
    pub const NIR: &str = "nir";
    /// Return number and number of returns, packed as the point format does, u8.
    pub const RETURNS: &str = "returns";
    /// Flags of LAS point formats 6-10 (classification flags, channel, scan direction), u8.
    pub const FLAGS: &str = "flags";
    /// Scan angle: i8 degrees (formats 0-5) or i16 in 0.006 degrees (6-10).
    pub const SCAN_ANGLE: &str = "scan_angle";
    /// Free byte of the user.
    pub const USER_DATA: &str = "user_data";
    /// Scan or flight line that the point belongs to, u16.
    pub const POINT_SOURCE_ID: &str = "point_source_id";
    /// GPS time, f64 seconds.
    pub const GPS_TIME: &str = "gps_time";
    /// Wave packet descriptor index, offset, size, location and direction, 29 bytes as they are.
    pub const WAVE_PACKET: &str = "wave_packet";
    /// Index into the store's sources of the file or scan that the point came from, u16 (u32 where
    /// there are more than 65,535).
    pub const SOURCE: &str = "source";
    /// What is missing from the lattice position to the exact float, 3 x i32 (single precision) or
    /// 3 x i64 (double precision); see [`exact_position`](super::super::exact_position).
    pub const COORDINATE_RESIDUAL: &str = "coordinate_residual";
    /// Surface normal, 3 x f32 (3 x f64 where the file has that).
    pub const NORMAL: &str = "normal";
}

/// All columns of a record.
///
/// Invariants: the first 12 bytes of a record are x, y, z as i32 on the scan's lattice; attributes
/// are in record order, do not overlap, and cover the rest of the record completely.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Schema {
    /// Size of one record, bytes.
    pub record_bytes: u32,
    /// The columns after x, y, z.
    pub attributes: Vec<Attribute>,
}

/// Bytes of the coordinates at the start of each record.
pub const COORDINATE_BYTES: usize = 12;

impl Schema {
    /// The attribute of that name and its place in the list.
    pub fn find(&self, name: &str) -> Option<(usize, &Attribute)> {
        self.attributes.iter().enumerate().find(|(_, attribute)| attribute.name == name)
    }

    /// Whether the attributes cover the record as the invariants say.
    pub fn covers_record(&self) -> bool {
        let end = self.attributes.iter().try_fold(COORDINATE_BYTES, |at, attribute| {
            (attribute.record_offset as usize == at && attribute.components > 0)
                .then(|| at + attribute.bytes())
        });
        end == Some(self.record_bytes as usize)
    }
}

/// The integer coordinates at the start of a record.
#[inline]
pub fn record_coordinates(record: &[u8]) -> [i32; 3] {
    let bytes: &[u8; COORDINATE_BYTES] =
        record[..COORDINATE_BYTES].try_into().expect("the slice has 12 bytes");
    let &[a, b, c, d, e, f, g, h, i, j, k, l] = bytes;
    [
        i32::from_le_bytes([a, b, c, d]),
        i32::from_le_bytes([e, f, g, h]),
        i32::from_le_bytes([i, j, k, l]),
    ]
}

#[cfg(test)]
mod tests {
    use Scalar::*;

    use super::*;

    #[test]
    fn wider_types_hold_both() {
        assert_eq!(U8.wider(U16), U16);
        assert_eq!(U8.wider(I8), I16);
        assert_eq!(U16.wider(I32), I32);
        assert_eq!(U32.wider(I32), I64);
        assert_eq!(U64.wider(I8), F64);
        assert_eq!(U16.wider(F32), F32);
        assert_eq!(I32.wider(F32), F64);
        assert_eq!(F32.wider(F64), F64);
        for scalar in [U8, I8, U16, I16, U32, I32, U64, I64, F32, F64] {
            assert_eq!(scalar.wider(scalar), scalar);
            assert_eq!(scalar.wider(F64), F64);
        }
    }
}
