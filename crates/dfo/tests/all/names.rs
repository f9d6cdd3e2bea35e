//! Names of methods.
#![allow(clippy::unwrap_used)]

use dfo::AnyMethod;

#[test]
fn methods_accept_full_names_and_scipy_names() {
    let name = |requested: &str| requested.parse::<AnyMethod>().map(|method| method.name());
    for (requested, expected) in [
        ("differential_evolution", "de"),
        ("differential-evolution", "de"),
        ("DE", "de"),
        ("de_classic", "de-classic"),
        ("genetic", "ga"),
        ("Genetic Algorithm", "ga"),
        ("ga", "ga"),
        ("Nelder-Mead", "nelder-mead"),
        ("neldermead", "nelder-mead"),
        ("least_squares", "least-squares"),
        ("cma", "cma-es"),
        ("Auto", "auto"),
    ] {
        assert_eq!(name(requested).unwrap(), expected);
    }
    for (requested, hint) in [
        ("COBYQA", "did you mean 'quadratic-model'?"),
        ("L-BFGS-B", "did you mean 'quadratic-model'?"),
        ("simplex", "did you mean 'nelder-mead'?"),
        ("nelder-maed", "did you mean 'nelder-mead'?"),
        ("trf", "did you mean 'least-squares'?"),
        ("dual_annealing", "did you mean 'multistart'?"),
        ("", "unknown method ''; expected one of: nelder-mead (1), barrier (2), de,"),
    ] {
        assert!(
            name(requested).unwrap_err().to_string().contains(hint),
            "{requested}: {}",
            name(requested).unwrap_err()
        );
    }
}
