//! Decimal numbers out of text: their value, and the digits that tell how exact it is.
//!
//! Digits are read eight at a time as one word. A mantissa below 2^53 over a power of ten up to
//! 10^22 is one exact division of two exact numbers, so the quotient is the nearest f64 (Clinger,
//! "How to read floating point numbers accurately", 1990); whatever is longer, has an exponent or
//! is no plain decimal goes through the standard library.

use std::str;

/// How a number was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Digits with at most one point: the value is `mantissa / 10^digits`, nearest f64.
    Decimal,
    /// With an exponent, or with more than 19 digits that matter.
    Float,
    /// Not a number, infinite, or an empty cell: no finite value.
    Missing,
}

/// A number of the text.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Number {
    /// Its value, correctly rounded.
    pub value: f64,
    /// All digits without sign and point, if the form is decimal.
    pub mantissa: u64,
    /// Digits after the point, if the form is decimal.
    pub digits: u8,
    /// How it was written.
    pub form: Form,
}

impl Number {
    /// An empty cell.
    pub const EMPTY: Number =
        Number { value: f64::NAN, mantissa: 0, digits: 0, form: Form::Missing };

    /// Digits after the point without the zeros at the end.
    pub fn digits_that_matter(&self) -> u8 {
        self.shortened().1
    }

    /// Mantissa and digits after the point, without zeros at the end of the fraction.
    pub fn shortened(&self) -> (u64, u8) {
        let (mut mantissa, mut digits) = (self.mantissa, self.digits);
        while digits > 0 && mantissa % 10 == 0 {
            mantissa /= 10;
            digits -= 1;
        }
        (mantissa, digits)
    }
}

/// Powers of ten that f64 holds exactly.
const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
    1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
];

/// Powers of ten of one word of digits.
const WORD_POWERS: [u64; 9] =
    [1, 10, 100, 1_000, 10_000, 100_000, 1_000_000, 10_000_000, 100_000_000];

/// Most digits whose mantissa cannot overflow 64 bits.
const MOST_DIGITS: usize = 19;

/// Reads the number that starts at `at` and ends before the first byte that no plain decimal has;
/// gives it and where it ends. `None` if these bytes are no plain decimal, or a long one: then
/// [`read_token`] decides once the token's end is known.
#[inline(always)]
pub fn read_plain(text: &[u8], at: usize) -> Option<(Number, usize)> {
    let mut at = at;
    let first = *text.get(at)?;
    let is_negative = first == b'-';
    // Signs change at random, so nothing branches on them.
    at += usize::from(is_negative | (first == b'+'));
    let begin = at;
    let mut mantissa = 0;
    at = read_digits(text, at, &mut mantissa);
    let mut count = at - begin;
    let mut digits = 0;
    if text.get(at) == Some(&b'.') {
        let fraction = at + 1;
        at = read_digits(text, fraction, &mut mantissa);
        digits = at - fraction;
        count += digits;
    }
    if count == 0 || count > MOST_DIGITS || mantissa >= 1 << 53 {
        return None;
    }
    let size = mantissa as f64 / POWERS[digits];
    let value = f64::from_bits(size.to_bits() | u64::from(is_negative) << 63);
    Some((Number { value, mantissa, digits: digits as u8, form: Form::Decimal }, at))
}

/// Reads a whole token, however it is written; `None` if it is no number.
#[cold]
pub fn read_token(token: &[u8]) -> Option<Number> {
    let unsigned = token.strip_prefix(b"-").or(token.strip_prefix(b"+")).unwrap_or(token);
    let begins = unsigned.first().is_some_and(|byte| byte.is_ascii_digit() || *byte == b'.');
    let value = str::from_utf8(token).ok().filter(|_| begins).and_then(|text| text.parse().ok());
    let Some(value) = value.filter(|value: &f64| value.is_finite()) else {
        return (value.is_some() || says_missing(unsigned)).then_some(Number::EMPTY);
    };
    let float = Number { value, mantissa: 0, digits: 0, form: Form::Float };
    if unsigned.iter().any(|byte| !byte.is_ascii_digit() && *byte != b'.') {
        return Some(float);
    }
    let (whole, fraction) = match unsigned.iter().position(|&byte| byte == b'.') {
        Some(point) => (&unsigned[..point], &unsigned[point + 1..]),
        None => (unsigned, &[][..]),
    };
    let zeros = fraction.iter().rev().take_while(|&&byte| byte == b'0').count();
    let fraction = &fraction[..fraction.len() - zeros];
    let mut mantissa = 0u64;
    for digit in whole.iter().chain(fraction) {
        let longer = mantissa.checked_mul(10).and_then(|m| m.checked_add(u64::from(digit - b'0')));
        let Some(longer) = longer else { return Some(float) };
        mantissa = longer;
    }
    match u8::try_from(fraction.len()) {
        Ok(digits) if usize::from(digits) < POWERS.len() => {
            Some(Number { value, mantissa, digits, form: Form::Decimal })
        }
        _ => Some(float),
    }
}

/// Whether a token without its sign is a word for no number.
fn says_missing(token: &[u8]) -> bool {
    let words = ["nan", "inf", "infinity", "na", "n/a", "null", "none"];
    // The C library of Windows writes "1.#QNAN" and the like.
    token.starts_with(b"1.#")
        || token.get(..4).is_some_and(|start| start.eq_ignore_ascii_case(b"nan("))
        || words.iter().any(|word| token.eq_ignore_ascii_case(word.as_bytes()))
}

/// Appends the digits from `at` on to the mantissa, wrapping around; gives the place after them.
#[inline(always)]
fn read_digits(text: &[u8], mut at: usize, mantissa: &mut u64) -> usize {
    while let Some(eight) = text.get(at..at + 8) {
        let word = u64::from_le_bytes(eight.try_into().expect("the range has 8 bytes"));
        let word = word ^ 0x3030_3030_3030_3030;
        // A byte above 9 gets its high bit set; a carry out of it only disturbs later bytes.
        let others = (word.wrapping_add(0x7676_7676_7676_7676) | word) & 0x8080_8080_8080_8080;
        let count = (others.trailing_zeros() / 8) as usize;
        if count == 0 {
            return at;
        }
        // The digits move to the end of the word, behind zeros.
        let word = word << (64 - 8 * count);
        let word = word.wrapping_mul(10).wrapping_add(word >> 8);
        let pairs = 0x0000_00ff_0000_00ff;
        let low = (word & pairs).wrapping_mul(0x000f_4240_0000_0064);
        let high = ((word >> 16) & pairs).wrapping_mul(0x0000_2710_0000_0001);
        let value = low.wrapping_add(high) >> 32;
        *mantissa = mantissa.wrapping_mul(WORD_POWERS[count]).wrapping_add(value);
        at += count;
        if count < 8 {
            return at;
        }
    }
    while let Some(digit) = text.get(at).map(|byte| byte.wrapping_sub(b'0')).filter(|d| *d < 10) {
        *mantissa = mantissa.wrapping_mul(10).wrapping_add(u64::from(digit));
        at += 1;
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As a row reads it: the plain way first, the token where that gives up.
    fn read(text: &str) -> Option<Number> {
        match read_plain(text.as_bytes(), 0) {
            Some((number, end)) if end == text.len() => Some(number),
            _ => read_token(text.as_bytes()),
        }
    }

    #[test]
    fn values_are_those_of_the_standard_library() {
        let mut random = crate::sampling::Random::new(7, 0);
        for round in 0..200_000 {
            let whole = (10f64.powf(9.0 * random.unit()) * random.unit()) as u64;
            let places = (11.0 * random.unit()) as usize;
            let fraction = (random.unit() * 10f64.powi(places as i32)) as u64;
            let sign = ["", "-", "+"][round % 3];
            let tail = ["", " ", " 12345678", "\n"][round % 4];
            let number = match places {
                0 => format!("{sign}{whole}"),
                _ => format!("{sign}{whole}.{fraction:0places$}"),
            };
            let text = format!("{number}{tail}");
            let read = match read_plain(text.as_bytes(), 0) {
                Some((value, end)) => {
                    assert_eq!(end, number.len(), "{text:?}");
                    value
                }
                None => read_token(number.as_bytes()).expect("it is a number"),
            };
            let expected: f64 = number.parse().expect("it is a number");
            assert_eq!(read.value.to_bits(), expected.to_bits(), "{text:?}");
            assert_eq!(read.form, Form::Decimal, "{text:?}");
            let again = read.mantissa as f64 / POWERS[usize::from(read.digits)];
            assert!(read.mantissa >= 1 << 53 || again == expected.abs(), "{text:?}");
        }
    }

    #[test]
    fn every_way_of_writing_a_number_is_told_apart() {
        let forms = |text: &str| read(text).map(|number| (number.value, number.form));
        assert_eq!(forms("0"), Some((0.0, Form::Decimal)));
        assert_eq!(forms(".5"), Some((0.5, Form::Decimal)));
        assert_eq!(forms("5."), Some((5.0, Form::Decimal)));
        assert_eq!(forms("-12.250"), Some((-12.25, Form::Decimal)));
        assert_eq!(forms("1e3"), Some((1000.0, Form::Float)));
        assert_eq!(forms("1.5E-2"), Some((0.015, Form::Float)));
        assert_eq!(forms("12345678901234567890123"), Some((1.2345678901234568e22, Form::Float)));
        assert_eq!(forms("637012.2400000000000000000000"), Some((637012.24, Form::Decimal)));
        assert_eq!(forms("9007199254740993"), Some((9007199254740992.0, Form::Decimal)));
        for text in ["nan", "NaN", "-nan", "inf", "-Infinity", "1.#QNAN", "-1.#IND", "1e999", "NA"]
        {
            assert_eq!(read(text).expect("a word for no value").form, Form::Missing, "{text}");
        }
        for text in ["", ".", "-", "+", "1.2.3", "1,5", "12a", "abc", "--1", "1e", "0x10", "\0"] {
            assert_eq!(read(text), None, "{text:?}");
        }
    }

    #[test]
    fn zeros_at_the_end_do_not_matter() {
        let number = read("-0.2500").expect("it is a number");
        assert_eq!((number.digits, number.digits_that_matter()), (4, 2));
        assert_eq!(read("51.000").expect("it is a number").shortened(), (51, 0));
        assert_eq!(read("100").expect("it is a number").shortened(), (100, 0));
        assert_eq!(read("0.000").expect("it is a number").shortened(), (0, 0));
    }
}
