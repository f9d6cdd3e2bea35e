//! Location of the first event in a step: turning points that may hide one, and root location.

use super::domains::{Domains, any_flips, flipped};
use crate::system::CallResult;

/// A parabola is near zero if the value at its turning point is less than this fraction of the smallest value
/// on it.
const NEAR: f64 = 0.25;

/// Location of the first change of domain in a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Located {
    /// First known point of the new domain (right end of the final bracket).
    pub(crate) time: f64,
    /// Last known point before the change (left end of the final bracket).
    pub(crate) before: f64,
    /// Number of evaluations of the indicators.
    pub(crate) evaluations: u64,
}

/// Returns the turning point after `start` of the parabola through three points `(t, z)` in one domain.
/// `None` if the turning point is neither in the other domain nor near it.
fn turning_point([(t0, z0), (t1, z1), (t2, z2)]: [(f64, f64); 3], start: f64) -> Option<f64> {
    if flipped(z0, z1) || flipped(z1, z2) {
        return None;
    }
    let (s1, s2) = ((z1 - z0) / (t1 - t0), (z2 - z1) / (t2 - t1));
    let curvature = (s2 - s1) / (t2 - t0);
    let inward = if z1 > 0.0 { curvature } else { -curvature };
    if inward.is_nan() || inward <= 0.0 {
        return None;
    }
    let t = 0.5 * (t1 + t2) - 0.5 * s2 / curvature;
    let value = z1 + (t - t1) * (s2 + curvature * (t - t2));
    // The step before this one was already checked.
    let least = if t0 < start { z1.abs().min(z2.abs()) } else { z0.abs().min(z1.abs()).min(z2.abs()) };
    let beyond = if z1 > 0.0 { value < NEAR * least } else { value > -NEAR * least };
    (t > start.max(t0) && t < t2 && t != t1 && beyond).then_some(t)
}

/// True if three points `(t, z)` are as far from zero as [`Domains::keeps_clear`] requires. All must be
/// finite.
#[inline]
fn is_clear([(t0, z0), (t1, z1), (t2, z2)]: [(f64, f64); 3]) -> bool {
    let least = |a: f64, b: f64| if a < b { a } else { b };
    let most = |a: f64, b: f64| if a > b { a } else { b };
    let (left, right) = (t1 - t0, t2 - t1);
    let (low, high) = (least(least(z0, z1), z2), most(most(z0, z1), z2));
    (high - low) * most(left, right) <= low * least(left, right)
}

impl Domains {
    /// Returns time and value of indicator `i` at the known point `k` of the step from `start` to `end`.
    /// Point 0 is the start, the points evaluated inside follow, and the last one is the end.
    #[inline]
    fn evaluated_point(&self, i: usize, k: usize, start: f64, end: f64) -> (f64, f64) {
        match k.checked_sub(1) {
            None => (start, self.base[i]),
            Some(inside) if inside < self.looked_at.len() => {
                (self.looked_at[inside], self.looked[inside * self.len() + i])
            }
            Some(_) => (end, self.end[i]),
        }
    }

    /// True if indicator `i` is so far from zero that [`turning_point`](Self::turning_point) and
    /// [`unresolved`](Self::unresolved) find nothing. The test bounds the curvature of the parabola through
    /// three neighbouring values by their largest difference d and the ratio r of their distances in time.
    /// The parabola extends at most d r / 4 beyond the smallest value.
    #[inline]
    pub(crate) fn keeps_clear(&self, i: usize, start: f64, end: f64) -> bool {
        let sign = if self.base[i] > 0.0 { 1.0 } else { -1.0 };
        let n_inside = self.looked_at.len();
        let inside = |k: usize| (self.looked_at[k], sign * self.looked[k * self.len() + i]);
        let (base, last) = ((start, sign * self.base[i]), (end, sign * self.end[i]));
        let (mut a, mut b) = (base, if n_inside > 0 { inside(0) } else { last });
        if let Some(before) = self.before_time
            && !is_clear([(before, sign * self.before[i]), a, b])
        {
            return false;
        }
        for k in 1..n_inside {
            let c = inside(k);
            if !is_clear([a, b, c]) {
                return false;
            }
            (a, b) = (b, c);
        }
        n_inside == 0 || is_clear([a, b, last])
    }

    /// Returns the turning point between `start` and `end` of a parabola through three neighbouring values of
    /// indicator `i`. `None` if no turning point is in the other domain or near it. A crossing and its return
    /// may be hidden there.
    pub(crate) fn turning_point(&self, i: usize, start: f64, end: f64) -> Option<f64> {
        let evaluated_point = |k| self.evaluated_point(i, k, start, end);
        let (mut a, mut b, next) = match self.before_time {
            Some(t) => ((t, self.before[i]), evaluated_point(0), 1),
            None => (evaluated_point(0), evaluated_point(1), 2),
        };
        (next..self.looked_at.len() + 2).find_map(|k| {
            let c = evaluated_point(k);
            let found = turning_point([a, b, c], start);
            (a, b) = (b, c);
            found
        })
    }

    /// Returns a point between `start` and `end` at which a crossing of indicator `i` and its return may be
    /// hidden. The test uses two neighbouring intervals whose three ends are in one domain. They are
    /// unresolved if the graph bends by more than its distance from zero. The point is the middle of the
    /// wider one, if its length is at least `least`.
    pub(crate) fn unresolved(&self, i: usize, start: f64, end: f64, least: f64) -> Option<f64> {
        if self.slides(i) {
            return None;
        }
        let evaluated_point = |k| self.evaluated_point(i, k, start, end);
        let (mut a, mut b) = (evaluated_point(0), evaluated_point(1));
        (2..self.looked_at.len() + 2).find_map(|k| {
            let c = evaluated_point(k);
            let [(t0, z0), (t1, z1), (t2, z2)] = [a, b, c];
            (a, b) = (b, c);
            if flipped(z0, z1) || flipped(z1, z2) {
                return None;
            }
            let bend = (z1 - (z0 + (z2 - z0) * ((t1 - t0) / (t2 - t0)))).abs();
            let (from, to) = if t1 - t0 >= t2 - t1 { (t0, t1) } else { (t1, t2) };
            let hides = bend > z0.abs().min(z1.abs()).min(z2.abs());
            (hides && to - from >= least).then_some(0.5 * (from + to))
        })
    }

    /// Reads the indicators at a point inside the step after those examined before. Returns `true` if an
    /// indicator has an event before this point; `end` then contains the indicators there. If an indicator
    /// has changed in another way, changes count from this point.
    pub(crate) fn changed_at(
        &mut self,
        t: f64,
        evaluate: impl FnOnce(f64, &mut [f64]) -> CallResult<()>,
    ) -> CallResult<bool> {
        evaluate(t, &mut self.mid)?;
        if any_flips(self.reference(), &self.mid) {
            if self.any_crosses(self.reference(), &self.mid) {
                std::mem::swap(&mut self.end, &mut self.mid);
                return Ok(true);
            }
            self.from.copy_from_slice(&self.mid);
            self.counts_since = Some(t);
        }
        self.looked_at.push(t);
        self.looked.extend_from_slice(&self.mid);
        if let [.., last, _] = self.looked_at[..]
            && last >= t
        {
            let place = self.looked_at.partition_point(|other| *other < t);
            self.looked_at[place..].rotate_right(1);
            self.looked[place * self.mid.len()..].rotate_right(self.mid.len());
        }
        Ok(false)
    }

    /// True if all indicators that change in the bracket only jump between a value and its negative. Their
    /// values then determine only the domain.
    fn only_jumps(&self) -> bool {
        let from = self.reference();
        let located = |i: &usize| self.is_located(*i, self.lo[*i], self.end[*i]);
        (0..self.len()).filter(located).all(|i| from[i] == -self.end[i] && from[i] == self.lo[i])
    }

    /// Finds the first event in `(t_lo, t_hi]`. `end` contains the indicators at `t_hi`, and `base` (or the
    /// point from which changes count) those at `t_lo`. The change of at least one of them must be an event.
    /// `evaluate(t, z)` fills in the indicators at a time between.
    ///
    /// The method is from T. R. Chandrupatla, A new hybrid quadratic/bisection algorithm for finding the zero
    /// of a nonlinear function, Advances in Engineering Software 28 (1997) 145-149. All indicators share one
    /// bracket. Each iteration uses the changed indicator whose secant crosses first. The iterations end when
    /// the width of the bracket is at most `tolerance`, for any values. The function returns the right end,
    /// at which the change has happened, and `end` then contains the indicators there. If all changing
    /// indicators only jump, a bracket of `for_jumps` is sufficient.
    pub(crate) fn locate(
        &mut self,
        t_lo: f64,
        t_hi: f64,
        tolerance: f64,
        for_jumps: f64,
        mut evaluate: impl FnMut(f64, &mut [f64]) -> CallResult<()>,
    ) -> CallResult<Located> {
        let start = if self.counts_since.is_some() { &self.from } else { &self.base };
        self.lo.copy_from_slice(start);
        let (mut lo, mut hi) = (t_lo, t_hi);
        // End of an earlier bracket, for the inverse quadratic step, and whether it was on the right side.
        let mut third: Option<f64> = None;
        let mut newest_is_hi = true;
        let mut active = usize::MAX;
        let mut evaluations = 0;
        let cap = 2 * (((hi - lo) / tolerance).log2().max(0.0) as u64) + 4;
        while hi - lo > tolerance && !(hi - lo <= for_jumps && self.only_jumps()) {
            let chosen = self.first_by_secant(lo, hi);
            if chosen != active {
                active = chosen;
                third = None;
            }
            let width = hi - lo;
            let from_lo = match third {
                Some(t3) if evaluations < cap => {
                    self.chandrupatla_fraction(active, lo, hi, t3, newest_is_hi, tolerance / width)
                }
                _ => 0.5,
            };
            let mut mid = lo + from_lo * width;
            if mid <= lo || mid >= hi {
                mid = lo + 0.5 * width;
                if mid <= lo || mid >= hi {
                    break; // neighbours in floating point
                }
            }
            evaluate(mid, &mut self.mid)?;
            evaluations += 1;
            let crossed = self.any_crosses(&self.lo, &self.mid);
            // The point that leaves the bracket, or the older one on the same side, becomes the third point.
            if crossed {
                std::mem::swap(&mut self.discarded, &mut self.end);
                std::mem::swap(&mut self.end, &mut self.mid);
                third = Some(hi);
                hi = mid;
            } else {
                if any_flips(&self.lo, &self.mid) {
                    self.from.copy_from_slice(&self.mid);
                    self.counts_since = Some(mid);
                }
                std::mem::swap(&mut self.discarded, &mut self.lo);
                std::mem::swap(&mut self.lo, &mut self.mid);
                third = Some(lo);
                lo = mid;
            }
            newest_is_hi = crossed;
        }
        Ok(Located { time: hi, before: lo, evaluations })
    }

    /// Returns the indicator whose secant predicts the earliest crossing, among those that change inside the
    /// bracket.
    fn first_by_secant(&self, lo: f64, hi: f64) -> usize {
        let mut best = (f64::INFINITY, 0);
        for i in 0..self.base.len() {
            let (a, b) = (self.lo[i], self.end[i]);
            if flipped(a, b) && self.is_located(i, a, b) {
                let t = lo + (hi - lo) * (a / (a - b)).clamp(0.0, 1.0);
                let t = if t.is_nan() { lo } else { t };
                if t < best.0 {
                    best = (t, i);
                }
            }
        }
        best.1
    }

    /// Returns the next evaluation point as a fraction of the bracket, counted from `lo`.
    fn chandrupatla_fraction(
        &self,
        i: usize,
        lo: f64,
        hi: f64,
        t3: f64,
        newest_is_hi: bool,
        least: f64,
    ) -> f64 {
        let (f_lo, f_hi, f3) = (self.lo[i], self.end[i], self.discarded[i]);
        let (x1, f1, x2, f2) = if newest_is_hi { (hi, f_hi, lo, f_lo) } else { (lo, f_lo, hi, f_hi) };
        let xi = (x1 - x2) / (t3 - x2);
        let phi = (f1 - f2) / (f3 - f2);
        let inverse_quadratic = phi * phi < xi && (1.0 - phi) * (1.0 - phi) < 1.0 - xi;
        let fraction = if inverse_quadratic {
            f1 / (f2 - f1) * f3 / (f2 - f3) + (t3 - x1) / (x2 - x1) * f1 / (f3 - f1) * f2 / (f3 - f2)
        } else {
            0.5
        };
        let least = (0.5 * least).min(0.5);
        let fraction = if fraction.is_finite() { fraction.clamp(least, 1.0 - least) } else { 0.5 };
        if newest_is_hi { 1.0 - fraction } else { fraction }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::system::Direction;

    fn locate(z: impl Fn(f64) -> Vec<f64>, lo: f64, hi: f64, tolerance: f64) -> (f64, u64, Domains) {
        let mut d = Domains::default();
        d.begin(z(lo).len(), |_| Direction::Both);
        d.base.copy_from_slice(&z(lo));
        d.end.copy_from_slice(&z(hi));
        assert!(d.changed());
        let found = d
            .locate(lo, hi, tolerance, tolerance, |t, out| {
                out.copy_from_slice(&z(t));
                Ok(())
            })
            .unwrap();
        (found.time, found.evaluations, d)
    }

    /// Values at uneven times in either domain, with zeros. No event is missed, and most indicators far from
    /// zero are not examined further.
    #[test]
    fn clear_indicators_have_no_turning_point_near_zero() {
        let mut state = 7_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let (mut n_clear, mut n_found) = (0, 0);
        for round in 0..20_000 {
            let sign = if random() < 0.5 { 1.0 } else { -1.0 };
            let spread = random() * random();
            let mut value = || if random() < 0.02 { 0.0 } else { sign * (1.0 - spread + spread * random()) };
            let mut d = Domains::default();
            d.begin(1, |_| Direction::Both);
            (d.base[0], d.before[0], d.end[0]) = (value(), value(), value());
            let inside = value();
            d.before_time = (random() < 0.5).then(|| -2.0 * random());
            if round % 3 > 0 {
                d.changed_at(random(), |_, z| {
                    z[0] = inside;
                    Ok(())
                })
                .unwrap();
            }
            let found = d.turning_point(0, 0.0, 1.0).or(d.unresolved(0, 0.0, 1.0, 0.0));
            let is_clear = d.keeps_clear(0, 0.0, 1.0);
            assert!(!is_clear || found.is_none(), "{d:?}: {found:?}");
            n_clear += u32::from(is_clear);
            n_found += u32::from(found.is_some());
        }
        assert!(n_clear > 10_000 && n_found > 1_000, "{n_clear} {n_found}");
    }

    #[test]
    fn locate_returns_right_end_of_tight_bracket() {
        for root in [0.1, 0.437, 0.9999] {
            let (t, n, d) = locate(|t| vec![(t - root) * 3.0], 0.0, 1.0, 1e-13);
            assert!(t > root && t - root <= 1e-13, "{t} for {root}");
            assert!(d.end[0] > 0.0);
            assert!(n <= 6, "{n} evaluations for a straight line");
        }
    }

    #[test]
    fn smooth_curves_need_few_evaluations() {
        let (t, n, _) = locate(|t| vec![(8.0 * t).exp() - 20.0], 0.0, 1.0, 1e-13);
        assert!((t - 20f64.ln() / 8.0).abs() < 1e-13);
        assert!(n <= 14, "{n}");
        let (t, n, _) = locate(|t| vec![0.3 - t * t], 0.0, 1.0, 1e-13);
        assert!((t - 0.3f64.sqrt()).abs() < 2e-13);
        assert!(n <= 12, "{n}");
    }

    #[test]
    fn jump_indicators_are_bisected() {
        let (t, n, _) = locate(|t| vec![if t < 0.7 { -1.0 } else { 1.0 }], 0.0, 1.0, 1e-13);
        assert!((0.7..0.7 + 1e-13).contains(&t));
        assert!(n <= 60, "{n}");
        let (t, n, _) = locate(|t| vec![if t < 0.7 { -1.0 } else { 1e-300 }], 0.0, 1.0, 1e-13);
        assert!((0.7..0.7 + 1e-13).contains(&t));
        assert!(n <= 140, "{n}");
    }

    #[test]
    fn wider_bracket_is_accepted_for_jumps_only() {
        let found = |z: fn(f64) -> f64| {
            let mut d = Domains::default();
            d.begin(1, |_| Direction::Both);
            (d.base[0], d.end[0]) = (z(0.0), z(1.0));
            let read = |t: f64, out: &mut [f64]| {
                out[0] = z(t);
                Ok(())
            };
            d.locate(0.0, 1.0, 1e-14, 1e-3, read).unwrap().time
        };
        let jump = found(|t| if t < 0.7 { -1.0 } else { 1.0 });
        assert!((1e-6..1e-3).contains(&(jump - 0.7)), "{jump}");
        let smooth = found(|t| (t - 0.7) * 3.0);
        assert!((smooth - 0.7).abs() < 1e-13, "{smooth}");
    }

    #[test]
    fn parabola_locates_possible_hidden_crossing() {
        let mut d = Domains::default();
        d.begin(2, |_| Direction::Both);
        let z = |t: f64| [(t - 2.4) * (t - 2.6), 1.0 + t];
        d.before.copy_from_slice(&z(1.0));
        d.before_time = Some(1.0);
        d.base.copy_from_slice(&z(2.0));
        d.end.copy_from_slice(&z(3.0));
        assert!(!d.changed());
        assert!((d.turning_point(0, 2.0, 3.0).unwrap() - 2.5).abs() < 1e-14);
        assert_eq!(d.turning_point(1, 2.0, 3.0), None);
        d.forget();
        assert_eq!(d.turning_point(0, 2.0, 3.0), None);
    }

    #[test]
    fn first_of_several_crossings_is_located() {
        let (t, _, mut d) = locate(|t| vec![0.8 - t, t - 0.3, (t - 0.55).powi(3)], 0.0, 1.0, 1e-12);
        assert!((t - 0.3).abs() <= 1e-12);
        assert_eq!(d.mark(1.0, 0.0), Some(1));
        assert_eq!(d.crossings, vec![0, 1, 0]);
    }

    #[test]
    fn changes_count_only_in_requested_directions() {
        // The first indicator is positive between 0.3 and 0.5; the second crosses at 0.8.
        let z = |t: f64| [(t - 0.3) * (0.5 - t), t - 0.8];
        let at = |look: Option<f64>, directions: [Direction; 2]| {
            let mut d = Domains::default();
            d.begin(2, |i| directions[i]);
            d.base.copy_from_slice(&z(0.0));
            d.end.copy_from_slice(&z(1.0));
            let read = |t: f64, out: &mut [f64]| {
                out.copy_from_slice(&z(t));
                Ok(())
            };
            let before = look.filter(|t| d.changed_at(*t, read).unwrap());
            let hi = before.or_else(|| d.changed().then_some(1.0));
            let lo = d.counts_since().unwrap_or(0.0);
            let found = d.locate(lo, hi?, 1e-12, 1e-12, read).unwrap();
            assert!(d.changed());
            d.mark(1.0, 0.0);
            Some((found.time, d.crossings.clone()))
        };
        use Direction::{Both, Down, Up};
        for (look, directions, time, crossings) in [
            (None, [Down, Up], 0.8, [0, 1]),
            (Some(0.4), [Up, Down], 0.3, [1, 0]),
            (Some(0.4), [Down, Down], 0.5, [-1, 0]),
            (Some(0.4), [Down, Up], 0.5, [-1, 0]),
            (Some(0.4), [Both, Both], 0.3, [1, 0]),
        ] {
            let (t, seen) = at(look, directions).unwrap();
            assert!((t - time).abs() < 2e-12, "{look:?} {directions:?}: {t}");
            assert_eq!(seen, crossings, "{look:?} {directions:?}");
        }
        assert_eq!(at(None, [Both, Down]), None);
        assert_eq!(at(Some(0.1), [Both, Down]), None);
    }

    #[test]
    fn return_found_during_search_is_the_event() {
        // The search for the crossing at 0.9 evaluates its middle, where the other indicator is returning.
        let z = |t: f64| vec![(t - 0.4) * (0.6 - t), t - 0.9];
        let mut d = Domains::default();
        d.begin(2, |i| if i == 0 { Direction::Down } else { Direction::Both });
        d.base.copy_from_slice(&z(0.0));
        d.end.copy_from_slice(&z(1.0));
        let read = |t: f64, out: &mut [f64]| {
            out.copy_from_slice(&z(t));
            Ok(())
        };
        let found = d.locate(0.0, 1.0, 1e-12, 0.0, read).unwrap();
        d.mark(1.0, 0.0);
        assert_eq!((d.crossings.clone(), d.counts_since()), (vec![-1, 0], Some(0.5)));
        assert!((found.time - 0.6).abs() < 2e-12, "{}", found.time);
    }

    #[test]
    fn simultaneous_crossings_share_one_event() {
        let (t, _, mut d) = locate(|t| vec![0.5 - t, t - 0.5, 1.0], 0.0, 1.0, 1e-12);
        assert!((t - 0.5).abs() <= 1e-12);
        d.mark(1.0, 0.0);
        // 0.5 - t leaves the positive domain at 0.5 itself, t - 0.5 enters it just after: both within the
        // bracket.
        assert_eq!(d.crossings[0], -1);
    }

    #[test]
    fn zero_belongs_to_the_lower_domain() {
        let mut d = Domains::default();
        d.begin(1, |_| Direction::Both);
        d.base[0] = 0.0;
        d.end[0] = -1.0;
        assert!(!d.changed());
        d.end[0] = 1e-300;
        assert!(d.changed());
        d.base[0] = 1e-300;
        d.end[0] = 0.0;
        assert!(d.changed());
    }
}
