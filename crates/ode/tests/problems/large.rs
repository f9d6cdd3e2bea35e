//! Larger problems and stiff oscillators: a circuit, a beam, and partial differential equations on a grid,
//! with the pattern of their Jacobian. Their references were computed with two of our methods at tight
//! tolerances, which agree in all digits that the tests require.

use super::Problem;
use ode::JacobianPattern;
use std::f64::consts::PI;

/// The ring modulator of the test set of Bari and CWI (F. Mazzia, C. Magherini, problem II-12); its published values.
pub fn ring_modulator() -> Problem {
    Problem {
        name: "Ring modulator",
        x0: vec![0.0; 15],
        end: 1e-3,
        f: |t, y, d| {
            const C: f64 = 1.6e-8;
            const CS: f64 = 2e-12;
            const CP: f64 = 1e-8;
            const LH: f64 = 4.45;
            const LS1: f64 = 2e-3;
            const LS2: f64 = 5e-4;
            let q = |u: f64| 40.67286402e-9 * ((17.7493332 * u).exp() - 1.0);
            let (one, two) = (0.5 * (2e3 * PI * t).sin(), 2.0 * (2e4 * PI * t).sin());
            let q1 = q(y[2] - y[4] - y[6] - two);
            let q2 = q(-y[3] + y[5] - y[6] - two);
            let q3 = q(y[3] + y[4] + y[6] + two);
            let q4 = q(-y[2] - y[5] + y[6] + two);
            d[0] = (y[7] - 0.5 * y[9] + 0.5 * y[10] + y[13] - y[0] / 25e3) / C;
            d[1] = (y[8] - 0.5 * y[11] + 0.5 * y[12] + y[14] - y[1] / 25e3) / C;
            d[2] = (y[9] - q1 + q4) / CS;
            d[3] = (-y[10] + q2 - q3) / CS;
            d[4] = (y[11] + q1 - q3) / CS;
            d[5] = (-y[12] - q2 + q4) / CS;
            d[6] = (-y[6] / 50.0 + q1 + q2 - q3 - q4) / CP;
            d[7] = -y[0] / LH;
            d[8] = -y[1] / LH;
            d[9] = (0.5 * y[0] - y[2] - 17.3 * y[9]) / LS2;
            d[10] = (-0.5 * y[0] + y[3] - 17.3 * y[10]) / LS2;
            d[11] = (0.5 * y[1] - y[4] - 17.3 * y[11]) / LS2;
            d[12] = (-0.5 * y[1] + y[5] - 17.3 * y[12]) / LS2;
            d[13] = (-y[0] + one - (50.0 + 36.3) * y[13]) / LS1;
            d[14] = (-y[1] - (600.0 + 36.3) * y[14]) / LS1;
        },
        reference: vec![
            -0.2339057358486745e-1,
            -0.7367485485540825e-2,
            0.2582956709291169,
            -0.4064465721283450,
            -0.4039455665149794,
            0.2607966765422943,
            0.1106761861269975,
            0.2939904342435596e-6,
            -0.2840029933642329e-7,
            0.7267198267264553e-3,
            0.7929487196960840e-3,
            -0.7255283495698965e-3,
            -0.7941401968526521e-3,
            0.7088495416976114e-4,
            0.2390059075236570e-4,
        ],
        atol: 1e-2,
        by_largest: true,
        ..Problem::default()
    }
}

/// Solves a tridiagonal system whose neighbours on both sides are `-c` and whose diagonal is `d`, in place of `b`.
fn solve_tridiagonal(d: impl Fn(usize) -> f64, c: &[f64], b: &mut [f64]) {
    let n = b.len();
    let mut pivot = vec![0.0; n];
    pivot[0] = d(0);
    for i in 1..n {
        let factor = c[i - 1] / pivot[i - 1];
        pivot[i] = d(i) - factor * c[i - 1];
        b[i] += factor * b[i - 1];
    }
    b[n - 1] /= pivot[n - 1];
    for i in (0..n - 1).rev() {
        b[i] = (b[i] + c[i] * b[i + 1]) / pivot[i];
    }
}

/// An elastic inextensible beam of 40 elements, clamped at one end, with a force at the other (the same test set, problem
/// II-3): eigenvalues up to 6400 i.
pub fn beam() -> Problem {
    Problem {
        name: "BEAM",
        x0: vec![0.0; 80],
        end: 5.0,
        f: |t, y, d| {
            const N: usize = 40;
            let (x, v) = y.split_at(N);
            let (n2, n4) = ((N * N) as f64, (N * N * N * N) as f64);
            let (mut s, mut c) = ([0.0; N], [0.0; N]);
            for i in 0..N - 1 {
                (s[i], c[i]) = (x[i + 1] - x[i]).sin_cos();
            }
            let force = if t <= PI { 1.5 * t.sin().powi(2) } else { 0.0 };
            let mut a = [0.0; N];
            for i in 0..N {
                let bend = match i {
                    0 => -3.0 * x[0] + x[1],
                    _ if i == N - 1 => x[N - 2] - x[N - 1],
                    _ => x[i - 1] - 2.0 * x[i] + x[i + 1],
                };
                a[i] = n4 * bend + n2 * force * (x[i].cos() + x[i].sin());
            }
            let mut w = [0.0; N];
            for i in 0..N {
                w[i] = v[i] * v[i];
                if i > 0 {
                    w[i] -= s[i - 1] * a[i - 1];
                }
                if i + 1 < N {
                    w[i] += s[i] * a[i + 1];
                }
            }
            let diagonal = |i| {
                if i == 0 {
                    1.0
                } else if i == N - 1 {
                    3.0
                } else {
                    2.0
                }
            };
            solve_tridiagonal(diagonal, &c, &mut w);
            d[..N].copy_from_slice(v);
            for i in 0..N {
                let mut u = diagonal(i) * a[i];
                if i > 0 {
                    u -= c[i - 1] * a[i - 1] + s[i - 1] * w[i - 1];
                }
                if i + 1 < N {
                    u += -c[i] * a[i + 1] + s[i] * w[i + 1];
                }
                d[N + i] = u;
            }
        },
        reference: vec![
            -0.005792366591184204,
            -0.04790616859740768,
            -0.08335219765405573,
            -0.11231503954101586,
            -0.13508851806088557,
            -0.15210194290019882,
            -0.163935123819217,
            -0.17132637824400412,
            -0.17517781878633157,
            -0.1765606097564571,
            0.037473626695341544,
            0.3121293828527397,
            0.546467784404498,
            0.7406572675989171,
            0.8955175497572481,
            1.012816579717422,
            1.0954902221825071,
            1.147818024700386,
            1.1754674248072816,
            1.1855439092994118,
        ],
        stride: 4,
        atol: 1e-2,
        by_largest: true,
        ..Problem::default()
    }
}

/// Penetration of radio-labelled antibodies into a tumour (the same test set, problem II-11, Medical Akzo
/// Nobel): 200 cells of a transformed line, 400 states. The supply at the border ends at `t = 5`.
pub fn medical_akzo() -> Problem {
    const CELLS: usize = 200;
    let near = |j: usize| {
        let (u, v) = (2 * j, 2 * j + 1);
        let left = (j > 0).then(|| (u, u - 2));
        let right = (j + 1 < CELLS).then(|| (u, u + 2));
        [(u, u), (u, v), (v, u), (v, v)].into_iter().chain(left).chain(right)
    };
    Problem {
        name: "Medical Akzo",
        x0: [0.0, 1.0].repeat(CELLS),
        end: 20.0,
        f: |t, y, d| {
            let width = 1.0 / CELLS as f64;
            let border = if t <= 5.0 { 2.0 } else { 0.0 };
            for j in 0..CELLS {
                let z = (j + 1) as f64 * width - 1.0;
                let (alpha, beta) = (2.0 * z.powi(3) / 16.0, z.powi(4) / 16.0);
                let u = y[2 * j];
                let left = if j > 0 { y[2 * j - 2] } else { border };
                let right = if j + 1 < CELLS { y[2 * j + 2] } else { u };
                let reaction = 100.0 * u * y[2 * j + 1];
                let diffusion = (left - 2.0 * u + right) / (width * width);
                d[2 * j] = alpha * (right - left) / (2.0 * width) + beta * diffusion - reaction;
                d[2 * j + 1] = -reaction;
            }
        },
        pattern: JacobianPattern::new(2 * CELLS, (0..CELLS).flat_map(near)),
        reference: vec![
            5.113983853928055e-6,
            0.00011724447555108105,
            0.0002400413321651873,
            0.00034163362979402096,
            0.00034092852559636515,
            9.774701207424735e-5,
            2.0773242155726386e-12,
            7.126950356643178e-26,
            1.383176734571238e-48,
            6.34458406794593e-89,
        ],
        stride: 40,
        atol: 1e-2,
        by_largest: true,
    }
}

/// Two chemicals that react and diffuse on a line of `N` points (E. Hairer, G. Wanner, Solving Ordinary Differential Equations II,
/// section IV.10, problem BRUSS): stiff by diffusion.
pub fn brusselator_line() -> Problem {
    const POINTS: usize = 200;
    let near = |j: usize| {
        let (u, v) = (2 * j, 2 * j + 1);
        let left = (j > 0).then(|| [(u, u - 2), (v, v - 2)]);
        let right = (j + 1 < POINTS).then(|| [(u, u + 2), (v, v + 2)]);
        [(u, u), (u, v), (v, u), (v, v)].into_iter().chain(left.into_iter().chain(right).flatten())
    };
    let start = |j: usize| [1.0 + (2.0 * PI * (j + 1) as f64 / (POINTS + 1) as f64).sin(), 3.0];
    Problem {
        name: "Brusselator line",
        x0: (0..POINTS).flat_map(start).collect(),
        end: 10.0,
        f: |_, y, d| {
            let scale = 0.02 * ((POINTS + 1) * (POINTS + 1)) as f64;
            for j in 0..POINTS {
                let (u, v) = (y[2 * j], y[2 * j + 1]);
                let left = if j > 0 { [y[2 * j - 2], y[2 * j - 1]] } else { [1.0, 3.0] };
                let right = if j + 1 < POINTS { [y[2 * j + 2], y[2 * j + 3]] } else { [1.0, 3.0] };
                d[2 * j] = 1.0 + u * u * v - 4.0 * u + scale * (left[0] - 2.0 * u + right[0]);
                d[2 * j + 1] = 3.0 * u - u * u * v + scale * (left[1] - 2.0 * v + right[1]);
            }
        },
        pattern: JacobianPattern::new(2 * POINTS, (0..POINTS).flat_map(near)),
        reference: vec![
            0.9871026625099428,
            0.7472308975395919,
            0.5786790487389177,
            0.4849333464225315,
            0.44171131414151427,
            0.4298665289665645,
            0.4432404391963721,
            0.48875576044054647,
            0.5861136917161078,
            0.7587900004557918,
        ],
        stride: 40,
        atol: 1e-2,
        by_largest: true,
    }
}

/// Heat on a square of 32 by 32 inner points with cold borders, from a hot corner.
pub fn heat() -> Problem {
    const SIDE: usize = 32;
    let near = |p: usize| {
        let (i, j) = (p / SIDE, p % SIDE);
        let up = (i > 0).then(|| (p, p - SIDE));
        let down = (i + 1 < SIDE).then(|| (p, p + SIDE));
        let left = (j > 0).then(|| (p, p - 1));
        let right = (j + 1 < SIDE).then(|| (p, p + 1));
        [Some((p, p)), up, down, left, right].into_iter().flatten()
    };
    let start = |p: usize| if p / SIDE < SIDE / 2 && p % SIDE < SIDE / 2 { 1.0 } else { 0.0 };
    Problem {
        name: "Heat",
        x0: (0..SIDE * SIDE).map(start).collect(),
        end: 0.2,
        f: |_, y, d| {
            let scale = ((SIDE + 1) * (SIDE + 1)) as f64;
            for p in 0..SIDE * SIDE {
                let (i, j) = (p / SIDE, p % SIDE);
                let mut sum = -4.0 * y[p];
                if i > 0 {
                    sum += y[p - SIDE];
                }
                if i + 1 < SIDE {
                    sum += y[p + SIDE];
                }
                if j > 0 {
                    sum += y[p - 1];
                }
                if j + 1 < SIDE {
                    sum += y[p + 1];
                }
                d[p] = scale * sum;
            }
        },
        pattern: JacobianPattern::new(SIDE * SIDE, (0..SIDE * SIDE).flat_map(near)),
        reference: vec![
            7.154170420370095e-5,
            0.0020269564929920702,
            0.004816545661419308,
            0.005527407817671664,
            0.0027416720618998864,
            0.0029215976833624085,
            0.006415709692448316,
            0.006289828089772198,
            0.003313367321633577,
            0.00027378435290540776,
        ],
        stride: 103,
        atol: 1e-2,
        by_largest: true,
    }
}

pub fn all() -> Vec<Problem> {
    vec![ring_modulator(), beam(), medical_akzo(), brusselator_line(), heat()]
}
