//! Signals of a simulation as piecewise polynomials through Chebyshev points.
//!
//! Each piece interpolates the signals at 5 or 9 Chebyshev points of the second kind, including both ends of
//! the piece. The points of the smaller set belong to the larger one. Values between the points follow from
//! the barycentric formula (Berrut and Trefethen, SIAM Review 46, 2004, equations 4.2 and 5.4).

use std::f64::consts::PI;
use std::sync::LazyLock;

/// Largest number of points of a piece.
pub(crate) const MOST_POINTS: usize = 9;

/// Nonnegative points and weights of the Gauss-Legendre rule with 9 points on [-1, 1], which is exact for
/// polynomials of degree 17 (Abramowitz and Stegun, Handbook of Mathematical Functions, table 25.4). The
/// square of a piece has degree 16.
const GAUSS: [(f64, f64); 5] = [
    (0.0, 0.330_239_355_001_259_76),
    (0.324_253_423_403_808_9, 0.312_347_077_040_002_84),
    (0.613_371_432_700_590_4, 0.260_610_696_402_935_46),
    (0.836_031_107_326_635_8, 0.180_648_160_694_857_4),
    (0.968_160_239_507_626_1, 0.081_274_388_361_574_41),
];

/// Returns point `k` of `n` Chebyshev points in [0, 1], ascending. The ends and the middle are exact.
pub(crate) fn point(k: usize, n: usize) -> f64 {
    match 2 * k {
        0 => 0.0,
        twice if twice == n - 1 => 0.5,
        twice if twice == 2 * (n - 1) => 1.0,
        _ => 0.5 - 0.5 * (PI * k as f64 / (n - 1) as f64).cos(),
    }
}

/// Supported numbers of points: a straight line, a parabola, the smaller and the larger set of a piece.
const SIZES: [usize; 4] = [2, 3, 5, MOST_POINTS];

/// Everything about pieces with a number of points that does not depend on their values.
struct Rule {
    /// The points, and their weights in the barycentric formula.
    points: Vec<(f64, f64)>,
    /// Positions between which local extrema are searched for, each with the factors of the values at the
    /// points whose sum is the value of the polynomial.
    samples: Vec<(f64, Vec<f64>)>,
    /// The same for the points of the Gauss-Legendre rule on the whole piece, with their weights.
    gauss: Vec<(f64, f64, Vec<f64>)>,
}

static RULES: LazyLock<[Rule; 4]> = LazyLock::new(|| SIZES.map(Rule::new));

impl Rule {
    fn new(n: usize) -> Self {
        let sign = |k: usize| if k.is_multiple_of(2) { 1.0 } else { -1.0 };
        let weight = |k: usize| if k == 0 || k == n - 1 { 0.5 * sign(k) } else { sign(k) };
        let points: Vec<(f64, f64)> = (0..n).map(|k| (point(k, n), weight(k))).collect();
        let factors = |s: f64| -> Vec<f64> {
            let of = |of: usize| interpolate_at(&points, |k| f64::from(u8::from(k == of)), s);
            (0..n).map(of).collect()
        };
        let m = INTERVALS * (n - 1);
        let samples = (0..=m).map(|k| point(k, m + 1)).map(|s| (s, factors(s))).collect();
        let gauss = GAUSS.into_iter().flat_map(|(x, weight)| {
            let both = [0.5 - 0.5 * x, 0.5 + 0.5 * x];
            both.into_iter().take(if x == 0.0 { 1 } else { 2 }).map(move |s| (s, 0.5 * weight))
        });
        let gauss = gauss.map(|(s, weight)| (s, weight, factors(s))).collect();
        Self { points, samples, gauss }
    }

    /// Returns the rule for a number of points among [`SIZES`].
    fn of(n: usize) -> &'static Self {
        let [line, parabola, smaller, larger] = &*RULES;
        match n {
            2 => line,
            3 => parabola,
            5 => smaller,
            _ => larger,
        }
    }
}

/// Returns the value at `s` of the polynomial through values at points, by the barycentric formula.
fn interpolate_at(points: &[(f64, f64)], value: impl Fn(usize) -> f64, s: f64) -> f64 {
    let (mut above, mut below) = (0.0, 0.0);
    for (k, (point, weight)) in points.iter().enumerate() {
        let distance = s - point;
        if distance == 0.0 {
            return value(k);
        }
        let weight = weight / distance;
        above += weight * value(k);
        below += weight;
    }
    above / below
}

/// Returns the value at `s` in [0, 1] of the polynomial through values at `n` Chebyshev points.
pub(crate) fn interpolate(n: usize, value: impl Fn(usize) -> f64, s: f64) -> f64 {
    interpolate_at(&Rule::of(n).points, value, s)
}

/// Part of a simulation in which the signals are polynomials.
#[derive(Debug, Clone, Copy)]
struct Piece {
    start: f64,
    end: f64,
    /// Number of points.
    n: usize,
    /// Index of the first value.
    first: usize,
}

/// Signals over a simulation, piece by piece in the order of time.
#[derive(Debug, Clone, Default)]
pub(crate) struct Pieces {
    n_signals: usize,
    pieces: Vec<Piece>,
    /// Values at the points of all pieces; the signals of a point are adjacent.
    values: Vec<f64>,
}

impl Pieces {
    /// Removes all pieces and sets the number of signals.
    pub(crate) fn begin(&mut self, n_signals: usize) {
        self.n_signals = n_signals;
        self.pieces.clear();
        self.values.clear();
    }

    /// Removes the pieces that start at `time` or later.
    pub(crate) fn remove_from(&mut self, time: f64) {
        while let Some(piece) = self.pieces.last().filter(|piece| piece.start >= time) {
            self.values.truncate(piece.first);
            self.pieces.pop();
        }
    }

    /// Adds a piece with the values at its points, in the order of time.
    pub(crate) fn push(&mut self, start: f64, end: f64, values: &[f64]) {
        let n = values.len() / self.n_signals.max(1);
        self.pieces.push(Piece { start, end, n, first: self.values.len() });
        self.values.extend_from_slice(values);
    }

    /// Returns a signal.
    pub(crate) fn signal(&self, index: usize) -> SignalPieces<'_> {
        SignalPieces { all: self, index }
    }
}

/// One signal over a simulation.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SignalPieces<'a> {
    all: &'a Pieces,
    index: usize,
}

/// One piece of a signal.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SignalPiece<'a> {
    pub(crate) start: f64,
    pub(crate) end: f64,
    n: usize,
    values: &'a [f64],
    stride: usize,
}

impl<'a> SignalPieces<'a> {
    pub(crate) fn pieces(self) -> impl DoubleEndedIterator<Item = SignalPiece<'a>> {
        self.all.pieces.iter().map(move |piece| SignalPiece {
            start: piece.start,
            end: piece.end,
            n: piece.n,
            values: &self.all.values[piece.first + self.index..],
            stride: self.all.n_signals,
        })
    }

    /// Returns the start and the end of the simulation.
    pub(crate) fn span(self) -> Option<(f64, f64)> {
        Some((self.all.pieces.first()?.start, self.all.pieces.last()?.end))
    }

    /// Returns the value at the start.
    pub(crate) fn first(self) -> f64 {
        self.pieces().next().map_or(f64::NAN, |piece| piece.node(0))
    }

    /// Returns the integral of a function of time and of the signal. It is exact if the function is a
    /// polynomial in the signal and time whose degree in time is at most 17 on each piece.
    pub(crate) fn integral(self, of: impl Fn(f64, f64) -> f64) -> f64 {
        self.pieces().map(|piece| piece.integral(0.0, 1.0, &of)).sum()
    }

    /// Returns the integral like [`integral`](Self::integral) for a function with a kink at the zeros of the
    /// signal.
    pub(crate) fn integral_between_zeros(self, of: impl Fn(f64, f64) -> f64) -> f64 {
        let of_piece = |piece: SignalPiece<'_>| {
            let (mut sum, mut from) = (0.0, 0.0);
            piece.crossings(0.0, |zero| {
                sum += piece.integral(from, zero, &of);
                from = zero;
                true
            });
            sum + piece.integral(from, 1.0, &of)
        };
        self.pieces().map(of_piece).sum()
    }

    /// Returns the largest value.
    pub(crate) fn max(self) -> f64 {
        self.pieces().map(|piece| piece.max(1.0)).fold(f64::NEG_INFINITY, larger)
    }

    /// Returns the smallest value.
    pub(crate) fn min(self) -> f64 {
        -self.pieces().map(|piece| piece.max(-1.0)).fold(f64::NEG_INFINITY, larger)
    }

    /// Returns the first time at which the signal reaches or jumps across a level.
    pub(crate) fn first_crossing(self, level: f64) -> Option<f64> {
        let mut before = None;
        for piece in self.pieces() {
            let begin = piece.node(0) - level;
            if begin == 0.0 || before.is_some_and(|before: f64| before * begin < 0.0) {
                return Some(piece.start);
            }
            let mut found = None;
            piece.crossings(level, |s| {
                found = Some(piece.time(s));
                false
            });
            if found.is_some() {
                return found;
            }
            before = Some(piece.node(piece.n - 1) - level);
        }
        None
    }

    /// Returns the last time at which the signal is farther from `centre` than `limit`; `None` if it never
    /// is.
    pub(crate) fn last_outside(self, centre: f64, limit: f64) -> Option<f64> {
        let is_outside = |value: f64| (value - centre).abs() > limit;
        for piece in self.pieces().rev() {
            if is_outside(piece.node(piece.n - 1)) {
                return Some(piece.end);
            }
            let mut last = f64::NEG_INFINITY;
            for level in [centre + limit, centre - limit] {
                piece.crossings(level, |s| {
                    last = last.max(s);
                    true
                });
            }
            if last >= 0.0 {
                return Some(piece.time(last));
            }
            if is_outside(piece.node(0)) {
                return Some(piece.start);
            }
        }
        None
    }
}

/// Returns the larger number, or NaN if one is NaN.
pub(super) fn larger(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) }
}

/// Number of intervals, per degree of a piece, in which local extrema are searched for. What happens between
/// the ends of these intervals exceeds the range of the values there by at most 1 % (Ehlich and Zeller, Math.
/// Z. 86, 1964: a polynomial of degree n is at most 1 / cos(pi / (2 * 8)) times its values at 8 n + 1
/// Chebyshev points).
const INTERVALS: usize = 8;

/// Steps of a golden section, which reduce an interval to the root of the rounding.
const SECTIONS: usize = 40;

impl SignalPiece<'_> {
    fn node(&self, k: usize) -> f64 {
        self.values.get(k * self.stride).copied().unwrap_or(f64::NAN)
    }

    fn time(&self, s: f64) -> f64 {
        if s == 1.0 { self.end } else { self.start + s * (self.end - self.start) }
    }

    fn value(&self, s: f64) -> f64 {
        interpolate(self.n, |k| self.node(k), s)
    }

    /// Returns the value from the factors of the values at the points.
    fn sum(&self, factors: &[f64]) -> f64 {
        factors.iter().enumerate().map(|(k, factor)| factor * self.node(k)).sum()
    }

    /// Integrates a function of time and the signal from `from` to `to`, both in [0, 1].
    fn integral(&self, from: f64, to: f64, of: &impl Fn(f64, f64) -> f64) -> f64 {
        let is_whole = (from, to) == (0.0, 1.0);
        let at = |(s, weight, factors): &(f64, f64, Vec<f64>)| {
            let s = from + s * (to - from);
            weight * of(self.time(s), if is_whole { self.sum(factors) } else { self.value(s) })
        };
        (to - from) * (self.end - self.start) * Rule::of(self.n).gauss.iter().map(at).sum::<f64>()
    }

    /// Calls a function with the ends of the piece and the local extrema between them, ascending.
    fn each_break(&self, mut use_it: impl FnMut(f64)) {
        use_it(0.0);
        let samples = &Rule::of(self.n).samples;
        let mut value = samples.iter().map(|(_, factors)| self.sum(factors));
        let (mut before, mut here) = (value.next().unwrap_or(f64::NAN), value.next().unwrap_or(f64::NAN));
        for (k, after) in value.enumerate() {
            if (here - before) * (after - here) < 0.0 {
                let sign = if here > before { 1.0 } else { -1.0 };
                use_it(self.extremum(samples[k].0, samples[k + 2].0, sign));
            }
            (before, here) = (here, after);
        }
        use_it(1.0);
    }

    /// Returns the position of a maximum of `sign` times the signal by golden section.
    fn extremum(&self, mut low: f64, mut high: f64, sign: f64) -> f64 {
        const PART: f64 = 0.381_966_011_250_105_1;
        let at = |s: f64| sign * self.value(s);
        let (mut a, mut b) = (low + PART * (high - low), high - PART * (high - low));
        let (mut of_a, mut of_b) = (at(a), at(b));
        for _ in 0..SECTIONS {
            if of_a >= of_b {
                (high, b, of_b) = (b, a, of_a);
                a = low + PART * (high - low);
                of_a = at(a);
            } else {
                (low, a, of_a) = (a, b, of_b);
                b = high - PART * (high - low);
                of_b = at(b);
            }
        }
        0.5 * (low + high)
    }

    /// Returns the largest value of `sign` times the signal.
    fn max(&self, sign: f64) -> f64 {
        let mut largest = f64::NEG_INFINITY;
        self.each_break(|s| largest = larger(largest, sign * self.value(s)));
        largest
    }

    /// Calls a function with each position after the start at which the signal equals a level, ascending,
    /// until it returns false. Between two breaks, the signal is monotone.
    fn crossings(&self, level: f64, mut use_it: impl FnMut(f64) -> bool) {
        let (mut from, mut of_from, mut is_over) = (0.0, self.node(0) - level, false);
        self.each_break(|s| {
            let of_s = if s == 1.0 { self.node(self.n - 1) } else { self.value(s) } - level;
            if !is_over && s > from && (of_from * of_s < 0.0 || of_s == 0.0) {
                is_over = !use_it(if of_s == 0.0 { s } else { self.root(level, from, s, of_from) });
            }
            (from, of_from) = (s, of_s);
        });
    }

    /// Returns the position of the level between two positions by bisection.
    fn root(&self, level: f64, mut low: f64, mut high: f64, of_low: f64) -> f64 {
        while high - low > f64::EPSILON {
            let middle = 0.5 * (low + high);
            if middle <= low || middle >= high {
                break;
            }
            if (self.value(middle) - level) * of_low > 0.0 { low = middle } else { high = middle }
        }
        high
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns functions over unit intervals as pieces.
    fn pieces(n: usize, n_pieces: usize, functions: &[fn(f64) -> f64]) -> Pieces {
        let mut all = Pieces::default();
        all.begin(functions.len());
        for piece in 0..n_pieces {
            let start = piece as f64;
            let values: Vec<f64> =
                (0..n).flat_map(|k| functions.iter().map(move |f| f(start + point(k, n)))).collect();
            all.push(start, start + 1.0, &values);
        }
        all
    }

    #[test]
    fn polynomials_are_interpolated_and_integrated_exactly() {
        let all = pieces(9, 2, &[|t| t.powi(8) - 3.0 * t, |t| 2.0 - t]);
        let signal = all.signal(0);
        assert_eq!(signal.span(), Some((0.0, 2.0)));
        assert_eq!(signal.first(), 0.0);
        let close =
            |value: f64, expected: f64| assert!((value / expected - 1.0).abs() < 1e-13, "{value} {expected}");
        close(signal.integral(|_, y| y), 512.0 / 9.0 - 6.0);
        close(signal.integral(|_, y| y * y), 131_072.0 / 17.0 - 6.0 * 1024.0 / 10.0 + 9.0 * 8.0 / 3.0);
        close(all.signal(1).integral(|t, y| t * y), 4.0 - 8.0 / 3.0);
        for s in [0.0, 0.1, 0.5, 0.77, 1.0] {
            let nodes = |k: usize| point(k, 5).powi(4);
            assert!((interpolate(5, nodes, s) - s.powi(4)).abs() < 1e-15);
        }
    }

    #[test]
    fn extrema_between_points_are_found() {
        let all = pieces(9, 4, &[|t| (3.0 * t).sin(), |t| 0.25 - (t - 1.3).powi(2)]);
        assert!((all.signal(0).max() - 1.0).abs() < 1e-6);
        assert!((all.signal(0).min() + 1.0).abs() < 1e-6);
        assert!((all.signal(1).max() - 0.25).abs() < 1e-14);
        assert!((all.signal(1).min() - 0.25 + 2.7 * 2.7).abs() < 1e-13);
    }

    #[test]
    fn absolute_values_are_integrated_between_zeros() {
        let all = pieces(9, 3, &[|t| (t - 0.3) * (t - 1.1) * (t - 1.9)]);
        let primitive = |t: f64| t.powi(4) / 4.0 - 1.1 * t.powi(3) + 1.495 * t * t - 0.627 * t;
        let area = |a: f64, b: f64| (primitive(b) - primitive(a)).abs();
        let expected = area(0.0, 0.3) + area(0.3, 1.1) + area(1.1, 1.9) + area(1.9, 3.0);
        let value = all.signal(0).integral_between_zeros(|_, y| y.abs());
        assert!((value - expected).abs() < 1e-13, "{value} {expected}");
    }

    #[test]
    fn crossings_are_located_within_pieces_and_at_jumps() {
        let all = pieces(9, 3, &[|t| t * t, |t| if t <= 1.0 { -1.0 } else { 2.0 }, |t| (t - 1.5).powi(2)]);
        assert!((all.signal(0).first_crossing(2.0).unwrap() - 2.0_f64.sqrt()).abs() < 1e-14);
        assert_eq!(all.signal(0).first_crossing(20.0), None);
        assert!((all.signal(0).last_outside(0.0, 2.0).unwrap() - 3.0).abs() < 1e-15);
        // The parabola touches small limits between its points.
        let last = all.signal(2).last_outside(0.0, 0.01);
        assert_eq!(last, Some(3.0));
        assert!((all.signal(2).first_crossing(0.01).unwrap() - 1.4).abs() < 1e-12);
        let mut jump = Pieces::default();
        jump.begin(1);
        jump.push(0.0, 1.0, &[-1.0; 5]);
        jump.push(1.0, 2.0, &[2.0; 5]);
        assert_eq!(jump.signal(0).first_crossing(0.5), Some(1.0));
        assert_eq!(jump.signal(0).last_outside(0.0, 1.5), Some(2.0));
        assert_eq!(jump.signal(0).last_outside(0.0, 3.0), None);
    }

    #[test]
    fn last_time_above_a_limit_precedes_the_decay() {
        let all = pieces(9, 20, &[|t| (-0.3 * t).exp() * (2.0 * t).cos()]);
        let last = all.signal(0).last_outside(0.0, 0.02).unwrap();
        let envelope = |t: f64| ((-0.3 * t).exp() * (2.0 * t).cos()).abs();
        assert!((envelope(last) - 0.02).abs() < 1e-6, "{last}");
        assert!((1..2000).all(|k| envelope(last + 0.005 * k as f64) <= 0.02 + 1e-6));
    }

    #[test]
    fn pieces_after_a_refused_step_are_replaced() {
        let mut all = pieces(5, 3, &[|t| t]);
        all.remove_from(1.0);
        all.push(1.0, 1.5, &[1.0; 5]);
        assert_eq!((all.signal(0).span(), all.values.len()), (Some((0.0, 1.5)), 10));
    }
}
