//! Butcher tableaux as data: coefficients, order, error weights and continuous extension, with their sources.

use std::fmt::Debug;

/// The nonzero weights and the stages they belong to.
pub(crate) type StageWeights = &'static [(usize, f64)];

/// An explicit Runge-Kutta method with `S` stages. Stage `end` is the right-hand side at the end of the step
/// (first same as last), so the next step reuses it as its first stage.
#[derive(Debug)]
pub(crate) struct Tableau<const S: usize> {
    /// Order of the propagated solution.
    pub(crate) order: u32,
    /// Index of the stage at the end of the step. Later stages belong to the continuous extension.
    pub(crate) end: usize,
    /// Abscissae.
    pub(crate) c: [f64; S],
    /// Stage weights. Each row uses only earlier stages. Row `end` is the solution itself.
    pub(crate) a: [StageWeights; S],
    /// Error estimate for the step-size controller.
    pub(crate) error: Estimate,
    /// Continuous extension of the step.
    pub(crate) dense: Dense<S>,
}

/// A method whose coefficients are known at compile time, for efficient sums of its stages.
pub(crate) trait Explicit<const S: usize>: Debug + Send + Sync {
    const TABLEAU: Tableau<S>;
}

/// Returns the weights of a stage; empty if the method has no such stage.
pub(crate) const fn row<const S: usize, T: Explicit<S>>(stage: usize) -> StageWeights {
    if stage < S { T::TABLEAU.a[stage] } else { &[] }
}

/// Form of the error estimate of a step.
#[derive(Debug)]
pub(crate) enum Estimate {
    /// No estimate: the step size is fixed.
    None,
    /// Solution minus embedded solution.
    Embedded(StageWeights),
    /// Solution minus embedded solutions of order 5 and of order 3. The first is reduced if the second is
    /// still larger (Hairer, Norsett, Wanner I, section II.10).
    Two(StageWeights, StageWeights),
}

/// The continuous extension.
#[derive(Debug)]
pub(crate) enum Dense<const S: usize> {
    /// Coefficients of `theta, theta^2, theta^3, theta^4` per stage: `x(t + theta h) = x + h * sum_i (sum_k
    /// p[i][k] theta^(k+1)) k_i`.
    Polynomials([[f64; 4]; S]),
    /// Weights of the four highest of the seven terms of dop853.f. They use stages after the end, which are
    /// evaluated only for steps that contain samples or events.
    Terms([StageWeights; 4]),
}

/// Tsitouras 5(4): Ch. Tsitouras, Runge-Kutta pairs of order 5(4) satisfying only the first column
/// simplifying assumption, Computers and Mathematics with Applications 62 (2011) 770-775, with its free
/// interpolant of order 4.
#[derive(Debug)]
pub(crate) struct Tsit5;

#[rustfmt::skip]
impl Explicit<7> for Tsit5 {
    const TABLEAU: Tableau<7> = Tableau {
        order: 5,
        end: 6,
        c: [0.0, 0.161, 0.327, 0.9, 0.980_025_540_904_509_7, 1.0, 1.0],
        a: [
            &[],
            &[(0, 0.161)],
            &[(0, -0.008_480_655_492_356_989), (1, 0.335_480_655_492_357)],
            &[(0, 2.897_153_057_105_493_5), (1, -6.359_448_489_975_075), (2, 4.362_295_432_869_581_5)],
            &[(0, 5.325_864_828_439_257), (1, -11.748_883_564_062_828), (2, 7.495_539_342_889_836_5), (3, -0.092_495_066_361_755_25)],
            &[(0, 5.861_455_442_946_42), (1, -12.920_969_317_847_11), (2, 8.159_367_898_576_159), (3, -0.071_584_973_281_401), (4, -0.028_269_050_394_068_383)],
            &[(0, 0.096_460_766_818_065_23), (1, 0.01), (2, 0.479_889_650_414_499_6), (3, 1.379_008_574_103_742), (4, -3.290_069_515_436_081), (5, 2.324_710_524_099_774)],
        ],
        error: Estimate::Embedded(&[
            (0, -0.001_780_011_052_225_777), (1, -0.000_816_434_459_656_746_9), (2, 0.007_880_878_010_261_995), (3, -0.144_711_007_173_262_9),
            (4, 0.582_357_165_452_555_2), (5, -0.458_082_105_929_186_97), (6, 1.0 / 66.0),
        ]),
        dense: Dense::Polynomials([
            [1.0, -2.763_706_197_274_826, 2.913_255_461_821_912_6, -1.053_088_497_729_021_6],
            [0.0, 0.131_7, -0.223_4, 0.101_7],
            [0.0, 3.930_296_236_894_751_6, -5.941_033_872_131_505, 2.490_627_285_651_253],
            [0.0, -12.411_077_166_933_676, 30.338_188_630_282_32, -16.548_102_889_244_902],
            [0.0, 37.509_313_416_511_04, -88.178_904_894_766_4, 47.379_521_962_819_28],
            [0.0, -27.896_526_289_197_286, 65.091_894_674_793_66, -34.870_657_861_496_61],
            [0.0, 1.5, -4.0, 2.5],
        ]),
    };
}

/// The classical method of order 4 (Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, table
/// II.1.2). Its continuous extension is the cubic Hermite polynomial through both ends, written as weights of
/// the stages.
#[derive(Debug)]
pub(crate) struct Rk4;

#[rustfmt::skip]
impl Explicit<5> for Rk4 {
    const TABLEAU: Tableau<5> = Tableau {
        order: 4,
        end: 4,
        c: [0.0, 0.5, 0.5, 1.0, 1.0],
        a: [
            &[],
            &[(0, 0.5)],
            &[(1, 0.5)],
            &[(2, 1.0)],
            &[(0, 1.0 / 6.0), (1, 1.0 / 3.0), (2, 1.0 / 3.0), (3, 1.0 / 6.0)],
        ],
        error: Estimate::None,
        dense: Dense::Polynomials([
            [1.0, -1.5, 2.0 / 3.0, 0.0],
            [0.0, 1.0, -2.0 / 3.0, 0.0],
            [0.0, 1.0, -2.0 / 3.0, 0.0],
            [0.0, 0.5, -1.0 / 3.0, 0.0],
            [0.0, -1.0, 1.0, 0.0],
        ]),
    };
}

/// The explicit Euler method, with linear interpolation.
#[derive(Debug)]
pub(crate) struct Euler;

impl Explicit<2> for Euler {
    const TABLEAU: Tableau<2> = Tableau {
        order: 1,
        end: 1,
        c: [0.0, 1.0],
        a: [&[], &[(0, 1.0)]],
        error: Estimate::None,
        dense: Dense::Polynomials([[1.0, 0.0, 0.0, 0.0], [0.0; 4]]),
    };
}

/// Rearranges the polynomial coefficients from per stage to per power, which is faster to evaluate.
pub(crate) fn by_power<const S: usize>(polynomials: &[[f64; 4]; S]) -> [[f64; S]; 4] {
    std::array::from_fn(|power| polynomials.map(|coefficients| coefficients[power]))
}

/// Evaluates the polynomial weights of the stages at `theta`.
#[inline]
pub(crate) fn polynomial_weights<const S: usize>(p: &[[f64; S]; 4], theta: f64) -> [f64; S] {
    std::array::from_fn(|i| theta * (p[0][i] + theta * (p[1][i] + theta * (p[2][i] + theta * p[3][i]))))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest violation of the order conditions (Hairer, Norsett, Wanner I, table II.2.1): for every rooted
    /// tree up to order 5, the elementary weight of `b` must be `theta^order / gamma(tree)`.
    fn defects<const S: usize>(t: &Tableau<S>, b: [f64; S], theta: f64, order: u32) -> f64 {
        let dot = |u: &[f64; S], v: &[f64; S]| (0..S).map(|i| u[i] * v[i]).sum::<f64>();
        let mul = |u: &[f64; S], v: &[f64; S]| std::array::from_fn::<f64, S, _>(|i| u[i] * v[i]);
        let app = |v: &[f64; S]| std::array::from_fn::<f64, S, _>(|i| dot(&row(t.a[i]), v));
        let one = [1.0; S];
        let c = t.c;
        let (c2, ac) = (mul(&c, &c), app(&c));
        let (c3, ac2, aac) = (mul(&c2, &c), app(&c2), app(&ac));
        let trees: Vec<(u32, f64, [f64; S])> = vec![
            (1, 1.0, one),
            (2, 2.0, c),
            (3, 3.0, c2),
            (3, 6.0, ac),
            (4, 4.0, c3),
            (4, 8.0, mul(&c, &ac)),
            (4, 12.0, ac2),
            (4, 24.0, aac),
            (5, 5.0, mul(&c3, &c)),
            (5, 10.0, mul(&c2, &ac)),
            (5, 20.0, mul(&ac, &ac)),
            (5, 15.0, mul(&c, &ac2)),
            (5, 30.0, mul(&c, &aac)),
            (5, 20.0, app(&c3)),
            (5, 40.0, app(&mul(&c, &ac))),
            (5, 60.0, app(&ac2)),
            (5, 120.0, app(&aac)),
        ];
        trees
            .iter()
            .filter(|(o, ..)| *o <= order)
            .map(|(o, gamma, phi)| (dot(&b, phi) - theta.powi(*o as i32) / gamma).abs())
            .fold(0.0, f64::max)
    }

    fn row<const S: usize>(weights: StageWeights) -> [f64; S] {
        let mut row = [0.0; S];
        weights.iter().for_each(|(j, w)| row[*j] = *w);
        row
    }

    fn check<const S: usize>(t: &Tableau<S>, dense_order: u32) {
        for i in 0..S {
            let sum: f64 = t.a[i].iter().map(|(_, w)| w).sum();
            assert!((sum - t.c[i]).abs() < 1e-14, "row {i} sums to {sum}, c = {}", t.c[i]);
        }
        assert!(defects(t, row(t.a[S - 1]), 1.0, t.order) < 2e-15 * 100.0);
        let Dense::Polynomials(polynomials) = &t.dense else { unreachable!() };
        for theta in [0.1, 0.35, 0.5, 0.77, 1.0] {
            let d = defects(t, polynomial_weights(&by_power(polynomials), theta), theta, dense_order);
            assert!(d < 1e-13, "dense output at {theta}: {d:e}");
        }
        let (at_end, solution): (_, [f64; S]) =
            (polynomial_weights(&by_power(polynomials), 1.0), row(t.a[S - 1]));
        for (i, w) in at_end.iter().enumerate() {
            assert!((w - solution[i]).abs() < 1e-13, "dense output ends elsewhere at stage {i}: {w}");
        }
    }

    #[test]
    fn tableaux_satisfy_order_conditions() {
        check(&Tsit5::TABLEAU, 4);
        check(&Rk4::TABLEAU, 3);
        check(&Euler::TABLEAU, 1);
    }

    #[test]
    fn tsit5_embedded_method_has_order_four() {
        let Estimate::Embedded(error) = Tsit5::TABLEAU.error else { unreachable!() };
        let (b, e): ([f64; 7], [f64; 7]) = (row(Tsit5::TABLEAU.a[6]), row(error));
        let hat: [f64; 7] = std::array::from_fn(|i| b[i] - e[i]);
        assert!(defects(&Tsit5::TABLEAU, hat, 1.0, 4) < 1e-13);
        assert!(defects(&Tsit5::TABLEAU, hat, 1.0, 5) > 1e-5);
    }
}
