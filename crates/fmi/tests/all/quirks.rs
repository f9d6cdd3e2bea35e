//! Deviations from the standard in real FMUs. They are tolerated and listed as quirks, and the FMUs run.
//! Strict parsing rejects each of them.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::support;

use fmi::description::{Causality, QuirkKind, VariableKind};
use fmi::{FmiError, ModelDescription, SimulateOptions, Value};
use support::{Folder, evil, evil_with};

/// Returns a description of FMI 2.0 with these variables and this structure.
fn two(variables: &str, structure: &str) -> String {
    format!(
        "<fmiModelDescription fmiVersion=\"2.0\" modelName=\"m\" guid=\"g\"><ModelExchange modelIdentifier=\"m\"/>\
         <ModelVariables>{variables}</ModelVariables><ModelStructure>{structure}</ModelStructure></fmiModelDescription>"
    )
}

/// Returns a description of FMI 3.0 with these variables.
fn three(version: &str, variables: &str) -> String {
    format!(
        "<fmiModelDescription fmiVersion=\"{version}\" modelName=\"m\" instantiationToken=\"g\">\
         <ModelExchange modelIdentifier=\"m\"/><ModelVariables>\
         <Float64 name=\"time\" valueReference=\"0\" causality=\"independent\" variability=\"continuous\"/>{variables}\
         </ModelVariables><ModelStructure/></fmiModelDescription>"
    )
}

fn real(name: &str, reference: u32, rest: &str) -> String {
    format!("<ScalarVariable name=\"{name}\" valueReference=\"{reference}\"><Real {rest}/></ScalarVariable>")
}

fn state(derivatives: &str) -> String {
    let x = "<ScalarVariable name=\"x\" valueReference=\"1\" initial=\"exact\"><Real start=\"1\"/></ScalarVariable>";
    format!("{x}{derivatives}")
}

/// Each case lists the sorted classes of its quirks, each once. An empty list means that the unusual content
/// is allowed or ignored.
#[test]
fn parse_lists_quirks_of_tolerated_descriptions() {
    use QuirkKind::{Combination, Duplicate, Range, Start, Structure, Undefined};
    let derivative = real("der(x)", 2, "derivative=\"1\"");
    let list = "<Derivatives><Unknown index=\"2\"/></Derivatives>";
    let independent = |rest: &str| {
        format!(
            "<ScalarVariable name=\"time\" valueReference=\"9\" causality=\"independent\" {rest}/></ScalarVariable>"
        )
    };
    let cases: Vec<(&str, String, &[QuirkKind])> = vec![
        ("unit \"A\"", two(&real("v", 1, "unit=\"A\""), ""), &[Undefined]),
        ("unit \"user-defined\"", two(&real("v", 1, "unit=\"user-defined\""), ""), &[Undefined]),
        (
            "wrong initial unknowns",
            two(&real("v", 1, ""), "<InitialUnknowns><Unknown index=\"9\"/></InitialUnknowns>"),
            &[Structure],
        ),
        (
            "a state in the place of its derivative",
            two(&state(&derivative), "<Derivatives><Unknown index=\"1\"/></Derivatives>"),
            &[Structure],
        ),
        ("a derivative without its state", two(&state(&real("der(x)", 2, "")), list), &[Structure]),
        (
            "two derivatives of one state",
            two(
                &state(&(derivative.clone() + &real("dx", 3, "derivative=\"1\""))),
                "<Derivatives><Unknown index=\"2\"/><Unknown index=\"3\"/></Derivatives>",
            ),
            &[Structure],
        ),
        (
            "a parameter that is a constant",
            two(
                "<ScalarVariable name=\"p\" valueReference=\"1\" causality=\"parameter\" variability=\"constant\">\
                 <Real start=\"1\"/></ScalarVariable>",
                "",
            ),
            &[Combination],
        ),
        (
            "a start value of time",
            two(&independent("variability=\"continuous\"><Real start=\"0\""), ""),
            &[Start],
        ),
        ("an integer as time", two(&independent("variability=\"discrete\"><Integer"), ""), &[Combination]),
        (
            "two independent variables",
            two(
                &(independent("variability=\"continuous\"><Real")
                    + &independent("variability=\"continuous\"><Real").replace("\"time\"", "\"t\"")),
                "",
            ),
            &[Duplicate],
        ),
        ("nominal 0", two(&real("v", 1, "nominal=\"0\""), ""), &[Range]),
        ("nominal -5", two(&real("v", 1, "nominal=\"-5\""), ""), &[Range]),
        ("nominal NaN", two(&real("v", 1, "nominal=\"NaN\""), ""), &[Range]),
        (
            "unknown elements and attributes",
            two(&real("v", 1, "author=\"me\""), "<Extra a=\"b\"><Deep/></Extra>"),
            &[],
        ),
        (
            "a Boolean and a Real with one reference",
            two(
                &(real("v", 1, "")
                    + "<ScalarVariable name=\"b\" valueReference=\"1\" variability=\"discrete\"><Boolean/></ScalarVariable>"),
                "",
            ),
            &[],
        ),
        (
            "odd names",
            two(
                &(real("a[1,2].b", 1, "")
                    + &real("'quoted name'", 2, "")
                    + &real("(a)/{b}", 3, "")
                    + &real("der(der(x))", 4, "")
                    + &real("\u{3b1} \u{e4}", 5, "")),
                "",
            ),
            &[],
        ),
        ("version 3.0.1", three("3.0.1", ""), &[]),
        ("version 3.0-beta.2", three("3.0-beta.2", ""), &[]),
        (
            "a Binary input without start",
            three("3.0", "<Binary name=\"b\" valueReference=\"1\" causality=\"input\"/>"),
            &[],
        ),
    ];
    let mut wrong = Vec::new();
    for (what, text, expected) in &cases {
        let model = match ModelDescription::parse(text.as_bytes()) {
            Ok(model) => model,
            Err(error) => {
                wrong.push(format!("{what}: {error}"));
                continue;
            }
        };
        let mut kinds: Vec<QuirkKind> = model.quirks.iter().map(|quirk| quirk.kind).collect();
        kinds.dedup();
        if kinds != *expected {
            wrong.push(format!("{what}: {:?}", model.quirks));
        }
        // Strict parsing rejects exactly the listed quirks.
        match model.require_conforming() {
            Ok(()) => assert!(kinds.is_empty(), "{what}"),
            Err(FmiError::NotConforming { count, .. }) => assert_eq!(count, model.quirks.len(), "{what}"),
            Err(error) => panic!("{what}: {error}"),
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn parse_preserves_guid_and_names() {
    let text = two(&real("a[1,2].b", 1, ""), "").replace("guid=\"g\"", "guid=\" {8c4e810f} \"");
    let model = ModelDescription::parse(text.as_bytes()).unwrap();
    assert_eq!(model.guid, " {8c4e810f} ");
    assert_eq!(model.variable("a[1,2].b").unwrap().causality, Causality::Local);
    // The variables are distinct although they share a reference.
    let text = two(
        &(real("v", 1, "start=\"2\" ")
            + "<ScalarVariable name=\"b\" valueReference=\"1\" variability=\"discrete\"><Boolean/></ScalarVariable>"),
        "",
    );
    let model = ModelDescription::parse(text.as_bytes()).unwrap();
    let kinds = ["v", "b"].map(|name| model.variable(name).unwrap().kind);
    assert_eq!(kinds, [VariableKind::Real, VariableKind::Boolean]);
}

/// Returns y(1) of y' = -y, y(0) = 1.
fn end(folder: &Folder) -> f64 {
    let options = SimulateOptions::new().relative_tolerance(1e-9);
    folder.open().simulate(&options).unwrap().final_value("y").unwrap().unwrap()
}

fn binaries(folder: &Folder) -> std::path::PathBuf {
    folder.path().join("binaries")
}

#[test]
fn binary_with_another_name_is_used_when_it_is_the_only_one() {
    let folder = evil(&[]);
    let place =
        binaries(&folder).join(&fmi::platform::binary_folders(fmi::platform::FolderNames::SystemAndBits)[0]);
    let [library, other] =
        ["evil", "model_2"].map(|name| place.join(format!("{name}.{}", fmi::platform::LIBRARY_EXTENSION)));
    std::fs::rename(&library, &other).unwrap();
    assert!((end(&folder) - (-1f64).exp()).abs() < 1e-8);
    // With two such libraries the choice is ambiguous.
    std::fs::copy(&other, library.with_file_name(format!("third.{}", fmi::platform::LIBRARY_EXTENSION)))
        .unwrap();
    let error = folder.open().instantiate().unwrap_err();
    assert!(matches!(error, FmiError::NoBinary { .. }) && error.to_string().contains("third"), "{error}");
}

#[test]
fn library_is_found_in_the_folder_of_another_fmi_version() {
    let folder = evil(&[]);
    let folders = fmi::platform::binary_folders(fmi::platform::FolderNames::SystemAndBits);
    std::fs::rename(binaries(&folder).join(&folders[0]), binaries(&folder).join(&folders[1])).unwrap();
    // An empty folder with the right name changes nothing.
    std::fs::create_dir(binaries(&folder).join(&folders[0])).unwrap();
    assert!((end(&folder) - (-1f64).exp()).abs() < 1e-8);
}

#[test]
fn library_for_another_processor_is_an_error_with_its_machine() {
    let folder = evil(&[]);
    let place = fmi::platform::find_binary(folder.path(), "evil", fmi::platform::FolderNames::SystemAndBits)
        .unwrap()
        .path;
    let mut bytes = std::fs::read(&place).unwrap();
    if bytes.starts_with(b"\x7fELF") {
        // The machine number (ELF header, e_machine) 21 is 64-bit PowerPC.
        bytes[18..20].copy_from_slice(&[21, 0]);
        std::fs::write(&place, bytes).unwrap();
        let error = folder.open().instantiate().unwrap_err();
        assert!(matches!(error, FmiError::NoBinary { .. }), "{error}");
        assert!(error.to_string().contains("ELF machine 21"), "{error}");
    }
}

#[test]
fn invalid_nominals_are_corrected() {
    let truth = evil(&[]).open().simulate(&SimulateOptions::new()).unwrap();
    for nominal in ["0.0", "-1.0", "NAN", "INFINITY", "-INFINITY"] {
        let folder = evil(&[&format!("NOMINAL={nominal}")]);
        let fmu = folder.open();
        for _ in 0..3 {
            assert_eq!(fmu.simulate(&SimulateOptions::new()).unwrap(), truth, "{nominal}");
        }
        // The quirk is reported once, with the name of the state.
        let messages: Vec<String> = fmu.quirks_seen().into_iter().map(|quirk| quirk.message).collect();
        assert_eq!(messages.len(), 1, "{messages:?}");
        assert!(messages[0].starts_with("the nominal value of x is "), "{messages:?}");
    }
}

#[test]
fn inputs_reject_two_aliases_with_different_values() {
    let folder = support::model_as(
        "switched_input",
        example_models::ExampleKind::Fmi2ModelExchange,
        &[],
        |xml| {
            let place = "</ModelVariables>";
            let alias = "<ScalarVariable name=\"also\" valueReference=\"6\" causality=\"input\" variability=\"continuous\">\
                     <Real start=\"0\"/></ScalarVariable>";
            assert!(xml.contains("name=\"u\" valueReference=\"6\""));
            xml.replace(place, &format!("{alias}{place}"))
        },
    );
    let inputs = fmi::Inputs::new().function("u", |t| t).function("also", |t| t);
    let error = folder.open().simulate(&SimulateOptions::new().inputs(inputs)).unwrap_err().to_string();
    assert!(error.contains("input also: it is the same variable as u, which is also specified"), "{error}");
    // If both names have the same rows, the input is driven once.
    let run = |inputs: fmi::Inputs| {
        let options = SimulateOptions::new().final_time(2.0).outputs(["x"]).inputs(inputs);
        folder.open().simulate(&options).map(|trajectory| trajectory.columns[0].clone())
    };
    let times = || vec![0.0, 1.0, 2.0];
    let one = fmi::Inputs::new().series("u", times(), vec![0.0, 1.0, 0.5]);
    let both = one.clone().series("also", times(), vec![0.0, 1.0, 0.5]);
    assert_eq!(run(one.clone()).unwrap(), run(both).unwrap());
    let error = run(one.series("also", times(), vec![0.0, 1.0, 0.6])).unwrap_err().to_string();
    assert!(error.contains("which is also specified, with different values"), "{error}");
}

#[test]
fn resources_are_found_when_the_path_has_special_characters() {
    // An instance receives its resources as a URI. A folder name with blanks and braces must not cause a
    // failure.
    let folder = evil(&[]);
    let odd = tempfile::Builder::new().prefix("a b {c} \u{e4} 100%").tempdir().unwrap();
    let copy = odd.path().join("model");
    let place = fmi::platform::find_binary(folder.path(), "evil", fmi::platform::FolderNames::SystemAndBits)
        .unwrap()
        .path;
    let target = copy.join(place.strip_prefix(folder.path()).unwrap());
    std::fs::create_dir_all(target.parent().unwrap()).unwrap();
    std::fs::copy(&place, &target).unwrap();
    std::fs::copy(folder.path().join("modelDescription.xml"), copy.join("modelDescription.xml")).unwrap();
    let result = fmi::Fmu::open(&copy).unwrap().simulate(&SimulateOptions::new()).unwrap();
    assert!((result.final_value("y").unwrap().unwrap() - (-1f64).exp()).abs() < 1e-5);
}

#[test]
fn constant_parameter_keeps_its_value() {
    let folder = evil_with(&[], |xml| {
        xml.replace(
            "name=\"c\" valueReference=\"4\" variability=\"constant\"",
            "name=\"c\" valueReference=\"4\" causality=\"parameter\" variability=\"constant\"",
        )
    });
    let fmu = folder.open();
    assert_eq!(fmu.description().quirks[0].kind, QuirkKind::Combination);
    let mut session = fmi::Session::new(fmu);
    assert!(matches!(session.set("c", 1.0), Err(FmiError::NotSettable { .. })));
    assert_eq!(session.get("c").unwrap(), Value::Real(2.5));
    session.simulate(&SimulateOptions::new()).unwrap();
    assert_eq!(session.get("c").unwrap(), Value::Real(2.5));
}
