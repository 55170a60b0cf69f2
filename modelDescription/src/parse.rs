//! Parser from the tree of elements to plain data.

use std::str::FromStr;

use crate::Error;
use crate::data::{
    Bounds, Category, Causality, Enumeration, Experiment, Initial, Item, Kind, ModelDescription, Name, SimpleType, Structure,
    TypeKind, Unit, Unknown, Variability, Variable,
};
use crate::element::Element;

/// Parses the whole description. [`super::check`] then checks its consistency.
pub(crate) fn description(xml: &str) -> Result<ModelDescription, Error> {
    let root = Element::parse(xml)?;
    let types = each(root.child("TypeDefinitions")?, simple_type)?;
    let variables = each(root.child("ModelVariables")?, |element| variable(element, &types))?;
    let structure = structure(root.child("ModelStructure")?, &variables)?;
    Ok(ModelDescription {
        xml: xml.to_owned(),
        model_name: root.required("modelName")?.to_owned(),
        description: root.required("description")?.to_owned(),
        model_identifier: root.child("CoSimulation")?.required("modelIdentifier")?.to_owned(),
        event_indicators: number(&root, &root, "numberOfEventIndicators")?
            .ok_or_else(|| Error("<fmiModelDescription> has no attribute numberOfEventIndicators".to_owned()))?,
        experiment: experiment(root.child("DefaultExperiment")?)?,
        units: each(root.child("UnitDefinitions")?, unit)?,
        types,
        categories: each(root.child("LogCategories")?, category)?,
        variables,
        structure,
    })
}

fn each<T>(parent: &Element, convert: impl FnMut(&Element) -> Result<T, Error>) -> Result<Vec<T>, Error> {
    parent.children.iter().map(convert).collect()
}

fn text(element: &Element, attribute: &str) -> Option<String> {
    element.attribute(attribute).map(str::to_owned)
}

fn description_of(element: &Element) -> String {
    text(element, "description").unwrap_or_default()
}

fn experiment(element: &Element) -> Result<Experiment, Error> {
    element.allow(&["startTime", "stopTime", "stepSize"])?;
    let seconds =
        |attribute| number(element, element, attribute)?.ok_or_else(|| Error(format!("{element} has no attribute {attribute}")));
    Ok(Experiment { stop_time: seconds("stopTime")?, step_size: seconds("stepSize")? })
}

fn unit(element: &Element) -> Result<Unit, Error> {
    element.allow(&["name"])?;
    let display = element.children.iter().filter(|child| child.tag == "DisplayUnit");
    Ok(Unit {
        name: element.required("name")?.to_owned(),
        display_units: display.map(|child| child.required("name").map(str::to_owned)).collect::<Result<_, _>>()?,
    })
}

fn category(element: &Element) -> Result<Category, Error> {
    element.allow(&["name", "description"])?;
    Ok(Category { name: element.required("name")?.to_owned(), description: description_of(element) })
}

fn simple_type(element: &Element) -> Result<SimpleType, Error> {
    element.allow(&["name", "description"])?;
    let [inner] = element.children.as_slice() else {
        return Err(Error(format!("{element} must hold exactly one type")));
    };
    inner.allow(match inner.tag.as_str() {
        "Real" => &["quantity", "unit", "displayUnit"],
        _ => &["quantity"],
    })?;
    let kind = match inner.tag.as_str() {
        "Real" => TypeKind::Real { unit: text(inner, "unit"), display_unit: text(inner, "displayUnit") },
        "Integer" => TypeKind::Integer,
        "Boolean" => TypeKind::Boolean,
        "Enumeration" => TypeKind::Enumeration(Enumeration { items: each(inner, item)? }),
        other => {
            return Err(Error(format!("{element}: <{other}> is not Real, Integer, Boolean or Enumeration")));
        }
    };
    Ok(SimpleType { name: element.required("name")?.to_owned(), description: description_of(element), kind })
}

fn item(element: &Element) -> Result<Item, Error> {
    element.allow(&["name", "value", "description"])?;
    Ok(Item {
        name: element.required("name")?.to_owned(),
        value: number(element, element, "value")?.ok_or_else(|| Error(format!("{element} has no attribute value")))?,
        description: description_of(element),
    })
}

fn variable(element: &Element, types: &[SimpleType]) -> Result<Variable, Error> {
    element.allow(&["name", "valueReference", "description", "causality", "variability", "initial"])?;
    let [inner] = element.children.as_slice() else {
        return Err(Error(format!("{element} must hold exactly one type")));
    };
    inner
        .allow(match inner.tag.as_str() {
            "Real" => &["declaredType", "start", "min", "max", "derivative"],
            "Integer" => &["declaredType", "start", "min", "max"],
            _ => &["declaredType", "start"],
        })
        .map_err(|error| Error(format!("{element}: {error}")))?;
    let declared_type = text(inner, "declaredType");
    let unit = types.iter().find(|t| Some(&t.name) == declared_type.as_ref()).and_then(|t| match &t.kind {
        TypeKind::Real { unit, .. } => unit.clone(),
        _ => None,
    });
    Ok(Variable {
        name: Name::parse(element.required("name")?)?,
        reference: number(element, element, "valueReference")?
            .ok_or_else(|| Error(format!("{element} has no attribute valueReference")))?,
        description: element.required("description")?.to_owned(),
        causality: choice(
            element,
            "causality",
            &[
                ("parameter", Causality::Parameter),
                ("input", Causality::Input),
                ("output", Causality::Output),
                ("local", Causality::Local),
            ],
        )?
        .ok_or_else(|| Error(format!("{element} has no attribute causality")))?,
        variability: choice(
            element,
            "variability",
            &[
                ("fixed", Variability::Fixed),
                ("tunable", Variability::Tunable),
                ("discrete", Variability::Discrete),
                ("continuous", Variability::Continuous),
            ],
        )?
        .ok_or_else(|| Error(format!("{element} has no attribute variability")))?,
        initial: choice(element, "initial", &[("exact", Initial::Exact), ("calculated", Initial::Calculated)])?,
        kind: kind(element, inner)?,
        declared_type,
        unit,
        derivative_of: text(inner, "derivative"),
    })
}

fn kind(variable: &Element, inner: &Element) -> Result<Kind, Error> {
    Ok(match inner.tag.as_str() {
        "Real" => Kind::Real {
            start: number(variable, inner, "start")?,
            bounds: Bounds { min: number(variable, inner, "min")?, max: number(variable, inner, "max")? },
        },
        "Integer" => Kind::Integer {
            start: number(variable, inner, "start")?,
            bounds: Bounds { min: number(variable, inner, "min")?, max: number(variable, inner, "max")? },
        },
        "Boolean" => Kind::Boolean { start: number(variable, inner, "start")? },
        "Enumeration" => Kind::Enumeration { start: number(variable, inner, "start")? },
        other => {
            return Err(Error(format!("{variable}: <{other}> is not Real, Integer, Boolean or Enumeration")));
        }
    })
}

/// Value of an attribute as a number or truth value; messages name `owner`.
fn number<T: FromStr>(owner: &Element, element: &Element, attribute: &str) -> Result<Option<T>, Error> {
    let Some(text) = element.attribute(attribute) else {
        return Ok(None);
    };
    match text.parse() {
        Ok(value) => Ok(Some(value)),
        Err(_) => Err(Error(format!("{owner}: {attribute}=\"{text}\" is not a value of its type"))),
    }
}

/// Value of an attribute as one of several words.
fn choice<T: Copy>(element: &Element, attribute: &str, choices: &[(&str, T)]) -> Result<Option<T>, Error> {
    let Some(text) = element.attribute(attribute) else {
        return Ok(None);
    };
    match choices.iter().find(|(word, _)| *word == text) {
        Some((_, value)) => Ok(Some(*value)),
        None => {
            let words: Vec<&str> = choices.iter().map(|(word, _)| *word).collect();
            Err(Error(format!("{element}: {attribute}=\"{text}\" is not one of {}", words.join(", "))))
        }
    }
}

fn structure(element: &Element, variables: &[Variable]) -> Result<Structure, Error> {
    let is_state = |v: &Variable| variables.iter().any(|derivative| derivative.derivative_of.as_ref() == Some(&v.name.full));
    let known = |wanted: &dyn Fn(&Variable) -> bool| variables.iter().filter(|v| wanted(v)).map(|v| &v.name).collect::<Vec<_>>();
    let running = known(&|v| v.causality == Causality::Input || is_state(v));
    let starting = known(&|v| matches!(v.causality, Causality::Parameter | Causality::Input));
    let section = |tag, known: &[&Name], words| each(element.child(tag)?, |element| unknown(element, known, words));
    Ok(Structure {
        outputs: section("Outputs", &running, "an input nor a continuous state")?,
        derivatives: section("Derivatives", &running, "an input nor a continuous state")?,
        initial_unknowns: section("InitialUnknowns", &starting, "a parameter nor an input")?,
    })
}

/// Parses an unknown. A dependency is a known, a family of knowns without index, or all knowns with the same beginning (`servo.*`).
fn unknown(element: &Element, known: &[&Name], words: &str) -> Result<Unknown, Error> {
    element.allow(&["name", "dependencies"])?;
    let name = element.required("name")?.to_owned();
    let mut dependencies = Vec::new();
    for pattern in element.required("dependencies")?.split_whitespace() {
        let meant = |known: &&&Name| match pattern.strip_suffix('*') {
            Some(beginning) => known.family.starts_with(beginning),
            None => known.full == pattern || known.family == pattern,
        };
        let before = dependencies.len();
        dependencies.extend(known.iter().filter(meant).map(|known| known.full.clone()));
        if dependencies.len() == before {
            return Err(Error(format!("variable {name}: dependency {pattern} is neither {words}")));
        }
    }
    Ok(Unknown { name, dependencies })
}
