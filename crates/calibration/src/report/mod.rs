//! What a fit found, for people: as text, as a part of a notebook, and as a page with figures.

mod number;
mod summary;
mod text;

#[cfg(test)]
mod tests;
