//! What was probably meant by a name that is not there.

use super::Catalog;
use crate::{Error, Kind, TypeName};

/// Longer names are not compared: the time goes with the square.
const LONGEST_COMPARED: usize = 128;

impl Catalog {
    pub(super) fn not_in_catalog(&self, name: &TypeName) -> Error {
        let is_there = |what: &str| format!(": it is {what}");
        let hint = if self.messages.contains_key(name) {
            is_there("a message, no service or action")
        } else if self.services.contains_key(name) {
            is_there("a service, no message")
        } else if self.actions.contains_key(name) {
            is_there("an action, no message or service")
        } else {
            let others = self.messages.keys().chain(self.services.keys()).chain(self.actions.keys());
            match nearest(name, others) {
                Some(other) => format!(", did you mean {other}?"),
                None => self.hint_for_package(name),
            }
        };
        Error::NotInCatalog { name: Box::new(name.clone()), hint }
    }

    /// For a field of that type.
    pub(super) fn hint_for_field(&self, wanted: &TypeName) -> String {
        match nearest(wanted, self.messages.keys().filter(|name| name.kind == Kind::Message)) {
            Some(other) => format!(", did you mean `{}`?", other.short()),
            None => self.hint_for_package(wanted),
        }
    }

    fn hint_for_package(&self, wanted: &TypeName) -> String {
        if self.messages.keys().any(|name| name.package == wanted.package) {
            return String::new();
        }
        format!(": no interface of the package {} is known, add its folder", wanted.package)
    }
}

/// One of the same name in another package, or else the one with the fewest letters to change, if they are few.
fn nearest<'a>(wanted: &TypeName, names: impl Iterator<Item = &'a TypeName>) -> Option<&'a TypeName> {
    let text = wanted.short();
    if text.len() > LONGEST_COMPARED {
        return None;
    }
    let most = 1 + wanted.name.len() / 4;
    names
        .filter_map(|name| {
            let kind = usize::from(name.kind != wanted.kind);
            if name.name == wanted.name {
                return Some((kind, name));
            }
            let distance = distance(&text, &name.short(), most)?;
            Some((2 * distance + kind, name))
        })
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, name)| name)
}

/// How many letters must be changed, added or taken away (Levenshtein); `None` if more than `most`.
fn distance(one: &str, two: &str, most: usize) -> Option<usize> {
    if one.len().abs_diff(two.len()) > most {
        return None;
    }
    let mut row: Vec<usize> = (0..=two.len()).collect();
    for (index, letter) in one.bytes().enumerate() {
        let mut diagonal = index;
        let mut left = index + 1;
        for (other, above) in two.bytes().zip(row.iter_mut().skip(1)) {
            let replaced = diagonal + usize::from(other != letter);
            diagonal = *above;
            left = replaced.min(left + 1).min(*above + 1);
            *above = left;
        }
        if let Some(first) = row.first_mut() {
            *first = index + 1;
        }
    }
    row.last().copied().filter(|distance| *distance <= most)
}

#[cfg(test)]
mod tests {
    use super::distance;

    #[test]
    fn letters_to_change_are_counted() {
        assert_eq!(distance("kitten", "sitting", 9), Some(3));
        assert_eq!(distance("kitten", "sitting", 2), None);
        assert_eq!(distance("", "ab", 2), Some(2));
        assert_eq!(distance("same", "same", 0), Some(0));
        assert_eq!(distance("PointCloud", "PointCloud2", 1), Some(1));
    }
}
