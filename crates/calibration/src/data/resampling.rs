//! Means over intervals in place of the rows of a recording, and what of its signals they take away.

use super::recording::{Data, Resampling};
use crate::error::CalibrationError;
use base::Number;
use std::ops::Range;

/// Of fewer values nothing is said.
const FEWEST: usize = 10;

/// The part of the variance of a signal that its means have not. The noise is that of the differences from
/// the mean of both neighbours: `y_i - (y_(i-1) + y_(i+1)) / 2` has 3/2 of its variance.
fn lost(values: &[f64], means: &[f64]) -> f64 {
    let known = |values: &[f64]| values.iter().copied().filter(|v| !v.is_nan()).collect::<Vec<f64>>();
    let (values, means) = (known(values), known(means));
    let variance = |values: &[f64]| {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / values.len() as f64
    };
    let bends = values.windows(3).map(|w| (w[1] - 0.5 * (w[0] + w[2])).powi(2));
    let noise = bends.sum::<f64>() / 1.5 / values.len().saturating_sub(2) as f64;
    let per_mean = values.len() as f64 / means.len().max(1) as f64;
    let (before, after) = (variance(&values) - noise, variance(&means) - noise / per_mean);
    // What is nearly all noise has no signal to lose.
    let has_signal = values.len() >= FEWEST && !means.is_empty() && before > 0.1 * noise && before > 0.0;
    if has_signal { (1.0 - after.max(0.0) / before).max(0.0) } else { 0.0 }
}

impl Data {
    /// Variance that means over intervals have removed, if the rows are such means.
    pub(crate) fn resampling(&self) -> Option<&Resampling> {
        self.resampling.as_ref()
    }

    /// A table of means over intervals of this length in s, beginning with the first time: of each column the
    /// mean of its values there, at the mean of the times of these values. Columns with values in the same
    /// rows of an interval share a row; missing values are NaN. Means keep a slope, and the noise falls with
    /// the root of their number; what is faster than the interval is lost.
    ///
    /// # Errors
    /// The interval is not positive, or shorter than the distance of the times: nothing is made up between
    /// them.
    pub fn resampled(mut self, interval: f64) -> Result<Self, CalibrationError> {
        let bad = |message: String| CalibrationError::Data { source_name: self.source.clone(), message };
        if !(interval.is_finite() && interval > 0.0) {
            return Err(bad(format!(
                "the interval of resampling must be positive and finite, not {}",
                Number(interval)
            )));
        }
        if let Some(own) = self.sampling_interval().filter(|own| interval < *own * (1.0 - 1e-9)) {
            return Err(bad(format!(
                "rows every {} s cannot be made of rows every {} s: values between them are not made up",
                Number(interval),
                Number(own)
            )));
        }
        // Times that fall on a limit up to rounding belong to the interval that begins there.
        let start = self.time[0];
        let number = |time: f64| ((time - start) / interval + 1e-9).floor();
        let rows: Vec<Range<usize>> = (self.time.chunk_by(|a, b| number(*a) == number(*b)))
            .scan(0, |end, chunk| {
                let begin = std::mem::replace(end, *end + chunk.len());
                Some(begin..*end)
            })
            .collect();
        let mean = |values: &[f64], known: &[usize]| {
            known.iter().map(|row| values[*row]).sum::<f64>() / known.len() as f64
        };
        // Per interval the times of the means in ascending order, with the columns that have theirs then.
        let mut time = Vec::with_capacity(rows.len());
        let mut means: Vec<Vec<f64>> = vec![Vec::with_capacity(rows.len()); self.columns.len()];
        let mut known = Vec::new();
        for rows in &rows {
            let all: Vec<usize> = rows.clone().collect();
            let mut found: Vec<(f64, Vec<(usize, f64)>)> = Vec::new();
            for (k, column) in self.columns.iter().enumerate() {
                known.clear();
                known.extend(all.iter().copied().filter(|row| !column.values[*row].is_nan()));
                if known.is_empty() {
                    continue;
                }
                let (at, value) = (mean(&self.time, &known), mean(&column.values, &known));
                match found.iter_mut().find(|(time, _)| *time == at) {
                    Some((_, columns)) => columns.push((k, value)),
                    None => found.push((at, vec![(k, value)])),
                }
            }
            if found.is_empty() {
                found.push((mean(&self.time, &all), Vec::new()));
            }
            found.sort_by(|a, b| a.0.total_cmp(&b.0));
            for (at, values) in found {
                time.push(at);
                means.iter_mut().for_each(|column| column.push(f64::NAN));
                let last = time.len() - 1;
                values.into_iter().for_each(|(k, value)| means[k][last] = value);
            }
        }
        let lost = self.columns.iter().zip(&means).map(|(column, means)| lost(&column.values, means));
        let lost = self.columns.iter().map(|column| column.name.clone()).zip(lost).collect();
        self.resampling = Some(Resampling { interval, lost });
        self.time = time.into();
        self.columns.iter_mut().zip(means).for_each(|(column, values)| column.values = values.into());
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Data {
        let time: Vec<f64> = (0..7).map(|k| 0.1 * f64::from(k)).collect();
        let y = vec![0.0, 1.0, 2.0, f64::NAN, 4.0, f64::NAN, 6.0];
        Data::from_columns(time, [("y [mm]".to_owned(), y)]).unwrap()
    }

    #[test]
    fn means_of_a_period_take_all_of_a_signal_away_and_noise_is_none() {
        let noise = |k: i32| 2.0 * ((12.9898 * (f64::from(k) + 1.0)).sin() * 43_758.547).fract().abs() - 1.0;
        let time: Vec<f64> = (0..1000).map(|k| 0.1 * f64::from(k)).collect();
        let wave = time.iter().map(|t| (std::f64::consts::TAU * t / 5.0).sin()).collect();
        let slow = (0..1000).map(|k| (0.01 * f64::from(k)).sin() + 0.2 * noise(k)).collect();
        let alone = (0..1000).map(noise).collect();
        let columns = [("wave", wave), ("slow", slow), ("noise", alone)].map(|(n, v)| (n.to_owned(), v));
        let data = Data::from_columns(time, columns).unwrap();
        let lost = |interval: f64| -> Vec<f64> {
            let data = data.clone().resampled(interval).unwrap();
            data.resampling().unwrap().lost.iter().map(|(_, lost)| *lost).collect()
        };
        let [wave, slow, noise] = lost(5.0)[..] else { panic!() };
        // The mean of a wave over an angle of 2 a has sin(a) / a of its height.
        let of_wave = |a: f64| 1.0 - (a.sin() / a).powi(2);
        assert!(wave > 0.99 && (slow - of_wave(0.25)).abs() < 0.01 && noise == 0.0, "{wave} {slow} {noise}");
        assert!((lost(1.0)[0] - of_wave(std::f64::consts::PI / 5.0)).abs() < 0.01, "{:?}", lost(1.0));
        assert!(lost(0.5)[0] < 0.05);
    }

    #[test]
    fn resampled_columns_keep_their_own_times() {
        // y = 1 + 2 t, known in every third row, and z in every row.
        let time: Vec<f64> = (0..60).map(|k| 0.1 * f64::from(k)).collect();
        let line: Vec<f64> = time.iter().map(|t| 1.0 + 2.0 * t).collect();
        let y = line.iter().enumerate().map(|(k, v)| if k % 3 == 2 { *v } else { f64::NAN }).collect();
        let columns = [("y".to_owned(), y), ("z".to_owned(), line)];
        let data = Data::from_columns(time, columns).unwrap().resampled(0.5).unwrap();
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
    fn resampling_takes_means() {
        let data = table().resampled(0.3).unwrap();
        let near =
            |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12) && a.len() == b.len();
        let known = |name: &str| -> (Vec<f64>, Vec<f64>) {
            let rows = data.time().iter().zip(data.column(name).unwrap()).filter(|(_, v)| !v.is_nan());
            rows.unzip()
        };
        let (times, values) = known("y");
        assert!(near(&times, &[0.1, 0.4, 0.6]) && near(&values, &[1.0, 4.0, 6.0]), "{times:?} {values:?}");
        for (interval, expected) in [
            (0.05, "rows every 0.05 s cannot be made of rows every 0.1"),
            (f64::NAN, "positive and finite, not NaN"),
        ] {
            assert!(table().resampled(interval).unwrap_err().to_string().contains(expected));
        }
    }
}
