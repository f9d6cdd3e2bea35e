//! Messages of failed runs: the value that was not finite, and a system whose index is too high.

#![allow(clippy::unwrap_used, clippy::panic)]

use ode::*;

/// `x_i' = 1`, with one kind of value that is not finite after a certain time.
struct Bad {
    what: Evaluated,
    value: f64,
    from: f64,
    refuses: bool,
}

impl Bad {
    fn spoil(&self, what: Evaluated, t: f64, values: &mut [f64]) -> CallResult<()> {
        if what == self.what && t >= self.from {
            values[2] = self.value;
            if self.refuses {
                return Err(CallError::Discard);
            }
        }
        Ok(())
    }
}

impl HybridSystem for Bad {
    fn n_states(&self) -> usize {
        3
    }
    fn n_event_indicators(&self) -> usize {
        3
    }
    fn start(&mut self, t0: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.fill(0.0);
        self.spoil(Evaluated::State, t0, x)?;
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, t: f64, _: &[f64], dx: &mut [f64]) -> CallResult<()> {
        dx.fill(1.0);
        self.spoil(Evaluated::Derivative, t, dx)
    }
    fn event_indicators(&mut self, t: f64, _: &[f64], z: &mut [f64]) -> CallResult<()> {
        z.fill(1.0);
        self.spoil(Evaluated::EventIndicator, t, z)
    }
    fn has_jacobian(&self) -> bool {
        self.what == Evaluated::Jacobian
    }
    fn jacobian(&mut self, t: f64, _: &[f64], j: &mut [f64]) -> CallResult<bool> {
        self.spoil(Evaluated::Jacobian, t, j)?;
        Ok(true)
    }
}

#[test]
fn error_reports_non_finite_value() {
    for method in Method::ALL {
        let name = method.name();
        assert_eq!(name.parse(), Ok(method));
        for what in [Evaluated::State, Evaluated::Derivative, Evaluated::EventIndicator, Evaluated::Jacobian]
        {
            for from in [0.0, 0.625] {
                for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                    for refuses in [false, true] {
                        let implicit = matches!(method, Method::Radau5 | Method::Bdf);
                        if (what == Evaluated::Jacobian && !(implicit && from == 0.0))
                            || (what == Evaluated::State && from > 0.0)
                        {
                            continue;
                        }
                        let mut driver = Driver::new(Options { method, ..Options::default() }).unwrap();
                        let mut bad = Bad { what, value, from, refuses };
                        let error = driver.run(&mut bad, 0.0, 1.0, &[], &mut Ignore).unwrap_err();
                        let Some(found) = &error.not_finite else {
                            panic!("{name} {what:?} {from}: {error}")
                        };
                        assert_eq!((found.what, found.index), (what, 2), "{name}: {error}");
                        assert!(found.value.to_bits() == value.to_bits(), "{name}: {error}");
                        assert!((found.time - from).abs() < 0.01, "{name} {what:?} {from}: {error}");
                        assert!(error.to_string().contains(&found.to_string()), "{error}");
                        if from == 0.0 && what == Evaluated::Derivative {
                            let text =
                                format!("the derivative of state 2 is {} at t = 0", base::Number(value));
                            assert_eq!(error.to_string(), text);
                            assert!(matches!(error.kind, ErrorKind::DiscardedAtRestart));
                        }
                    }
                }
            }
        }
    }
}

/// `M x' = f`, defined by closures.
struct Dae {
    x0: Vec<f64>,
    mass: Vec<f64>,
    f: fn(f64, &[f64], &mut [f64]),
}

impl HybridSystem for Dae {
    fn n_states(&self) -> usize {
        self.x0.len()
    }
    fn mass_matrix(&self) -> Option<&[f64]> {
        Some(&self.mass)
    }
    fn start(&mut self, _: f64, x: &mut [f64]) -> CallResult<EventOutcome> {
        x.copy_from_slice(&self.x0);
        Ok(EventOutcome::default())
    }
    fn derivatives(&mut self, t: f64, x: &[f64], dx: &mut [f64]) -> CallResult<()> {
        (self.f)(t, x, dx);
        Ok(())
    }
}

type System = (Vec<f64>, Vec<f64>, fn(f64, &[f64], &mut [f64]));

fn diagonal(entries: &[f64]) -> Vec<f64> {
    let n = entries.len();
    (0..n * n).map(|p| if p % (n + 1) == 0 { entries[p / n] } else { 0.0 }).collect()
}

#[test]
fn error_reports_higher_index_only_for_index_above_one() {
    const G: f64 = 9.81;
    let ones = [1.0, 1.0, 1.0, 1.0, 0.0];
    let high: [System; 4] = [
        // x = sin t determines y = cos t only after differentiation.
        (vec![0.0, 1.0], vec![1.0, 0.0], |t, x, d| d.copy_from_slice(&[x[1], x[0] - t.sin()])),
        // The pendulum with a constraint on its length has index 3.
        (vec![1.0, 0.0, 0.0, 0.0, 0.0], ones.to_vec(), |_, x, d| {
            d.copy_from_slice(&[x[2], x[3], -x[0] * x[4], -x[1] * x[4] - G, x[0] * x[0] + x[1] * x[1] - 1.0]);
        }),
        // With a constraint on the speed along the rod, it has index 2. The start is not consistent.
        (vec![1.0, 0.0, 0.3, 0.0, 0.0], ones.to_vec(), |_, x, d| {
            d.copy_from_slice(&[x[2], x[3], -x[0] * x[4], -x[1] * x[4] - G, x[0] * x[2] + x[1] * x[3]]);
        }),
        // An equation that does not contain any state.
        (vec![0.0, 1.0], vec![1.0, 0.0], |t, x, d| d.copy_from_slice(&[x[1], (20.0 * t).sin()])),
    ];
    for method in [Method::Radau5, Method::Auto, Method::Bdf] {
        for (i, (x0, mass, f)) in high.iter().enumerate() {
            let mut driver = Driver::new(Options { method, ..Options::default() }).unwrap();
            let mut dae = Dae { x0: x0.clone(), mass: diagonal(mass), f: *f };
            let error = driver.run(&mut dae, 0.0, 5.0, &[], &mut Ignore).unwrap_err();
            let found = error.undetermined.as_ref().map(|u| (u.equation, u.states.clone()));
            assert_eq!(found, Some((x0.len() - 1, vec![x0.len() - 1])), "{i}: {error}");
            assert!(error.to_string().contains("the system probably has index 2 or higher"), "{i}: {error}");
        }
    }
    let low: [System; 4] = [
        // The solution of x = y^2 ends when y is 0.
        (vec![1.0, 1.0], vec![1.0, 0.0], |_, x, d| d.copy_from_slice(&[-1.0, x[1] * x[1] - x[0]])),
        // x' = y, y = x^2: infinite at t = 1.
        (vec![1.0, 1.0], vec![1.0, 0.0], |_, x, d| d.copy_from_slice(&[x[1], x[0] * x[0] - x[1]])),
        // The start is not consistent, and no consistent states exist.
        (vec![1.0, 2.0], vec![1.0, 0.0], |_, x, d| d.copy_from_slice(&[-x[0], x[1] * x[1] + 1.0])),
        // The algebraic state is a million times as large as the other one.
        (vec![1.0, 1e6], vec![1.0, 0.0], |_, x, d| {
            d.copy_from_slice(&[1e-12 * x[1] * x[1], 1e-6 * x[1] - x[0]])
        }),
    ];
    for method in [Method::Radau5, Method::Bdf] {
        for (i, (x0, mass, f)) in low.iter().enumerate() {
            let mut dae = Dae { x0: x0.clone(), mass: diagonal(mass), f: *f };
            let mut driver = Driver::new(Options { method, ..Options::default() }).unwrap();
            let error = driver.run(&mut dae, 0.0, 5.0, &[], &mut Ignore).unwrap_err();
            assert!(error.undetermined.is_none() && !error.to_string().contains("index 2"), "{i}: {error}");
        }
    }
}
