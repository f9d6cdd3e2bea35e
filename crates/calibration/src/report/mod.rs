//! Reports of a fit: as text, as a part of a notebook, and as a page with figures.

mod curves;
mod figure;
pub(crate) mod live_content;
mod number;
mod page;
mod summary;
mod template;
mod text;

pub use curves::{ExperimentCurves, OutputCurves, Signal, plot};

use crate::error::CalibrationError;
use crate::fit::one_stage::Fit;
use crate::loaded::calibration::Calibration;
use base::RunContext;
use base::files::AtomicFile;
use std::io::Write;
use std::path::Path;

impl Fit {
    /// Content of [`Display`](std::fmt::Display) as an HTML element for a notebook: it takes the colours of
    /// the page around it, light or dark.
    pub fn to_html(&self) -> String {
        template::notebook(&summary::Summary::new(self))
    }
}

impl Calibration {
    /// Writes a report of a fit: one HTML page that needs nothing but itself, with parameters and their
    /// intervals, outputs, figures of measurements, responses and residuals, correlation, search, warnings,
    /// settings, versions, and hashes of model and data. Each experiment is simulated at the start and at the
    /// fitted values. An existing file is replaced once the new one is whole.
    ///
    /// # Errors
    /// [`CalibrationError::ReportFile`]: the file cannot be written. [`CalibrationError::Setup`]: its name ends in something else than
    /// `.html`. The fit has another number of parameters, or its simulation
    /// fails now.
    pub fn report(
        &self,
        fit: &Fit,
        path: impl AsRef<Path>,
        context: &RunContext<'_>,
    ) -> Result<(), CalibrationError> {
        let path = path.as_ref();
        let suffix = path.extension().map(|suffix| suffix.to_string_lossy().to_lowercase());
        if let Some(other) = suffix.filter(|suffix| suffix != "html" && suffix != "htm") {
            return Err(CalibrationError::Setup(format!(
                "{}: a report is a page in HTML, which no '.{other}' holds: give a name that ends in .html",
                path.display()
            )));
        }
        let failed = |source| CalibrationError::ReportFile { path: path.to_owned(), source };
        // Before the simulations, which may take long.
        let unfinished = AtomicFile::new(path).map_err(failed)?;
        let page = self.report_page(fit, context)?;
        unfinished.file().write_all(page.as_bytes()).and_then(|()| unfinished.finish()).map_err(failed)
    }
}

impl Calibration {
    /// The page that [`report`](Self::report) writes.
    pub(crate) fn report_page(
        &self,
        fit: &Fit,
        context: &RunContext<'_>,
    ) -> Result<String, CalibrationError> {
        page::page(self, fit, context)
    }
}

#[cfg(test)]
mod tests {
    use crate::{BoundSide, Calibration, Data, Experiment, Finding, Fit, FitOptions, Origin, Parameter};
    use base::RunContext;

    /// x' = -k x with k = 2, recorded with an error of a thousandth; c has no effect.
    fn decay() -> (Calibration, Fit) {
        let t: Vec<f64> = (0..31).map(|i| f64::from(i) / 10.0).collect();
        let x = t.iter().enumerate().map(|(i, t)| (-2.0 * t).exp() + if i % 2 == 0 { 1e-3 } else { -1e-3 });
        let data =
            Data::from_columns(t.clone(), [("measured <x> & \"more\"".to_owned(), x.collect())]).unwrap();
        let fmu = fmi::Fmu::open(example_models::example_fmu("dahlquist").unwrap()).unwrap();
        let calibration = Calibration::builder(fmu)
            .experiment(Experiment::new(data).output("x", "measured <x> & \"more\""))
            .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
            .build()
            .unwrap();
        let fit = calibration.fit(FitOptions::default()).unwrap();
        (calibration, fit)
    }

    #[test]
    fn outputs_say_how_well_they_are_reproduced() {
        let (_, fit) = decay();
        let [output] = &fit.outputs[..] else { panic!("{:?}", fit.outputs) };
        // The noise of the recording, and at k = 1 the difference of two exponentials.
        assert!((output.rms - 1e-3).abs() < 3e-5, "{output:?}");
        assert_eq!(output.n, 31);
        let times = || (0..31).map(|i| f64::from(i) / 10.0);
        let difference: f64 = times().map(|t| ((-t).exp() - (-2.0 * t).exp()).powi(2)).sum();
        assert!((output.start_rms.unwrap() / (difference / 31.0).sqrt() - 1.0).abs() < 1e-3, "{output:?}");
        let mean = times().map(|t| (-2.0 * t).exp()).sum::<f64>() / 31.0;
        let spread: f64 = times().map(|t| ((-2.0 * t).exp() - mean).powi(2)).sum();
        let percent = 100.0 * (1.0 - 1e-3 / (spread / 31.0).sqrt());
        assert!((output.fit_percent - percent).abs() < 0.02, "{output:?}");
    }

    #[test]
    fn text_says_start_value_error_and_what_to_mistrust() {
        let (_, mut fit) = decay();
        let uncertainty = fit.uncertainty.as_mut().unwrap();
        (uncertainty.standard_errors, uncertainty.uncorrected_covariance, uncertainty.findings) =
            (vec![1e-3], None, Vec::new());
        let text = fit.to_string();
        assert!(text.contains("The fit converged: RMS 0.001 (at the start 0.1629) over 31"), "{text}");
        assert!(text.contains("k  1  -> 2.0001  +- 0.001  1/s") && text.contains("sandwich"), "{text}");
        assert!(text.contains("31 measurements. Standard errors: k 0.05 %.\n"), "{text}");
        assert!(!text.contains("warning") && !text.contains("note"), "{text}");
        let uncertainty = fit.uncertainty.as_mut().unwrap();
        uncertainty.uncorrected_covariance = Some(vec![25e-8]);
        uncertainty.findings = vec![Finding::note("residuals", "the residuals are not white", "wait")];
        fit.at_bound = vec![(0, BoundSide::Upper)];
        let text = fit.to_string();
        assert!(
            text.contains("+- 0.001 (uncorrected 0.0005)") && text.contains("at its upper bound 10"),
            "{text}"
        );
        assert!(text.contains("Standard errors: k 0.05 %. 1 warning, 1 note.\n"), "{text}");
        let said = "\nwarning  k is at its upper bound 10: the best value may lie beyond\nnote     the residuals are not white\n         -> wait\n";
        assert!(text.contains(said), "{text}");
        fit.uncertainty.as_mut().unwrap().standard_errors = vec![f64::INFINITY];
        fit.uncertainty.as_mut().unwrap().uncorrected_covariance = None;
        assert!(fit.to_string().contains("(not determined"), "{fit}");
        assert!(fit.to_string().contains("31 measurements. Not determined: k. 1 warning"), "{fit}");
        fit.uncertainty = None;
        assert!(fit.to_string().contains("none were estimated"), "{fit}");
    }

    #[test]
    fn parameters_are_shown_by_their_display_names() {
        let (calibration, _) = decay();
        let mut problem = calibration.problem().clone();
        problem.parameters[0] = problem.parameters[0].clone().display_name("rate of decay");
        let calibration = Calibration::from_problem(calibration.fmu().clone(), problem).unwrap();
        let mut fit = calibration.fit(FitOptions::default()).unwrap();
        let sentence = "the data do not determine k: other values fit as well";
        let uncertainty = fit.uncertainty.as_mut().unwrap();
        uncertainty.undetermined = vec![0];
        uncertainty.findings = vec![
            Finding::warning("k", sentence, "").of(Origin::Search),
            Finding::note("", "all is well", ""),
        ];
        fit.report.message = "f_tol reached".to_owned();
        let text = fit.to_string();
        assert!(text.contains("rate of decay  1  -> 2.0001"), "{text}");
        let said = "\nwarning  the data do not determine rate of decay: other values fit as well\nnote     all is well\n";
        assert!(text.contains(said), "{text}");
        assert!(text.contains(": f_tol reached\n"), "{text}");
        assert!(fit.to_html().contains("rate of decay"));
        assert!(fit.to_json(&calibration).unwrap().contains("\"name\": \"k\""));
    }

    #[test]
    fn nothing_in_a_name_moves_the_cursor_or_turns_the_text() {
        let (calibration, _) = decay();
        let mut problem = calibration.problem().clone();
        problem.parameters[0] = problem.parameters[0].clone().display_name("k\u{1b}[2J\u{202e}");
        let calibration = Calibration::from_problem(calibration.fmu().clone(), problem).unwrap();
        let fit = calibration.fit(FitOptions::default()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("report.html");
        calibration.report(&fit, &path, &RunContext::new()).unwrap();
        for text in [fit.to_string(), fit.to_html(), std::fs::read_to_string(&path).unwrap()] {
            assert!(text.contains("k\\u{1b}[2J\\u{202e}"), "{text}");
            assert!(!text.contains(['\u{1b}', '\u{202e}']), "{text}");
        }
    }

    #[test]
    fn the_page_needs_nothing_but_itself_and_escapes_names() {
        let (calibration, mut fit) = decay();
        let uncertainty = fit.uncertainty.as_mut().unwrap();
        uncertainty.standard_errors = vec![1e-3];
        uncertainty.findings = vec![Finding::note("<x>", "the residuals are not white", "")];
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("report.html");
        std::fs::write(&path, "an older one").unwrap();
        calibration.report(&fit, &path, &RunContext::new()).unwrap();
        let page = std::fs::read_to_string(&path).unwrap();
        for expected in [
            "<!DOCTYPE html>",
            "The fit converged: RMS 0.001",
            "&#177; 0.001",
            "the residuals are not white",
            "<svg",
            "relative tolerance",
            &calibration.problem().model.content_hash,
            "SHA-256 of the data",
            "<strong>note</strong> &lt;x&gt;: the residuals are not white",
            "<details>\n<summary>Experiment run1: ",
            "prefers-color-scheme",
        ] {
            assert!(page.contains(expected), "{expected}: {page}");
        }
        let column = "measured &lt;x&gt; &amp; &quot;more&quot;";
        assert!(page.contains(column) && !page.contains("<x>"), "{page}");
        let elsewhere = page.replace("http://www.w3.org/2000/svg", "");
        assert!(!["http", "<script", "@import", "url("].iter().any(|text| elsewhere.contains(text)));
        assert!(fit.to_html().contains(column) && fit.to_html().contains("Parameters"));
        // Nothing but the report is left.
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_report_that_cannot_be_written_says_where_and_why() {
        let (calibration, mut fit) = decay();
        let error =
            calibration.report(&fit, "/no/such/folder/x.html", &RunContext::new()).unwrap_err().to_string();
        assert!(error.contains("cannot write /no/such/folder/x.html: there is no folder"), "{error}");
        let folder = tempfile::tempdir().unwrap();
        assert!(calibration.report(&fit, folder.path(), &RunContext::new()).is_err());
        let error = calibration
            .report(&fit, folder.path().join("x.pdf"), &RunContext::new())
            .unwrap_err()
            .to_string();
        assert!(error.contains("x.pdf: a report is a page in HTML"), "{error}");
        fit.x.push(1.0);
        assert!(calibration.report(&fit, folder.path().join("x.html"), &RunContext::new()).is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
