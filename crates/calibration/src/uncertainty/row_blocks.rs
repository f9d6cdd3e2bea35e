//! Operations on matrices with many rows. The context is checked before each operation. In the longest
//! operation, the factorisation, it is also checked between blocks of rows.

use crate::error::CalibrationError;
use base::RunContext;
use nalgebra::{DMatrix, DMatrixView, DVector};
use std::ops::Range;

/// Number of operations on a block: about 10 ms.
const OPERATIONS: usize = 1 << 24;

/// Thin singular value decomposition of a matrix.
pub(crate) struct ThinSvd {
    /// Left singular vectors, m x p. Columns of zero singular values are zero.
    pub(crate) u: DMatrix<f64>,
    /// Singular values, p.
    pub(crate) values: Vec<f64>,
    /// Transposed right singular vectors, p x p.
    pub(crate) v_t: DMatrix<f64>,
}

/// Checks whether the work may continue. Called about every 10 ms.
///
/// # Errors
/// Returns [`CalibrationError::Cancelled`] if the work must end.
pub(crate) fn go_on(context: &RunContext<'_>) -> Result<(), CalibrationError> {
    if context.is_over() { Err(CalibrationError::Cancelled) } else { Ok(()) }
}

/// Returns the triangle of the QR factorisation of these rows of a matrix. It has the same singular values as
/// the rows. If there are at most as many rows as columns, the rows themselves are returned.
pub(crate) fn triangle(
    matrix: &DMatrix<f64>,
    rows: &[Range<usize>],
    context: &RunContext<'_>,
) -> Result<DMatrix<f64>, CalibrationError> {
    let p = matrix.ncols();
    let mut above: DMatrix<f64> = DMatrix::zeros(0, p);
    let at_once = (OPERATIONS / (2 * p * p).max(1)).max(p).max(1);
    for range in rows {
        for from in range.clone().step_by(at_once) {
            go_on(context)?;
            let (n_above, n) = (above.nrows(), range.end.min(from + at_once) - from);
            let mut stacked =
                std::mem::replace(&mut above, DMatrix::zeros(0, 0)).resize_vertically(n_above + n, 0.0);
            stacked.rows_mut(n_above, n).copy_from(&matrix.rows(from, n));
            above = if n_above + n > p { stacked.qr().r() } else { stacked };
        }
    }
    Ok(above)
}

/// Returns the product of a matrix and a small matrix.
pub(crate) fn product(
    matrix: &DMatrix<f64>,
    by: &DMatrix<f64>,
    context: &RunContext<'_>,
) -> Result<DMatrix<f64>, CalibrationError> {
    go_on(context)?;
    Ok(matrix * by)
}

/// Returns the rows, each multiplied by its factor.
pub(crate) fn scaled(
    matrix: &DMatrix<f64>,
    factors: &[f64],
    context: &RunContext<'_>,
) -> Result<DMatrix<f64>, CalibrationError> {
    go_on(context)?;
    let mut rows = matrix.clone();
    for mut column in rows.column_iter_mut() {
        column.iter_mut().zip(factors).for_each(|(entry, factor)| *entry *= factor);
    }
    Ok(rows)
}

/// Returns the products `a'b` of the columns of two matrices.
pub(crate) fn inner_products(
    a: DMatrixView<'_, f64>,
    b: DMatrixView<'_, f64>,
    context: &RunContext<'_>,
) -> Result<DMatrix<f64>, CalibrationError> {
    go_on(context)?;
    Ok(a.tr_mul(&b))
}

/// Returns the products `a' W a` of the columns of a matrix, with a diagonal W.
pub(crate) fn weighted_products(
    a: &DMatrix<f64>,
    weights: &[f64],
    context: &RunContext<'_>,
) -> Result<DMatrix<f64>, CalibrationError> {
    Ok(a.tr_mul(&scaled(a, weights, context)?))
}

/// Returns the products of the columns of a matrix with a vector.
pub(crate) fn along(
    matrix: &DMatrix<f64>,
    vector: &[f64],
    context: &RunContext<'_>,
) -> Result<DVector<f64>, CalibrationError> {
    go_on(context)?;
    Ok(matrix.tr_mul(&DVector::from_column_slice(vector)))
}

/// Returns the decomposition, computed from the triangle. Returns `None` if it does not converge or there are
/// no columns.
pub(crate) fn thin_svd(
    matrix: &DMatrix<f64>,
    context: &RunContext<'_>,
) -> Result<Option<ThinSvd>, CalibrationError> {
    let (m, p) = matrix.shape();
    if p == 0 {
        return Ok(None);
    }
    let triangle = triangle(matrix, std::slice::from_ref(&(0..m)), context)?;
    let svd = triangle.resize_vertically(p, 0.0).try_svd(false, true, f64::EPSILON, 10_000);
    let Some((values, v_t)) = svd.and_then(|svd| Some((svd.singular_values, svd.v_t?))) else {
        return Ok(None);
    };
    let mut by = v_t.transpose();
    for (mut column, value) in by.column_iter_mut().zip(values.iter()) {
        column *= if *value > 0.0 { value.recip() } else { 0.0 };
    }
    let u = product(matrix, &by, context)?;
    Ok(Some(ThinSvd { u, values: values.as_slice().to_vec(), v_t }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    fn matrix(m: usize, p: usize) -> DMatrix<f64> {
        DMatrix::from_fn(m, p, |i, k| (0.7 * (i * (k + 1)) as f64).sin() + f64::from(u8::from(i % p == k)))
    }

    /// Several blocks give the same results as one, and the context is checked between them.
    #[test]
    fn thin_svd_of_many_row_blocks_matches_single_block() {
        let (context, p) = (RunContext::new(), 40);
        let tall = matrix(3 * OPERATIONS / (2 * p * p), p);
        let svd = thin_svd(&tall, &context).unwrap().unwrap();
        let of_u = inner_products(svd.u.as_view(), svd.u.as_view(), &context).unwrap();
        assert!((of_u - DMatrix::identity(p, p)).amax() < 1e-12);
        let diagonal = DMatrix::from_diagonal(&DVector::from_vec(svd.values));
        assert!((&svd.u * diagonal * svd.v_t - &tall).amax() < 1e-12);
        let factors: Vec<f64> = (0..tall.nrows()).map(|i| 1.0 / (i + 1) as f64).collect();
        let of_rows = scaled(&tall, &factors, &context).unwrap();
        assert!(of_rows.row(7) == tall.row(7) / 8.0);
        let weighted = weighted_products(&tall, &factors, &context).unwrap();
        assert!((weighted - tall.tr_mul(&of_rows)).amax() < 1e-12 * tall.amax());
        let squares = tall.tr_mul(&tall);
        let r = triangle(&tall, &[0..10, 10..tall.nrows()], &context).unwrap();
        assert!(r.nrows() == p && (r.tr_mul(&r) - &squares).amax() < 1e-12 * squares.amax());
        let few = triangle(&tall, std::slice::from_ref(&(5..8)), &context).unwrap();
        assert_eq!(few, tall.rows(5, 3).into_owned());
        let requested = Cell::new(0);
        let ask = || {
            requested.set(requested.get() + 1);
            requested.get() == 3
        };
        let cancelled = RunContext::new().polling(&ask);
        assert!(matches!(thin_svd(&tall, &cancelled), Err(CalibrationError::Cancelled)));
        assert_eq!(requested.get(), 3);
        assert!(thin_svd(&DMatrix::zeros(3, 0), &context).unwrap().is_none());
    }
}
