//! Parser from text to JSON without duplicate keys: one of two values would silently have no effect.

use std::fmt;

use serde::de::{DeserializeSeed, Deserializer, Error, MapAccess, SeqAccess, Visitor};
use serde_json::{Map, Value as Json};

/// Largest depth of nested brackets; scenes need five.
const MOST_BRACKETS: u32 = 8;

/// Parses the content of a file. Refuses text that is not JSON, duplicate keys and deeper nesting.
pub(crate) fn read(text: &str) -> serde_json::Result<Json> {
    let mut reader = serde_json::Deserializer::from_str(text);
    let content = Unique { left: MOST_BRACKETS }.deserialize(&mut reader)?;
    reader.end()?;
    Ok(content)
}

/// A value with room for `left` more levels of brackets.
#[derive(Clone, Copy)]
struct Unique {
    left: u32,
}

impl Unique {
    /// The values within its brackets; refuses deeper nesting.
    fn within<E: Error>(self) -> Result<Self, E> {
        match self.left.checked_sub(1) {
            Some(left) => Ok(Self { left }),
            None => Err(E::custom(format_args!("more than {MOST_BRACKETS} brackets are nested"))),
        }
    }
}

impl<'de> DeserializeSeed<'de> for Unique {
    type Value = Json;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Json, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Unique {
    type Value = Json;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("JSON")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Json, A::Error> {
        let (mut map, within) = (Map::new(), self.within()?);
        while let Some(key) = entries.next_key::<String>()? {
            let value = entries.next_value_seed(within)?;
            if map.contains_key(&key) {
                return Err(A::Error::custom(format_args!("'{key}' is given twice")));
            }
            map.insert(key, value);
        }
        Ok(map.into())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut elements: A) -> Result<Json, A::Error> {
        let (mut list, within) = (Vec::new(), self.within()?);
        while let Some(element) = elements.next_element_seed(within)? {
            list.push(element);
        }
        Ok(list.into())
    }

    fn visit_unit<E>(self) -> Result<Json, E> {
        Ok(Json::Null)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Json, E> {
        Ok(value.into())
    }

    fn visit_u64<E>(self, value: u64) -> Result<Json, E> {
        Ok(value.into())
    }

    fn visit_i64<E>(self, value: i64) -> Result<Json, E> {
        Ok(value.into())
    }

    fn visit_f64<E>(self, value: f64) -> Result<Json, E> {
        Ok(value.into())
    }

    fn visit_str<E>(self, value: &str) -> Result<Json, E> {
        Ok(value.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_is_what_serde_makes_of_it() {
        let text = r#"{"z": [1, -2, 2.5e-3, true, null], "a": {"b": "ü \" c", "d": {}}, "e": 0.30000000000000004}"#;
        assert_eq!(read(text).expect("JSON"), serde_json::from_str::<Json>(text).expect("JSON"));
    }

    #[test]
    fn keys_differ_at_every_depth() {
        for text in [r#"{"a": 1, "a": 1}"#, r#"{"b": [{"a": 1, "c": 2, "a": 3}]}"#] {
            assert!(read(text).expect_err("twice").to_string().starts_with("'a' is given twice at line 1 column "), "{text}");
        }
        assert!(read(r#"[{"a": 1}, {"a": 1}]"#).is_ok());
    }
}
