//! Encoding of numbers as bit strings.

use crate::error::Error;
use crate::problem::space::Space;
use crate::values::choices::ParameterKind;
use serde::{Deserialize, Serialize};

/// Number of bits of a continuous parameter without a given resolution.
const DEFAULT_BITS: u32 = 16;
/// Maximum number of bits of a parameter; floating-point numbers have 53.
const MAX_BITS: u32 = 52;

/// Bit field of a free parameter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Field {
    bits: u32,
    lower: f64,
    upper: f64,
    /// Number of values of a discrete parameter. `first` is the smallest value.
    values: Option<u64>,
    first: f64,
}

/// Representation of points as bits, most significant bit first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Coding {
    fields: Vec<Field>,
    gray: bool,
}

impl Coding {
    pub(super) fn new(space: &Space, resolution: &[f64], gray: bool) -> Result<Self, Error> {
        if !resolution.is_empty() && resolution.len() != space.n() {
            return Err(Error::Length { what: "resolution", expected: space.n(), got: resolution.len() });
        }
        let mut fields = Vec::new();
        for (k, &index) in space.free().iter().enumerate() {
            let (lower, upper) = space.working_bounds(k);
            let (values, first) = match space.kind(k) {
                ParameterKind::Continuous => (None, 0.0),
                ParameterKind::Integer | ParameterKind::Categorical => {
                    let first = space.bounds().lower()[index].ceil();
                    (Some((space.bounds().upper()[index].floor() - first) as u64 + 1), first)
                }
            };
            let bits = match (values, resolution.get(index)) {
                // At least eight codes per value, so that the values have similar shares.
                (Some(1), _) => 0,
                (Some(values), _) if values.is_power_of_two() => values.ilog2(),
                (Some(values), _) => values.ilog2() + 4,
                (None, None) => DEFAULT_BITS,
                (None, Some(&value)) => {
                    if !(value > 0.0 && value.is_finite()) {
                        let range = "positive and finite";
                        return Err(Error::ParameterOption { name: "resolution", index, value, range });
                    }
                    ((upper - lower) / value + 1.0).log2().ceil().max(1.0) as u32
                }
            };
            fields.push(Field { bits: bits.min(MAX_BITS), lower, upper, values, first });
        }
        Ok(Self { fields, gray })
    }

    /// Returns the length of a string in bits.
    pub(super) fn length(&self) -> usize {
        self.fields.iter().map(|f| f.bits as usize).sum()
    }

    /// Decodes a string to working coordinates.
    pub(super) fn decode(&self, space: &Space, mut bits: &[bool], u: &mut [f64]) {
        for (k, field) in self.fields.iter().enumerate() {
            let (of_field, rest) = bits.split_at(field.bits as usize);
            bits = rest;
            let mut code = 0u64;
            let mut above = false;
            for &bit in of_field {
                let bit = if self.gray { bit ^ above } else { bit };
                above = bit;
                code = code << 1 | u64::from(bit);
            }
            u[k] = match field.values {
                Some(values) => {
                    let value = field.first + field.value_of(code, values) as f64;
                    match space.transform(k) {
                        crate::values::choices::Transform::Linear => value,
                        crate::values::choices::Transform::Log => value.ln().clamp(field.lower, field.upper),
                    }
                }
                None => {
                    let last = ((1u64 << field.bits) - 1) as f64;
                    let t = code as f64 / last;
                    (field.lower + t * (field.upper - field.lower)).clamp(field.lower, field.upper)
                }
            };
        }
    }

    /// Encodes a point, given in working coordinates and in the user's units, as the nearest string.
    pub(super) fn encode(&self, space: &Space, u: &[f64], x: &[f64], out: &mut [bool]) {
        let mut at = 0;
        for (k, field) in self.fields.iter().enumerate() {
            let codes = 1u64 << field.bits;
            let code = match field.values {
                Some(values) => {
                    let value = (x[space.free()[k]] - field.first).max(0.0) as u64;
                    // First code of the value: the smallest c with c * values / codes >= value.
                    ((u128::from(value) * u128::from(codes)).div_ceil(u128::from(values))) as u64
                }
                None => {
                    let t = (u[k] - field.lower) / (field.upper - field.lower);
                    (t * (codes - 1) as f64).round() as u64
                }
            };
            let code = code.min(codes - 1);
            let code = if self.gray { code ^ (code >> 1) } else { code };
            for bit in (0..field.bits).rev() {
                out[at] = code >> bit & 1 == 1;
                at += 1;
            }
        }
    }
}

impl Field {
    fn value_of(&self, code: u64, values: u64) -> u64 {
        ((u128::from(code) * u128::from(values)) >> self.bits) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::problem::space::Bounds;
    use crate::values::choices::Transform;

    fn space() -> Space {
        let bounds = Bounds::new(&[-1.0, 2.0, 0.0, 1e-3], &[3.0, 8.0, 3.0, 1e3]).unwrap();
        let transforms = [Transform::Linear, Transform::Linear, Transform::Linear, Transform::Log];
        let kinds = [
            ParameterKind::Continuous,
            ParameterKind::Integer,
            ParameterKind::Categorical,
            ParameterKind::Continuous,
        ];
        Space::new(&[0.5, 4.0, 1.0, 1.0], bounds, &transforms, &[]).unwrap().with_kinds(&kinds).unwrap()
    }

    #[test]
    fn coding_chooses_number_of_bits_from_resolution() {
        let coding = Coding::new(&space(), &[0.5, 1.0, 1.0, 0.1], true).unwrap();
        // 4 / 0.5 + 1 = 9 values: 4 bits; 7 values: 2 + 4 bits; 4 values: 2 bits; ln(1e6) / 0.1 + 1 = 139.2: 8 bits.
        assert_eq!(coding.fields.iter().map(|f| f.bits).collect::<Vec<_>>(), [4, 6, 2, 8]);
        assert_eq!(Coding::new(&space(), &[], true).unwrap().length(), 16 + 6 + 2 + 16);
        assert!(matches!(Coding::new(&space(), &[1.0], true), Err(Error::Length { .. })));
        let bad = Coding::new(&space(), &[1.0, 1.0, 1.0, f64::NAN], true);
        assert!(matches!(bad, Err(Error::ParameterOption { index: 3, .. })));
    }

    #[test]
    fn coding_round_trips_points() {
        let space = space();
        for gray in [true, false] {
            let coding = Coding::new(&space, &[1e-9, 1.0, 1.0, 1e-9], gray).unwrap();
            let mut bits = vec![false; coding.length()];
            for x in
                [[-1.0, 2.0, 0.0, 1e-3], [3.0, 8.0, 3.0, 1e3], [0.123, 5.0, 1.0, 0.7], [2.9, 7.0, 2.0, 3.0]]
            {
                let (mut u, mut v, mut y) = ([0.0; 4], [0.0; 4], [0.0; 4]);
                space.to_working(&x, &mut u);
                coding.encode(&space, &u, &x, &mut bits);
                coding.decode(&space, &bits, &mut v);
                space.to_user(&v, &mut y);
                for i in 0..4 {
                    assert!((x[i] - y[i]).abs() <= 1e-8 * x[i].abs(), "{x:?} {y:?}");
                }
            }
        }
    }

    #[test]
    fn neighbours_in_gray_code_differ_in_one_bit() {
        let space = space();
        let coding = Coding::new(&space, &[0.1, 1.0, 1.0, 1.0], true).unwrap();
        let bits = |t: f64| {
            let mut bits = vec![false; coding.length()];
            coding.encode(&space, &[-1.0 + 4.0 * t, 2.0, 0.0, 0.0], &[0.0, 2.0, 0.0, 1.0], &mut bits);
            bits
        };
        for code in 0..63 {
            let (a, b) = (bits(f64::from(code) / 63.0), bits(f64::from(code + 1) / 63.0));
            assert_eq!(a.iter().zip(&b).filter(|(a, b)| a != b).count(), 1);
        }
    }

    #[test]
    fn decode_assigns_similar_numbers_of_codes_to_discrete_values() {
        let space = space();
        let coding = Coding::new(&space, &[], false).unwrap();
        let mut counts = [0; 7];
        for code in 0..64u32 {
            let mut bits = vec![false; coding.length()];
            (0..6).for_each(|b| bits[16 + b] = code >> (5 - b) & 1 == 1);
            let mut u = [0.0; 4];
            coding.decode(&space, &bits, &mut u);
            counts[u[1] as usize - 2] += 1;
        }
        assert!(counts.iter().all(|c| (9..=10).contains(c)), "{counts:?}");
    }
}
