//! JSON schemas of fields that the records of a problem accept in several forms.

use crate::problem::experiment::OutputScale;
use crate::problem::input::ColumnRecord;
use crate::problem::objective::CostKind;
use crate::problem::parameter::Parameter;
use fmi::worker::Isolation;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use std::borrow::Cow;
use std::collections::BTreeMap;

macro_rules! untagged {
    ($($(#[$doc:meta])* $name:ident $(<$T:ident>)? { $($variant:ident($content:ty)),* $(,)? })*) => {
        $($(#[$doc])*
        #[derive(JsonSchema)]
        #[serde(untagged)]
        #[allow(dead_code, clippy::large_enum_variant, reason = "its schema alone is used")]
        pub(crate) enum $name $(<$T>)? {
            $($variant($content)),*
        })*
    };
}

untagged! {
    /// A value for each name, or only names, which are then also the values.
    Pairs<T> { ByName(BTreeMap<String, T>), InOrder(Vec<(String, T)>), Alike(Vec<String>) }
    /// A number, or a value of another type.
    NumberOr<T> { Number(f64), Other(T) }
    /// The weight of an output: a number or a column.
    OutputWeight { Number(Positive), Column(String) }
    /// Weights of outputs.
    Weights { Scale(OutputScale), Each(Pairs<OutputWeight>) }
    /// A value of a variable of the model.
    ModelValue { Truth(bool), Number(f64), Text(String), Array(Vec<ModelValue>) }
    /// Start values, or the path of a file that contains them.
    StartValues { File(String), Each(Pairs<ModelValue>) }
    /// Source of an input that is not a number.
    InputRecord { Column(String), Settings(ColumnRecord) }
    /// Initial values of states, or the start from steady state.
    InitialStates { Word(Steady), Each(Pairs<NumberOr<InitialStateRecord>>) }
    /// Initial value of a state that is not a number.
    InitialStateRecord { Word(Measured), Fitted(Parameter) }
}

/// A positive number.
pub(crate) struct Positive;

impl JsonSchema for Positive {
    fn schema_name() -> Cow<'static, str> {
        "Positive".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "number", "exclusiveMinimum": 0 })
    }
}

/// The start from steady state.
#[derive(JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[allow(dead_code, reason = "its schema alone is used")]
pub(crate) enum Steady {
    Steady,
}

/// The first measurement; for the name `*`, steady state of all other states.
#[derive(JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[allow(dead_code, reason = "its schema alone is used")]
pub(crate) enum Measured {
    Measured,
    Steady,
}

pub(crate) fn isolation(_: &mut SchemaGenerator) -> Schema {
    json_schema!({ "enum": Isolation::NAMES.map(|(name, _)| name) })
}

pub(crate) fn objective(_: &mut SchemaGenerator) -> Schema {
    json_schema!({ "enum": CostKind::named().map(|kind| kind.name().to_owned()).collect::<Vec<_>>() })
}
