//! What the numbers of a column have in common, and the type that holds all of them.

use super::number::{Form, Number};
use crate::points::Scalar;

/// What was seen in one column.
///
/// Joining the statistics of two texts gives those of both, in any order, so texts can be looked
/// through side by side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColumnStats {
    /// Smallest whole number; larger than `highest` if none was seen.
    lowest: i64,
    /// Largest whole number.
    highest: i64,
    /// Smallest number that is not whole; infinite if none was seen.
    low: f64,
    /// Largest number that is not whole.
    high: f64,
    /// Cells without a finite number.
    has_missing: bool,
    /// Every number that is not whole comes back from f32.
    fits_f32: bool,
    /// Every number that is not whole is a 255th, as far as three digits tell.
    is_of_255: bool,
    /// Whole numbers beyond 64 bits.
    has_huge: bool,
}

impl ColumnStats {
    /// Of no numbers.
    pub const EMPTY: ColumnStats = ColumnStats {
        lowest: i64::MAX,
        highest: i64::MIN,
        low: f64::INFINITY,
        high: f64::NEG_INFINITY,
        has_missing: false,
        fits_f32: true,
        is_of_255: true,
        has_huge: false,
    };

    /// Takes in one number.
    #[inline(always)]
    pub fn add(&mut self, number: &Number) {
        if number.digits == 0 && number.form == Form::Decimal && number.mantissa <= i64::MAX as u64
        {
            let whole = signed(number.mantissa, number.value);
            self.lowest = self.lowest.min(whole);
            self.highest = self.highest.max(whole);
        } else {
            self.add_other(number);
        }
    }

    fn add_other(&mut self, number: &Number) {
        let value = number.value;
        if number.form == Form::Missing {
            self.has_missing = true;
            return;
        }
        let whole = whole(number);
        if let Some(whole) = whole {
            self.lowest = self.lowest.min(whole);
            self.highest = self.highest.max(whole);
            return;
        }
        self.low = self.low.min(value);
        self.high = self.high.max(value);
        self.has_huge |= value.fract() == 0.0;
        if self.fits_f32 {
            // Six digits always survive f32; more may.
            let is_short = number.form == Form::Decimal
                && (number.mantissa < 1_000_000 || number.shortened().0 < 1_000_000);
            self.fits_f32 = is_short || f64::from(value as f32) == value;
        }
        if self.is_of_255 {
            let steps = value * 255.0;
            self.is_of_255 = (steps - steps.round()).abs() < 0.13;
        }
    }

    /// Those of both.
    pub fn join(&self, other: &ColumnStats) -> ColumnStats {
        ColumnStats {
            lowest: self.lowest.min(other.lowest),
            highest: self.highest.max(other.highest),
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            has_missing: self.has_missing || other.has_missing,
            fits_f32: self.fits_f32 && other.fits_f32,
            is_of_255: self.is_of_255 && other.is_of_255,
            has_huge: self.has_huge || other.has_huge,
        }
    }

    /// Those of a column that some rows do not have.
    pub fn or_missing(self) -> ColumnStats {
        ColumnStats { has_missing: true, ..self }
    }

    /// Whether some numbers come back rounded whatever the type.
    pub fn is_rounded(&self) -> bool {
        self.has_huge
    }

    /// Whether cells are without a finite number.
    pub fn has_missing(&self) -> bool {
        self.has_missing
    }

    /// Whether all numbers are whole and lie in a range.
    pub fn is_whole_within(&self, low: i64, high: i64) -> bool {
        let none = self.lowest > self.highest;
        self.low > self.high && (none || self.lowest >= low && self.highest <= high)
    }

    /// Whether all numbers lie in a range and some are not whole.
    pub fn is_fraction_within(&self, low: i64, high: i64) -> bool {
        let whole_fit = self.lowest > self.highest || self.lowest >= low && self.highest <= high;
        self.low <= self.high && whole_fit && self.low >= low as f64 && self.high <= high as f64
    }

    /// Whether a number is negative.
    pub fn has_negative(&self) -> bool {
        self.lowest < 0 || self.low < 0.0
    }

    /// Whether all numbers are 255ths.
    pub fn is_of_255(&self) -> bool {
        self.is_of_255
    }

    /// The type that holds all numbers; few types, so that files of one kind get the same.
    pub fn scalar(&self) -> Scalar {
        let most_exact = |most: i64| self.is_whole_within(-most, most);
        if self.has_missing || !self.is_whole_within(i64::MIN, i64::MAX) {
            // Whole numbers among others: exact in f32 up to 2^24.
            let whole_fit =
                self.lowest > self.highest || self.lowest >= -(1 << 24) && self.highest <= 1 << 24;
            if self.fits_f32 && whole_fit { Scalar::F32 } else { Scalar::F64 }
        } else if self.is_whole_within(0, i64::from(u16::MAX)) {
            Scalar::U16
        } else if most_exact(i64::from(i32::MAX)) {
            Scalar::I32
        } else {
            Scalar::I64
        }
    }
}

/// The number as an integer, if it is one that 64 bits hold.
#[inline(always)]
pub fn whole(number: &Number) -> Option<i64> {
    match number.form {
        Form::Decimal => {
            let (mantissa, digits) = number.shortened();
            (digits == 0 && mantissa <= i64::MAX as u64).then(|| signed(mantissa, number.value))
        }
        Form::Float => {
            let value = number.value;
            (value.fract() == 0.0 && value.abs() < (1u64 << 53) as f64).then_some(value as i64)
        }
        Form::Missing => None,
    }
}

fn signed(mantissa: u64, value: f64) -> i64 {
    if value < 0.0 { -(mantissa as i64) } else { mantissa as i64 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::input::text::number::{read_plain, read_token};

    fn stats(numbers: &[&str]) -> ColumnStats {
        let mut stats = ColumnStats::EMPTY;
        for text in numbers {
            let number = match read_plain(text.as_bytes(), 0) {
                Some((number, end)) if end == text.len() => number,
                _ => read_token(text.as_bytes()).expect("it is a number"),
            };
            stats.add(&number);
        }
        stats
    }

    #[test]
    fn the_type_holds_every_number() {
        assert_eq!(stats(&["0", "65535"]).scalar(), Scalar::U16);
        assert_eq!(stats(&["7.000", "1.2e2"]).scalar(), Scalar::U16);
        assert_eq!(stats(&["-2048", "2047"]).scalar(), Scalar::I32);
        assert_eq!(stats(&["65536"]).scalar(), Scalar::I32);
        assert_eq!(stats(&["1700000000000000001"]).scalar(), Scalar::I64);
        assert_eq!(stats(&["0.034912", "1"]).scalar(), Scalar::F32);
        assert_eq!(stats(&["0.03491234"]).scalar(), Scalar::F64);
        assert_eq!(stats(&["1.500000000000000000e+00"]).scalar(), Scalar::F32);
        assert_eq!(stats(&["0.5", "16777217"]).scalar(), Scalar::F64);
        assert_eq!(stats(&["nan", "3"]).scalar(), Scalar::F32);
        assert_eq!(stats(&["99999999999999999999"]).scalar(), Scalar::F64);
        assert!(stats(&["99999999999999999999"]).is_rounded());
        assert_eq!(ColumnStats::EMPTY.scalar(), Scalar::U16);
    }

    #[test]
    fn ranges_tell_colours_from_directions() {
        assert!(stats(&["0", "255"]).is_whole_within(0, 255));
        assert!(!stats(&["0", "255.5"]).is_whole_within(0, 255));
        assert!(stats(&["0", "0.6039216", "1"]).is_fraction_within(0, 1));
        assert!(stats(&["0", "0.6039216", "0.604"]).is_of_255());
        assert!(!stats(&["0.6", "0.602"]).is_of_255());
        assert!(stats(&["-0.7", "1"]).has_negative());
    }

    #[test]
    fn joining_is_as_seeing_all() {
        let (a, b) = (stats(&["1", "0.5"]), stats(&["-7", "nan", "0.1234567"]));
        assert_eq!(a.join(&b), stats(&["1", "0.5", "-7", "nan", "0.1234567"]));
        assert_eq!(b.join(&ColumnStats::EMPTY), b);
    }
}
