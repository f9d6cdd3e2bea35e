//! Replacement of the rows of a recording by means over intervals.

use super::recording::Data;
use crate::error::CalibrationError;
use base::Number;
use std::ops::Range;

impl Data {
    /// Replaces the rows by means over intervals of this length in s, which begin at the first time. The time
    /// of each mean is the mean time of its values, so that slopes are preserved. Columns with values in the
    /// same rows of an interval share a row. Missing values are NaN. `means(k)` specifies the reduction of
    /// column `k`.
    ///
    /// Returns the table and the weights of the means for each column. A weight is the root of the sum of the
    /// squared weights, because averaging n measurements divides their error by the root of n. The weights
    /// are empty for columns without weights.
    ///
    /// # Errors
    /// Returns an error if the interval is not positive, or is shorter than the row spacing. Values between
    /// rows are not interpolated.
    pub(crate) fn resampled<'w>(
        mut self,
        interval: f64,
        means: impl Fn(usize) -> Means<'w>,
    ) -> Result<(Self, Vec<Vec<f64>>), CalibrationError> {
        let bad = |message: String| CalibrationError::Data { source_name: self.source.clone(), message };
        if !(interval.is_finite() && interval > 0.0) {
            return Err(bad(format!("resample = {} must be positive and finite", Number(interval))));
        }
        let (start, end) = (self.time[0], self.time[self.time.len() - 1]);
        let tolerance = base::time_tolerance(start, end);
        if let Some(spacing) = self.sampling_interval().filter(|spacing| interval < spacing - tolerance) {
            let unit = self.time_unit();
            return Err(bad(format!(
                "resample = {} {unit} is shorter than the row spacing of {} {unit}. Set a larger interval",
                Number(interval),
                Number(spacing)
            )));
        }
        let columns: Vec<ColumnMeans<'_>> = (self.columns.iter().enumerate())
            .map(|(k, column)| ColumnMeans { values: &column.values, means: means(k) })
            .collect();
        // Times on a limit, up to rounding, belong to the interval that begins there.
        let number = |time: f64| ((time - start + tolerance) / interval).floor();
        let (mut time, mut reduced) = (Vec::new(), vec![(Vec::new(), Vec::new()); columns.len()]);
        let mut first = 0;
        for times in self.time.chunk_by(|a, b| number(*a) == number(*b)) {
            let rows = first..first + times.len();
            first = rows.end;
            // Means of the interval in ascending order of time, with their columns.
            let mut found: Vec<(f64, usize, Mean)> = Vec::new();
            for (k, column) in columns.iter().enumerate() {
                column.reduce(&self.time, rows.clone(), |at, mean| found.push((at, k, mean)));
            }
            if found.is_empty() {
                time.push(mean(&self.time, &rows.collect::<Vec<_>>(), |_| 1.0));
            }
            found.sort_by(|a, b| a.0.total_cmp(&b.0));
            // Means whose times differ only by rounding share a row, but a column has one value per row.
            let mut begin = f64::NEG_INFINITY;
            for (at, k, Mean { value, weight }) in found {
                if at - begin > tolerance || reduced[k].0.len() == time.len() {
                    time.push(at);
                    begin = at;
                }
                reduced[k].0.resize(time.len() - 1, f64::NAN);
                reduced[k].0.push(value);
                reduced[k].1.resize(time.len() - 1, 0.0);
                reduced[k].1.push(weight);
            }
        }
        for (values, weights) in &mut reduced {
            values.resize(time.len(), f64::NAN);
            weights.resize(time.len(), 0.0);
        }
        let is_weighted: Vec<bool> =
            columns.iter().map(|column| matches!(column.means, Means::Weighted(_))).collect();
        let (values, weights): (Vec<_>, Vec<_>) = reduced.into_iter().unzip();
        self.resampled = Some(interval);
        self.written = None;
        self.time = time.into();
        self.columns.iter_mut().zip(values).for_each(|(column, values)| column.values = values.into());
        let if_weighted = |(weights, is_weighted)| if is_weighted { weights } else { Vec::new() };
        Ok((self, weights.into_iter().zip(is_weighted).map(if_weighted).collect()))
    }
}

/// Reduction of the values of a column in an interval.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Means<'w> {
    /// Mean of the values.
    Plain,
    /// Mean weighted with the squares of these row weights. Rows with weight 0 do not count.
    Weighted(&'w [f64]),
    /// First value and each value that differs from its predecessor, at their original times. Values that are
    /// held constant between rows have no meaningful mean.
    Held,
}

/// Value that replaces several values, and the root of the sum of their squared weights.
struct Mean {
    value: f64,
    weight: f64,
}

/// Column and its reduction.
struct ColumnMeans<'a> {
    values: &'a [f64],
    means: Means<'a>,
}

impl ColumnMeans<'_> {
    /// Passes the values of an interval with their times to `put`.
    fn reduce(&self, time: &[f64], rows: Range<usize>, mut put: impl FnMut(f64, Mean)) {
        let is_present = |row: &usize| !self.values[*row].is_nan();
        match self.means {
            Means::Held => {
                let mut last = None;
                let is_end = rows.end == time.len();
                let end = rows.clone().rev().find(is_present).filter(|_| is_end);
                for row in rows.filter(is_present) {
                    // The last row of the table defines the end of the recording.
                    if last != Some(self.values[row]) || Some(row) == end {
                        put(time[row], Mean { value: self.values[row], weight: 0.0 });
                    }
                    last = Some(self.values[row]);
                }
            }
            Means::Plain => {
                let present: Vec<usize> = rows.filter(is_present).collect();
                if !present.is_empty() {
                    put(
                        mean(time, &present, |_| 1.0),
                        Mean { value: mean(self.values, &present, |_| 1.0), weight: 0.0 },
                    );
                }
            }
            Means::Weighted(weights) => {
                let present: Vec<usize> =
                    rows.filter(is_present).filter(|row| weights[*row] != 0.0).collect();
                // Squares of ratios to the largest weight do not overflow.
                let largest = present.iter().map(|row| weights[*row]).fold(0.0, f64::max);
                let square = |row: usize| (weights[row] / largest).powi(2);
                if !present.is_empty() {
                    let weight = largest * present.iter().map(|row| square(*row)).sum::<f64>().sqrt();
                    put(
                        mean(time, &present, square),
                        Mean { value: mean(self.values, &present, square), weight },
                    );
                }
            }
        }
    }
}

/// Returns the weighted mean of at least one row. It averages the differences from the first value, so that
/// large numbers, such as times since 1970, lose no digits.
fn mean(values: &[f64], rows: &[usize], weight: impl Fn(usize) -> f64) -> f64 {
    let first = values[rows[0]];
    let total: f64 = rows.iter().map(|row| weight(*row)).sum();
    first + rows.iter().map(|row| weight(*row) * (values[*row] - first)).sum::<f64>() / total
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Data {
        let time: Vec<f64> = (0..7).map(|k| 0.1 * f64::from(k)).collect();
        let y = vec![0.0, 1.0, 2.0, f64::NAN, 4.0, f64::NAN, 6.0];
        Data::from_columns(time, [("y [mm]".to_owned(), y)]).unwrap()
    }

    fn plain(data: Data, interval: f64) -> Result<Data, CalibrationError> {
        Ok(data.resampled(interval, |_| Means::Plain)?.0)
    }

    /// Rows every 0.1 s, from 0 and from a time in seconds since 1970, whose last digit is 2.4e-7 s.
    #[test]
    fn resampling_is_accurate_when_times_are_large() {
        for start in [0.0, 1.7e9] {
            let time: Vec<f64> = (0..2000).map(|k| start + 0.1 * f64::from(k)).collect();
            let y = time.iter().map(|t| t - start).collect();
            let data = Data::from_columns(time, [("y".to_owned(), y)]).unwrap();
            for (interval, rows) in [(0.1, 2000), (0.2, 1000), (0.7, 286)] {
                let means = plain(data.clone(), interval).unwrap();
                assert_eq!(means.time().len(), rows, "{start} {interval}");
                let errors = means.time().iter().zip(means.column("y").unwrap()).map(|(t, y)| t - start - y);
                assert!(errors.fold(0.0, |most: f64, e| most.max(e.abs())) < 1e-6, "{start} {interval}");
            }
        }
    }

    /// Two rows with weights 1 and 3 have the weighted mean (0 + 9 * 1) / 10. Its weight is the root of 10.
    #[test]
    fn resampling_combines_weights_by_root_sum_of_squares() {
        let y = vec![0.0, 1.0, 5.0, f64::NAN, 7.0, 2.0];
        let columns = [("y".to_owned(), y.clone()), ("u".to_owned(), vec![0.0, 1.0, 1.0, 0.0, 0.0, 0.0])];
        let data = Data::from_columns(vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0], columns).unwrap();
        let weights = [1.0, 3.0, 2.0, 8.0, 0.0, 4.0];
        let how = |k: usize| if k == 0 { Means::Weighted(&weights) } else { Means::Held };
        let (means, of_means) = data.resampled(2.0, how).unwrap();
        let rows: Vec<(f64, f64, f64)> =
            (means.time().iter().zip(means.column("y").unwrap()).zip(&of_means[0]))
                .filter(|((_, y), _)| !y.is_nan())
                .map(|((t, y), w)| (*t, *y, *w))
                .collect();
        let expected = [(0.9, 0.9, 10f64.sqrt()), (2.0, 5.0, 2.0), (5.0, 2.0, 4.0)];
        assert_eq!(rows.len(), 3, "{rows:?}");
        for ((t, y, w), (time, value, weight)) in rows.into_iter().zip(expected) {
            assert!(
                (t - time).abs() < 1e-14 && (y - value).abs() < 1e-14 && (w - weight).abs() < 1e-14,
                "{t} {y} {w}"
            );
        }
        // A held value appears at the beginning of an interval, at a change, and at the end.
        let held: Vec<(f64, f64)> = (means.time().iter().zip(means.column("u").unwrap()))
            .filter(|(_, u)| !u.is_nan())
            .map(|(t, u)| (*t, *u))
            .collect();
        assert_eq!(held, [(0.0, 0.0), (1.0, 1.0), (2.0, 1.0), (3.0, 0.0), (4.0, 0.0), (5.0, 0.0)]);
        assert!(of_means[1].is_empty());
    }

    #[test]
    fn resampling_keeps_separate_times_of_columns() {
        // y = 1 + 2 t is known in every third row, and z in every row.
        let time: Vec<f64> = (0..60).map(|k| 0.1 * f64::from(k)).collect();
        let line: Vec<f64> = time.iter().map(|t| 1.0 + 2.0 * t).collect();
        let y = line.iter().enumerate().map(|(k, v)| if k % 3 == 2 { *v } else { f64::NAN }).collect();
        let columns = [("y".to_owned(), y), ("z".to_owned(), line)];
        let data = plain(Data::from_columns(time, columns).unwrap(), 0.5).unwrap();
        for name in ["y", "z"] {
            let rows = data.time().iter().zip(data.column(name).unwrap()).filter(|(_, v)| !v.is_nan());
            assert_eq!(rows.clone().count(), 12, "{name}");
            for (t, v) in rows {
                assert!((v - (1.0 + 2.0 * t)).abs() < 1e-12, "{name}: {v} at {t}");
            }
        }
        assert!(data.time().windows(2).all(|pair| pair[0] < pair[1]));
    }

    #[test]
    fn resampling_computes_means() {
        let data = plain(table(), 0.3).unwrap();
        let near =
            |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12) && a.len() == b.len();
        let resampled = |name: &str| -> (Vec<f64>, Vec<f64>) {
            let rows = data.time().iter().zip(data.column(name).unwrap()).filter(|(_, v)| !v.is_nan());
            rows.unzip()
        };
        let (times, values) = resampled("y");
        assert!(near(&times, &[0.1, 0.4, 0.6]) && near(&values, &[1.0, 4.0, 6.0]), "{times:?} {values:?}");
        for (interval, expected) in [
            (0.05, "resample = 0.05 s is shorter than the row spacing of 0.1"),
            (f64::NAN, "resample = NaN must be positive"),
        ] {
            assert!(plain(table(), interval).unwrap_err().to_string().contains(expected));
        }
    }
}
