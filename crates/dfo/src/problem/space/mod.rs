//! The search space: which parameters are free, on which scale they are, and what size a step of one has.
//!
//! Outside, points are always in the user's units and order. Methods see *working coordinates*: one per free
//! parameter, `x` itself on a linear scale (bit for bit, so that tolerances in x stay tolerances in x) and
//! `ln x` on a logarithmic one. The typical size of a coordinate is taken from the user, else from the width
//! of a finite box that is not too wide to tell one, else from |x0|, else it is 1: see [`typical_size`].
//!
//! Searches that start from a point (all but those that sample a box) take finite bounds that stand for
//! "none", at least 1e10 times as far as the largest of 1, |x0| and the given size, as none: the coordinates
//! are those of a parameter without them. No point outside of them is evaluated all the same.

mod angles;
mod bounds;
mod coordinates;

pub use bounds::Bounds;
pub(crate) use bounds::{clamp, fold};
pub use coordinates::{Space, typical_size};
