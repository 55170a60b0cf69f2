//! The structured naming convention (FMI 2.0.4, section 2.2.9), as far as this project uses it.

use crate::{Error, Name};

impl Name {
    /// Parses a name: identifiers joined by dots, with at most one 1-based index, possibly within `der(...)`. Refuses other names.
    pub fn parse(full: &str) -> Result<Self, Error> {
        let refuse = |why: &str| Err(Error(format!("variable name \"{full}\": {why}")));
        let (before, inner, after) = match full.strip_prefix("der(").map(|rest| rest.strip_suffix(')')) {
            Some(Some(inner)) => ("der(", inner, ")"),
            Some(None) => return refuse("der( is not closed"),
            None => ("", full, ""),
        };
        let mut family = String::from(before);
        let mut index = None;
        for (position, part) in inner.split('.').enumerate() {
            let (identifier, subscript) = match part.split_once('[') {
                Some((identifier, rest)) => match rest.strip_suffix(']') {
                    Some(subscript) => (identifier, Some(subscript)),
                    None => return refuse("[ is not closed"),
                },
                None => (part, None),
            };
            let mut letters = identifier.chars();
            let starts_well = letters.next().is_some_and(|c| c.is_ascii_alphabetic() || c == '_');
            if !starts_well || !letters.all(|c| c.is_ascii_alphanumeric() || c == '_') {
                return refuse("each part must be a letter or _ followed by letters, digits or _");
            }
            if position > 0 {
                family.push('.');
            }
            family.push_str(identifier);
            if let Some(subscript) = subscript {
                match subscript.parse::<usize>() {
                    Ok(one_based) if one_based >= 1 && subscript.bytes().all(|b| b.is_ascii_digit()) => {
                        if index.replace(one_based - 1).is_some() {
                            return refuse("at most one index is allowed");
                        }
                    }
                    _ => return refuse("an index must be a whole number from 1 on"),
                }
            }
        }
        family.push_str(after);
        Ok(Self { full: full.to_owned(), family, index })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_taken_apart() {
        for (full, family, index) in [
            ("tau[1]", "tau", Some(0)),
            ("link[4].length", "link.length", Some(3)),
            ("tip.fx", "tip.fx", None),
            ("der(theta[2])", "der(theta)", Some(1)),
        ] {
            let name = Name::parse(full).expect(full);
            assert_eq!((name.family.as_str(), name.index), (family, index), "{full}");
        }
    }

    #[test]
    fn malformed_names_are_refused() {
        for full in ["", "a..b", "1a", "a[0]", "a[+1]", "a[1", "a[1].b[2]", "der(a", "a b", "a-b", "a[1]b"] {
            let error = Name::parse(full).expect_err(full);
            assert!(error.0.contains(&format!("\"{full}\"")), "{error}");
        }
    }
}
