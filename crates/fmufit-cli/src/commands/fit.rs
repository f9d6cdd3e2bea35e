//! `fmufit fit` and `fmufit resume`: parameters are fitted to recordings.

use super::report;
use crate::arguments::Fit;
use crate::console::{Console, LiveLine};
use crate::error::{Error, Exit};
use crate::interrupt::Interrupt;
use crate::output_paths::check_written;
use crate::problem::{self, short_form};
use calibration::{Calibration, CurrentPhase, FitOptions, FitPhase, RunContext, Stage};
use dfo::{Checkpoint, Progress, Resume, Termination};
use ode::Number;
use std::cell::RefCell;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

/// Where a fit with a checkpoint begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Begin {
    /// As the options say.
    Auto,
    /// Where the checkpoint ends: there must be one.
    Resume,
}

pub(crate) fn run(arguments: &Fit, begin: Begin, console: &Console) -> Result<Exit, Error> {
    let mut file = problem::asked(&arguments.problem, console)?;
    file.set("fit", short_form::options(&arguments.option)?);
    let written = [&arguments.checkpoint, &arguments.save, &arguments.report];
    check_written(written.into_iter().flatten(), &file.files())?;
    arguments.report.iter().try_for_each(|path| report::check_suffix(path))?;
    let interrupt = Interrupt::watch()?;
    let is_asked = || interrupt.is_asked();
    let calibration = file.calibration(&RunContext::new().asking(&is_asked))?;
    let n = calibration.parameters().len();
    let (mut options, stages) = (file.options(n)?, file.stages(n)?);
    if let Some(path) = &arguments.checkpoint {
        // Relative to where the command was given, unlike that of the file.
        options.run.checkpoint = Some(Checkpoint::new(path));
    }
    match (&mut options.run.checkpoint, begin) {
        (_, Begin::Auto) => {}
        (Some(checkpoint), Begin::Resume) => checkpoint.resume = Resume::Require,
        (None, Begin::Resume) => {
            return Err(Error::input(
                "resume: there is no checkpoint to continue from: give the one of the fit, --checkpoint FILE, or checkpoint = \"FILE\" \
                 in the table [fit] of the problem file",
            ));
        }
    }
    let fit = searched(&calibration, options, &stages, &interrupt, console)?;
    // First of all: what follows may take long, or fail.
    match arguments.json {
        true => console.data(&(fit.to_json(&calibration).map_err(Error::of_work)? + "\n")),
        false => console.result(&fit.to_string()),
    }
    if let Some(path) = &arguments.save {
        fit.save(&calibration, path).map_err(Error::of_input)?;
        console.note(&format!("saved {}", path.display()));
    }
    let is_interrupted = fit.report.termination == Termination::Interrupted;
    if let Some(path) = &arguments.report {
        if is_interrupted {
            console.note("no report after Ctrl-C: fmufit report writes that of a saved fit");
        } else {
            report::write(&fit, &calibration, path, &RunContext::new().asking(&is_asked))?;
            console.note(&format!("wrote {}", path.display()));
        }
    }
    Ok(match fit.is_success() {
        _ if is_interrupted => Exit::Interrupted,
        true => Exit::Success,
        false => Exit::NoSuccess,
    })
}

/// Fits, and shows how far it is.
fn searched(
    calibration: &Calibration,
    options: FitOptions<'_>,
    stages: &[Stage],
    interrupt: &Interrupt,
    console: &Console,
) -> Result<calibration::Fit, Error> {
    let shown = Shown {
        line: console.live_line(),
        phase: Arc::clone(&options.phase),
        began: Instant::now(),
        state: RefCell::default(),
    };
    let poll = || {
        match interrupt.is_asked() {
            true => shown.line.end(),
            false => shown.show(),
        }
        interrupt.is_asked()
    };
    let observer = |progress: &Progress<'_>| {
        shown.note(calibration, progress);
        ControlFlow::Continue(())
    };
    let context = RunContext::new().asking(&poll);
    let options = FitOptions { context, observer: Some(Box::new(observer)), ..options };
    let fit = match stages.is_empty() {
        true => calibration.fit(options),
        false => calibration.fit_stages(stages, options),
    };
    fit.map_err(Error::of_work)
}

/// The line that shows a fit while it runs.
struct Shown {
    line: LiveLine,
    phase: Arc<CurrentPhase>,
    began: Instant,
    /// Progress of the search.
    state: RefCell<String>,
}

impl Shown {
    fn show(&self) {
        let (phase, state) = (self.phase.get(), self.state.borrow());
        let seconds = format!("{:.1} s", self.began.elapsed().as_secs_f64());
        match phase {
            FitPhase::Search if state.is_empty() => {
                self.line.show("evaluating the start", || seconds.clone())
            }
            FitPhase::Search => self.line.show(phase.name(), || format!("{seconds}, {state}")),
            _ => self.line.show(phase.name(), || seconds.clone()),
        }
    }

    fn note(&self, calibration: &Calibration, progress: &Progress<'_>) {
        let best = calibration.parameters().iter().zip(progress.x);
        let best =
            best.map(|(parameter, value)| format!("{} {}", parameter.shown_name(), Number(rounded(*value))));
        let failed = match progress.n_failed {
            0 => String::new(),
            n => format!(", {n} failed"),
        };
        *self.state.borrow_mut() = format!(
            "iteration {}, {} evaluations{failed}, cost {}, {}",
            progress.n_iterations,
            progress.n_evaluations,
            Number(rounded(progress.fun)),
            best.collect::<Vec<_>>().join(", "),
        );
        self.show();
    }
}

/// A number with five digits.
fn rounded(number: f64) -> f64 {
    format!("{number:.4e}").parse().unwrap_or(number)
}

#[cfg(test)]
mod tests {
    use super::rounded;

    #[test]
    fn numbers_are_shown_with_five_digits() {
        assert_eq!((rounded(0.012_345_678), rounded(-1.0), rounded(0.0)), (0.012_346, -1.0, 0.0));
        assert!(rounded(f64::NAN).is_nan() && rounded(f64::INFINITY).is_infinite());
    }
}
