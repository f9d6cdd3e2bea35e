//! Templates of the report and of the notebook element. Their input is escaped, because names in an FMU may
//! contain any characters.

use super::summary::Summary;
use crate::findings::display_text::visible_line;
use crate::findings::identifier::FindingId;
use minijinja::value::Serde;
use minijinja::{Environment, Value, context, escape_formatter};
use serde::Serialize;

/// Returns the summary as an HTML element for a notebook.
pub(super) fn notebook(summary: &Summary) -> String {
    render("notebook.html", context! { summary => Serde(summary) })
}

/// Returns the page of a report.
pub(super) fn page(summary: &Summary, page: impl Serialize) -> String {
    render("page.html", context! { summary => Serde(summary), page => Serde(&page) })
}

/// Returns the page of a running fit. The `nonce` belongs to its script.
pub(super) fn live(title: &str, nonce: &str, state: &str) -> String {
    render("live.html", context! { title, nonce, state })
}

/// Returns the variable part of the page of a running fit.
pub(super) fn live_state(state: impl Serialize) -> String {
    render("live_state.html", context! { state => Serde(&state) })
}

/// Returns the page of a failed fit.
pub(super) fn error(message: &str) -> String {
    render("error.html", context! { message })
}

/// Renders a template. The templates are part of the program, so an error is a defect of a template that the
/// tests detect.
fn render(name: &str, values: Value) -> String {
    let mut environment = Environment::new();
    let templates = [
        ("error.html", include_str!("templates/error.html")),
        ("figure.html", include_str!("templates/figure.html")),
        ("legend.html", include_str!("templates/legend.html")),
        ("live.html", include_str!("templates/live.html")),
        ("live_state.html", include_str!("templates/live_state.html")),
        ("tables.html", include_str!("templates/tables.html")),
        ("notebook.html", include_str!("templates/notebook.html")),
        ("page.html", include_str!("templates/page.html")),
        ("style.html", include_str!("templates/style.html")),
    ];
    environment
        .add_filter("name_of_finding", |id: String| FindingId::try_from(id).map_or("", FindingId::name));
    // Strings are single lines. Safe values come from other templates and figures.
    environment.set_formatter(|out, state, value| match value.as_str().filter(|_| !value.is_safe()) {
        Some(text) => escape_formatter(out, state, &Value::from(visible_line(text))),
        None => escape_formatter(out, state, value),
    });
    let rendered = templates
        .into_iter()
        .try_for_each(|(name, source)| environment.add_template(name, source))
        .and_then(|()| environment.get_template(name)?.render(values));
    rendered.unwrap_or_else(|error| error.to_string())
}
