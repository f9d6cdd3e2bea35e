//! The numbers of matrices: real or complex.

use nalgebra::ComplexField;

/// Number type of both kinds of decompositions, real or complex.
pub(crate) trait Scalar: ComplexField<RealField = f64> + faer::traits::ComplexField + Copy {}

impl<T: ComplexField<RealField = f64> + faer::traits::ComplexField + Copy> Scalar for T {}
