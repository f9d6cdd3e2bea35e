//! Parts shared by several methods: costs and ranks, populations, generations, planes that separate failed
//! points, products of long vectors.

pub(crate) mod cost;
pub(crate) mod dot;
pub(crate) mod failures;
pub(crate) mod generations;
pub(crate) mod pending_generation;
pub(crate) mod population;
pub(crate) mod ranked_points;
pub(crate) mod size_search;
pub(crate) mod with_sizes;
