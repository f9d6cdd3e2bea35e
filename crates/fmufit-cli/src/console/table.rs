//! Text tables.

use comfy_table::ContentArrangement;
use comfy_table::presets::NOTHING;

/// A table with a header. Empty columns are left out.
pub(crate) struct Table<const N: usize> {
    header: [&'static str; N],
    rows: Vec<[String; N]>,
}

impl<const N: usize> Table<N> {
    /// Creates an empty table.
    pub(crate) fn new(header: [&'static str; N]) -> Self {
        Self { header, rows: Vec::new() }
    }

    /// Adds a row.
    pub(crate) fn row(&mut self, row: [String; N]) {
        self.rows.push(row);
    }

    /// Returns the text, one line per row. With a terminal `width`, cells wrap if a line is too long.
    pub(crate) fn text(&self, width: Option<u16>) -> String {
        let is_kept: [bool; N] = std::array::from_fn(|k| self.rows.iter().any(|row| !row[k].is_empty()));
        let kept = |row: &[String; N]| {
            let cells = row.iter().zip(is_kept).filter(|(_, is_kept)| *is_kept);
            cells.map(|(cell, _)| calibration::visible_line(cell).into_owned()).collect::<Vec<_>>()
        };
        let mut table = comfy_table::Table::new();
        table.load_style(NOTHING);
        if let Some(width) = width {
            table.set_width(width).set_content_arrangement(ContentArrangement::Dynamic);
        }
        table.set_header(kept(&self.header.map(str::to_owned)));
        self.rows.iter().for_each(|row| _ = table.add_row(kept(row)));
        table.trim_fmt()
    }
}
