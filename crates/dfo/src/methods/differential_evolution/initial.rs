//! First population given by the user: its checks, and its description in the identity of a run.

use super::options::DifferentialEvolution;
use crate::error::Error;
use crate::problem::option_texts;
use crate::problem::space::Space;
use crate::values::choices::ParameterKind;
use crate::values::encoding::encode;

/// Name of the option in Python and in files.
const NAME: &str = "initial_population";

/// Checks the members of the first population, if the user has given them.
///
/// Members must be points of the box. Along each free parameter, they must have at least two values. Trials
/// are sums of members and their differences, so they could not leave a single value.
pub(super) fn check(space: &Space, options: &DifferentialEvolution) -> Result<(), Error> {
    let Some(members) = &options.initial_population else { return Ok(()) };
    if let Some(n) = options.population.filter(|n| *n != members.len()) {
        let range = "the number of members in initial_population, or omitted";
        return Err(Error::Option { name: "population", value: n as f64, range });
    }
    for (member, x) in members.iter().enumerate() {
        if x.len() != space.n() {
            let what = "member of the initial population";
            return Err(Error::Length { what, expected: space.n(), got: x.len() });
        }
        for (index, &value) in x.iter().enumerate() {
            let (lower, upper) = (space.bounds().lower()[index], space.bounds().upper()[index]);
            let is_inside = value.is_finite() && lower <= value && value <= upper;
            if !is_inside {
                return Err(Error::MemberOutside { member, index, value, lower, upper });
            }
        }
        for (k, &index) in space.free().iter().enumerate() {
            let value = x[index];
            if space.kind(k) != ParameterKind::Continuous && value != value.round() {
                let (name, range) = ("initial population", "an integer, because the parameter is discrete");
                return Err(Error::ParameterOption { name, index, value, range });
            }
        }
    }
    let first = members.first().map_or(space.x0(), |x| x);
    match space.free().iter().find(|&&index| members.iter().all(|x| x[index] == first[index])) {
        Some(&index) => Err(Error::FlatPopulation { index, value: first[index] }),
        None => Ok(()),
    }
}

/// Returns the options by name. A given population is described by its size and a checksum. Without one, the
/// entry is missing, because checkpoints of earlier versions do not have it.
pub(super) fn describe(options: &DifferentialEvolution) -> Vec<(String, String)> {
    let mut fields = option_texts::fields(options);
    match &options.initial_population {
        None => fields.retain(|(name, _)| name != NAME),
        Some(members) => {
            let bytes = encode(members).unwrap_or_default();
            let text = format!("{} points ({:08x})", members.len(), crc32fast::hash(&bytes));
            fields.iter_mut().filter(|(name, _)| name == NAME).for_each(|field| field.1.clone_from(&text));
        }
    }
    fields
}
