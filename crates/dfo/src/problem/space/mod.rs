//! Search space: the free parameters, their scales and their typical sizes.
//!
//! In the public interface, points are always in the user's units and order. Methods see *working
//! coordinates*, one per free parameter. On a linear scale, the coordinate is `x` itself, bit for bit, so
//! tolerances in x remain tolerances in x. On a logarithmic scale, it is `ln x`. The typical size of a
//! coordinate is the user's value if given. Otherwise, it is the width of a finite box that is not too wide,
//! then |x0|, then 1; see [`typical_size`].
//!
//! Searches that start from a point (all except those that sample a box) ignore finite bounds that are far
//! away. A bound is far if it is at least 1e10 times the largest of 1, |x0| and the given size. The
//! coordinates are then the same as for a parameter without bounds. Still, no point outside these bounds is
//! evaluated.
//!
//! Linear equalities remove free parameters ([`Space::with_linear`]). Linear inequalities are rows over the
//! working coordinates, which methods keep like bounds.

mod angles;
mod bounds;
mod coordinates;
mod linear;
mod linear_points;
mod linear_set;

pub use bounds::Bounds;
pub(crate) use bounds::{clamp, fold};
pub(crate) use coordinates::IntegerCell;
pub use coordinates::{Space, typical_size};
