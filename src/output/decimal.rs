//! Numbers as text: lattice coordinates digit by digit, integers, floats in the fewest digits that
//! read back as the same float.

use std::io::Write;

/// Turns the integers along one axis of a lattice into decimals, exactly.
///
/// Step and offset count as the decimals that are written for them: a step of 0.01 is a hundredth,
/// though no float is. So what a scanner wrote as 635577.79 comes back as 635577.79.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct DecimalAxis {
    step: i128,
    offset: i128,
    digits: u32,
}

/// Most digits after the point; more than any lattice of decimals has.
const MOST_DIGITS: u32 = 24;
/// Steps of powers of two with more digits than this are printed as floats instead.
const MOST_BINARY_DIGITS: u32 = 9;

impl DecimalAxis {
    /// For a step and an offset; `None` where floats say it in fewer digits.
    pub fn new(scale: f64, offset: f64) -> Option<Self> {
        let (step, step_exponent) = shortest_decimal(scale)?;
        let (offset, offset_exponent) = shortest_decimal(offset)?;
        let least = step_exponent.min(offset_exponent).min(0);
        let digits = least.unsigned_abs();
        let is_power_of_two = scale.to_bits() & ((1 << 52) - 1) == 0;
        let limit = if is_power_of_two { MOST_BINARY_DIGITS } else { MOST_DIGITS };
        if digits > limit {
            return None;
        }
        let scaled = |mantissa: i128, exponent: i32| {
            let power = 10i128.checked_pow((exponent - least).unsigned_abs())?;
            // Room for the product with a coordinate of 64 bits and for the sum.
            mantissa.checked_mul(power).filter(|value| value.unsigned_abs() >> 80 == 0)
        };
        Some(DecimalAxis {
            step: scaled(step, step_exponent)?,
            offset: scaled(offset, offset_exponent)?,
            digits,
        })
    }

    /// Appends the decimal of a coordinate of at most 40 bits.
    pub fn append(&self, steps: i64, out: &mut Vec<u8>) {
        let value = self.step * i128::from(steps) + self.offset;
        if value < 0 {
            out.push(b'-');
        }
        let value = value.unsigned_abs();
        let Ok(small) = u64::try_from(value) else {
            let digits = self.digits as usize;
            let text = format!("{value:0>width$}", width = digits + 1);
            let (whole, part) = text.split_at(text.len() - digits);
            out.extend_from_slice(whole.as_bytes());
            if digits > 0 {
                out.push(b'.');
                out.extend_from_slice(part.as_bytes());
            }
            return;
        };
        append_fixed(small, self.digits as usize, out);
    }
}

/// Mantissa and power of ten of the shortest decimal that reads back as a float.
fn shortest_decimal(value: f64) -> Option<(i128, i32)> {
    if !value.is_finite() {
        return None;
    }
    let text = format!("{value:e}");
    let (mantissa, exponent) = text.split_once('e')?;
    let (whole, part) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let digits: i128 = format!("{whole}{part}").parse().ok()?;
    let exponent: i32 = exponent.parse().ok()?;
    Some((digits, exponent - part.len() as i32))
}

/// Appends an integer with its last `digits` digits behind a point.
fn append_fixed(mut value: u64, digits: usize, out: &mut Vec<u8>) {
    let mut text = [b'0'; 48];
    let mut at = text.len();
    let mut put = |byte: u8| {
        at -= 1;
        text[at] = byte;
    };
    for _ in 0..digits {
        put(b'0' + (value % 10) as u8);
        value /= 10;
    }
    if digits > 0 {
        put(b'.');
    }
    loop {
        put(b'0' + (value % 10) as u8);
        value /= 10;
        if value == 0 {
            break;
        }
    }
    out.extend_from_slice(&text[at..]);
}

/// Appends a whole number.
pub(super) fn append_integer(value: i64, out: &mut Vec<u8>) {
    if value < 0 {
        out.push(b'-');
    }
    append_fixed(value.unsigned_abs(), 0, out);
}

/// Appends a whole number from 0 on.
pub(super) fn append_unsigned(value: u64, out: &mut Vec<u8>) {
    append_fixed(value, 0, out);
}

/// Appends thousandths.
pub(super) fn append_thousandths(value: i64, out: &mut Vec<u8>) {
    if value < 0 {
        out.push(b'-');
    }
    append_fixed(value.unsigned_abs(), 3, out);
}

/// Appends a float in the fewest digits that read back as it.
pub(super) fn append_double(value: f64, out: &mut Vec<u8>) {
    let plain = value == 0.0 || (1e-5..1e17).contains(&value.abs());
    let written =
        if plain || !value.is_finite() { write!(out, "{value}") } else { write!(out, "{value:e}") };
    written.expect("memory takes every write");
}

/// Appends a single-precision float in the fewest digits that read back as it.
pub(super) fn append_single(value: f32, out: &mut Vec<u8>) {
    let plain = value == 0.0 || (1e-5..1e17).contains(&value.abs());
    let written =
        if plain || !value.is_finite() { write!(out, "{value}") } else { write!(out, "{value:e}") };
    written.expect("memory takes every write");
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(append: impl FnOnce(&mut Vec<u8>)) -> String {
        let mut out = Vec::new();
        append(&mut out);
        String::from_utf8(out).expect("ASCII")
    }

    #[test]
    fn coordinates_are_the_decimals_that_a_scanner_wrote() {
        let cases: [(f64, f64, i64, &str); 9] = [
            (0.01, 0.0, 63_557_779, "635577.79"),
            (0.01, 635_000.0, 57_779, "635577.79"),
            (0.001, -0.5, 3, "-0.497"),
            (0.001, 0.0, -7, "-0.007"),
            (1.0, 0.0, -12, "-12"),
            (10.0, 3.0, 4, "43"),
            (0.5, 0.0, 3, "1.5"),
            (1e-7, -94.68, 1, "-94.6799999"),
            (0.000_25, 515_385.0, 3, "515385.00075"),
        ];
        for (scale, offset, steps, expected) in cases {
            let axis = DecimalAxis::new(scale, offset).expect("it is a decimal");
            assert_eq!(text(|out| axis.append(steps, out)), expected);
        }
    }

    #[test]
    fn long_coordinates_keep_all_their_digits() {
        let axis = DecimalAxis::new(1e-15, 123_456.5).expect("it is a decimal");
        assert_eq!(text(|out| axis.append(1, out)), "123456.500000000000001");
        assert_eq!(text(|out| axis.append(-1 << 32, out)), "123456.499995705032704");
        assert_eq!(DecimalAxis::new(1e-15, 1e300), None);
        assert_eq!(DecimalAxis::new(f64::NAN, 0.0), None);
    }

    #[test]
    fn fine_binary_steps_are_left_to_floats() {
        assert_eq!(DecimalAxis::new(2f64.powi(-20), 0.0), None);
        assert!(DecimalAxis::new(2f64.powi(-8), 0.0).is_some());
    }

    #[test]
    fn numbers_read_back_as_themselves() {
        for value in [0.0, -0.0, 0.1, 1e-40, -3.5e38, 1e300, 123_456_789.123, f64::MIN_POSITIVE] {
            let read: f64 = text(|out| append_double(value, out)).parse().expect("a number");
            assert_eq!(read.to_bits(), value.to_bits());
            let single = value as f32;
            let read: f32 = text(|out| append_single(single, out)).parse().expect("a number");
            assert_eq!(read.to_bits(), single.to_bits());
        }
        for value in [i64::MIN, -1, 0, 9, 10, i64::MAX] {
            assert_eq!(text(|out| append_integer(value, out)), value.to_string());
        }
        assert_eq!(text(|out| append_unsigned(u64::MAX, out)), u64::MAX.to_string());
        assert_eq!(text(|out| append_thousandths(-6, out)), "-0.006");
        assert_eq!(text(|out| append_double(f64::NAN, out)), "NaN");
    }
}
