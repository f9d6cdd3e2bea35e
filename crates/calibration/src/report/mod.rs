//! Reports of a fit: as text, as an HTML element for notebooks, and as a page with figures.

mod curves;
#[cfg(feature = "report")]
mod figure;
#[cfg(feature = "report")]
mod front;
#[cfg(feature = "report")]
pub(crate) mod live_content;
mod number;
#[cfg(feature = "report")]
mod page;
#[cfg(feature = "report")]
mod setup;
mod summary;
#[cfg(feature = "report")]
mod template;
mod text;

#[cfg(feature = "report")]
pub use curves::plot;
pub use curves::{ExperimentCurves, OutputCurves, Signal};
#[cfg(feature = "report")]
pub(crate) use front::plot_front;

#[cfg(feature = "report")]
use {
    crate::error::CalibrationError, crate::fit::one_stage::Fit, crate::loaded::calibration::Calibration,
    base::RunContext, base::files::AtomicFile, std::io::Write, std::path::Path,
};

#[cfg(feature = "report")]
impl Fit {
    /// Returns the content of [`Display`](std::fmt::Display) as an HTML element for a notebook. It uses the
    /// light or dark colours of the surrounding page.
    pub fn to_html(&self) -> String {
        template::notebook(&summary::Summary::new(self))
    }
}

#[cfg(feature = "report")]
impl Calibration {
    /// Writes a report of a fit as one self-contained HTML page. The page contains:
    /// - parameters and their intervals, outputs, and warnings,
    /// - figures of measurements, responses and residuals,
    /// - the correlation, the search and the settings,
    /// - versions, and hashes of model and data.
    ///
    /// Each experiment is simulated at the start and at the fitted values. An existing file is replaced when
    /// the new one is complete.
    ///
    /// # Errors
    /// Returns [`CalibrationError::ReportFile`] if the file cannot be written, and
    /// [`CalibrationError::Setup`] if its name does not end in `.html` or `.htm`. Returns an error if the fit
    /// has a different number of parameters, or if its simulation now fails.
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
                "{}: a report is an HTML page, not a '.{other}' file. Specify a name that ends in .html",
                path.display()
            )));
        }
        let failed = |source| CalibrationError::ReportFile { path: path.to_owned(), source };
        // The file is opened before the simulations, which may take long.
        let unfinished = AtomicFile::new(path).map_err(failed)?;
        let page = self.report_page(fit, context)?;
        unfinished.file().write_all(page.as_bytes()).and_then(|()| unfinished.finish()).map_err(failed)
    }
}

#[cfg(feature = "report")]
impl Calibration {
    /// Returns the page that [`report`](Self::report) writes.
    pub(crate) fn report_page(
        &self,
        fit: &Fit,
        context: &RunContext<'_>,
    ) -> Result<String, CalibrationError> {
        let curves = self.curves(fit, context)?;
        let design = match self.problem().goals.is_empty() {
            true => None,
            false => Some((self.design_point(&fit.start, context).ok(), self.design_point(&fit.x, context)?)),
        };
        Ok(page::page(self, fit, &curves, design))
    }

    /// Returns the page with these curves, without running simulations.
    pub(crate) fn report_page_with(&self, fit: &Fit, curves: &[ExperimentCurves]) -> String {
        page::page(self, fit, curves, None)
    }
}

#[cfg(test)]
mod tests {
    use crate::{
        BoundSide, Calibration, Data, Experiment, Finding, FindingId, Fit, FitOptions, Origin, Parameter,
    };
    use base::RunContext;

    /// x' = -k x with k = 2, recorded with an error of 0.001.
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

    /// The page and the document report what was fitted and how, as text and numbers.
    #[test]
    fn document_and_page_record_setup_and_options() {
        let folder = tempfile::tempdir().unwrap();
        let csv = folder.path().join("run.csv");
        let row = |k: u32| {
            let t = f64::from(k) / 20.0;
            format!("{t},{},{}\n", (-2.0 * t).exp(), u32::from(k != 4))
        };
        let text: String = std::iter::once("time,x,ok\n".to_owned()).chain((0..40).map(row)).collect();
        std::fs::write(&csv, &text).unwrap();
        let data = Data::from_csv(&csv).unwrap().masked_by(&["x"], "ok").unwrap();
        let run = fmi::RunSettings {
            max_step: Some(0.021),
            timeout: Some(std::time::Duration::from_millis(3250)),
            chattering: ode::ChatteringPolicy::Slide,
            relative_tolerance: Some(1e-8),
            ..fmi::RunSettings::default()
        };
        let settings = crate::SimulationSettings { memory_limit: Some(512_345_678), ..run.into() };
        let fmu = fmi::Fmu::open(example_models::example_fmu("dahlquist").unwrap()).unwrap();
        let calibration = Calibration::builder(fmu)
            .experiment(
                Experiment::new(data).resample(0.1).output("x", "x").delay("x", 0.0).hold_inputs(true),
            )
            .parameter(Parameter::new("k", 1.0).bounds(0.1, 10.0))
            .settings(settings)
            .build()
            .unwrap();
        let requested = serde_json::json!({
            "loss": "huber", "f_scale": 0.77, "max_evaluations": 777, "max_failed": 0.44, "covariance": null, "rng": 17
        });
        let dfo::Value::Record(requested) = requested.into() else { panic!("no record") };
        let options = FitOptions::from_record(requested, 1).unwrap();
        let record = options.record().unwrap();
        let again = FitOptions::from_record(record.clone(), 1).unwrap();
        assert_eq!((again.record().unwrap(), &again.run), (record.clone(), &options.run));
        let fit = calibration.fit(options).unwrap();
        assert_eq!(fit.options, record);
        let document: serde_json::Value = serde_json::from_str(&fit.to_json(&calibration).unwrap()).unwrap();
        for (path, expected) in [
            ("/relative_tolerance", serde_json::json!(1e-8)),
            ("/problem/settings/max_step", serde_json::json!(0.021)),
            ("/problem/settings/timeout", serde_json::json!(3.25)),
            ("/problem/settings/chattering", serde_json::json!("slide")),
            ("/problem/settings/memory_limit", serde_json::json!(512_345_678)),
            ("/problem/parameters/0/upper", serde_json::json!(10.0)),
            ("/problem/experiments/0/hold_inputs", serde_json::json!(true)),
            ("/problem/experiments/0/delays", serde_json::json!([["x", 0.0]])),
            ("/problem/experiments/0/data/mask", serde_json::json!("column 'ok': 39 of 40 rows")),
            ("/problem/experiments/0/data/resample", serde_json::json!(0.1)),
            // In one of the 20 intervals, the mask gives x a different mean time than the mask
            // column itself.
            ("/problem/experiments/0/data/n_rows", serde_json::json!(21)),
            (
                "/problem/experiments/0/data/file_sha256",
                crate::problem::fingerprint::hash_of_bytes(text.as_bytes()).into(),
            ),
            ("/fit_options/method", serde_json::json!("auto")),
            ("/fit_options/search", serde_json::json!("local")),
            ("/fit_options/objective", serde_json::json!("sum-of-squares")),
            ("/fit_options/loss", serde_json::json!("huber")),
            ("/fit_options/f_scale", serde_json::json!(0.77)),
            ("/fit_options/max_failed", serde_json::json!(0.44)),
            ("/fit_options/covariance", serde_json::Value::Null),
            ("/fit_options/seed", serde_json::json!(17)),
        ] {
            assert_eq!(document.pointer(path), Some(&expected), "{path}: {document}");
        }
        let page = calibration.report_page(&fit, &RunContext::new()).unwrap();
        let line = |name: &str, value: &str| format!("<dt>{name}</dt><dd>{value}</dd>");
        for expected in [
            line("max_step", "0.021"),
            line("memory_limit", "512345678"),
            line("chattering", "slide"),
            line("max_evaluations", "777"),
            line("covariance", "none"),
            line("outputs", "x measured by column x"),
            line("mask", "column &#x27;ok&#x27;: 39 of 40 rows"),
            line("resample", "means over 0.1 s"),
            line("delays", "x 0 s"),
        ] {
            assert!(page.contains(&expected), "{expected}: {page}");
        }
        assert!(
            page.contains("<dt>hold inputs</dt>") && page.contains("<dt>SHA-256 of the file</dt>"),
            "{page}"
        );
        // Default values are omitted.
        assert!(!page.contains("<dt>sandbox</dt>") && !page.contains("Constant"), "{page}");
        let named = serde_json::json!({ "objective": "rmse", "max_evaluations": 20 });
        let dfo::Value::Record(named) = named.into() else { panic!("no record") };
        let fit = calibration.fit(FitOptions::from_record(named, 1).unwrap()).unwrap();
        assert!(
            fit.to_string().lines().any(|line| line.split_whitespace().eq(["objective", "rmse"])),
            "{fit}"
        );
    }

    #[test]
    fn outputs_report_quality_of_fit() {
        let (_, fit) = decay();
        let [output] = &fit.outputs[..] else { panic!("{:?}", fit.outputs) };
        // The RMS is the noise of the recording; at k = 1 it is the difference of two exponentials.
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
    fn text_contains_start_value_error_and_findings() {
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
        uncertainty.findings =
            vec![Finding::note(FindingId::Outliers, "residuals", "the residuals are not white", "Wait")];
        fit.at_bound = vec![(0, BoundSide::Upper)];
        let text = fit.to_string();
        assert!(
            text.contains("+- 0.001 (uncorrected 0.0005)") && text.contains("at its upper bound 10"),
            "{text}"
        );
        assert!(text.contains("Standard errors: k 0.05 %. 1 warning, 1 note.\n"), "{text}");
        let reported = "\nwarning  k is at its upper bound 10. The best value may lie beyond [F001 at-bound]\n         -> Widen the bound if larger or \
                    smaller values are possible\nnote     the residuals are not white [F015 outliers]\n         -> Wait\n";
        assert!(text.contains(reported), "{text}");
        fit.uncertainty.as_mut().unwrap().standard_errors = vec![f64::INFINITY];
        fit.uncertainty.as_mut().unwrap().uncorrected_covariance = None;
        // The data determine the parameter, but no residual is left to estimate its error.
        assert!(fit.to_string().contains("(error unknown)"), "{fit}");
        assert!(fit.to_string().contains("31 measurements. Of unknown error: k. 1 warning"), "{fit}");
        fit.uncertainty.as_mut().unwrap().undetermined = vec![0];
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
        let sentence = "the data do not determine k: other values fit equally well";
        let uncertainty = fit.uncertainty.as_mut().unwrap();
        uncertainty.undetermined = vec![0];
        uncertainty.findings = vec![
            Finding::warning(
                FindingId::UndeterminedParameter,
                "k",
                sentence,
                "Fix it, add a prior, or record an experiment that determines it",
            )
            .of(Origin::Search),
            Finding::note(FindingId::Outliers, "", "all is well", ""),
        ];
        fit.report.message = "f_tol reached".to_owned();
        let text = fit.to_string();
        assert!(text.contains("rate of decay  1  -> 2.0001"), "{text}");
        for reported in [
            "\nwarning  the data do not determine rate of decay: other values fit equally well [F003 undetermined-parameter]\n",
            "\nnote     all is well [F015 outliers]\n",
        ] {
            assert!(text.contains(reported), "{text}");
        }
        assert!(text.contains(": f_tol reached\n"), "{text}");
        assert!(fit.to_html().contains("rate of decay"));
        assert!(fit.to_json(&calibration).unwrap().contains("\"name\": \"k\""));
    }

    #[test]
    fn reports_escape_control_characters_in_names() {
        let (calibration, _) = decay();
        let mut problem = calibration.problem().clone();
        problem.parameters[0] = problem.parameters[0].clone().display_name("k\n\tz\u{1b}[2J\u{202e}");
        let calibration = Calibration::from_problem(calibration.fmu().clone(), problem).unwrap();
        let fit = calibration.fit(FitOptions::default()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("report.html");
        calibration.report(&fit, &path, &RunContext::new()).unwrap();
        for text in [fit.to_string(), fit.to_html(), std::fs::read_to_string(&path).unwrap()] {
            assert!(text.contains("k\\u{a}\\u{9}z\\u{1b}[2J\\u{202e}"), "{text}");
            assert!(!text.contains(['\u{1b}', '\u{202e}', '\t']) && !text.contains("k\n"), "{text}");
        }
    }

    #[test]
    fn result_below_all_minima_is_not_reported_as_minimum_when_search_is_limited() {
        let (_, mut fit) = decay();
        let optimum = |cost: f64| -> dfo::Optimum {
            serde_json::from_value(serde_json::json!({"x": [2.0], "cost": cost, "n_starts": 3})).unwrap()
        };
        fit.report.termination = dfo::Termination::MaxEvaluations;
        fit.report.optima = vec![optimum(2.0 * fit.report.fun), optimum(3.0 * fit.report.fun)];
        let text = fit.to_string();
        assert!(text.contains("the best point within its limits, below all minima"), "{text}");
        assert!(
            text.contains("6 local searches ended at 2 minima, and the result is below all of them"),
            "{text}"
        );
        fit.report.optima[0] = optimum(fit.report.fun);
        let text = fit.to_string();
        assert!(
            text.contains("The fit returned the lowest minimum that it found within its limits"),
            "{text}"
        );
        assert!(text.contains("6 local searches ended at 2 minima, 3 of them at the lowest"), "{text}");
    }

    #[test]
    fn page_is_self_contained_and_escapes_names() {
        let (calibration, mut fit) = decay();
        let uncertainty = fit.uncertainty.as_mut().unwrap();
        uncertainty.standard_errors = vec![1e-3];
        uncertainty.findings =
            vec![Finding::note(FindingId::Outliers, "<x>", "the residuals are not white", "")];
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
            "fingerprint of the compared data",
            "<strong>note</strong> &lt;x&gt;: the residuals are not white [F015 outliers]</li>",
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
        // Only the report is left in the folder.
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn report_error_names_path_and_reason() {
        let (calibration, mut fit) = decay();
        let error =
            calibration.report(&fit, "/no/such/folder/x.html", &RunContext::new()).unwrap_err().to_string();
        assert!(
            error.contains("cannot write /no/such/folder/x.html: folder '/no/such/folder' does not exist"),
            "{error}"
        );
        let folder = tempfile::tempdir().unwrap();
        assert!(calibration.report(&fit, folder.path(), &RunContext::new()).is_err());
        let error = calibration
            .report(&fit, folder.path().join("x.pdf"), &RunContext::new())
            .unwrap_err()
            .to_string();
        assert!(error.contains("x.pdf: a report is an HTML page"), "{error}");
        fit.x.push(1.0);
        assert!(calibration.report(&fit, folder.path().join("x.html"), &RunContext::new()).is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
