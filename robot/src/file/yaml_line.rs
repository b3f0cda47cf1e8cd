//! The line of a value in a YAML file.

use std::fmt;

use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, Visitor};

/// Returns the line, from 1, of the key to which `keys` lead from the root, or 1 if there is no such key.
pub(super) fn line_of(text: &str, keys: &[String]) -> usize {
    if keys.is_empty() {
        return 1;
    }
    let found = Search(keys).deserialize(serde_norway::Deserializer::from_str(text));
    found.err().and_then(|error| error.location()).map_or(1, |location| location.line())
}

/// Searches a map for the first of the keys, and its value for the others.
struct Search<'k>(&'k [String]);

impl<'de> DeserializeSeed<'de> for Search<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Search<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a map")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        let Some((wanted, rest)) = self.0.split_first() else { return Ok(()) };
        while let Some(is_wanted) = map.next_key_seed(Key { wanted, is_last: rest.is_empty() })? {
            if is_wanted {
                map.next_value_seed(Search(rest))?;
            } else {
                map.next_value::<IgnoredAny>()?;
            }
        }
        Ok(())
    }
}

/// Compares a key with the wanted one. Returns an error if it is the last wanted key, which ends the search.
struct Key<'k> {
    wanted: &'k str,
    is_last: bool,
}

impl<'de> DeserializeSeed<'de> for Key<'_> {
    type Value = bool;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<bool, D::Error> {
        deserializer.deserialize_str(self)
    }
}

impl Visitor<'_> for Key<'_> {
    type Value = bool;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a key")
    }

    fn visit_str<E: Error>(self, key: &str) -> Result<bool, E> {
        if key == self.wanted && self.is_last { Err(E::custom("found")) } else { Ok(key == self.wanted) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_found_on_its_line() {
        let text = "# comment\n/**:\n  ros__parameters:\n    a: 1\n    b:\n      - x\n      - a\n    'c': {d: 1,\n      a: 2}\n";
        let line = |keys: &[&str]| line_of(text, &keys.iter().map(|&key| key.to_owned()).collect::<Vec<_>>());
        assert_eq!(line(&["/**"]), 2);
        assert_eq!(line(&["/**", "ros__parameters", "a"]), 4);
        assert_eq!(line(&["/**", "ros__parameters", "c"]), 8);
        assert_eq!(line(&["/**", "ros__parameters", "c", "a"]), 9);
        assert_eq!(line(&["/**", "elsewhere"]), 1);
        assert_eq!(line(&[]), 1);
    }
}
