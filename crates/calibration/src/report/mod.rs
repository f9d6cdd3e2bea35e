//! What a fit found, for people: as text, as a part of a notebook, and as a page with figures.

mod number;
mod summary;
mod text;

#[cfg(test)]
mod tests {
    use crate::{BoundSide, Calibration, Data, Experiment, Fit, FitOptions, Parameter};

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
        let worth = fit.worth.take();
        let text = fit.to_string();
        assert!(text.contains("The fit converged: RMS 0.001 (at"), "{text}");
        assert!(text.contains("k  1  -> 2.0") && text.contains("none were estimated"), "{text}");
        assert!(!text.contains("Mistrust") && !text.contains('!'), "{text}");
        let mut worth = worth.unwrap();
        (worth.standard_errors, worth.corrected_errors) = (vec![1e-3], Some(vec![2e-3]));
        worth.verdict = vec!["the residuals are not white".to_owned()];
        fit.worth = Some(worth);
        fit.at_bound = vec![(0, BoundSide::Upper)];
        let text = fit.to_string();
        assert!(
            text.contains("+- 0.001 (corrected 0.002)") && text.contains("at its upper bound 10"),
            "{text}"
        );
        assert!(text.contains("! the residuals are not white") && text.contains("Mistrust k"), "{text}");
        fit.worth.as_mut().unwrap().standard_errors = vec![f64::INFINITY];
        assert!(fit.to_string().contains("(not determined)"), "{fit}");
    }
}
