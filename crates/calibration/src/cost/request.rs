//! Requests to a worker process, and its answers.

use crate::cost::accuracy::Accuracy;
use crate::cost::failure::ReportedCostFailure;
use crate::cost::residual::sum_of_squares;
use crate::problem::definition::{ModelFile, Problem};
use dfo::RobustLoss;
use fmi::worker::Frame;
use fmi::{
    FmiError, InstanceCall, InstanceOptions, InterfaceChoice, InterfaceKind, OpenOptions, SimulateOptions,
    Trajectory, Value,
};
use ode::Stats;
use serde::{Deserialize, Serialize};
use std::io;

/// Data of a calibration that a worker loads.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Loaded {
    pub(crate) problem: Problem,
    pub(crate) options: OpenOptions,
}

/// Request to a worker.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) enum Job {
    /// Loads a problem and its model, to which the evaluations refer.
    Load(Box<Loaded>),
    /// Opens a model, to which the next four jobs refer.
    Open(ModelFile, Box<OpenOptions>),
    /// Simulates the model.
    Simulate(Box<SimulateOptions>),
    /// Returns values of variables at the end of a simulation. The simulation is repeated unless it was the
    /// last one.
    FinalValues(Box<SimulateOptions>, Vec<String>),
    /// Returns values of variables after an initialization with some values set.
    InitialValues { kind: InterfaceChoice, set: Vec<(String, Value)>, names: Vec<String> },
    /// Creates an instance that is controlled call by call, to which the next job refers.
    NewInstance(InterfaceKind, Box<InstanceOptions>),
    /// Calls the instance. The numbers of the frames contain the vectors of the call and of the answer.
    Instance(InstanceCall),
    /// Computes the cost and the residuals at a point.
    Evaluate {
        x: Vec<f64>,
        loss: RobustLoss,
        cutoff: f64,
        /// Accuracy, if it differs from the accuracy of the problem.
        accuracy: Option<Accuracy>,
        /// Index of the only recording to simulate. `None`: all, followed by the priors.
        recording: Option<usize>,
    },
    /// Returns the compared outputs of an experiment.
    Experiment { experiment: usize, x: Vec<f64>, times: Option<Vec<f64>> },
    /// Returns variables of the model in an experiment.
    Variables { experiment: usize, x: Vec<f64>, times: Option<Vec<f64>>, variables: Vec<String> },
}

impl Job {
    /// The question without the values of parameters.
    pub(super) fn without_values(&self) -> io::Result<Frame> {
        match self {
            Self::Simulate(options) => {
                let mut options = options.clone();
                options.start_values.clear();
                Frame::of(&Self::Simulate(options))
            }
            Self::Experiment { experiment, times, .. } => {
                Frame::of(&Self::Experiment { experiment: *experiment, x: Vec::new(), times: times.clone() })
            }
            Self::Variables { experiment, times, variables, .. } => Frame::of(&Self::Variables {
                experiment: *experiment,
                x: Vec::new(),
                times: times.clone(),
                variables: variables.clone(),
            }),
            _ => Ok(Frame::default()),
        }
    }

    /// Switches the log of the model on if the job opens a model.
    pub(super) fn switch_log_on(&mut self) {
        match self {
            Self::Load(loaded) => loaded.options.logging.requested = true,
            Self::Open(_, options) => options.logging.requested = true,
            _ => {}
        }
    }
}

/// Result of an evaluation. The numbers of the frame are its residuals, then its criteria.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Evaluated {
    pub(crate) cost: Result<f64, ReportedCostFailure>,
    pub(crate) stats: Stats,
}

pub(crate) fn unsaid(error: io::Error) -> FmiError {
    FmiError::BadSetting(error.to_string())
}

/// Reads an evaluation with `n` values and this cutoff. The first values are the residuals. Checks that the
/// cost matches the residuals, because a faulty worker may return any cost.
pub(super) fn evaluated(answer: &Frame, n_residuals: usize, n: usize, cutoff: f64) -> io::Result<Evaluated> {
    let evaluated: Evaluated = answer.head()?;
    let numbers = &answer.numbers;
    if let Ok(cost) = &evaluated.cost {
        if numbers.len() != n {
            return Err(wrong(format!("{} values instead of {n}", numbers.len())));
        }
        let sum = sum_of_squares(&numbers[..n_residuals.min(n)]);
        if !sum.is_finite() || sum.to_bits() != cost.to_bits() || sum > cutoff {
            return Err(wrong(format!("a cost of {cost} for residuals whose sum of squares is {sum}")));
        }
    }
    Ok(evaluated)
}

/// Writes a trajectory to a frame. Its rows become the numbers.
pub(crate) fn put_trajectory(mut trajectory: Trajectory, answer: &mut Frame) -> io::Result<()> {
    answer.numbers.append(&mut trajectory.time);
    trajectory.columns.iter_mut().for_each(|column| answer.numbers.append(column));
    answer.set_head(&trajectory)
}

pub(super) fn trajectory_of(answer: &mut Frame) -> io::Result<Trajectory> {
    let mut trajectory: Trajectory = answer.head()?;
    let n_columns = trajectory.columns.len() + 1;
    if !answer.numbers.len().is_multiple_of(n_columns) {
        return Err(wrong(format!("{} numbers in {n_columns} columns", answer.numbers.len())));
    }
    let rows = answer.numbers.len() / n_columns;
    let mut columns = answer.numbers.chunks(rows.max(1));
    let mut column = || {
        let numbers = columns.next().unwrap_or_default();
        let mut copy = Vec::new();
        copy.try_reserve_exact(numbers.len()).map_err(|_| io::Error::from(io::ErrorKind::OutOfMemory))?;
        copy.extend_from_slice(numbers);
        Ok::<_, io::Error>(copy)
    };
    trajectory.time = column()?;
    for values in &mut trajectory.columns {
        *values = column()?;
    }
    match trajectory.is_consistent() {
        true => Ok(trajectory),
        false => Err(wrong("columns of different lengths".to_owned())),
    }
}

/// Returns an error for an answer with invalid contents.
pub(super) fn wrong(what: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evaluation_is_rejected_when_cost_and_residuals_differ() {
        let answer = |cost: f64, residuals: &[f64]| {
            let mut frame = Frame::of(&Evaluated { cost: Ok(cost), stats: Stats::default() }).unwrap();
            frame.numbers = residuals.to_vec();
            frame
        };
        let read =
            |frame: &Frame, cutoff: f64| evaluated(frame, 2, 2, cutoff).map(|evaluated| evaluated.cost.ok());
        assert_eq!(read(&answer(25.0, &[3.0, 4.0]), f64::INFINITY).unwrap(), Some(25.0));
        let wrong = [
            (
                answer(24.0, &[3.0, 4.0]),
                f64::INFINITY,
                "a cost of 24 for residuals whose sum of squares is 25",
            ),
            (answer(25.000000000000004, &[3.0, 4.0]), f64::INFINITY, "a cost of 25.000000000000004"),
            (answer(25.0, &[3.0, 4.0]), 20.0, "a cost of 25"),
            (answer(f64::NAN, &[f64::NAN, 4.0]), f64::INFINITY, "a cost of NaN"),
            (answer(9.0, &[3.0]), f64::INFINITY, "1 values instead of 2"),
            (Frame::of(&"a text").unwrap(), f64::INFINITY, "its header has unexpected contents"),
        ];
        for (frame, cutoff, expected) in wrong {
            let error = read(&frame, cutoff).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
