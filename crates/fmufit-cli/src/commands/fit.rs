//! `fmufit fit` and `fmufit resume`: fit parameters to recordings.

use super::report;
use crate::arguments;
use crate::console::{Console, LiveLine};
use crate::error::{Error, Exit};
use crate::interrupt::Interrupt;
use crate::output_paths::check_written;
use crate::problem::{self, short_form};
use base::Number;
use calibration::{
    Calibration, CurrentPhase, Fit, FitOptions, FitPhase, LivePage, Origin, RunContext, Severity, Stage,
};
use dfo::{Checkpoint, Progress, Resume, Termination};
use std::cell::RefCell;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Start of a fit with a checkpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Begin {
    /// According to the options.
    Auto,
    /// From an existing checkpoint; it is an error if there is none.
    Resume,
}

pub(crate) fn run(arguments: &arguments::Fit, begin: Begin, console: &Console) -> Result<Exit, Error> {
    let mut file = problem::of_arguments(&arguments.problem, console)?;
    if file.is_design() {
        return Err(Error::input("the problem has an objective and no recordings. Use fmufit optimize"));
    }
    file.set("fit", short_form::options(&arguments.option)?);
    let written = [&arguments.checkpoint, &arguments.save, &arguments.report];
    check_written(written.into_iter().flatten(), &file.files())?;
    arguments.report.iter().try_for_each(|path| report::check_suffix(path))?;
    let interrupt = Interrupt::watch()?;
    let is_requested = || interrupt.is_requested();
    let calibration = file.calibration(&RunContext::new().polling(&is_requested))?;
    calibration.columns_without_unit().iter().for_each(|reported| console.note(reported));
    let n = calibration.parameters().len();
    let mut options = file.options(n)?;
    let stages = file.stages(n, options.run.workers)?;
    if let Some(path) = &arguments.checkpoint {
        // Relative to the working folder, in contrast to a path in the problem file.
        options.run.checkpoint = Some(Checkpoint::new(path));
    }
    match (&mut options.run.checkpoint, begin) {
        (_, Begin::Auto) => {}
        (Some(checkpoint), Begin::Resume) => checkpoint.resume = Resume::Require,
        (None, Begin::Resume) => {
            return Err(Error::input(
                "resume: no checkpoint is specified. Use --checkpoint FILE, or set checkpoint = \"FILE\" in \
                 the table [fit] of the problem file",
            ));
        }
    }
    // Checked before the page gets an address, and separately from later failures.
    check_fit(&calibration, &options, &stages)?;
    let watch = arguments.watch.then(|| watch(&calibration, console)).transpose()?;
    let fit = searched(&calibration, options, &stages, (&is_requested, watch.as_ref()), console)
        .inspect_err(|error| watch.iter().for_each(|watch| watch.show_error(&error.to_string())))?;
    // Printed first, because the following steps may take long or fail.
    print(&fit, &calibration, arguments.json, console)?;
    // The page of the result waits for a request.
    let is_interrupted = fit.report.termination == Termination::Interrupted || interrupt.is_requested();
    if let Some(path) = &arguments.save {
        fit.save(&calibration, path).map_err(Error::of_input)?;
        console.note(&format!("saved {}", path.display()));
    }
    if let Some(path) = &arguments.report {
        if interrupt.is_requested() {
            console.note(
                "no report was written after Ctrl-C; use fmufit report to write the report of a saved fit",
            );
        } else {
            report::write(&fit, &calibration, path, None, &RunContext::new().polling(&is_requested))?;
            console.note(&format!("wrote {}", path.display()));
        }
    }
    if let Some(watch) = &watch {
        show_report(watch, &fit, &calibration, &interrupt, console);
    }
    Ok(conclude(&fit, is_interrupted, console))
}

/// Prints the result of a fit.
pub(super) fn print(
    fit: &Fit,
    calibration: &Calibration,
    json: bool,
    console: &Console,
) -> Result<(), Error> {
    match json {
        true => console.data(&(fit.to_json(calibration).map_err(Error::of_work)? + "\n")),
        false => console.result(&fit.to_string()),
    }
    Ok(())
}

/// Prints the reasons against a result and returns the exit code. They are printed last, because a terminal
/// shows the end and a log ends there. The findings are above, among the results.
pub(super) fn conclude(fit: &Fit, is_interrupted: bool, console: &Console) -> Exit {
    reasons_against(fit).iter().for_each(|reason| console.say(reason));
    match (fit.is_success(), fit.is_usable()) {
        _ if is_interrupted => Exit::Interrupted,
        (false, _) => Exit::NoSuccess,
        (true, false) => Exit::NotUsable,
        (true, true) => Exit::Success,
    }
}

/// Rejects options and stages that the fit would reject.
pub(super) fn check_fit(
    calibration: &Calibration,
    options: &FitOptions<'_>,
    stages: &[Stage],
) -> Result<(), Error> {
    let requested = FitOptions {
        run: options.run.clone(),
        start: options.start.clone(),
        objective: options.objective.clone(),
        loss: options.loss,
        noise: options.noise,
        ..FitOptions::default()
    };
    let stages = (!stages.is_empty()).then_some(stages);
    calibration.check_fit(stages, requested).map_err(Error::of_input)
}

/// Returns the reasons why the result of a fit should not be used, with the probable cause.
fn reasons_against(fit: &Fit) -> Vec<String> {
    let findings = fit.findings();
    let errors = findings.iter().filter(|finding| finding.severity == Severity::Error);
    let mut reported: Vec<String> =
        errors.map(|error| format!("error: the result should not be used: {}", error.text())).collect();
    let cause = findings.iter().find(|f| f.severity == Severity::Warning && f.origin == Origin::Problem);
    reported.extend(
        cause.filter(|_| !reported.is_empty()).map(|cause| format!("probable cause: {}", cause.advice())),
    );
    reported
}

/// Serves a page that will show the fit, and prints its address.
pub(super) fn watch(calibration: &Calibration, console: &Console) -> Result<LivePage, Error> {
    let watch = LivePage::start(calibration)
        .map_err(|error| Error::work(format!("--watch: cannot serve the page: {error}")))?;
    // Printed even with `--quiet`, because the page is useless without its address.
    console.say(&format!("watch the fit at {}", watch.url()));
    Ok(watch)
}

/// Shows the report of a fit on its page until the reader closes it or presses Ctrl-C. Without a terminal,
/// Ctrl-C is not possible, so the page ends with the program.
pub(super) fn show_report(
    watch: &LivePage,
    fit: &Fit,
    calibration: &Calibration,
    interrupt: &Interrupt,
    console: &Console,
) {
    let is_requested = || interrupt.is_requested();
    if interrupt.is_requested() || !console.is_terminal() {
        return;
    }
    match watch.show_report(calibration, fit, &RunContext::new().polling(&is_requested)) {
        Ok(()) => {
            console.say(&format!("the report is available at {} until you press Ctrl-C", watch.url()));
            while !(interrupt.is_requested() || watch.is_closed()) {
                std::thread::sleep(Duration::from_millis(50));
            }
        }
        // The fit itself is complete; only its display failed.
        Err(error) => console.say(&format!("cannot show the report on the page: {error}")),
    }
}

/// Runs the fit and shows its progress. Either `is_interrupted` or `watch` can end the fit.
pub(super) fn searched(
    calibration: &Calibration,
    options: FitOptions<'_>,
    stages: &[Stage],
    (is_interrupted, watch): (&dyn Fn() -> bool, Option<&LivePage>),
    console: &Console,
) -> Result<Fit, Error> {
    let mut options = options;
    watch.iter().for_each(|watch| watch.attach(&mut options));
    let shown = Shown {
        line: console.live_line(),
        phase: Arc::clone(&options.phase),
        began: Instant::now(),
        state: RefCell::default(),
    };
    let poll = || {
        let is_requested = is_interrupted();
        match is_requested {
            true => shown.line.end(),
            false => shown.show(),
        }
        is_requested || watch.is_some_and(LivePage::is_stop_requested)
    };
    let observer = |progress: &Progress<'_>| {
        shown.note(calibration, progress);
        ControlFlow::Continue(())
    };
    let context = RunContext::new().polling(&poll);
    let options = FitOptions { context, observer: Some(Box::new(observer)), ..options };
    let fit = match stages.is_empty() {
        true => calibration.fit(options),
        false => calibration.fit_stages(stages, options),
    };
    fit.map_err(Error::of_work)
}

/// Progress line of a running fit.
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

/// Rounds a number to five significant digits.
fn rounded(number: f64) -> f64 {
    format!("{number:.4e}").parse().unwrap_or(number)
}

#[cfg(test)]
mod tests {
    use super::rounded;

    #[test]
    fn numbers_are_rounded_to_five_digits() {
        assert_eq!((rounded(0.012_345_678), rounded(-1.0), rounded(0.0)), (0.012_346, -1.0, 0.0));
        assert!(rounded(f64::NAN).is_nan() && rounded(f64::INFINITY).is_infinite());
    }
}
