//! The name that was meant.

/// The known name that is most like `name`; the part behind the last slash says most about what was meant.
pub(super) fn nearest(name: &str, known: impl Iterator<Item = &'static str>) -> &'static str {
    fn short(name: &str) -> &str {
        name.rsplit_once('/').map_or(name, |(_, short)| short)
    }
    let likeness = |known: &str| {
        strsim::normalized_damerau_levenshtein(name, known)
            + strsim::normalized_damerau_levenshtein(short(name), short(known))
    };
    known.max_by(|a, b| likeness(a).total_cmp(&likeness(b))).unwrap_or_default()
}
