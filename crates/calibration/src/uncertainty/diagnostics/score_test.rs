//! One more number that the residuals ask for: an offset, a factor, a delay or a drift of measurements, an
//! offset of an input, a start value or a held parameter of the model.

use crate::error::CalibrationError;
use crate::findings::finding::{Finding, Severity};
use crate::findings::shown_text::digits;
use crate::problem::residual_layout::{OutputResiduals, ResidualLayout};
use crate::uncertainty::diagnostics::output_effect::{Changes, OutputEffectKind};
use crate::uncertainty::diagnostics::parameter_constancy::WithNoise;
use crate::uncertainty::diagnostics::residual_check::ResidualCheck;
use crate::uncertainty::p_values::{BY_CHANCE, OfIndependent};
use crate::uncertainty::row_blocks::{along, go_on, thin_svd};
use crate::uncertainty::scores::Working;
use base::RunContext;
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

/// Fewer degrees of freedom tell nothing.
const FEWEST_DEGREES: usize = 3;

/// Larger matrices are not copied: so many numbers take some 100 MB.
const MOST: usize = 1 << 24;

/// A change that the parameters make, too, but for this part of its squares, is no other one; nor is a
/// direction below this part of the largest.
const OWN: f64 = 1e-3;
const LEAST: f64 = 1e-9;

/// Where residuals are systematic anything explains some of it: told is what takes away so much of all
/// squares, or leaves nothing systematic.
const MUCH: f64 = 0.5;

/// Others that take away this part of what the first does explain the residuals as well.
const ALIKE: f64 = 0.9;

/// So many of them are named.
const NAMED: usize = 3;

/// Kind of a number that a fit takes as known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum OmittedKind {
    /// What measurements of an output may have.
    Output(OutputEffectKind),
    /// An offset of an input.
    InputOffset,
    /// The start value of a state.
    StartValue,
    /// A parameter of the model that is not fitted.
    HeldValue,
}

/// The changes of the residuals by such a number, for a size of one.
pub(crate) struct Change {
    pub(crate) effect: OmittedKind,
    pub(crate) variable: String,
    /// The value that it has.
    pub(crate) start: f64,
    /// The only experiment that it is of; `None`: all.
    pub(crate) experiment: Option<usize>,
    pub(crate) column: DVector<f64>,
}

/// A number that the fit takes as known and that the residuals ask to be another one.
///
/// By the score test of one more parameter beside those of the fit (Rao, Proc. Camb. Phil. Soc. 44, 1948):
/// no fit is made with it, the numbers are those of a linear model around the result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[non_exhaustive]
pub struct Omitted {
    /// Kind of the number.
    pub effect: OmittedKind,
    /// The variable of the model.
    pub variable: String,
    /// The experiment that it is of; `None`: all of them.
    pub experiment: Option<String>,
    /// The number that the residuals ask for, in the unit of the variable: an offset, a factor, a delay in s,
    /// a drift per s, a value.
    pub value: f64,
    /// Its standard error.
    pub standard_error: f64,
    /// The value that the fit took; zero for an offset, a delay and a drift, one for a factor.
    pub held_at: f64,
    /// The chance of residuals that ask as much for any of the numbers that were looked at, if all are right;
    /// `None` where residuals are systematic, so that there is no such chance.
    pub chance: Option<f64>,
    /// The part of the squares of all residuals, in units of their variances, that it takes away.
    pub gain: f64,
    /// Where residuals are systematic: it leaves nothing of that.
    pub explains: bool,
    /// The parameter that it, or one of the [others](Self::others), moves most, by number, and by how many of
    /// its standard errors.
    pub moves_most: Option<(usize, f64)>,
    /// Others that explain the residuals as well, in words.
    pub others: Vec<String>,
}

/// What the residuals are looked at with.
pub(crate) struct Score<'a> {
    pub(crate) layout: &'a ResidualLayout,
    /// Names of the experiments.
    pub(crate) names: &'a [String],
    pub(crate) working: &'a Working,
    /// The working residuals.
    pub(crate) noise: WithNoise<'a>,
    /// Changes by the parameters, in an orthonormal base, and by measured initial states.
    pub(crate) changes: (&'a DMatrix<f64>, &'a [DVector<f64>]),
    /// Steps of the coordinates of the search by those along the base.
    pub(crate) inverse: &'a DMatrix<f64>,
    /// Numbers of these parameters, and their standard errors there.
    pub(crate) free: (&'a [usize], &'a [f64]),
    /// What the residuals show may be noise; else it is something that lasts, as the checks of the outputs
    /// say.
    pub(crate) is_noise: bool,
    pub(crate) checks: (&'a [ResidualCheck], &'a [OfIndependent]),
}

/// A change that was tested.
struct Tested {
    change: usize,
    /// The step that the residuals ask for, and its standard error.
    step: (f64, f64),
    /// Squares that it takes away.
    gained: f64,
}

/// The changes by what the measurements of each output may have: of one recording, and of all of a variable.
/// `plain`: the residuals without a loss.
pub(crate) fn of_outputs(layout: &ResidualLayout, plain: &[f64]) -> Vec<Change> {
    let mut all: Vec<Change> = Vec::new();
    let n_experiments = layout.outputs.iter().map(|output| output.experiment + 1).max().unwrap_or(0);
    for output in layout.outputs.iter().filter(|output| output.range.len() > 1) {
        let changes = Changes::of(output, &plain[output.range.clone()]);
        for kind in OutputEffectKind::ALL {
            let mut column = DVector::zeros(plain.len());
            column.rows_mut(output.range.start, output.range.len()).copy_from(&-changes.by(kind));
            let start = if kind == OutputEffectKind::Factor { 1.0 } else { 0.0 };
            let effect = OmittedKind::Output(kind);
            let of_all = all
                .iter_mut()
                .find(|c| c.experiment.is_none() && c.effect == effect && c.variable == output.variable);
            match of_all {
                Some(of_all) => of_all.column += &column,
                None => {
                    let (variable, column) = (output.variable.clone(), column.clone());
                    all.push(Change { effect, variable, start, experiment: None, column });
                }
            }
            if n_experiments > 1 {
                let (variable, experiment) = (output.variable.clone(), Some(output.experiment));
                all.push(Change { effect, variable, start, experiment, column });
            }
        }
    }
    all
}

impl Omitted {
    /// The number that the residuals ask for most, if that is no chance.
    ///
    /// # Errors
    /// [`CalibrationError::Cancelled`].
    pub(crate) fn find(
        score: &Score<'_>,
        changes: &[Change],
        context: &RunContext<'_>,
    ) -> Result<Option<Self>, CalibrationError> {
        let Score { layout, working, noise, changes: (base, by_starts), is_noise, .. } = score;
        let (m, q) = (base.nrows(), base.ncols() + by_starts.len());
        if changes.is_empty() || m.saturating_mul(q + changes.len()) > MOST || !noise.is_noisy() {
            return Ok(None);
        }
        let mut known = (*base).clone();
        for change in *by_starts {
            let at = known.ncols();
            known = known.insert_column(at, 0.0);
            known.set_column(at, change);
        }
        for mut column in known.column_iter_mut() {
            go_on(context)?;
            noise.whiten(layout, &mut column);
            column.try_normalize_mut(0.0);
        }
        let known = thin_svd(&known, context)?;
        let known = known.map(|svd| {
            let largest = svd.values.first().copied().unwrap_or(0.0);
            let rank = svd.values.iter().filter(|value| **value > LEAST * largest).count();
            svd.u.columns(0, rank).into_owned()
        });
        let left = |mut column: DVector<f64>| -> Result<(f64, DVector<f64>), CalibrationError> {
            go_on(context)?;
            noise.whiten(layout, &mut column);
            let all = column.norm_squared();
            if let Some(known) = &known {
                let along = along(known, column.as_slice(), context)?;
                column -= known * along;
            }
            Ok((all, column))
        };
        let (_, residuals) = left(DVector::from_column_slice(noise.values))?;
        let squares = residuals.norm_squared();
        let rank = known.as_ref().map_or(0, DMatrix::ncols);
        let Some(degrees) = m.checked_sub(rank + 1).filter(|degrees| *degrees >= FEWEST_DEGREES) else {
            return Ok(None);
        };
        let mut tested: Vec<Tested> = Vec::new();
        for (k, change) in changes.iter().enumerate() {
            let (all, column) = left(working.weighed(&change.column))?;
            let own = column.norm_squared();
            let step = -column.dot(&residuals) / own;
            // A sign is no gain.
            let is_possible =
                change.effect != OmittedKind::Output(OutputEffectKind::Factor) || change.start + step > 0.0;
            if all.is_finite() && own > OWN * all && step.is_finite() && is_possible {
                tested.push(Tested {
                    change: k,
                    step: (step, own.sqrt().recip()),
                    gained: step * step * own,
                });
            }
        }
        let n = tested.len() as f64;
        tested.sort_by(|a, b| b.gained.total_cmp(&a.gained));
        let Some(best) = tested.first() else { return Ok(None) };
        let ratio = best.gained / ((squares - best.gained).max(0.0) / degrees as f64);
        let chance = match FisherSnedecor::new(1.0, degrees as f64) {
            Ok(distribution) if ratio.is_finite() => n * distribution.sf(ratio),
            _ => 0.0,
        };
        let gain = best.gained / squares;
        let change = &changes[best.change];
        let explains = !is_noise && score.explains(change, best.step.0, context)?;
        if chance >= BY_CHANCE || !(*is_noise || gain > MUCH || explains) {
            return Ok(None);
        }
        let name = |change: &Change| change.experiment.map(|k| score.names[k].clone());
        let mut moves_most = score.moves_most(change, best.step.0, context)?;
        let mut others = Vec::new();
        for other in tested[1..].iter().filter(|other| other.gained > ALIKE * best.gained) {
            let change = &changes[other.change];
            others.push(what(change.effect, &change.variable, name(change).as_deref()));
            let moves = score.moves_most(change, other.step.0, context)?;
            moves_most = moves_most.into_iter().chain(moves).max_by(|a, b| a.1.total_cmp(&b.1));
        }
        Ok(Some(Self {
            effect: change.effect,
            variable: change.variable.clone(),
            experiment: name(change),
            value: change.start + best.step.0,
            standard_error: best.step.1,
            held_at: change.start,
            chance: is_noise.then_some(chance),
            gain,
            explains,
            moves_most,
            others,
        }))
    }

    /// A warning where it moves a parameter by more than its standard error, else a note.
    pub(crate) fn finding(&self, names: &[String]) -> Finding {
        let Self { effect, variable, experiment, value, standard_error, held_at, .. } = self;
        let what = what(*effect, variable, experiment.as_deref());
        let number = format!("{} +- {}", digits(*value), digits(*standard_error));
        let number = match effect {
            OmittedKind::StartValue | OmittedKind::HeldValue => {
                format!("{number} instead of {}", digits(*held_at))
            }
            _ => number,
        };
        let asks = match self.chance {
            Some(chance) => format!(
                "the residuals ask for {what}, {number}: by chance with a probability of {}",
                digits(chance)
            ),
            None => format!(
                "{what}, about {}, would take away {:.0} % of the squares of the residuals{}",
                digits(*value),
                100.0 * self.gain,
                if self.explains { " and leave noise" } else { "" }
            ),
        };
        let moves = match self.moves_most {
            Some((index, by)) => format!(
                "; with it {} moves by {}{} standard errors",
                names[index],
                if self.others.is_empty() { "" } else { "up to " },
                digits(by)
            ),
            None => String::new(),
        };
        let others = match (self.others.len(), self.others.iter().take(NAMED).cloned().collect::<Vec<_>>()) {
            (0, _) => String::new(),
            (n, named) if n <= NAMED => format!(" (or as well for {})", named.join(", or ")),
            (n, named) => {
                let more =
                    if n == NAMED + 1 { "another".to_owned() } else { format!("{} others", n - NAMED) };
                format!(" (or as well for {}, or {more})", named.join(", or "))
            }
        };
        let severity = match self.moves_most {
            Some((_, by)) if by < 1.0 => Severity::Note,
            _ => Severity::Warning,
        };
        let remedy = match effect {
            OmittedKind::Output(kind) => kind.remedy(),
            OmittedKind::InputOffset => {
                "is the zero of that sensor right? A parameter with offset_of fits it"
            }
            OmittedKind::StartValue => "is it known? initial_states takes it from the recording or fits it",
            OmittedKind::HeldValue => "is its value known? Fit it, too",
        };
        Finding::new(severity, variable.clone(), format!("{asks}{others}{moves}"), remedy)
    }
}

impl Score<'_> {
    /// True if a step of a change leaves nothing systematic in the residuals.
    fn explains(
        &self,
        change: &Change,
        step: f64,
        context: &RunContext<'_>,
    ) -> Result<bool, CalibrationError> {
        let mut by = self.working.weighed(&change.column) * step;
        let base = self.changes.0;
        by -= base * along(base, by.as_slice(), context)?;
        let left: Vec<f64> = self.noise.values.iter().zip(&by).map(|(r, by)| r + by).collect();
        let (checks, independent) = self.checks;
        let is_left = |(k, output): (usize, &OutputResiduals)| {
            let left = &left[output.range.clone()];
            checks[k].clone().with_numbers_of(left, independent.get(k)).is_systematic()
        };
        Ok(!self.layout.outputs.iter().enumerate().any(is_left))
    }

    /// The parameter that a step of a change moves most for its standard error.
    fn moves_most(
        &self,
        change: &Change,
        step: f64,
        context: &RunContext<'_>,
    ) -> Result<Option<(usize, f64)>, CalibrationError> {
        let column = self.working.weighed(&change.column);
        let moves = self.inverse * along(self.changes.0, column.as_slice(), context)? * step;
        let (free, errors) = self.free;
        let all = free.iter().zip(&moves).map(|(i, by)| (*i, (by / errors[*i]).abs()));
        Ok(all.filter(|(_, by)| by.is_finite()).max_by(|a, b| a.1.total_cmp(&b.1)))
    }
}

/// "an offset of the measurements of T2 of run1"
fn what(effect: OmittedKind, variable: &str, experiment: Option<&str>) -> String {
    let name = match experiment {
        Some(experiment) => format!("{variable} of {experiment}"),
        None => variable.to_owned(),
    };
    match effect {
        OmittedKind::Output(OutputEffectKind::Offset) => format!("an offset of the measurements of {name}"),
        OmittedKind::Output(OutputEffectKind::Factor) => format!("a factor of the measurements of {name}"),
        OmittedKind::Output(OutputEffectKind::Delay) => format!("a delay of the measurements of {name} in s"),
        OmittedKind::Output(OutputEffectKind::Drift) => {
            format!("a drift of the measurements of {name} per s")
        }
        OmittedKind::InputOffset => format!("an offset of the input {name}"),
        OmittedKind::StartValue => format!("another start value of {name}"),
        OmittedKind::HeldValue => format!("another value of {name}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::uncertainty::covariance::noise::groups;
    use crate::uncertainty::p_values::normal_numbers;
    use crate::uncertainty::result::Estimator;
    use crate::uncertainty::scores::Criterion;

    /// Two outputs of n rows, the second three times as noisy, a fit of two parameters to both, and an input
    /// that moves both.
    #[test]
    fn a_number_is_asked_for_where_it_is_wrong_and_hardly_ever_by_chance() {
        let (n, context, mut state) = (40, RunContext::new(), 1);
        // The simulation is smooth: its residuals are the noise of the measurements.
        let simulated = |i: usize| 3.0 + (0.2 * (i % n) as f64).sin();
        let output = |k: usize, left: &[f64]| OutputResiduals {
            experiment: 0,
            output: k,
            variable: format!("y{k}"),
            column: format!("y{k}"),
            range: k * n..(k + 1) * n,
            times: (0..n).map(|i| i as f64).collect::<Vec<_>>().into(),
            measured: (k * n..(k + 1) * n).map(|i| simulated(i) - left[i]).collect::<Vec<_>>().into(),
            weights: vec![1.0; n].into(),
            starts_simulation: false,
        };
        let t = |i: usize| (i % n) as f64 / n as f64;
        let base = DMatrix::from_fn(2 * n, 2, |i, j| (3.0 * t(i) * (j as f64 + 1.0)).cos()).qr().q();
        let sd = |i: usize| if i < n { 1.0 } else { 3.0 };
        let variances: Vec<f64> = (0..2 * n).map(|i| sd(i) * sd(i)).collect();
        let by_input = DVector::from_fn(2 * n, |i, _| t(i) * t(i));
        let names = ["a".to_owned()];
        let found = |errors: Vec<f64>| {
            let errors = DVector::from_vec(errors);
            let left = &errors - &base * base.tr_mul(&errors);
            let outputs = vec![output(0, left.as_slice()), output(1, left.as_slice())];
            let layout = ResidualLayout { outputs, priors: Vec::new() };
            let groups = groups(&layout, left.as_slice(), Estimator::Sandwich, Criterion::default());
            let working = Working::new(Criterion::default(), left.as_slice(), &groups, 2);
            let mut changes = of_outputs(&layout, left.as_slice());
            changes.push(Change {
                effect: OmittedKind::InputOffset,
                variable: "u".to_owned(),
                start: 0.0,
                experiment: None,
                column: by_input.clone(),
            });
            let noise =
                WithNoise { values: left.as_slice(), variances: &variances, autocorrelations: &[0.0; 2] };
            let score = Score {
                layout: &layout,
                names: &names,
                working: &working,
                noise,
                changes: (&base, &[]),
                inverse: &DMatrix::identity(2, 2),
                free: (&[0, 1], &[1.0, 1.0]),
                is_noise: true,
                checks: (&[], &[]),
            };
            Omitted::find(&score, &changes, &context).unwrap()
        };
        let noise = |state: &mut u64| -> Vec<f64> {
            normal_numbers(2 * n, state).iter().enumerate().map(|(i, e)| sd(i) * e).collect()
        };
        let false_alarms = (0..4000).filter(|_| found(noise(&mut state)).is_some()).count();
        assert!(false_alarms <= 12, "{false_alarms} of 4000, where 4 at most are expected");
        // The simulation lacks 4 times the effect of a unit of the input, and an offset of two deviations.
        for (effect, by) in [
            (OmittedKind::InputOffset, &(|i: usize| -4.0 * by_input[i]) as &dyn Fn(usize) -> f64),
            (OmittedKind::Output(OutputEffectKind::Offset), &|i| if i < n { 2.0 } else { 0.0 }),
        ] {
            let all = (0..100).map(|_| {
                let mut errors = noise(&mut state);
                errors.iter_mut().enumerate().for_each(|(i, e)| *e += by(i));
                found(errors)
            });
            let all: Vec<Omitted> = all.flatten().collect();
            let own: Vec<&Omitted> = all.iter().filter(|o| o.effect == effect).collect();
            assert!(all.len() >= 95 && own.len() >= 50, "{effect:?}: {} and {}", all.len(), own.len());
            let mean = own.iter().map(|o| o.value).sum::<f64>() / own.len() as f64;
            let expected = if effect == OmittedKind::InputOffset { 4.0 } else { -2.0 };
            assert!((mean - expected).abs() < 0.4, "{effect:?}: {mean}");
        }
    }
}
