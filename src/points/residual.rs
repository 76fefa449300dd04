//! Exact floats beside an integer lattice: how far a float is from its lattice position.
//!
//! A file of floats whose values lie on no lattice of 32-bit integers keeps, per axis, the
//! difference between the float and the float nearest to its lattice position, counted in floats:
//! both are read as integers whose order is that of the floats and subtracted. Most differences are
//! 0 or small; wrapping arithmetic makes every one of them exact.

use glam::DVec3;

use super::Scalar;

/// The attribute `coordinate_residual` of that type tells which floats are meant: `I32` for single,
/// `I64` for double precision. `None` for any other type.
pub fn residual_bytes(scalar: Scalar) -> Option<usize> {
    matches!(scalar, Scalar::I32 | Scalar::I64).then(|| 3 * scalar.bytes())
}

/// Writes the residual of a world position from its lattice position into the bytes of the
/// attribute, which are as many as [`residual_bytes`] says.
pub fn write_residual(scalar: Scalar, exact: DVec3, on_lattice: DVec3, bytes: &mut [u8]) {
    for axis in 0..3 {
        match scalar {
            Scalar::I32 => {
                let ordinal = |value: f64| ordinal_32(value as f32);
                let residual = ordinal(exact[axis]).wrapping_sub(ordinal(on_lattice[axis]));
                bytes[4 * axis..4 * axis + 4].copy_from_slice(&residual.to_le_bytes());
            }
            _ => {
                let residual = ordinal_64(exact[axis]).wrapping_sub(ordinal_64(on_lattice[axis]));
                bytes[8 * axis..8 * axis + 8].copy_from_slice(&residual.to_le_bytes());
            }
        }
    }
}

/// The exact position from a lattice position and the bytes of the attribute.
pub fn exact_position(scalar: Scalar, on_lattice: DVec3, bytes: &[u8]) -> DVec3 {
    let axis = |axis: usize| match scalar {
        Scalar::I32 => {
            let residual = bytes[4 * axis..4 * axis + 4].try_into().expect("the slice has 4 bytes");
            let ordinal = ordinal_32(on_lattice[axis] as f32);
            f64::from(float_32(ordinal.wrapping_add(i32::from_le_bytes(residual))))
        }
        _ => {
            let residual = bytes[8 * axis..8 * axis + 8].try_into().expect("the slice has 8 bytes");
            let ordinal = ordinal_64(on_lattice[axis]);
            float_64(ordinal.wrapping_add(i64::from_le_bytes(residual)))
        }
    };
    DVec3::new(axis(0), axis(1), axis(2))
}

/// An integer whose order is that of the floats.
fn ordinal_32(value: f32) -> i32 {
    let bits = value.to_bits() as i32;
    if bits < 0 { !bits ^ i32::MIN } else { bits }
}

fn float_32(ordinal: i32) -> f32 {
    let bits = if ordinal < 0 { !(ordinal ^ i32::MIN) } else { ordinal };
    f32::from_bits(bits as u32)
}

fn ordinal_64(value: f64) -> i64 {
    let bits = value.to_bits() as i64;
    if bits < 0 { !bits ^ i64::MIN } else { bits }
}

fn float_64(ordinal: i64) -> f64 {
    let bits = if ordinal < 0 { !(ordinal ^ i64::MIN) } else { ordinal };
    f64::from_bits(bits as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floats_come_back_bit_by_bit_from_any_lattice_position() {
        let odd = [0.0, -0.0, 1.5, -1.5, 1e-40, -3.4e38, 3.4e38, 0.1, -123_456.78];
        for exact in odd {
            for near in [0.0, -1.0, 0.1, 3e38, -3e38] {
                let single = f64::from(exact as f32);
                let mut bytes = [0; 24];
                write_residual(Scalar::I32, DVec3::splat(single), DVec3::splat(near), &mut bytes);
                let back = exact_position(Scalar::I32, DVec3::splat(near), &bytes);
                assert_eq!(back.to_array().map(f64::to_bits), [single.to_bits(); 3]);
                write_residual(Scalar::I64, DVec3::splat(exact), DVec3::splat(near), &mut bytes);
                let back = exact_position(Scalar::I64, DVec3::splat(near), &bytes);
                assert_eq!(back.to_array().map(f64::to_bits), [exact.to_bits(); 3]);
            }
        }
    }

    #[test]
    fn neighbours_are_one_apart_also_across_zero() {
        let steps = [-1.0f32, -f32::from_bits(1), -0.0, 0.0, f32::from_bits(1), 1.0];
        assert!(steps.windows(2).all(|pair| ordinal_32(pair[0]) < ordinal_32(pair[1])));
        assert_eq!(ordinal_32(0.0) - ordinal_32(-0.0), 1);
        assert_eq!(ordinal_32(f32::from_bits(1)), 1);
    }
}
