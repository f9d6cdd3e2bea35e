//! Parts that several methods share: the rank of a cost, populations, generations, planes beside points that
//! failed, products of long vectors.

pub(crate) mod cost;
pub(crate) mod dot;
pub(crate) mod failures;
pub(crate) mod generations;
pub(crate) mod pending_generation;
pub(crate) mod population;
pub(crate) mod ranked_points;
pub(crate) mod size_search;
pub(crate) mod with_sizes;
