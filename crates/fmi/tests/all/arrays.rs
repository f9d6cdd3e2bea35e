//! FMI 3.0 beyond scalar values: arrays, structural parameters, all types.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use fmi::{
    FmiError, Fmu, Inputs, InterfaceChoice, Session, SimulateOptions, SimulationPlan, Simulator, Value,
};
use std::sync::Arc;
use support::{arrays, fixture};

fn close(a: f64, b: f64) {
    assert!((a - b).abs() <= 1e-8, "{a} is not {b}");
}

#[test]
fn structural_parameters_change_number_of_array_columns() {
    let folder = arrays();
    let fmu = folder.open();
    assert!(fmu.description().quirks.is_empty(), "{:?}", fmu.description().quirks);
    assert_eq!(fmu.description().n_states(), 3);
    for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
        let options = SimulateOptions::new().kind(kind).relative_tolerance(1e-10).ncp(10);
        let result = fmu.simulate(&options).unwrap();
        assert_eq!(result.names, ["x[1]", "x[2]", "x[3]", "sum"]);
        for (i, name) in ["x[1]", "x[2]", "x[3]"].into_iter().enumerate() {
            close(result.final_value(name).unwrap().unwrap(), (i + 1) as f64 * (-1f64).exp());
        }
        close(result.final_value("sum").unwrap().unwrap(), 6.0 * (-1f64).exp());

        // Two states instead of three, with other values, twice with identical bits, and then again three.
        let smaller = options
            .clone()
            .start_value("n", 2)
            .start_value("x", vec![4.0, 5.0])
            .start_value("k", vec![1.0, 2.0])
            .outputs(["level[2]", "matrix[2,1]", "u8", "flags", "sum", "choice", "u64"]);
        let mut simulator = Simulator::new(Arc::new(SimulationPlan::new(&fmu, &smaller).unwrap())).unwrap();
        let first = simulator.trajectory(&[]).unwrap();
        assert_eq!(
            first.names,
            ["level[2]", "matrix[2,1]", "u8", "flags[1]", "flags[2]", "sum", "choice", "u64"]
        );
        let last: Vec<f64> = first.columns.iter().map(|column| *column.last().unwrap()).collect();
        close(last[0], 5.0 * (-2f64).exp());
        close(last[5], 4.0 * (-1f64).exp() + 5.0 * (-2f64).exp());
        assert_eq!(
            (&last[1..5], &last[6..]),
            (&[3.0, 208.0, 1.0, 0.0][..], &[2.0, 18000000000000000064.0][..])
        );
        assert_eq!(simulator.trajectory(&[]).unwrap(), first);
        assert_eq!(fmu.simulate(&options).unwrap(), result);
    }
}

/// Returns the solution of x' = u - k x at `t`.
fn grown(x0: f64, k: f64, u: f64, t: f64) -> f64 {
    u / k + (x0 - u / k) * (-k * t).exp()
}

#[test]
fn array_elements_work_as_start_values_parameters_and_inputs() {
    let folder = arrays();
    let fmu = folder.open();
    let inputs = Inputs::new()
        .series("u[2]", vec![0.0, 1.0], vec![3.0, 3.0])
        .series("steps[2]", vec![0.0, 0.5], vec![4.0, 5.0])
        .table(vec![0.0, 1.0], [("u[1]", vec![2.0, 2.0])]);
    for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
        let options = SimulateOptions::new()
            .kind(kind)
            .relative_tolerance(1e-10)
            .times([0.0, 0.25, 1.0])
            .start_value("n", 2)
            .start_value("k", vec![2.0, 1.0])
            .start_value("u", vec![0.0, 0.0])
            .start_value("x", vec![9.0, 9.0])
            .start_value("x[2]", 5.0)
            .start_value("x[1]", 4)
            .parameters(["k[2]", "x[1]"])
            .inputs(inputs.clone())
            .outputs(["x", "k[2]", "steps"]);
        let plan = Arc::new(SimulationPlan::new(&fmu, &options).unwrap());
        assert_eq!(plan.parameter_starts(), [1.0, 4.0]);
        let mut simulator = Simulator::new(plan).unwrap();
        for (k2, x1) in [(1.0, 4.0), (3.0, -1.0), (1.0, 4.0)] {
            let result = simulator.trajectory(&[k2, x1]).unwrap();
            let last = |name: &str| result.final_value(name).unwrap().unwrap();
            close(last("x[1]"), grown(x1, 2.0, 2.0, 1.0));
            close(last("x[2]"), grown(5.0, k2, 3.0, 1.0));
            assert_eq!(last("k[2]"), k2);
            // The other element of a driven array keeps its start value.
            assert_eq!(result.get("steps[1]").unwrap(), [1.0, 1.0, 1.0]);
            assert_eq!(result.get("steps[2]").unwrap(), [4.0, 4.0, 5.0]);
            assert_eq!(simulator.value("k").unwrap(), vec![2.0, k2].into());
            assert_eq!(simulator.get("x[2]").unwrap(), last("x[2]"));
        }
    }
    let problem = |options: SimulateOptions| SimulationPlan::new(&fmu, &options).unwrap_err().to_string();
    let new = SimulateOptions::new;
    assert!(problem(new().parameters(["k"])).contains("specify its elements"));
    assert!(problem(new().parameters(["k[1]", "k[1]"])).contains("specified twice"));
    assert!(problem(new().start_value("k[4]", 1.0)).contains("k[4]"));
    assert!(
        problem(new().start_value("n", 2).start_value("k[1]", 1.0)).contains("3 start values for 2 elements")
    );
    assert!(problem(new().start_value("k[1]", "one")).contains("Real"));
    assert!(problem(new().inputs(Inputs::new().series("u", vec![0.0], vec![1.0]))).contains("u[...]"));
    let twice =
        new().inputs(Inputs::new().series("u[1]", vec![0.0], vec![1.0]).series("u[1]", vec![0.0], vec![1.0]));
    assert!(problem(twice).contains("twice"));
}

#[test]
fn session_sets_and_gets_array_elements() {
    let folder = arrays();
    let mut session = Session::new(folder.open());
    session.set("k[2]", 3.0).unwrap();
    session.set("matrix[2,1]", 30).unwrap();
    assert_eq!(session.get("k").unwrap(), vec![1.0, 3.0, 1.0].into());
    assert_eq!((session.get("k[2]").unwrap(), session.get("k[1]").unwrap()), (3.0.into(), 1.0.into()));
    session.simulate(&SimulateOptions::new().ncp(1).relative_tolerance(1e-10)).unwrap();
    assert_eq!(session.get("matrix").unwrap(), vec![0, 1, 2, 30, 4, 5].into());
    let Value::Real(x) = session.get("x[2]").unwrap() else { panic!("x[2] is real") };
    close(x, 2.0 * (-3f64).exp());
    assert_eq!((session.extents("k").unwrap(), session.extents("matrix").unwrap()), (vec![3], vec![2, 3]));
    session.set("n", 5).unwrap();
    assert_eq!((session.extents("k").unwrap(), session.extents("i8").unwrap()), (vec![5], vec![]));
}

#[test]
fn session_round_trips_values_of_all_types() {
    let folder = arrays();
    let mut session = Session::new(folder.open());
    let values: [(&str, Value); 15] = [
        ("f32", Value::Real(0.25)),
        ("i8", (-128).into()),
        ("u8", 255.into()),
        ("i16", (-32768).into()),
        ("u16", 65535.into()),
        ("i32", i32::MIN.into()),
        ("u32", u32::MAX.into()),
        ("i64", i64::MIN.into()),
        ("u64", u64::MAX.into()),
        ("choice", 1.into()),
        ("flags", vec![false, true].into()),
        ("matrix", vec![9, 8, 7, 6, 5, 4].into()),
        ("text", vec!["a", "\u{e4}"].into()),
        ("bytes", Value::Binary(vec![0, 1, 255])),
        ("k", vec![0.5, 1.0, 2.0].into()),
    ];
    for (name, value) in &values {
        session.set(name, value.clone()).unwrap();
    }
    session.simulate(&SimulateOptions::new().ncp(1)).unwrap();
    for (name, value) in &values {
        assert_eq!(session.get(name).unwrap(), *value, "{name}");
    }
    session.reset();
    session.simulate(&SimulateOptions::new().ncp(1)).unwrap();
    assert_eq!(session.get("bytes").unwrap(), Value::Binary(vec![0xca, 0xfe]));
    assert_eq!(session.get("text").unwrap(), vec!["one", "two"].into());
    assert_eq!(session.get("u64").unwrap(), 18_000_000_000_000_000_064u64.into());
}

#[test]
fn outputs_of_every_type_share_sample_rows() {
    let folder = arrays();
    let fmu = folder.open();
    for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
        let options = SimulateOptions::new().kind(kind).ncp(10);
        let wanted = ["label", "sum", "count", "text", "matrix", "blob", "u64", "text[2]", "time", "f32"];
        let result = fmu.simulate(&options.clone().outputs(wanted)).unwrap();
        let recorded: Vec<(&str, &[usize])> =
            result.recorded.iter().map(|r| (r.name.as_str(), r.extents.as_slice())).collect();
        assert_eq!(
            recorded,
            [
                ("label", &[][..]),
                ("sum", &[]),
                ("count", &[]),
                ("text", &[2]),
                ("matrix", &[2, 3]),
                ("blob", &[]),
                ("u64", &[]),
                ("text[2]", &[]),
                ("time", &[]),
                ("f32", &[])
            ]
        );
        let mut names = vec!["sum".to_owned(), "count".to_owned()];
        names.extend((1..=2).flat_map(|i| (1..=3).map(move |j| format!("matrix[{i},{j}]"))));
        names.extend(["u64", "time", "f32"].map(str::to_owned));
        assert_eq!(result.names, names);
        let value_names: Vec<&str> = result.values.iter().map(|column| column.name.as_str()).collect();
        assert_eq!(value_names, ["label", "count", "text[1]", "text[2]", "blob", "u64", "text[2]"]);
        for column in &result.values {
            assert_eq!(column.len(), 11, "{}", column.name);
        }

        let bytes = [0u8, 1, 255];
        for row in 0..11 {
            let label: Value = if row < 5 { "early" } else { "late" }.into();
            assert_eq!(result.values_of("label").unwrap()[row], label, "row {row}");
            let count = (1i64 << 53) + 1 + i64::try_from(row).unwrap();
            assert_eq!(result.values_of("count").unwrap()[row], count.into());
            // The number is the nearest representable one.
            assert_eq!(result.get("count").unwrap()[row], count as f64);
            assert_eq!(result.values_of("blob").unwrap()[row], Value::Binary(bytes[..row % 4].to_vec()));
            assert_eq!(result.values_of("u64").unwrap()[row], 18_000_000_000_000_000_064u64.into());
            assert_eq!(result.values_of("text[2]").unwrap()[row], "two".into());
        }
        let error = result.values_of("sum").unwrap_err().to_string();
        assert!(error.contains("label, count"), "{error}");

        // The default outputs are all variables with causality output, including strings. The run is repeated
        // with the same instance and other strings.
        let mut session = Session::of_kind(fmu.clone(), kind);
        let result = session.simulate(&options).unwrap();
        assert_eq!(result.recorded.len(), 3);
        session.set("text", vec!["", "\u{1f600}"]).unwrap();
        let again = session.simulate(&options.clone().outputs(["text"])).unwrap();
        assert!(again.names.is_empty());
        assert_eq!(*again.values_of("text[1]").unwrap(), [""; 11].map(Value::from)[..]);
        assert_eq!(*again.values_of("text[2]").unwrap(), ["\u{1f600}"; 11].map(Value::from)[..]);

        let plan = |outputs: &[&str]| {
            SimulationPlan::new(&fmu, &options.clone().outputs(outputs.iter().copied())).unwrap()
        };
        assert!(plan(&["sum", "x[2]", "count"]).require_single_numbers().is_ok());
        for (outputs, why) in
            [(["sum", "label"], "label cannot be an output"), (["x", "sum"], "its elements")]
        {
            let error = plan(&outputs).require_single_numbers().unwrap_err().to_string();
            assert!(error.contains(why), "{error}");
        }
    }
}

#[test]
fn start_values_that_do_not_fit_are_rejected_by_name() {
    let folder = arrays();
    let fmu = folder.open();
    let problem = |name: &str, value: Value| {
        SimulationPlan::new(&fmu, &SimulateOptions::new().start_value(name, value)).unwrap_err().to_string()
    };
    for (name, value, text) in [
        ("i8", 128.into(), "i8 = 128 is out of range for type Int8 (8 bits, from -128 to 127)"),
        ("u64", (-1).into(), "64 bits, from 0 to 18446744073709551615"),
        ("k", vec![1.0, 2.0].into(), "array of different size"),
        ("k", 1.0.into(), "a scalar for an array"),
        ("k", vec![1.0, f64::NAN, 1.0].into(), "NaN"),
        ("flags", vec![1, 0].into(), "Boolean"),
        ("bytes", "text".into(), "Binary"),
        ("f32", vec![1.0].into(), "array"),
    ] {
        let problem = problem(name, value);
        assert!(problem.contains(text), "{problem}");
    }
    for (output, text) in [("text[3]", "no variable"), ("x[4]", "no variable"), ("x[0]", "no variable")] {
        let error =
            SimulationPlan::new(&fmu, &SimulateOptions::new().outputs([output])).unwrap_err().to_string();
        assert!(error.contains(text), "{error}");
    }
    let error = SimulationPlan::new(&fmu, &SimulateOptions::new().parameters(["k"])).unwrap_err();
    assert!(matches!(error, FmiError::NotSettable { .. }), "{error}");
}

#[test]
fn instance_checks_array_sizes() {
    let folder = arrays();
    let fmu: Fmu = folder.open();
    let mut instance = fmu.instantiate().unwrap();
    instance.set("n", 2).unwrap();
    instance.set("x", vec![7.0, 8.0]).unwrap();
    let mut instance = instance.enter_initialization(0.0, None, None).unwrap();
    assert!(matches!(instance.set("n", 3), Err(FmiError::NotSettable { .. })));
    assert_eq!(instance.get("x").unwrap(), vec![7.0, 8.0].into());
    let mut values = [0.0; 3];
    assert!(matches!(instance.get_reals(&[2], &mut values), Err(FmiError::Length { expected: 2, .. })));
    instance.get_reals(&[2, 5], &mut values).unwrap();
    assert_eq!(values, [7.0, 8.0, 15.0]);
    let mut instance = instance.exit_initialization().unwrap();
    assert!(matches!(instance.get_continuous_states(&mut values), Err(FmiError::Length { expected: 2, .. })));
    instance.get_continuous_states(&mut values[..2]).unwrap();
    let fresh = instance.terminate().unwrap().reset().unwrap();
    let mut instance = fresh.enter_initialization(0.0, None, None).unwrap().exit_initialization().unwrap();
    instance.get_continuous_states(&mut values).unwrap();
    assert_eq!(values, [1.0, 2.0, 3.0]);
}

#[test]
fn tunable_structural_parameters_resize_running_instance() {
    let tunable = |xml: String| {
        xml.replace(
            "causality=\"structuralParameter\" variability=\"fixed\"",
            "causality=\"structuralParameter\" variability=\"tunable\"",
        )
    };
    let folder = fixture("arrays", tunable);
    let fmu = folder.open();
    let mut instance = fmu.instantiate().unwrap();
    instance.set("n", 2).unwrap();
    let instance = instance.enter_initialization(0.0, None, None).unwrap().exit_initialization().unwrap();
    let mut states = [0.0; 4];
    let mut instance = instance.enter_reconfiguration().unwrap();
    assert!(matches!(instance.set("k", vec![1.0, 1.0]), Err(FmiError::NotSettable { .. })));
    instance.set("n", 4).unwrap();
    assert_eq!(instance.get("n").unwrap(), 4u64.into());
    let mut instance = instance.exit_reconfiguration().unwrap();
    instance.update_discrete_states(10).unwrap();
    assert!(matches!(
        instance.get_continuous_states(&mut states[..2]),
        Err(FmiError::Length { expected: 4, .. })
    ));
    instance.get_continuous_states(&mut states).unwrap();
    assert_eq!(states, [1.0, 2.0, 3.0, 4.0]);
    let mut instance = instance.enter_continuous_time().unwrap();
    let mut slopes = [0.0; 4];
    instance.get_derivatives(&mut slopes).unwrap();
    assert_eq!(slopes, [-1.0, -2.0, -3.0, -4.0]);
    // A reset restores the sizes of the description.
    let fresh = instance.terminate().unwrap().reset().unwrap();
    let mut instance = fresh.enter_initialization(0.0, None, None).unwrap();
    assert_eq!(instance.get("x").unwrap(), vec![1.0, 2.0, 3.0].into());

    let instance = fmu.instantiate_co_simulation(&fmi::InstanceOptions::default()).unwrap();
    let mut instance = instance.enter_initialization(0.0, None, None).unwrap().exit_initialization().unwrap();
    instance.do_step(0.0, 1.0).unwrap();
    let mut instance = instance.enter_reconfiguration().unwrap();
    instance.set("n", 1).unwrap();
    let mut instance = instance.exit_reconfiguration().unwrap();
    instance.do_step(1.0, 1.0).unwrap();
    assert_eq!(instance.get("x").unwrap(), vec![1f64 * (-1f64).exp() * (-1f64).exp()].into());

    // Between runs any structural parameter may change, and a simulation after a change equals a first one.
    let run = |n: u64| {
        fmu.simulate(
            &SimulateOptions::new()
                .start_value("n", n)
                .start_value("x", vec![1.0; n as usize])
                .start_value("k", vec![1.0; n as usize])
                .ncp(2),
        )
        .unwrap()
    };
    let two = run(2);
    assert_eq!((run(4).names.len(), run(2)), (5, two));

    // The model has nothing to reconfigure, or this variable cannot be reconfigured.
    let fixed = arrays();
    let instance = fixed.open().instantiate().unwrap();
    let instance = instance.enter_initialization(0.0, None, None).unwrap().exit_initialization().unwrap();
    let error = instance.enter_reconfiguration().unwrap_err().to_string();
    assert!(error.contains("no tunable structural parameters"), "{error}");
}

#[test]
fn structural_parameter_accepts_real_with_integer_value() {
    let folder = arrays();
    let fmu = folder.open();
    let mut instance = fmu.instantiate().unwrap();
    // A real with an integer value is accepted, even for the sizes of vectors.
    instance.set("n", 2.0).unwrap();
    let mut instance = instance.enter_initialization(0.0, None, None).unwrap().exit_initialization().unwrap();
    let mut states = [0.0; 2];
    instance.get_continuous_states(&mut states).unwrap();
    assert_eq!(states, [1.0, 2.0]);
    assert_eq!(instance.get("x").unwrap(), vec![1.0, 2.0].into());
}

#[test]
fn session_uses_array_sizes_of_structural_parameters() {
    let folder = arrays();
    let mut session = Session::new(folder.open());
    session.set_all([("n", 4.into()), ("k", vec![1.0, 2.0, 3.0, 4.0].into()), ("k[4]", 5.into())]).unwrap();
    assert_eq!(session.get("k").unwrap(), vec![1.0, 2.0, 3.0, 5.0].into());
    // Start values for another size are ignored. The model provides the values.
    assert_eq!(session.get("x").unwrap(), vec![1.0, 2.0, 3.0, 4.0].into());
    assert_eq!(session.get("u[4]").unwrap(), 0.0.into());
    // Either all values are set, or none.
    let error = session.set_all([("k[1]", 9.into()), ("f32", 0.25.into()), ("k[5]", 1.into())]).unwrap_err();
    assert!(error.to_string().contains("k[5]"), "{error}");
    assert_eq!(session.get("k[1]").unwrap(), 1.0.into());
    assert_eq!(session.get("f32").unwrap(), 0.5.into());
}

#[test]
fn saved_states_restore_array_sizes() {
    let folder = arrays();
    let fmu = folder.open();
    let mut instance = fmu.instantiate().unwrap();
    let three = instance.save_state().unwrap();
    instance.set("n", 2).unwrap();
    let two = instance.save_state().unwrap();
    instance.restore_state(&three).unwrap();
    instance.restore_state(&two).unwrap();
    instance.restore_state(&three).unwrap();
    let mut instance = instance.enter_initialization(0.0, None, None).unwrap();
    assert_eq!(instance.get("x").unwrap(), vec![1.0, 2.0, 3.0].into());
    let mut instance = instance.exit_initialization().unwrap();
    let mut states = [0.0; 3];
    instance.get_continuous_states(&mut states).unwrap();
    assert_eq!(states, [1.0, 2.0, 3.0]);
}

/// Strings and bytes change at their rows, as events. The next run starts from the start values again.
#[test]
fn inputs_accept_strings_and_bytes() {
    let folder = arrays();
    let fmu = folder.open();
    let inputs = || {
        Inputs::new().values("word", [0.0, 0.25, 0.5], ["first", "second", "first"]).values(
            "packet",
            [0.25, 0.5],
            [vec![], vec![0, 255]].map(Value::Binary),
        )
    };
    for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
        let options = SimulateOptions::new()
            .kind(kind)
            .final_time(1.0)
            .output_interval(0.25)
            .outputs(["word", "packet"]);
        let found = fmu.simulate(&options.clone().inputs(inputs())).unwrap();
        // Without event mode, a row is read before the inputs of the next step are set.
        let late = kind == InterfaceChoice::CoSimulation;
        let words = if late { [1, 1, 2, 1, 1] } else { [1, 2, 1, 1, 1] };
        let words = words.map(|word| Value::String(["none", "first", "second"][word].into()));
        assert_eq!(*found.values_of("word").unwrap(), words[..]);
        let packet = vec![0, 255];
        let third = if late { vec![] } else { packet.clone() };
        let packets = [vec![], vec![], third, packet.clone(), packet].map(Value::Binary);
        assert_eq!(*found.values_of("packet").unwrap(), packets[..]);
        let plain = fmu.simulate(&options).unwrap();
        assert!(plain.values_of("word").unwrap().iter().all(|word| *word == Value::String("none".into())));
    }
    let problem = |inputs: Inputs| {
        SimulationPlan::new(&fmu, &SimulateOptions::new().inputs(inputs)).unwrap_err().to_string()
    };
    for (inputs, text) in [
        (
            Inputs::new().values("word", [0.0], [Value::Binary(vec![1])]),
            "word: expected a value of type String",
        ),
        (Inputs::new().values("word", [0.0], ["a\0b"]), "NUL"),
        (Inputs::new().values("word", [0.0, 1.0], ["a"]), "1 values for 2 times"),
        (Inputs::new().values("u[1]", [0.0], ["a"]), "expected a value of type Real"),
        (Inputs::new().table([0.0], [("word", vec![1.0])]), "text and binary"),
    ] {
        let problem = problem(inputs);
        assert!(problem.contains(text), "{problem}");
    }
}

#[test]
fn inputs_accept_64_bit_integers_without_loss() {
    let folder = fixture("arrays", |xml| {
        let input = |xml: String, name: &str| {
            let from = format!("name=\"{name}\"");
            let at = xml.find(&from).unwrap();
            let (head, tail) = xml.split_at(at);
            let role = "causality=\"parameter\" variability=\"fixed\"";
            head.to_owned() + &tail.replacen(role, "causality=\"input\" variability=\"discrete\"", 1)
        };
        input(input(input(xml, "i64"), "u64"), "i16")
    });
    let fmu = folder.open();
    let big = (1i64 << 53) + 1;
    for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
        let inputs = Inputs::new()
            .values("i64", [0.0, 0.25, 0.5, 0.75], [big, -big, i64::MAX, i64::MAX])
            .values(
                "u64",
                [0.0, 0.5],
                [Value::Integer(u64::MAX.into()), Value::Integer(u64::MAX as i128 - 1)],
            )
            .values("i16", [0.0, 0.5], [-300, 300]);
        let options = SimulateOptions::new().kind(kind).inputs(inputs).outputs(["i64", "u64", "i16"]);
        let result = fmu.simulate(&options.times([0.0, 0.3, 0.6, 0.9])).unwrap();
        assert_eq!(
            *result.values_of("i64").unwrap(),
            [big, -big, i64::MAX, i64::MAX].map(Value::from)[..],
            "{kind:?}"
        );
        let (most, less) = (Value::Integer(u64::MAX.into()), Value::Integer(u64::MAX as i128 - 1));
        assert_eq!(
            *result.values_of("u64").unwrap(),
            [most.clone(), most, less.clone(), less][..],
            "{kind:?}"
        );
        assert_eq!(result.get("i16").unwrap(), [-300.0, -300.0, 300.0, 300.0]);
        // Changes of held values are events. A row without a change is not an event.
        assert_eq!(result.stats.input_events, if kind == InterfaceChoice::ModelExchange { 2 } else { 0 });
    }
    let refused = |inputs: Inputs| {
        SimulationPlan::new(&fmu, &SimulateOptions::new().inputs(inputs)).unwrap_err().to_string()
    };
    let message = refused(Inputs::new().values("u64", [0.0], [-1]));
    assert!(message.contains("u64") && message.contains("-1"), "{message}");
    let message = refused(Inputs::new().values("i64", [0.0], ["many"]));
    assert!(message.contains("i64"), "{message}");
    let message = refused(Inputs::new().values("i64", [0.0, 1.0], [1]));
    assert!(message.contains("1 values for 2 times"), "{message}");
}

#[test]
fn instance_is_unchanged_after_rejected_structure() {
    let folder = arrays();
    let fmu = folder.open();
    let mut instance = fmu.instantiate().unwrap();
    let error = instance.set("n", 99).unwrap_err();
    assert!(error.to_string().contains("fmi3SetUInt64"), "{error}");
    // The instance has left configuration mode. The model itself rejects calls that are only allowed in that
    // mode.
    instance.set("k", vec![1.0, 2.0, 3.0]).unwrap();
    let mut instance = instance.enter_initialization(0.0, None, None).unwrap();
    assert_eq!(instance.get("k").unwrap(), vec![1.0, 2.0, 3.0].into());
    let mut instance = instance.reset().unwrap();
    instance.set("n", 2).unwrap();
    let instance = instance.enter_initialization(0.0, None, None).unwrap();
    let mut instance = instance.exit_initialization().unwrap();
    let mut states = [0.0; 2];
    instance.get_continuous_states(&mut states).unwrap();
    assert_eq!(states, [1.0, 2.0]);
}

/// x' = f32 - x, x(0) = 1.
fn driven_by_single(edit: &'static str) -> support::Folder {
    support::fixture_with("arrays", &["SINGLE"], move |xml| {
        let (before, after) = xml.split_once("<Float32 name=\"f32\"").unwrap();
        let (_, after) = after.split_once("/>").unwrap();
        format!("{before}<Float32 name=\"f32\" {edit} start=\"0.5\"/>{after}")
    })
}

#[test]
fn single_precision_inputs_are_interpolated() {
    let folder = driven_by_single("valueReference=\"10\" causality=\"input\" variability=\"continuous\"");
    let fmu = folder.open();
    let rows: Vec<f64> = (0..11).map(|k| 0.1 * f64::from(k)).collect();
    // The double-precision input follows, because each type has a separate call.
    let ramp = Inputs::new().series("f32", rows.clone(), rows);
    let function = Inputs::new().function("f32", |t| t);
    for inputs in [ramp, function] {
        let both = inputs.series("u[2]", vec![0.0, 1.0], vec![0.0, 1.0]);
        let options = SimulateOptions::new()
            .kind(InterfaceChoice::ModelExchange)
            .relative_tolerance(1e-9)
            .times([0.0, 0.25, 1.0])
            .inputs(both)
            .outputs(["x", "f32"]);
        let result = fmu.simulate(&options).unwrap();
        for (row, t) in [0.0f64, 0.25, 1.0].into_iter().enumerate() {
            // x' = t - x and x' = 2 t - x.
            let (first, second) = (t - 1.0 + 2.0 * (-t).exp(), 2.0 * (t - 1.0) + 4.0 * (-t).exp());
            assert!((result.get("x[1]").unwrap()[row] - first).abs() < 1e-6, "{result:?}");
            assert!((result.get("x[2]").unwrap()[row] - second).abs() < 1e-6, "{result:?}");
            assert_eq!(result.get("f32").unwrap()[row], f64::from(t as f32));
        }
        assert_eq!(result.stats.input_events, 0);
    }
}

#[test]
fn single_precision_parameters_change_between_runs() {
    let folder = driven_by_single("valueReference=\"10\" causality=\"parameter\" variability=\"fixed\"");
    let fmu = folder.open();
    for kind in [InterfaceChoice::ModelExchange, InterfaceChoice::CoSimulation] {
        let options = SimulateOptions::new()
            .kind(kind)
            .relative_tolerance(1e-10)
            .times([0.0, 1.0])
            .parameters(["f32", "k[2]"])
            .outputs(["x", "f32"]);
        let plan = Arc::new(SimulationPlan::new(&fmu, &options).unwrap());
        assert_eq!(plan.parameter_starts(), [0.5, 1.0]);
        let mut simulator = Simulator::new(plan).unwrap();
        for (single, k) in [(0.3, 1.0), (2.5, 2.0), (0.3, 1.0)] {
            let result = simulator.trajectory(&[single, k]).unwrap();
            let single = f64::from(single as f32);
            assert_eq!(result.get("f32").unwrap(), [single, single]);
            if kind == InterfaceChoice::ModelExchange {
                close(result.final_value("x[1]").unwrap().unwrap(), grown(1.0, 1.0, single, 1.0));
                close(result.final_value("x[2]").unwrap().unwrap(), grown(2.0, k, single, 1.0));
            }
        }
    }
}

#[test]
fn aliases_are_recorded_by_their_names() {
    let folder = arrays();
    let fmu = folder.open();
    let names = |outputs: &[&str]| {
        let plan =
            SimulationPlan::new(&fmu, &SimulateOptions::new().outputs(outputs.iter().copied())).unwrap();
        plan.output_names().to_vec()
    };
    assert_eq!(names(&["lev*"]), ["level[1]", "level[2]", "level[3]"]);
    assert_eq!(names(&["level[2]", "x[2]"]), ["level[2]", "x[2]"]);
    let all = names(&["all"]);
    assert!(
        ["x[1]", "level[1]", "sum"].iter().all(|name| all.iter().any(|listed| listed == name)),
        "{all:?}"
    );
    // A different name results in a separate column; the same name does not.
    assert_eq!(names(&["level", "*evel", "x"]).iter().filter(|name| *name == "level[1]").count(), 1);
    let result = fmu.simulate(&SimulateOptions::new().outputs(["x", "level"])).unwrap();
    assert_eq!(result.get("x[2]").unwrap(), result.get("level[2]").unwrap());
}
