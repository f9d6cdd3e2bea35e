//! The numbers of matrices: real or complex.

use nalgebra::ComplexField;

/// What both sorts of decompositions take.
pub(crate) trait Scalar: ComplexField<RealField = f64> + faer::traits::ComplexField + Copy {}

impl<T: ComplexField<RealField = f64> + faer::traits::ComplexField + Copy> Scalar for T {}
