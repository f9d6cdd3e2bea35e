//! Figures of the report as SVG: panels over a common axis. Long series are drawn with fewer points.
//!
//! Colours are attributes in the drawings. The style sheet of the page uses them to redraw elements on a dark
//! page.

use super::number::rounded;
use crate::findings::display_text::visible_line;
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use std::ops::Range;

/// Colours of recordings, the start of a fit, the fitted values, text, and grid lines. Colour-blind readers
/// can distinguish blue, vermillion and greys (Okabe and Ito, Color universal design, 2008). Lines also
/// differ by their dashes.
const MEASURED: RGBColor = RGBColor(0x76, 0x76, 0x76);
const START: RGBColor = RGBColor(0xD5, 0x5E, 0x00);
const FITTED: RGBColor = RGBColor(0x00, 0x72, 0xB2);
const TEXT: RGBColor = RGBColor(0x1A, 0x1A, 0x1A);
const GRID: RGBColor = RGBColor(0xDD, 0xDD, 0xDD);

/// Units of a drawing per pixel of a figure: coordinates are integers.
const FINE: u32 = 3;

/// Width of a figure in pixels.
const WIDTH: u32 = 560;

/// Space for labels at the left and below, and margin at the other sides, in pixels.
const LEFT: u32 = 86;
const BELOW: u32 = 44;
const MARGIN: u32 = 8;

/// Space at the right for half of the last axis label.
const END_LABEL: u32 = 28;

/// Number of pixels per label on the axis of values.
const PER_LABEL: u32 = 26;

/// Size of the text in pixels; the drawing library writes the size divided by 1.24.
const TEXT_SIZE: f64 = 13.0 * 1.24 * FINE as f64;

/// Longest label; longer labels are cut.
const LONGEST_LABEL: usize = 34;

/// Maximum number of points of a line, or of marks of a series.
const MOST: usize = 1000;

/// A point of a drawing.
pub(super) type Point = (f64, f64);

/// A series and its style.
pub(super) enum Series {
    /// Single marks of measurements or evaluations.
    Measured(Vec<Point>),
    /// Vertical bars of the uncertainty of measurements, each from one point to the next.
    Bars(Vec<Point>),
    /// Single marks that belong to the fitted values.
    Marks(Vec<Point>),
    /// A line of an input of the model.
    Input(Vec<Point>),
    /// A line at the start, and a line at the fitted values.
    Start(Vec<Point>),
    Fitted(Vec<Point>),
}

/// Series over a common axis.
pub(super) struct Panel {
    /// Height of the panel, in pixels.
    pub(super) height: u32,
    pub(super) y_label: String,
    pub(super) series: Vec<Series>,
    /// True if the values are logarithms, to base 10, of the labelled quantity.
    pub(super) is_logarithm: bool,
    /// True if a line at zero is drawn.
    pub(super) has_zero: bool,
}

impl Series {
    fn points(&self) -> &[Point] {
        match self {
            Self::Measured(points)
            | Self::Bars(points)
            | Self::Marks(points)
            | Self::Input(points)
            | Self::Start(points)
            | Self::Fitted(points) => points,
        }
    }
}

/// Draws the panels below each other as an SVG element. Returns `None` if there are no finite values to draw.
pub(super) fn draw(panels: &[Panel], x_label: &str) -> Option<String> {
    let all = panels.iter().flat_map(|panel| panel.series.iter().flat_map(Series::points));
    let x = range(all.filter(|(_, y)| y.is_finite()).map(|(x, _)| *x), 0.0)?;
    let heights: Vec<u32> = panels.iter().map(|panel| panel.height).collect();
    let size = (WIDTH * FINE, (heights.iter().sum::<u32>() + BELOW) * FINE);
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        let mut rest = area.clone();
        for (k, panel) in panels.iter().enumerate() {
            let is_last = k + 1 == panels.len();
            let height = (panel.height + if is_last { BELOW } else { 0 }) * FINE;
            let (panel_area, others) = rest.split_vertically(height as i32);
            rest = others;
            panel.draw(&panel_area, x.clone(), is_last.then_some(x_label)).ok()?;
        }
        area.present().ok()?;
    }
    // Default attributes are removed because they occur often enough to affect the size.
    Some(svg.replace(" opacity=\"1\"", "").replace(" stroke=\"none\" stroke-width=\"1\"", ""))
}

/// Returns a note about omitted marks; empty if all marks are drawn.
pub(super) fn note(n: usize) -> String {
    match n.div_ceil(MOST) {
        0 | 1 => String::new(),
        every => format!("One of {every} of the {n} measurements is drawn."),
    }
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type Drawn = Result<(), DrawingAreaErrorKind<std::io::Error>>;

impl Panel {
    /// Returns the range of the values. The curve at the start is cut off where it exceeds the range of the
    /// others by more than twice its width.
    fn y_range(&self) -> Option<Range<f64>> {
        let of = |is_start: bool| {
            let series = self.series.iter().filter(move |s| matches!(s, Series::Start(_)) == is_start);
            series.flat_map(Series::points).map(|(_, y)| *y)
        };
        let zero = self.has_zero.then_some(0.0);
        let Some(others) = range(of(false).chain(zero), 0.05) else { return range(of(true), 0.05) };
        let by = 2.0 * (others.end - others.start);
        let start = of(true).map(|y| y.clamp(others.start - by, others.end + by));
        range(of(false).chain(zero).chain(start.filter(|y| y.is_finite())), 0.05)
    }

    fn draw(&self, area: &Area<'_>, x: Range<f64>, x_label: Option<&str>) -> Drawn {
        let Some(y) = self.y_range() else { return Ok(()) };
        let mut chart = ChartBuilder::on(area)
            .margin(MARGIN * FINE)
            .margin_right(END_LABEL * FINE)
            .set_label_area_size(LabelAreaPosition::Left, LEFT * FINE)
            .set_label_area_size(LabelAreaPosition::Bottom, x_label.map_or(0, |_| BELOW * FINE))
            .build_cartesian_2d(x.clone(), y.clone())?;
        let x_text = labels(&x);
        let plain = labels(&y);
        let powers = power_labels(&y, self.height / PER_LABEL);
        let y_text = |y: &f64| if self.is_logarithm { powers(y) } else { plain(y) };
        let text = ("sans-serif", TEXT_SIZE).into_font().color(&TEXT);
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(GRID.stroke_width(FINE))
            .axis_style(MEASURED.stroke_width(FINE))
            .label_style(text.clone())
            .axis_desc_style(text)
            .x_labels(if x_label.is_some() { 6 } else { 0 })
            .y_labels((self.height / PER_LABEL) as usize)
            .x_label_formatter(&x_text)
            .y_label_formatter(&y_text)
            .x_desc(x_label.unwrap_or_default())
            .y_desc(visible_line(&cut(&self.y_label)))
            .draw()?;
        if self.has_zero {
            chart
                .draw_series(LineSeries::new([(x.start, 0.0), (x.end, 0.0)], MEASURED.stroke_width(FINE)))?;
        }
        self.series.iter().try_for_each(|series| draw_series(&mut chart, series, &y))
    }
}

fn draw_series(chart: &mut Chart<'_, '_>, series: &Series, y: &Range<f64>) -> Drawn {
    let line = |colour: RGBColor| colour.stroke_width(2 * FINE - 1);
    match series {
        Series::Measured(points) | Series::Marks(points) => {
            let colour = if matches!(series, Series::Marks(_)) { FITTED } else { MEASURED };
            let marks = sampled(points).into_iter();
            chart.draw_series(marks.map(|point| Circle::new(point, 2 * FINE, colour.filled())))?;
        }
        Series::Bars(points) => {
            let is_drawable = |bar: &&[Point]| bar.iter().all(|(x, y)| x.is_finite() && y.abs() < 1e200);
            let bars: Vec<&[Point]> = points.chunks_exact(2).filter(is_drawable).collect();
            for bar in bars.iter().step_by(bars.len().div_ceil(MOST).max(1)) {
                chart.draw_series(LineSeries::new(bar.iter().copied(), MEASURED.stroke_width(FINE)))?;
            }
        }
        Series::Input(points) => {
            chart.draw_series(LineSeries::new(thinned(points), line(MEASURED)))?;
        }
        Series::Start(points) => {
            let inside = points.iter().map(|(t, value)| (*t, value.clamp(y.start, y.end)));
            chart.draw_series(LineSeries::new(thinned(&inside.collect::<Vec<_>>()), line(START)))?;
        }
        Series::Fitted(points) => {
            chart.draw_series(LineSeries::new(thinned(points), line(FITTED)))?;
        }
    }
    Ok(())
}

fn finite(points: &[Point]) -> Vec<Point> {
    points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite()).collect()
}

/// Returns the finite points as marks. For many points, it returns every k-th, which preserves the scatter,
/// and the lowest and the highest point.
fn sampled(points: &[Point]) -> Vec<Point> {
    let finite = finite(points);
    let by_value = |a: &&Point, b: &&Point| a.1.total_cmp(&b.1);
    let every = finite.len().div_ceil(MOST).max(1);
    let mut marks: Vec<Point> = finite.iter().step_by(every).copied().collect();
    if every > 1 {
        marks.extend(finite.iter().min_by(by_value).into_iter().chain(finite.iter().max_by(by_value)));
    }
    marks
}

/// Returns the finite points of a line. For many points, it returns the lowest and the highest of each
/// section, so that no extreme is lost.
fn thinned(points: &[Point]) -> Vec<Point> {
    let finite = finite(points);
    if finite.len() <= MOST {
        return finite;
    }
    let extremes = |stretch: &[Point]| {
        let by_value = |a: &&Point, b: &&Point| a.1.total_cmp(&b.1);
        let mut pair: Vec<Point> = stretch
            .iter()
            .min_by(by_value)
            .into_iter()
            .chain(stretch.iter().max_by(by_value))
            .copied()
            .collect();
        pair.sort_by(|a, b| a.0.total_cmp(&b.0));
        pair
    };
    finite.chunks(finite.len().div_ceil(MOST / 2)).flat_map(extremes).collect()
}

/// Returns the range of the finite values, with a margin on both sides relative to the width. If all values
/// are equal within the digits of the labels, the width of the range is still positive.
fn range(values: impl Iterator<Item = f64>, margin: f64) -> Option<Range<f64>> {
    let drawable = values.filter(|v| v.abs() < 1e200);
    let (low, high) =
        drawable.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low > high {
        return None;
    }
    let size = low.abs().max(high.abs());
    let by = match high - low {
        width if width > 1e-8 * size && size > 1e-200 => margin * width,
        _ if size > 1e-200 => 0.05 * size,
        _ => 1.0,
    };
    Some(low - by..high + by)
}

/// Returns the labels of an axis, with enough digits to distinguish them.
fn labels(range: &Range<f64>) -> impl Fn(&f64) -> String {
    let width = range.end - range.start;
    let digits = ((range.start.abs().max(range.end.abs()) / width).log10() + 3.0).clamp(3.0, 12.0);
    // The value is the rounding error of zero.
    move |value| if value.abs() < 1e-9 * width { "0".to_owned() } else { rounded(*value, digits as usize) }
}

/// Returns the labels of a logarithmic axis, with enough digits to distinguish `n` labels.
fn power_labels(range: &Range<f64>, n: u32) -> impl Fn(&f64) -> String {
    let ratio = 10_f64.powf((range.end - range.start) / f64::from(2 * n.max(1))) - 1.0;
    let digits = (1.0 - ratio.log10()).ceil().clamp(2.0, 12.0);
    move |value| rounded(10_f64.powf(*value), digits as usize)
}

fn cut(label: &str) -> String {
    match label.chars().count() {
        n if n <= LONGEST_LABEL => label.to_owned(),
        n => {
            let tail = label.chars().skip(n - LONGEST_LABEL + 3);
            "...".chars().chain(tail).collect()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figure_is_drawn_for_extreme_values() {
        let panel = |values: &[f64]| Panel {
            height: 200,
            y_label: "<script>alert(\"x\") & a very long name of a variable".to_owned(),
            series: vec![
                Series::Measured(values.iter().enumerate().map(|(i, v)| (i as f64, *v)).collect()),
                Series::Fitted(values.iter().enumerate().map(|(i, v)| (i as f64, *v)).collect()),
            ],
            is_logarithm: false,
            has_zero: false,
        };
        for values in [
            &[1.0, 2.0][..],
            &[3.0, 3.0],
            &[0.0],
            &[f64::NAN, 1.0, f64::INFINITY],
            &[1e-300, 2e-300],
            &[5e-324, 0.0],
            &[-1e199, 1e199],
            &[1e9, 1e9 + 1e-6],
            &[1.0, 1.0 + 1e-15],
        ] {
            let svg = draw(&[panel(values)], "time in s").unwrap();
            assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"), "{values:?}");
            assert!(!svg.contains("<script>") && !svg.contains("NaN"), "{values:?}: {svg}");
        }
        assert_eq!(draw(&[panel(&[f64::NAN])], ""), None);
        let mut wild = panel(&[1.0, 2.0]);
        wild.series.push(Series::Start(vec![(0.0, 1.5), (1.0, 1e150), (2.0, f64::INFINITY)]));
        let y = wild.y_range().unwrap();
        assert!(y.end < 5.0 && y.start > 0.5, "{y:?}");
        assert!(draw(&[wild], "").is_some());
        assert_eq!(draw(&[], ""), None);
    }

    #[test]
    fn power_labels_are_distinct() {
        for (low, high) in [(115.0_f64, 134.0_f64), (1e-9, 1e4), (100.0, 100.01), (2.0, 3.0)] {
            let y = low.log10()..high.log10();
            let text = power_labels(&y, 8);
            let at = |k: u32| text(&(y.start + (y.end - y.start) * f64::from(k) / 8.0));
            let texts: Vec<String> = (0..=8).map(at).collect();
            assert!(texts.windows(2).all(|pair| pair[0] != pair[1]), "{texts:?}");
        }
    }

    #[test]
    fn thinning_keeps_extremes() {
        let mut points: Vec<Point> = (0..100_000).map(|i| (f64::from(i), 0.0)).collect();
        points[77_777].1 = 5.0;
        points[3].1 = -5.0;
        let few = thinned(&points);
        assert!(few.len() <= MOST && few.contains(&(77_777.0, 5.0)) && few.contains(&(3.0, -5.0)));
        assert!(few.windows(2).all(|pair| pair[0].0 <= pair[1].0));
        let few = sampled(&points);
        assert!(few.len() <= MOST + 2 && few.contains(&(77_777.0, 5.0)) && few.contains(&(3.0, -5.0)));
    }
}
