//! Opening of large model descriptions: 1 000 to 100 000 variables, all three versions. The time must grow
//! linearly with the number of variables. `cargo bench -p fmufit-fmi --bench open`.

#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

use fmi::ModelDescription;
use std::fmt::Write;
use std::hint::black_box;
use std::time::Instant;

fn version_1(n: usize) -> String {
    let mut text =
        "<fmiModelDescription fmiVersion=\"1.0\" modelName=\"m\" modelIdentifier=\"m\" guid=\"{1}\" \
                    numberOfContinuousStates=\"0\" numberOfEventIndicators=\"0\">\n<ModelVariables>\n"
            .to_owned();
    for i in 0..n {
        writeln!(
            text,
            "<ScalarVariable name=\"plant.stage[{i}].massFlowRate\" valueReference=\"{i}\" description=\"mass flow rate \
             of stage {i}\"><Real unit=\"kg/s\" min=\"0\"/></ScalarVariable>"
        )
        .unwrap();
    }
    text + "</ModelVariables></fmiModelDescription>"
}

fn version_2(n: usize) -> String {
    let mut text = "<fmiModelDescription fmiVersion=\"2.0\" modelName=\"m\" guid=\"{1}\"><ModelExchange \
                    modelIdentifier=\"m\"/>\n<ModelVariables>\n"
        .to_owned();
    for i in 1..=n {
        let derivative = if i % 2 == 0 { format!(" derivative=\"{}\"", i - 1) } else { String::new() };
        writeln!(
            text,
            "<ScalarVariable name=\"plant.stage[{i}].massFlowRate\" valueReference=\"{i}\" description=\"mass flow rate \
             of stage {i}\"><Real unit=\"kg/s\" min=\"0\"{derivative}/></ScalarVariable>"
        )
        .unwrap();
    }
    text += "</ModelVariables><ModelStructure><Derivatives>\n";
    for i in 1..=n / 2 {
        writeln!(text, "<Unknown index=\"{}\" dependencies=\"{} 1\"/>", 2 * i, 2 * i - 1).unwrap();
    }
    text + "</Derivatives></ModelStructure></fmiModelDescription>"
}

fn version_3(n: usize) -> String {
    let mut text =
        "<fmiModelDescription fmiVersion=\"3.0\" modelName=\"m\" instantiationToken=\"{1}\"><ModelExchange \
                    modelIdentifier=\"m\"/>\n<ModelVariables>\n"
            .to_owned();
    for i in 1..=n {
        let derivative = if i % 2 == 0 { format!(" derivative=\"{}\"", i - 1) } else { String::new() };
        writeln!(
            text,
            "<Float64 name=\"plant.stage[{i}].massFlowRate\" valueReference=\"{i}\" description=\"mass flow rate of \
             stage {i}\" unit=\"kg/s\" min=\"0\"{derivative}/>"
        )
        .unwrap();
    }
    text += "</ModelVariables><ModelStructure>\n";
    for i in 1..=n / 2 {
        writeln!(
            text,
            "<ContinuousStateDerivative valueReference=\"{}\" dependencies=\"{}\"/>",
            2 * i,
            2 * i - 1
        )
        .unwrap();
    }
    text + "</ModelStructure></fmiModelDescription>"
}

/// Milliseconds: the minimum of five repetitions.
fn best(text: &str) -> f64 {
    let times = (0..5).map(|_| {
        let begin = Instant::now();
        black_box(ModelDescription::parse(text.as_bytes()).unwrap());
        1e3 * begin.elapsed().as_secs_f64()
    });
    times.fold(f64::INFINITY, f64::min)
}

fn main() {
    println!("{:<8} {:>12} {:>12} {:>12}", "FMI", "1 000 [ms]", "10 000", "100 000");
    for (name, write) in [("1.0", version_1 as fn(usize) -> String), ("2.0", version_2), ("3.0", version_3)] {
        let [small, middle, large] = [1_000, 10_000, 100_000].map(|n| best(&write(n)));
        println!("{name:<8} {small:>12.2} {middle:>12.1} {large:>12.1}");
    }
}
