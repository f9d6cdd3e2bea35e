//! The scalars of matrices: real or complex.

use num_complex::ComplexFloat;
use num_traits::NumAssignOps;
use std::fmt::Debug;

/// A real or complex number, as required by both decompositions.
#[cfg(feature = "sparse")]
pub(crate) trait Scalar:
    ComplexFloat<Real = f64> + NumAssignOps + Debug + faer::traits::ComplexField
{
}

#[cfg(feature = "sparse")]
impl<T: ComplexFloat<Real = f64> + NumAssignOps + Debug + faer::traits::ComplexField> Scalar for T {}

/// A real or complex number.
#[cfg(not(feature = "sparse"))]
pub(crate) trait Scalar: ComplexFloat<Real = f64> + NumAssignOps + Debug {}

#[cfg(not(feature = "sparse"))]
impl<T: ComplexFloat<Real = f64> + NumAssignOps + Debug> Scalar for T {}
