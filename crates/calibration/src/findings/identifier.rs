//! Identifiers of the findings: a number and a name that do not change between versions.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Declares the identifiers: variant, number and name.
macro_rules! identifiers {
    ($($(#[$meaning:meta])+ $variant:ident = $number:literal $name:literal,)+) => {
        /// Identifier of a kind of finding, such as `F012 autocorrelated-residuals`. `Display` writes both.
        ///
        /// Findings with the same meaning share one identifier. A number is never reused. The page
        /// `docs/findings.md` lists all identifiers with an example and a remedy.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(into = "String", try_from = "String")]
        #[non_exhaustive]
        pub enum FindingId {
            $($(#[$meaning])+ $variant = $number,)+
        }

        impl FindingId {
            /// All identifiers in the order of their numbers.
            pub const ALL: &[Self] = &[$(Self::$variant),+];

            /// Returns the name, such as `autocorrelated-residuals`.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)+
                }
            }
        }
    };
}

identifiers! {
    // Parameters and their standard errors.
    /// A fitted parameter is at its lower or upper bound.
    AtBound = 1 "at-bound",
    /// A parameter changes no measured output.
    ParameterWithoutEffect = 2 "parameter-without-effect",
    /// The data determine a parameter, or several together, not at all.
    UndeterminedParameter = 3 "undetermined-parameter",
    /// Two parameters change the outputs in the same way.
    CorrelatedParameters = 4 "correlated-parameters",
    /// A combination of three or more parameters hardly changes the outputs.
    WeakCombination = 5 "weak-combination",
    /// A standard error exceeds half of the value.
    LargeStandardError = 6 "large-standard-error",
    /// Parameters that the data can determine together.
    IdentifiableParameters = 7 "identifiable-parameters",
    /// The data contain no information about a parameter that has a prior.
    PriorOnly = 8 "prior-only",
    /// There are too few residuals to estimate standard errors.
    NoDegreesOfFreedom = 9 "no-degrees-of-freedom",
    /// The residuals contain only simulation errors.
    ExactMeasurements = 10 "exact-measurements",
    // Residuals and their noise.
    /// A constant would reproduce the measurements better.
    WorseThanConstant = 11 "worse-than-constant",
    /// The residuals are autocorrelated.
    AutocorrelatedResiduals = 12 "autocorrelated-residuals",
    /// The standard errors are corrected for autocorrelated residuals.
    CorrectedStandardErrors = 13 "corrected-standard-errors",
    /// The mean of the residuals differs from zero.
    ResidualOffset = 14 "residual-offset",
    /// Some residuals are far from the others.
    Outliers = 15 "outliers",
    /// The residuals contradict the noise that the weights state.
    ContradictedNoise = 16 "contradicted-noise",
    /// The measurements contradict a prior.
    ContradictedPrior = 17 "contradicted-prior",
    /// A prior is combined with measurements of unknown noise.
    UnstatedNoise = 18 "unstated-noise",
    /// The estimate of the noise is rough.
    RoughNoiseEstimate = 19 "rough-noise-estimate",
    // Search and simulations.
    /// The search ended before the minimum.
    BeforeMinimum = 21 "before-minimum",
    /// The stages ended at their minima, but all parameters together are not at one.
    StagesApart = 22 "stages-apart",
    /// The cost decreases towards values that cannot be simulated.
    MinimumBeyondFailures = 23 "minimum-beyond-failures",
    /// The cost is not smooth.
    RoughCost = 24 "rough-cost",
    /// A search from several starts ended before it found all minima.
    OpenMinima = 25 "open-minima",
    /// The noise of the simulations exceeds `f_tol`, which was raised.
    RaisedFTol = 26 "raised-f-tol",
    /// The fit chose the relative tolerance of its simulations.
    ChosenTolerance = 27 "chosen-tolerance",
    /// More accurate simulations change the outputs or the cost.
    InaccurateSimulation = 28 "inaccurate-simulation",
    /// Checks or standard errors are incomplete because the run ended.
    IncompleteAssessment = 29 "incomplete-assessment",
    /// No stage of the fit frees a parameter.
    UnusedParameter = 30 "unused-parameter",
    /// The model keeps hidden state, so that each evaluation ran in a separate process.
    HiddenState = 31 "hidden-state",
    /// Evaluations depended on earlier ones, and the fit could not restart.
    DependentEvaluations = 32 "dependent-evaluations",
    /// Two runs of the same simulation differ.
    NotReproducible = 33 "not-reproducible",
    /// The executor lost answers.
    LostAnswers = 34 "lost-answers",
    /// The validation uses measurements of the fit.
    ValidationOverlap = 35 "validation-overlap",
    // Model, recordings and settings.
    /// The times of a recording are probably in another unit.
    TimeUnit = 41 "time-unit",
    /// The recording starts later than the simulation.
    LateFirstRow = 42 "late-first-row",
    /// An hour is missing or repeated in times without a zone.
    ClockChange = 43 "clock-change",
    /// Columns state no unit although the model does.
    MissingUnit = 44 "missing-unit",
    /// Columns were converted from the units that they state.
    ConvertedUnit = 45 "converted-unit",
    /// The unit of a column was not converted.
    UnconvertedUnit = 46 "unconverted-unit",
    /// Measured and simulated values differ as with another unit.
    UnitMismatch = 47 "unit-mismatch",
    /// Two columns are probably swapped.
    SwappedColumns = 48 "swapped-columns",
    /// All measurements of an output are equal.
    ConstantColumn = 49 "constant-column",
    /// A column contains placeholders for missing values.
    Placeholder = 50 "placeholder",
    /// The simulation of an output is constant.
    ConstantSimulation = 51 "constant-simulation",
    /// The simulation starts far from the first measurement.
    InitialState = 52 "initial-state",
    /// An unused column has the name of an input that nothing drives.
    UnusedColumn = 53 "unused-column",
    /// Nothing drives an input of the model.
    UndrivenInput = 54 "undriven-input",
    /// All values of an input are zero.
    ZeroInput = 55 "zero-input",
    /// The recording of an input has a long gap.
    InputGap = 56 "input-gap",
    /// A column drives an input and is compared with an output.
    SharedColumn = 57 "shared-column",
    /// A given value differs strongly from the range or the start value of the model.
    ValueUnlikeModel = 58 "value-unlike-model",
    /// The start or a bound of a parameter is outside of the range of the model.
    OutsideModelRange = 59 "outside-model-range",
    /// A start value had no effect in the simulation.
    StartValueWithoutEffect = 60 "start-value-without-effect",
    /// A setting has no effect.
    SettingWithoutEffect = 61 "setting-without-effect",
    /// The simulation fails at the start values.
    FailedStart = 62 "failed-start",
    /// The simulation fails close to the start values.
    FailedNearStart = 63 "failed-near-start",
    /// The simulation requires very many steps.
    ManySteps = 64 "many-steps",
    /// A switching input is interpolated linearly between its rows.
    SwitchingInput = 65 "switching-input",
    /// Rows repeat the time and all measured values of the row before.
    DuplicateRows = 66 "duplicate-rows",
    /// The residuals are compared with the pure error of replicates.
    LackOfFit = 67 "lack-of-fit",
    /// The noise of an output is below the error of its simulation.
    NoiseBelowAccuracy = 68 "noise-below-accuracy",
    /// The time unit in the settings differs from the one that the model states.
    ContradictedTimeUnit = 69 "contradicted-time-unit",
}

impl FindingId {
    /// Returns the number with its letter, such as `F012`.
    pub fn code(self) -> String {
        format!("F{:03}", self as u16)
    }
}

impl fmt::Display for FindingId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.code(), self.name())
    }
}

impl From<FindingId> for String {
    fn from(id: FindingId) -> Self {
        id.code()
    }
}

impl TryFrom<String> for FindingId {
    type Error = String;

    fn try_from(code: String) -> Result<Self, String> {
        let found = Self::ALL.iter().copied().find(|id| id.code() == code);
        found.ok_or_else(|| format!("'{code}' is not an identifier of a finding"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn codes_and_names_are_distinct_and_ordered() {
        assert!(FindingId::ALL.is_sorted_by(|a, b| a < b));
        let names: BTreeSet<_> = FindingId::ALL.iter().map(|id| id.name()).collect();
        assert_eq!(names.len(), FindingId::ALL.len());
        for id in FindingId::ALL {
            assert_eq!(FindingId::try_from(id.code()), Ok(*id));
            assert!(id.name().chars().all(|c| c.is_ascii_lowercase() || c == '-'), "{id}");
        }
        assert_eq!(FindingId::AutocorrelatedResiduals.to_string(), "F012 autocorrelated-residuals");
    }

    /// Each identifier has a row in one of the tables, and each row has an identifier.
    #[test]
    fn page_of_findings_lists_exactly_these_identifiers() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/findings.md");
        let page = std::fs::read_to_string(path).unwrap();
        let rows = page.lines().filter_map(|line| line.strip_prefix("| `F")?.split_once('`'));
        let listed: Vec<String> = rows.map(|(id, _)| format!("F{id}")).collect();
        let all: Vec<String> = FindingId::ALL.iter().map(ToString::to_string).collect();
        assert_eq!(listed, all);
    }
}
