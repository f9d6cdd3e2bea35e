//! Jacobians of implicit methods: directional derivatives along the colors of the declared dependencies, or
//! differences without them. If declared directional derivatives are missing, differences are used.

#![allow(clippy::unwrap_used)]

use crate::support;

use fmi::ode::Method;
use fmi::{Fmu, Inputs, SimulateOptions, Trajectory};
use std::fs;
use support::{Folder, model};

fn edited(name: &str, edit: impl Fn(&str) -> String) -> Folder {
    let folder = model(name);
    let path = folder.path().join("modelDescription.xml");
    let text = fs::read_to_string(&path).unwrap();
    let changed = edit(&text);
    assert_ne!(text, changed);
    fs::write(&path, changed).unwrap();
    folder
}

fn without(attribute: &str) -> impl Fn(&str) -> String {
    let start = format!(" {attribute}=\"");
    move |text| {
        let mut parts = text.split(&start);
        let mut rest = parts.next().unwrap().to_owned();
        for part in parts {
            rest += part.split_once('"').unwrap().1;
        }
        rest
    }
}

fn tanks(fmu: &Fmu, method: Method) -> Trajectory {
    let columns = [("u1", vec![5.0, 7.0, 5.0]), ("u2", vec![6.0, 5.0, 6.0])];
    let inputs = Inputs::new().table([0.0, 30.0, 60.0], columns);
    let options = SimulateOptions::new()
        .final_time(60.0)
        .inputs(inputs)
        .method(method)
        .relative_tolerance(1e-8)
        .outputs(["qt.x1", "qt.x2", "qt.x3", "qt.x4"]);
    fmu.simulate(&options).unwrap()
}

fn largest_difference(a: &Trajectory, b: &Trajectory) -> f64 {
    let pairs = a.columns.iter().flatten().zip(b.columns.iter().flatten());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn jacobian_uses_one_directional_derivative_per_color() {
    let folder = model("quad_tank");
    for method in [Method::Radau5, Method::Bdf] {
        let found = tanks(&folder.open(), method);
        assert!(found.stats.jacobians > 0);
        // Two tanks share a color, because each upper tank feeds only one lower tank.
        assert_eq!(found.stats.directional_derivatives, 2 * found.stats.jacobians, "{method:?}");

        let dense = tanks(&edited("quad_tank", without("dependencies")).open(), method);
        assert_eq!(dense.stats.directional_derivatives, 4 * dense.stats.jacobians, "{method:?}");
        assert!(largest_difference(&found, &dense) < 1e-9);

        let none = tanks(&edited("quad_tank", without("providesDirectionalDerivative")).open(), method);
        assert_eq!(none.stats.directional_derivatives, 0);
        assert!(largest_difference(&found, &none) < 1e-9);
        assert!(largest_difference(&found, &tanks(&folder.open(), Method::Dop853)) < 1e-7);
    }
}

#[test]
fn jacobian_uses_differences_when_directional_derivatives_are_missing() {
    let promise =
        |text: &str| text.replace("<ModelExchange", "<ModelExchange providesDirectionalDerivative=\"true\"");
    let folder = support::evil_with(&[], |text| promise(&text));
    let options = SimulateOptions::new().final_time(1.0).method(Method::Radau5).outputs(["x"]);
    let found = folder.open().simulate(&options).unwrap();
    assert!(found.stats.jacobians > 0 && found.stats.directional_derivatives == 0);
    // x' = -k x with k = 1.
    assert!((found.final_value("x").unwrap().unwrap() - (-1.0_f64).exp()).abs() < 1e-5);
}
