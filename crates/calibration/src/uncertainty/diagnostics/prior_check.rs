//! Priors that the measurements contradict.

use crate::error::CalibrationError;
use crate::findings::display_text::digits;
use crate::findings::finding::Finding;
use crate::findings::identifier::FindingId;
use crate::problem::parameter::{inner, outer};
use crate::problem::prior::Prior;
use crate::problem::residual_layout::ResidualLayout;
use crate::uncertainty::differences::Center;
use crate::uncertainty::row_blocks::{ThinSvd, scaled, thin_svd};
use crate::uncertainty::scores::Working;
use base::RunContext;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Distance in standard deviations above which two estimates contradict each other.
const CONTRADICTS: f64 = 4.0;

/// A prior that the measurements contradict.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct PriorConflict {
    /// Index of the parameter.
    pub parameter: usize,
    /// Prior of the parameter.
    pub prior: Prior,
    /// Value determined by the measurements alone, by one least-squares step from the result.
    pub without_prior: f64,
    /// Distance of this value from the prior, in standard deviations of both, combined as independent errors.
    pub deviations: f64,
}

impl PriorConflict {
    /// Returns the priors that are contradicted. The `jacobian` contains the derivatives of the residuals (m
    /// x p, in the coordinates of the search), with the priors last. The `slopes` are the derivatives of the
    /// free parameters with respect to these coordinates.
    pub(crate) fn all(
        at: &Center<'_>,
        layout: &ResidualLayout,
        slopes: &[f64],
        (jacobian, working): (&DMatrix<f64>, &Working),
        context: &RunContext<'_>,
    ) -> Result<Vec<Self>, CalibrationError> {
        let Center { parameters, x, free, .. } = *at;
        let (n, p) = (layout.n_measurements(), free.len());
        if layout.priors.is_empty() || n <= p {
            return Ok(Vec::new());
        }
        let mut j = scaled(&jacobian.rows(0, n).into_owned(), &working.roots[..n], context)?;
        let lengths: Vec<f64> = j.column_iter().map(|column| column.norm()).collect();
        // A parameter that the measurements do not move has an infinite standard error, so it
        // cannot contradict a prior.
        for (mut column, length) in j.column_iter_mut().zip(&lengths).filter(|(_, length)| **length > 0.0) {
            column /= *length;
        }
        let r = DVector::from_column_slice(&working.residuals[..n]);
        let Some(ThinSvd { u, values, v_t }) = thin_svd(&j, context)? else { return Ok(Vec::new()) };
        let along = u.tr_mul(&r);
        let step = |k: usize| -> f64 { (0..p).map(|i| -v_t[(i, k)] * along[i] / values[i]).sum() };
        let left = (r.norm_squared() - along.norm_squared()).max(0.0) / (n - p) as f64;
        let variance =
            |k: usize| -> f64 { (0..p).map(|i| (v_t[(i, k)] / values[i]).powi(2)).sum::<f64>() * left };
        let conflict = |k: usize| {
            let (i, length) = (free[k], lengths[k]);
            let prior = layout.priors.iter().find(|prior| prior.parameter == i)?.prior;
            let parameter = &parameters[i];
            let (step, error) = (step(k) / length, variance(k).sqrt() / length);
            let without_prior = outer(parameter, inner(parameter, x[i]) + step);
            let slope = prior.slope(x[i]) * slopes[k];
            let from_prior = prior.residual(x[i]) + slope * step;
            let deviations = from_prior.abs() / (1.0 + (slope * error).powi(2)).sqrt();
            (deviations > CONTRADICTS).then_some(Self { parameter: i, prior, without_prior, deviations })
        };
        Ok((0..p).filter(|k| lengths[*k] > 0.0).filter_map(conflict).collect())
    }

    pub(crate) fn finding(&self, name: &str) -> Finding {
        let stated = match self.prior {
            Prior::Normal { mean, sd } => format!("mean {}, sd {}", digits(mean), digits(sd)),
            Prior::LogNormal { median, sigma } => {
                format!("median {}, sigma {}", digits(median), digits(sigma))
            }
        };
        let center = match self.prior {
            Prior::Normal { mean: center, .. } | Prior::LogNormal { median: center, .. } => center,
        };
        let direction = if self.without_prior < center { "smaller" } else { "larger" };
        let sentence = format!(
            "the prior of {name} ({stated}) contradicts the measurements, which lead to a {direction} value ({} standard deviations away by \
             linearisation). The result follows whichever has the larger weight",
            digits(self.deviations)
        );
        let remedy = "Check the value and the unit of the prior, and widen or remove it";
        Finding::warning(FindingId::ContradictedPrior, format!("prior of {name}"), sentence, remedy)
    }
}
