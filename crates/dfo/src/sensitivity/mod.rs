//! Global sensitivity analysis: the effect of each parameter on each value of a vector function, over the
//! whole box. A design is a list of points, which a run evaluates and from whose values the effects are
//! estimated.

mod bootstrap;
mod design;
mod evaluations;
mod listed_points;
mod method;
mod morris;
mod result;
mod sobol;

pub use design::SensitivityDesign;
pub use evaluations::Evaluations;
pub use listed_points::ListedPoints;
pub use method::SensitivityMethod;
pub use morris::MorrisEffects;
pub use result::{Effects, IntervalOptions, OutputEffects, Sensitivity};
pub use sobol::SobolIndices;
