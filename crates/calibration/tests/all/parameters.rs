//! Kinds of parameters: one value for several variables, tied parameters, priors, delays, offsets, initial
//! states.

#![allow(clippy::unwrap_used)]

use calibration::RunContext;
use calibration::{
    Calibration, CalibrationBuilder, Data, Experiment, FitOptions, InitialState, Parameter, Prior, Scale,
    Table, Weight,
};
use dfo::{LeastSquares, NelderMead, RunOptions};
use example_models::example_fmu;
use fmi::Fmu;

fn open(name: &str) -> Fmu {
    Fmu::open(example_fmu(name).unwrap()).unwrap()
}

fn times(n: u32, step: f64) -> Vec<f64> {
    (0..n).map(|k| step * f64::from(k)).collect()
}

fn data(time: &[f64], columns: &[(&str, &dyn Fn(f64) -> f64)]) -> Data {
    let column = |(name, of): &(&str, &dyn Fn(f64) -> f64)| {
        ((*name).to_owned(), time.iter().map(|t| of(*t)).collect())
    };
    Data::from_columns(time.to_vec(), columns.iter().map(column)).unwrap()
}

/// x' = -k x, compared with these measurements.
fn decay(measured: &dyn Fn(f64) -> f64) -> Experiment {
    Experiment::new(data(&times(21, 0.1), &[("x", measured)])).output("x", "x")
}

fn dahlquist(experiment: Experiment) -> CalibrationBuilder {
    Calibration::builder(open("dahlquist")).experiment(experiment)
}

fn k() -> Parameter {
    Parameter::new("k", 1.0).bounds(0.1, 10.0)
}

/// A level of the tank, which is driven by two inputs.
fn tank(parameters: impl IntoIterator<Item = Parameter>) -> Calibration {
    let recording = data(
        &times(31, 1.0),
        &[
            ("u1", &|t| 5.0 + t % 2.0),
            ("u2", &|_| 5.0),
            ("x", &|t| 0.06 - 1e-4 * t),
            ("z", &|t| 0.06 - 2e-4 * t),
        ],
    );
    let experiment = Experiment::new(recording)
        .output("qt.x1", "x")
        .output("qt.x2", "z")
        .input("u1", "u1")
        .input("u2", "u2");
    let builder = Calibration::builder(open("quad_tank")).experiment(experiment);
    parameters.into_iter().fold(builder, CalibrationBuilder::parameter).build().unwrap()
}

fn assert_near(found: f64, expected: f64, tolerance: f64) {
    assert!((found - expected).abs() <= tolerance, "{found} is not {expected}");
}

#[test]
fn parameter_sets_several_variables_and_tied_ones_follow() {
    let explicit = tank(["qt.a1", "qt.a2", "qt.a3"].map(|name| Parameter::new(name, 3e-6)));
    let one = tank([
        Parameter::tied("qt.a3", "outlets", 2.0, 1e-6).display_name("upper outlet"),
        Parameter::new("outlets", 3e-6).variables(["qt.a1", "qt.a2"]).bounds(1e-6, 5e-6),
    ]);
    assert_eq!(one.parameters().len(), 1);
    let x = [2.5e-6];
    let expected = explicit.residuals(&[2.5e-6, 2.5e-6, 6e-6], &RunContext::new()).unwrap();
    assert_eq!(one.residuals(&x, &RunContext::new()).unwrap(), expected);
    assert_eq!(
        one.simulate(&x, None, &RunContext::new()).unwrap()[0].columns,
        explicit.simulate(&[2.5e-6, 2.5e-6, 6e-6], None, &RunContext::new()).unwrap()[0].columns
    );
    assert_eq!(one.derived_values(&x), [("qt.a3".to_owned(), 6e-6)]);
    let names = |(name, value): &(&str, f64)| ((*name).to_owned(), *value);
    let set = [("qt.a3", 6e-6), ("qt.a1", 2.5e-6), ("qt.a2", 2.5e-6)];
    assert_eq!(one.model_values(0, &x), set.iter().map(names).collect::<Vec<_>>());

    let fit = one.fit(FitOptions::default()).unwrap();
    assert_eq!((fit.names.len(), fit.derived.len()), (1, 1));
    assert_eq!(fit.derived[0].value, 2.0 * fit.x[0] + 1e-6);
    assert!(fit.to_string().contains("tied: 2 * outlets + 0.000001"), "{fit}");
    let csv = fit.csv(&one, Table::Parameters, &RunContext::new()).unwrap();
    let row: Vec<&str> = csv.lines().nth(2).unwrap().split(',').collect();
    assert_eq!((row[0], row[9]), ("qt.a3", "outlets"), "{csv}");
    assert_eq!(row[1].parse(), Ok(fit.derived[0].value), "{csv}");
    let error = fit.uncertainty.as_ref().unwrap().standard_errors[0];
    assert_eq!(row[2].parse(), Ok(2.0 * error), "{csv}");
    let json: serde_json::Value = serde_json::from_str(&fit.to_json(&one).unwrap()).unwrap();
    let tied = &json["parameters"][1];
    assert_eq!((&tied["name"], &tied["tied_to"]), (&"qt.a3".into(), &"outlets".into()), "{json}");
}

#[test]
fn parameter_tied_to_local_parameter_is_local() {
    let experiment = |x0: f64, k: f64| decay(&move |t| x0 * (-k * t).exp());
    let calibration = dahlquist(experiment(1.0, 1.0).named("slow"))
        .experiment(experiment(2.0, 2.0))
        .parameter(k().local(true))
        .parameter(Parameter::tied("x", "k", 1.0, 0.0))
        .build()
        .unwrap();
    assert!(calibration.cost(&[1.0, 2.0], &RunContext::new()).unwrap() < 1e-8);
    let expected = [("x[slow]".to_owned(), 1.0), ("x[run2]".to_owned(), 2.0)];
    assert_eq!(calibration.derived_values(&[1.0, 2.0]), expected);
}

/// The start of a decay is a linear parameter, so the minimum is the solution of a linear regression with a prior.
#[test]
fn prior_is_a_residual_but_not_a_measurement() {
    let (mean, sd, weight) = (2.0, 0.1, 5.0);
    let measured = |t: f64| (-t).exp() + 0.1 * (7.0 * t).sin();
    let experiment =
        Experiment::new(data(&times(21, 0.1), &[("x", &measured)])).weighted_output("x", "x", weight);
    let build = |prior: Option<Prior>| {
        let start = Parameter::new("x", 1.5).bounds(0.1, 10.0);
        let start = prior.into_iter().fold(start, Parameter::prior);
        dahlquist(experiment.clone().start_value("k", 1.0)).parameter(start).build().unwrap()
    };
    let calibration = build(Some(Prior::Normal { mean, sd }));
    assert_eq!((calibration.n_residuals(), calibration.n_measurements()), (22, 21));
    let residuals = calibration.residuals(&[1.3], &RunContext::new()).unwrap();
    assert_eq!(residuals[21], (1.3 - mean) / sd);
    assert_eq!(residuals[..21], build(None).residuals(&[1.3], &RunContext::new()).unwrap());
    assert_eq!(
        calibration.cost(&[1.3], &RunContext::new()).unwrap(),
        residuals.iter().fold(0.0, |sum, r| sum + r * r)
    );
    let layout = calibration.residual_layout();
    assert_eq!((layout.priors[0].parameter, layout.priors[0].index, layout.n_residuals()), (0, 21, 22));

    let (mut a, mut b) = (mean / (sd * sd), 1.0 / (sd * sd));
    for t in times(21, 0.1) {
        a += weight * weight * (-t).exp() * measured(t);
        b += weight * weight * (-2.0 * t).exp();
    }
    for method in [dfo::AnyMethod::auto(dfo::Search::Local), NelderMead::default().into()] {
        let fit = calibration.fit(RunOptions { method, ..FitOptions::default_run() }).unwrap();
        assert_near(fit.x[0], a / b, 2e-4);
        let squares: f64 =
            calibration.residuals(&fit.x, &RunContext::new()).unwrap()[..21].iter().map(|r| r * r).sum();
        assert_near(fit.rms, (squares / 21.0).sqrt(), 1e-12);
        assert_near(calibration.prior_cost(&fit.x), ((fit.x[0] - mean) / sd).powi(2), 1e-12);
    }
    // The prior is on the logarithm; the prior of a fixed parameter is ignored.
    let relative = build(Some(Prior::LogNormal { median: 1.0, sigma: 0.5 }));
    assert_near(relative.residuals(&[2.0], &RunContext::new()).unwrap()[21], 2.0f64.ln() / 0.5, 1e-12);
    let fixed = Parameter::new("x", 1.0).fixed(true).prior(Prior::Normal { mean, sd });
    assert_eq!(dahlquist(experiment).parameter(fixed).parameter(k()).build().unwrap().n_residuals(), 21);
}

#[test]
fn prior_above_cutoff_skips_simulation() {
    let far = Parameter::new("x", 1.0).bounds(0.1, 1e9).prior(Prior::Normal { mean: 1.0, sd: 1e-3 });
    let log = Parameter::new("k", 1.0)
        .bounds(0.1, 10.0)
        .scale(Scale::Log)
        .prior(Prior::LogNormal { median: 1.0, sigma: 0.1 });
    let calibration = dahlquist(decay(&|t| (-t).exp())).parameter(far).parameter(log).build().unwrap();
    let (run, serial) = (FitOptions::default_run(), |cutoffs| {
        let run = RunOptions { method: NelderMead::default().into(), ..FitOptions::default_run() };
        calibration.fit(FitOptions { cutoffs, ..run.into() }).unwrap()
    });
    assert_eq!(serial(true).x, serial(false).x);
    assert_near(calibration.fit(run).unwrap().x[0], 1.0, 1e-4);
    let outside = calibration.cost(&[1.0, -1.0], &RunContext::new()).unwrap_err().to_string();
    assert!(outside.contains("the prior of 'k' is not defined at -1"), "{outside}");
}

#[test]
fn initial_states_are_given_measured_or_fitted() {
    let measured = |t: f64| 3.0 * (-t).exp();
    let experiment = || decay(&measured);
    let with = |experiment: Experiment, initial: InitialState| {
        dahlquist(experiment.initial_state("x", initial)).parameter(k()).build()
    };
    let cost = |initial: InitialState| {
        with(experiment(), initial).unwrap().cost(&[1.0], &RunContext::new()).unwrap()
    };
    assert!(cost(3.0.into()) < 1e-8);
    // Only the first measurement is used.
    assert!(cost(InitialState::Measured) < 1e-8);
    let late = decay(&|t| if t < 0.05 { f64::NAN } else { measured(t) });
    let refused = with(late, InitialState::Measured).unwrap_err().to_string();
    assert!(refused.contains("'x'"), "{refused}");
    let fitted = InitialState::from(Parameter::new("any", 1.0).bounds(0.1, 10.0));
    let calibration = dahlquist(experiment().initial_state("x", fitted.clone()))
        .experiment(decay(&|t| 2.0 * (-t).exp()).initial_state("x", fitted).named("other"))
        .parameter(k())
        .build()
        .unwrap();
    let names: Vec<&str> = calibration.parameters().iter().map(Parameter::name).collect();
    assert_eq!(names, ["k", "x[run1]", "x[other]"]);
    let fit = calibration.fit(FitOptions::default()).unwrap();
    for (found, expected) in fit.x.iter().zip([1.0, 3.0, 2.0]) {
        assert_near(*found, expected, 1e-3);
    }
}

#[test]
fn delayed_output_is_compared_with_earlier_model_values() {
    let (rate, tau) = (1.5, 0.137);
    let measured = |t: f64| (-rate * (t - tau).max(0.0)).exp();
    let fixed = dahlquist(decay(&measured).delay("x", tau)).parameter(k()).build().unwrap();
    assert!(fixed.cost(&[rate], &RunContext::new()).unwrap() < 1e-8);
    let delay = || Parameter::new("tau", 0.05).bounds(0.0, 1.0).delay_of("x");
    let calibration = dahlquist(decay(&measured)).parameter(k()).parameter(delay()).build().unwrap();
    // Invalid times are rejected as for outputs without delay.
    let refused = [
        (vec![f64::NAN], "times[0] = NaN is not a finite number"),
        (vec![0.0, f64::INFINITY], "times[1] = inf is not a finite number"),
        (vec![-1.0], "times[0] = -1 is before the start of the simulation, 0"),
        (vec![1.0, 0.5], "times must ascend: times[1] = 0.5 comes after 1"),
    ];
    for (times, expected) in refused {
        let error = fixed.simulate(&[1.0], Some(&times), &RunContext::new()).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    // A fitted delay gives bit-for-bit the same result as a given delay.
    for x in [0.8, rate] {
        assert_eq!(
            calibration.residuals(&[x, tau], &RunContext::new()).unwrap(),
            fixed.residuals(&[x], &RunContext::new()).unwrap()
        );
        let rows = |calibration: &Calibration, x: &[f64]| {
            calibration.simulate(x, Some(&[0.0, 0.1, 0.5, 2.0]), &RunContext::new()).unwrap()
        };
        assert_eq!(rows(&calibration, &[x, tau])[0].columns, rows(&fixed, &[x])[0].columns);
    }
    let rows = calibration.simulate(&[rate, tau], None, &RunContext::new()).unwrap();
    assert_eq!(rows[0].time, times(21, 0.1));
    rows[0].time.iter().zip(&rows[0].columns[0]).for_each(|(t, x)| assert_near(*x, measured(*t), 1e-5));
    let fits: Vec<_> = [(1, true), (3, true), (1, false)]
        .map(|(workers, cutoffs)| {
            let method = LeastSquares::default().serial().into();
            let run = RunOptions { method, workers: Some(workers), ..FitOptions::default_run() };
            calibration.fit(FitOptions { cutoffs, ..run.into() }).unwrap()
        })
        .into();
    assert_near(fits[0].x[0], rate, 1e-3);
    assert_near(fits[0].x[1], tau, 1e-3);
    assert!(fits.iter().all(|fit| (&fit.x, fit.cost) == (&fits[0].x, fits[0].cost)));
    assert_eq!(fits[0].cost, calibration.cost(&fits[0].x, &RunContext::new()).unwrap());

    // The clock of the recording is ahead, so samples after its last time are needed.
    let early = dahlquist(decay(&|t| (-rate * (t + 0.3)).exp()))
        .parameter(k())
        .parameter(Parameter::new("tau", 0.0).bounds(-0.5, 0.5).delay_of("x"))
        .build()
        .unwrap();
    assert!(early.cost(&[rate, -0.3], &RunContext::new()).unwrap() < 1e-8);
    let fit = early.fit(FitOptions::default()).unwrap();
    assert_near(fit.x[1], -0.3, 1e-3);
}

#[test]
fn delayed_inputs_match_a_shifted_recording() {
    let recording = |delay: f64| {
        let columns: [(&str, &dyn Fn(f64) -> f64); 2] =
            [("u1", &|t| 5.0 + t % 3.0), ("x", &|t| 0.06 - 1e-4 * t)];
        let inputs = data(&times(31, 1.0).iter().map(|t| t + delay).collect::<Vec<_>>(), &columns[..1]);
        (data(&times(31, 1.0), &columns), inputs)
    };
    let build = |experiment: Experiment, parameters: &[Parameter]| {
        let builder =
            Calibration::builder(open("quad_tank")).experiment(experiment.constant_input("u2", 5.0));
        parameters.iter().cloned().fold(builder, CalibrationBuilder::parameter).build().unwrap()
    };
    let a1 = Parameter::new("qt.a1", 3e-6).bounds(2e-6, 4e-6);
    let plain = || Experiment::new(recording(0.0).0).output("qt.x1", "x");
    let later = move |t: f64| {
        let t = (t - 0.7).clamp(0.0, 30.0);
        let (low, high) = (5.0 + t.floor() % 3.0, 5.0 + t.ceil() % 3.0);
        low + (high - low) * (t - t.floor())
    };
    let by_function = build(plain().function_input("u1", later), std::slice::from_ref(&a1));
    let fixed = build(plain().input("u1", "u1").delay("u1", 0.7), std::slice::from_ref(&a1));
    let delay = Parameter::new("tau", 0.1).bounds(0.0, 2.0).delay_of("u1");
    let offset = Parameter::new("bias", 0.0).bounds(-1.0, 1.0).offset_of("u1");
    let fitted = build(plain().input("u1", "u1"), &[a1, delay, offset]);
    let expected = fixed.residuals(&[2.8e-6], &RunContext::new()).unwrap();
    assert_eq!(fitted.residuals(&[2.8e-6, 0.7, 0.0], &RunContext::new()).unwrap(), expected);
    for (one, other) in by_function.residuals(&[2.8e-6], &RunContext::new()).unwrap().iter().zip(&expected) {
        // The function has kinks, at which a table stops the integration.
        assert_near(*one, *other, 1e-5);
    }
    assert_ne!(fitted.residuals(&[2.8e-6, 0.7, 0.5], &RunContext::new()).unwrap(), expected);
    assert_eq!(fitted.residuals(&[2.8e-6, 0.7, 0.0], &RunContext::new()).unwrap(), expected);
}

#[test]
fn offset_is_added_to_output() {
    let calibration = dahlquist(decay(&|t| 0.25 + (-2.0 * t).exp()))
        .parameter(k())
        .parameter(Parameter::new("bias", 0.0).bounds(-1.0, 1.0).offset_of("x"))
        .build()
        .unwrap();
    assert!(calibration.cost(&[2.0, 0.25], &RunContext::new()).unwrap() < 1e-8);
    assert_near(
        calibration.simulate(&[2.0, 0.25], None, &RunContext::new()).unwrap()[0].columns[0][0],
        1.25,
        1e-12,
    );
    let fit = calibration.fit(FitOptions::default()).unwrap();
    assert_near(fit.x[1], 0.25, 1e-4);
}

#[test]
fn windows_weights_and_warm_up_select_measurements() {
    let names = |experiment: Experiment| {
        let calibration = dahlquist(experiment).parameter(k()).build().unwrap();
        let o = calibration.residual_layout().outputs[0].clone();
        (o.times.to_vec(), o.weights.to_vec())
    };
    let recording = data(&times(6, 1.0), &[("x", &|t| t), ("w", &|t| if t == 2.0 { 0.0 } else { t })]);
    let base = || Experiment::new(recording.clone());
    let plain = || base().output("x", "x");
    assert_eq!(names(plain().window(1.0, 2.0).window(4.0, 9.0)).0, [1.0, 2.0, 4.0, 5.0]);
    assert_eq!(names(plain().window(1.0, 2.0).windows([(3.0, 3.0)])).0, [3.0]);
    let by_column = names(base().weighted_output("x", "x", Weight::Column("w".to_owned())));
    assert_eq!(by_column, (vec![1.0, 3.0, 4.0, 5.0], vec![1.0, 3.0, 4.0, 5.0]));
    let by_rows =
        names(base().weighted_output("x", "x", Weight::Rows(vec![0.0, 2.0, 0.0, 0.0, 0.5, 0.0].into())));
    assert_eq!(by_rows, (vec![1.0, 4.0], vec![2.0, 0.5]));
    // Without a window, the first measurements do not count. With a window, the simulation starts before it.
    assert_eq!(names(plain().warm_up(2.0)).0, [2.0, 3.0, 4.0, 5.0]);
    let calibration = dahlquist(plain().window(3.0, 5.0).warm_up(1.5)).parameter(k()).build().unwrap();
    let rows = calibration.simulate(&[1.0], None, &RunContext::new()).unwrap();
    assert_eq!(rows[0].time, [3.0, 4.0, 5.0]);
    assert_near(rows[0].columns[0][0], (-1.5f64).exp(), 1e-5);
}

/// The rate k as an angle of period 4: the model receives 2 for 6 and for -2, too.
#[test]
fn periodic_parameter_reaches_the_model_within_its_bounds() {
    let t: Vec<f64> = (0..21).map(|k| 0.1 * f64::from(k)).collect();
    let x = t.iter().map(|t| (-2.0 * t).exp()).collect();
    let data = calibration::Data::from_columns(t, [("x".to_owned(), x)]).unwrap();
    let fmu = fmi::Fmu::open(example_models::example_fmu("dahlquist").unwrap()).unwrap();
    let calibration = Calibration::builder(fmu)
        .experiment(calibration::Experiment::new(data).output("x", "x"))
        .parameter(Parameter::new("k", 3.5).bounds(0.5, 4.5).periodic(true))
        .build()
        .unwrap();
    let bits = |k: f64| calibration.cost(&[k], &calibration::RunContext::new()).unwrap().to_bits();
    assert_eq!((bits(6.0), bits(-2.0), bits(-6.0)), (bits(2.0), bits(2.0), bits(2.0)));
    assert_eq!(bits(4.5), bits(0.5));
    assert_ne!(bits(2.5), bits(2.0));
    let fit = calibration.fit(calibration::FitOptions::default()).unwrap();
    assert!((fit.x[0] - 2.0).abs() < 1e-4 && fit.at_bound.is_empty(), "{fit}");
    assert_eq!(fit.bounds, [(0.5, 4.5)]);
    // A start outside of the period is the equivalent one inside.
    for start in [7.5, -0.5, -4.5] {
        let options =
            calibration::FitOptions { start: Some(vec![start]), ..calibration::FitOptions::default() };
        let again = calibration.fit(options).unwrap();
        assert_eq!((&again.start, again.x[0].to_bits()), (&vec![3.5], fit.x[0].to_bits()));
    }
    let open = Parameter::new("k", 1.0).periodic(true).check().unwrap_err().to_string();
    assert!(open.contains("its period is the difference of its bounds, but they are -inf and inf"), "{open}");
}
