//! Variables by name, and suggestions for misspelt names.

use std::sync::LazyLock;

use anyhow::{Result, bail, ensure};
use model_description::{Causality, Item, Kind, ModelDescription, TypeKind, Variability, Variable};

/// The model description against which all scenes are checked.
pub(crate) fn model() -> Result<&'static ModelDescription> {
    static MODEL: LazyLock<Result<ModelDescription, model_description::Error>> = LazyLock::new(ModelDescription::read);
    Ok(MODEL.as_ref()?)
}

/// Keys of scenes in tip coordinates, which need inverse kinematics.
const TIP: [&str; 4] = ["tip.x", "tip.y", "mode.working", "mode.assembly"];
/// Keys of encoder offsets, which are not variables of a unit.
const OFFSETS: [&str; 2] = ["encoder.offset[1]", "encoder.offset[2]"];

/// Refuses a key of tip coordinates or of an encoder.
fn not_of_the_package(name: &str) -> Result<()> {
    for (keys, what) in [(&TIP[..], "is in the tip's coordinates"), (&OFFSETS, "is of an encoder")] {
        ensure!(!keys.contains(&name), "'{name}' {what}, which the Python package fivebar reads and this reader does not");
    }
    Ok(())
}

/// The variable of a start value in a scene; refuses unknown and computed variables. `reserved` are other keys that a misspelt
/// name may mean.
pub(crate) fn settable(name: &str, reserved: &[&str]) -> Result<&'static Variable> {
    not_of_the_package(name)?;
    let variables = &model()?.variables;
    let can_be_set = |variable: &&Variable| matches!(variable.causality, Causality::Parameter | Causality::Input);
    match variables.iter().find(|variable| variable.name.full == name) {
        Some(variable) if can_be_set(&variable) => Ok(variable),
        Some(_) => bail!("'{name}' is computed by the FMU and cannot be set"),
        None => {
            let known = variables.iter().filter(can_be_set).map(|variable| variable.name.full.as_str());
            bail!("there is no variable '{name}'{}", similar(name, known.chain(reserved.iter().copied())))
        }
    }
}

/// The input of a signal in a scene; refuses other variables.
pub(crate) fn input(name: &str) -> Result<&'static Variable> {
    not_of_the_package(name)?;
    if let Some(parameter) = model()?.variables.iter().find(|v| v.name.full == name && v.causality == Causality::Parameter) {
        let tunable = parameter.variability == Variability::Tunable;
        bail!(
            "'{name}' is a {}",
            if tunable {
                "tunable parameter: if it is Real, it takes 'steps'"
            } else {
                "fixed parameter: it keeps its start value"
            }
        );
    }
    let inputs = || model().into_iter().flat_map(|model| &model.variables).filter(|v| v.causality == Causality::Input);
    match inputs().find(|variable| variable.name.full == name) {
        Some(variable) => Ok(variable),
        None => bail!("'{name}' is not an input of the FMU{}", similar(name, inputs().map(|variable| variable.name.full.as_str()))),
    }
}

/// The input or tunable Real parameter that a scene changes in steps; refuses other variables.
pub(crate) fn input_or_tunable(name: &str) -> Result<&'static Variable> {
    let tunable = |variable: &&Variable| variable.variability == Variability::Tunable && matches!(variable.kind, Kind::Real { .. });
    match model()?.variables.iter().filter(tunable).find(|variable| variable.name.full == name) {
        Some(variable) => Ok(variable),
        None => input(name),
    }
}

/// The unit of a variable, `1` if it has none.
pub(crate) fn unit(variable: &Variable) -> &str {
    variable.unit.as_deref().unwrap_or("1")
}

/// Items of an enumeration variable; empty for other types.
pub(crate) fn items(variable: &Variable) -> Result<&'static [Item]> {
    let declared = model()?.types.iter().find(|declared| Some(&declared.name) == variable.declared_type.as_ref());
    match declared.map(|declared| &declared.kind) {
        Some(TypeKind::Enumeration(enumeration)) => Ok(&enumeration.items),
        _ => Ok(&[]),
    }
}

/// End of a sentence about an unknown name, with suggestions.
pub(crate) fn similar<'a>(name: &str, known: impl Iterator<Item = &'a str>) -> String {
    /// Likeness from which a name is suggested: 0.4 of the letters may differ.
    const ALIKE: f64 = 0.6;
    const MOST_ALIKE: usize = 3;
    const MOST_KNOWN: usize = 6;
    let known: Vec<&str> = known.collect();
    let rate = |other: &&'a str| (strsim::normalized_damerau_levenshtein(name, other), *other);
    let mut near: Vec<(f64, &str)> = known.iter().map(rate).filter(|(likeness, _)| *likeness >= ALIKE).collect();
    near.sort_by(|a, b| b.0.total_cmp(&a.0));
    let quoted: Vec<String> = near.iter().take(MOST_ALIKE).map(|(_, other)| format!("'{other}'")).collect();
    match (quoted.as_slice(), known.len().saturating_sub(MOST_KNOWN)) {
        ([], 0) => format!("; known are {}", known.join(", ")),
        ([], more) => format!("; known are {} and {more} more", known[..MOST_KNOWN].join(", ")),
        _ => format!("; did you mean {}?", quoted.join(" or ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_names_come_first_and_are_few() {
        let known = ["tau[1]", "tau[2]", "tip.fx", "tau.g[1]", "gravity.g"];
        assert_eq!(similar("tau[3]", known.into_iter()), "; did you mean 'tau[1]' or 'tau[2]' or 'tau.g[1]'?");
        assert_eq!(similar("gravty.g", known.into_iter()), "; did you mean 'gravity.g'?");
        assert_eq!(similar("zzz", known.into_iter()), "; known are tau[1], tau[2], tip.fx, tau.g[1], gravity.g");
        let more = known.into_iter().chain(["aaa", "bbb", "ccc"]);
        assert_eq!(similar("zzz", more), "; known are tau[1], tau[2], tip.fx, tau.g[1], gravity.g, aaa and 2 more");
    }
}
