//! Names of methods as arguments, with what there is to say of each in the help.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use umbrage::query::{Exactness, Method, Selection};

/// Reads a method or `auto`; the possible values are the one list of methods.
pub fn parser<M: Method + Send + Sync>() -> impl TypedValueParser<Value = Selection<M>> {
    let auto = PossibleValue::new(Selection::<M>::AUTO).help("The fastest exact method that fits the scene");
    PossibleValuesParser::new(std::iter::once(auto).chain(values::<M>())).try_map(|name| name.parse())
}

/// Reads a method where nothing else chooses one.
pub fn modes<M: Method + Send + Sync>() -> impl TypedValueParser<Value = M> {
    PossibleValuesParser::new(values::<M>()).try_map(|name| name.parse())
}

fn values<M: Method>() -> impl Iterator<Item = PossibleValue> {
    M::all().iter().map(|&method| {
        let value = PossibleValue::new(method.name()).help(describe(method));
        match method.alias() {
            Some(alias) => value.alias(alias),
            None => value,
        }
    })
}

fn describe(method: impl Method) -> String {
    let also = method.alias().map_or(String::new(), |alias| format!(" Also {alias}."));
    match method.exactness() {
        Exactness::Exact => format!("{} Exact.{also}", method.summary()),
        Exactness::Approximate(error) => format!("{} Approximate: {error}{also}", method.summary()),
    }
}
