//! Mistakes in recordings: their times, columns and sensors.

use super::{calibration, decay, fitted, k, noise, open, recording, sound, times, warnings, warns};
use calibration::{
    Calibration, CheckOptions, Data, Experiment, FitOptions, Parameter, PreflightOptions, RunContext, Scale,
    SimulationSettings,
};
use std::path::Path;

/// A rate from 1e-5 to 10 on a logarithmic scale.
fn rate(start: f64) -> Parameter {
    Parameter::new("k", start).bounds(1e-5, 10.0).scale(Scale::Log)
}

fn tank(data: Data) -> Calibration {
    let driven = Experiment::new(data).input("u1", "u1").input("u2", "u2");
    let measured = (1..=2).fold(driven, |e, i| e.output(format!("qt.x{i}"), format!("x{i}")));
    let builder = Calibration::builder(open("quad_tank")).experiment(measured);
    (1..=2)
        .fold(builder, |b, i| b.parameter(Parameter::new(format!("qt.a{i}"), 3e-6).bounds(2e-6, 4e-6)))
        .build()
        .unwrap()
}

/// A recording of the examples with its times multiplied.
fn example(name: &str, factor: f64) -> Data {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../examples/data/{name}.csv"));
    let data = Data::from_csv(path).unwrap();
    let columns = data.names().map(|name| (name.to_owned(), data.column(name).unwrap().to_vec()));
    Data::from_columns(data.time().iter().map(|t| factor * t).collect(), columns).unwrap()
}

#[test]
fn times_of_sound_setups_are_not_accused() {
    let dice = |k: usize| 0.5 + 0.5 * noise(k);
    for k in 0..100 {
        let rate_of = 10f64.powf(-2.0 + 2.0 * dice(7 * k));
        let n = 20 + (150.0 * dice(7 * k + 1)) as usize;
        // A third of them by the second, from 0 or 1 on.
        let interval = if k % 3 == 0 { 1.0 } else { (1.0 + 4.0 * dice(7 * k + 2)) / rate_of / n as f64 };
        let start = rate_of * 10f64.powf(2.0 * dice(7 * k + 3) - 1.0);
        let first = if k % 6 == 0 { 1.0 } else { 0.0 };
        let t: Vec<f64> = times(n, interval).iter().map(|t| first + t).collect();
        let experiment = recording(&t, decay(&t, rate_of, 1e-2)).start_time(0.0);
        let fit = fitted(experiment, rate(start).bounds(1e-5, 1e2));
        let accused: Vec<String> =
            warnings(&fit.findings()).into_iter().filter(|text| text.contains("the times look")).collect();
        assert!(accused.is_empty(), "set-up {k}: {accused:#?} {fit}");
    }
}

#[test]
fn months_taken_for_days_are_named() {
    let day = 86_400.0;
    let slow = || Parameter::new("k", 1e-7).bounds(1e-9, 1e-5).scale(Scale::Log);
    let check = |t: &[f64]| {
        let experiment = recording(t, decay(t, 1e-7, 1e-3));
        let calibration = calibration(vec![experiment], slow(), SimulationSettings::default());
        calibration.check_with(&CheckOptions { simulate: false, max_time: None }, &RunContext::new()).unwrap()
    };
    // The first of January to the first of April of 2024, and four days by the hour.
    let first = [0.0, 31.0, 60.0, 91.0].map(|days| days * day);
    assert!(warns(&check(&first).findings, "a month of the calendar apart: are day and month swapped"));
    let hourly: Vec<f64> =
        first.iter().flat_map(|start| (0..24).map(move |h| start + 3600.0 * f64::from(h))).collect();
    assert!(warns(&check(&hourly).findings, "to the same day of the next month: are day and month swapped"));
    for sound in [times(100, day), times(300, 3600.0)] {
        assert!(!warns(&check(&sound).findings, "month"));
    }
}

#[test]
fn means_that_are_too_coarse_are_named() {
    let t = times(601, 0.01);
    let resampled = |interval: f64| {
        let data = Data::from_columns(t.clone(), [("x".to_owned(), decay(&t, 2.0, 1e-2))]).unwrap();
        fitted(Experiment::new(data).resample(interval).output("x", "x"), k())
    };
    let coarse = resampled(1.5);
    assert!(warns(&coarse.findings(), "means over 1.5 s take away"), "{coarse}");
    let fine = resampled(0.1);
    assert!(!warns(&fine.findings(), "means over"), "{fine}");
}

#[test]
fn a_recording_that_is_there_twice_is_named_and_parts_of_one_are_not() {
    let two = |first: Experiment, second: Experiment| {
        calibration(vec![first, second], k(), SimulationSettings::default())
            .fit(FitOptions::default())
            .unwrap()
    };
    let fit = two(sound(1e-3), sound(1e-3));
    assert!(
        warns(&fit.findings(), "experiments run1 and run2: output 'x' has the same 61 measurements"),
        "{fit}"
    );
    let fit = two(sound(1e-3).window(0.0, 1.0), sound(1e-3).window(1.05, 3.0));
    assert!(warnings(&fit.findings()).is_empty(), "{fit}");
    let fit = two(sound(1e-3).window(0.0, 2.0), sound(1e-3).window(1.5, 3.0));
    assert!(warns(&fit.findings(), "output 'x' has the same 11 measurements in both"), "{fit}");
    let t = times(61, 0.05);
    let late = t.iter().map(|t| t + 10.0).collect::<Vec<f64>>();
    let later = recording(&late, decay(&t, 2.0, 1e-3)).start_time(10.0);
    let fit = two(sound(1e-3), later);
    assert!(warns(&fit.findings(), "output 'x' has the same 61 measurements in both"), "{fit}");
    let t = times(61, 0.05);
    let columns = ["x", "copy"].map(|name| (name.to_owned(), decay(&t, 2.0, 1e-3)));
    let one = Experiment::new(Data::from_columns(t.clone(), columns).unwrap())
        .output("x", "x")
        .output("der(x)", "copy");
    let check = calibration(vec![one], k(), SimulationSettings::default()).check();
    assert!(
        warns(&check.findings, "outputs 'x' and 'der(x)': both have the same 61 measurements"),
        "{check}"
    );
}

/// The same recording as the logger has it, and as it was exported in six digits.
#[test]
fn a_recording_that_is_there_twice_in_fewer_digits_is_named() {
    let t: Vec<f64> = times(61, 0.05).iter().map(|t| t + 1e-8 * t.sin()).collect();
    let x = decay(&t, 2.0, 1e-3);
    let printed =
        |values: &[f64]| values.iter().map(|v| format!("{v:.5e}").parse().unwrap()).collect::<Vec<f64>>();
    let check = |other: Experiment| {
        calibration(vec![recording(&t, x.clone()), other], k(), SimulationSettings::default()).check()
    };
    let twice = check(recording(&printed(&t), printed(&x)));
    let said = "output 'x' has the same 61 measurements at the same times in both";
    assert!(warns(&twice.findings, said), "{twice}");
    let other: Vec<f64> = x.iter().enumerate().map(|(k, x)| x + 1e-3 * noise(k + 500)).collect();
    let two = check(recording(&printed(&t), printed(&other)));
    assert!(!two.to_string().contains("in both"), "{two}");
}

#[test]
fn sensors_that_stand_still_wrap_or_write_placeholders_are_named() {
    let t = times(301, 0.01);
    let changed = |change: &dyn Fn(&mut Vec<f64>)| {
        let mut x = decay(&t, 2.0, 1e-3);
        change(&mut x);
        fitted(recording(&t, x), k())
    };
    let fit = changed(&|x| (100..160).for_each(|i| x[i] = x[100]));
    assert!(warns(&fit.findings(), "frozen?"), "{fit}");
    for value in [9999.0, -999.0, 1e30] {
        let fit = changed(&|x| x[200] = value);
        assert!(warns(&fit.findings(), "a placeholder for a missing value?"), "{fit}");
    }
    let angle: Vec<f64> =
        t.iter().enumerate().map(|(i, t)| 20.0 * (-2.0 * t).exp() + 1e-3 * noise(i)).collect();
    for (is_wrapped, values) in
        [(false, angle.clone()), (true, angle.iter().map(|v| v.rem_euclid(std::f64::consts::TAU)).collect())]
    {
        let fit = fitted(recording(&t, values).start_value("x", 20.0), k());
        assert_eq!(warns(&fit.findings(), "measured values jump by 2 pi"), is_wrapped, "{fit}");
    }
}

/// A sensor that ends at 0.8, in a part of the rows that is too small for a doubt without the simulation.
#[test]
fn a_column_that_stays_at_its_limit_below_the_simulation_is_clipped() {
    let t = times(400, 0.01);
    let of = |limit: f64| {
        let x = decay(&t, 2.0, 1e-3).into_iter().map(|x| x.min(limit)).collect();
        fitted(recording(&t, x), k())
    };
    let clipped = of(0.8);
    let said = "it is clipped at 0.8: 12 measurements are exactly that, its largest value, and the simulation at the fitted values goes beyond it by up to";
    assert!(warns(&clipped.findings(), said), "{clipped}");
    assert!(!clipped.to_string().contains("clipped?"), "{clipped}");
    let larger = of(0.5);
    assert!(
        warns(&larger.findings(), "it is clipped at 0.5") && !larger.to_string().contains("clipped?"),
        "{larger}"
    );
    let sound = of(2.0);
    assert!(!sound.to_string().contains("clipped"), "{sound}");
}

#[test]
fn measurements_in_coarse_steps_are_named() {
    let t = times(61, 0.05);
    let cut: Vec<f64> = decay(&t, 2.0, 0.02).iter().map(|x| (10.0 * x).floor() / 10.0).collect();
    let fit = fitted(recording(&t, cut), k());
    assert!(warns(&fit.findings(), "come in steps of 0.1"), "{fit}");
}

#[test]
fn a_column_that_drives_and_is_compared_is_named() {
    let said = "its column is compared with the output 'qt.x1', too";
    let tank = |input: &str| {
        let driven = Experiment::new(example("quad_tank", 1.0)).input("u1", input).input("u2", "u2");
        let builder = Calibration::builder(open("quad_tank")).experiment(driven.output("qt.x1", "x1"));
        builder.parameter(Parameter::new("qt.a1", 3e-6).bounds(2e-6, 4e-6)).build().unwrap()
    };
    assert!(warns(&tank("x1").check().findings, said), "{}", tank("x1").check());
    assert!(!warns(&tank("u1").check().findings, said));
}

/// The recording of the quadruple tank with a change of its columns, whose names may change, too.
fn changed_tank(change: impl Fn(&str, &mut Vec<f64>) -> String) -> Calibration {
    let data = example("quad_tank", 1.0);
    let column = |name: &str| {
        let mut values = data.column(name).unwrap().to_vec();
        (change(name, &mut values), values)
    };
    let columns: Vec<_> = data.names().map(column).collect();
    tank(Data::from_columns(data.time().to_vec(), columns).unwrap())
}

#[test]
fn cells_of_an_input_that_are_missing_for_long_are_named_wherever_it_is_used() {
    let without = |n: usize| {
        changed_tank(move |name, values| {
            if name == "u1" {
                values[20..20 + n].fill(f64::NAN);
            }
            name.to_owned()
        })
    };
    let said = "input 'u1' (column 'u1'): it has no value from";
    for (n, is_named) in [(1, false), (2, false), (3, true), (12, true)] {
        let calibration = without(n);
        let check = calibration
            .check_with(&CheckOptions { simulate: false, ..CheckOptions::default() }, &RunContext::new());
        assert_eq!(warns(&check.unwrap().findings, said), is_named, "{n}");
    }
    let calibration = without(12);
    let preflight = calibration.preflight(&PreflightOptions::default(), &RunContext::new()).unwrap();
    assert!(warns(&preflight.findings, said), "{preflight}");
    let fit = calibration.fit(FitOptions::default()).unwrap();
    assert!(
        warns(&fit.findings(), "a straight line from value to value there, which nobody measured"),
        "{fit}"
    );
}

#[test]
fn a_placeholder_is_that_of_the_file_whatever_was_converted() {
    let calibration = changed_tank(|name, values| match name {
        "x1" => {
            values.iter_mut().for_each(|value| *value *= 1e3);
            values[30] = -999.0;
            "x1 [mm]".to_owned()
        }
        other => other.to_owned(),
    });
    let check = calibration.check();
    assert!(warns(&check.findings, "one value is -999 mm, the others lie between"), "{check}");
}
