//! Figure of a Pareto front.

use super::figure::{Panel, Point, Series, draw};

/// Height of a panel, in pixels.
const PANEL: u32 = 260;

/// Draws each further goal over the first one as SVG. `values` are the goals of each design, and the
/// `compromise` has another colour. Returns `None` if there are no finite values to draw.
pub(crate) fn plot_front(goals: &[String], values: &[Vec<f64>], compromise: Option<usize>) -> Option<String> {
    let (first, others) = goals.split_first()?;
    let panel = |(k, goal): (usize, &String)| {
        let point = |row: &Vec<f64>| Some((*row.first()?, *row.get(k + 1)?));
        let points: Vec<Point> = values.iter().filter_map(point).collect();
        let chosen = compromise.and_then(|row| points.get(row).copied());
        Panel {
            height: PANEL,
            y_label: goal.clone(),
            series: vec![Series::Measured(points), Series::Marks(chosen.into_iter().collect())],
            is_logarithm: false,
            has_zero: false,
        }
    };
    draw(&others.iter().enumerate().map(panel).collect::<Vec<_>>(), first)
}
