//! The search space: which parameters are free, on which scale they live, and what size a step of one has.
//!
//! Outside, points are always in the user's units and order. Methods see *working coordinates*: one per free
//! parameter, `x` itself on a linear scale (bit for bit, so that tolerances in x stay tolerances in x) and `ln x` on
//! a logarithmic one. The typical size of a coordinate is taken from the user, else from the width of a finite box,
//! else from |x0|, else it is 1.

mod angles;
mod bounds;
mod coordinates;

pub use bounds::Bounds;
pub(crate) use bounds::fold;
pub use coordinates::Space;
