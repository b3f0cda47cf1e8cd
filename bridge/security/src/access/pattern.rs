//! Patterns of topics and partitions, as POSIX's `fnmatch` without flags matches them.

/// Whether `text` matches `pattern`, in which `*` stands for any text (slashes too), `?` for one character,
/// `[a-z]` and `[!a-z]` for one of a set, and a backslash for the next character itself.
///
/// Takes at most the product of both lengths, whatever the pattern.
pub(super) fn matches(pattern: &str, text: &str) -> bool {
    let (mut pattern, mut text) = (pattern, text);
    // Where to continue when the last star must stand for one character more.
    let mut retry: Option<(&str, &str)> = None;
    loop {
        if let Some(after) = pattern.strip_prefix('*') {
            pattern = after;
            retry = Some((after, text));
            continue;
        }
        let mut characters = text.chars();
        let next = match characters.next() {
            None if pattern.is_empty() => return true,
            None => return false,
            Some(character) => one(pattern, character),
        };
        if let Some(after) = next {
            pattern = after;
            text = characters.as_str();
            continue;
        }
        let Some((after_star, from)) = retry else { return false };
        let mut longer = from.chars();
        if longer.next().is_none() {
            return false;
        }
        retry = Some((after_star, longer.as_str()));
        (pattern, text) = (after_star, longer.as_str());
    }
}

/// The rest of the pattern if its first element, which is no star, matches the character.
fn one(pattern: &str, character: char) -> Option<&str> {
    let mut rest = pattern.chars();
    let is_match = match rest.next()? {
        '?' => true,
        '[' => match set(rest.as_str(), character) {
            Some((is_match, after)) => return is_match.then_some(after),
            None => character == '[', // never closed: the bracket itself
        },
        '\\' => rest.next().unwrap_or('\\') == character,
        literal => literal == character,
    };
    is_match.then_some(rest.as_str())
}

/// Whether the set that begins after a bracket contains the character, and the pattern after the set. `None`
/// if the bracket is not closed.
fn set(pattern: &str, character: char) -> Option<(bool, &str)> {
    let is_negated = pattern.starts_with(['!', '^']);
    let mut rest = pattern.get(usize::from(is_negated)..)?.chars();
    let mut is_member = false;
    let mut is_first = true;
    loop {
        let from = rest.next()?;
        if from == ']' && !is_first {
            return Some((is_member != is_negated, rest.as_str()));
        }
        is_first = false;
        if from == '['
            && let Some((is_inside, after)) = class(rest.as_str(), character)
        {
            is_member |= is_inside;
            rest = after.chars();
            continue;
        }
        let from = if from == '\\' { rest.next()? } else { from };
        let mut to = from;
        if let Some(after) = rest.as_str().strip_prefix('-')
            && !after.starts_with(']')
        {
            rest = after.chars();
            to = rest.next()?;
        }
        is_member |= (from..=to).contains(&character);
    }
}

/// Whether a class within a set, such as `:digit:]` behind its bracket, contains the character, and what
/// follows it. `None` if it is none.
fn class(pattern: &str, character: char) -> Option<(bool, &str)> {
    let (kind, rest) = (pattern.chars().next()?, pattern.get(1..)?);
    let end = match kind {
        ':' => ":]",
        '.' => ".]",
        '=' => "=]",
        _ => return None,
    };
    let (name, after) = rest.split_once(end)?;
    let is_member = match (kind, name) {
        (':', "alnum") => character.is_ascii_alphanumeric(),
        (':', "alpha") => character.is_ascii_alphabetic(),
        (':', "blank") => [' ', '\t'].contains(&character),
        (':', "cntrl") => character.is_ascii_control(),
        (':', "digit") => character.is_ascii_digit(),
        (':', "graph") => character.is_ascii_graphic(),
        (':', "lower") => character.is_ascii_lowercase(),
        (':', "print") => character.is_ascii_graphic() || character == ' ',
        (':', "punct") => character.is_ascii_punctuation(),
        (':', "space") => character.is_ascii_whitespace() || character == '\u{b}',
        (':', "upper") => character.is_ascii_uppercase(),
        (':', "xdigit") => character.is_ascii_hexdigit(),
        (':', _) => false,
        (_, name) => name.chars().eq([character]),
    };
    Some((is_member, after))
}

/// Whether every partition that `partition` may stand for matches `pattern`. A partition of an endpoint may
/// be a pattern itself.
pub(super) fn contains(pattern: &str, partition: &str) -> bool {
    // Only a star of the pattern can be what a wildcard of the partition is matched with.
    let is_safe = !is_pattern(partition)
        || pattern == "*"
        || !pattern.contains(['?', '[', '\\']) && !partition.contains(['[', '\\']);
    pattern == partition || is_safe && matches(pattern, partition)
}

/// Whether some partition that `partition` may stand for matches `pattern`. Two patterns are taken to meet.
pub(super) fn meets(pattern: &str, partition: &str) -> bool {
    matches(pattern, partition)
        || is_pattern(partition) && (is_pattern(pattern) || matches(partition, pattern))
}

fn is_pattern(text: &str) -> bool {
    text.contains(['*', '?', '[', '\\'])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_match_as_fnmatch_does() {
        let cases = [
            ("", "", true),
            ("", "a", false),
            ("*", "", true),
            ("*", "rt/chatter", true),
            ("rt/*", "rt/a/b", true),
            ("rt/*", "rq/a", false),
            ("rt/chatter", "rt/chatter2", false),
            ("rt/chatter2", "rt/chatter", false),
            ("rt/arm[[:digit:]]", "rt/arm5", true),
            ("rt/arm[[:digit:]]", "rt/army", false),
            ("rt/arm[![:digit:]]", "rt/arm5", false),
            ("rt/arm[[:digit:]x]", "rt/armx", true),
            ("rt/arm[[.5.]]", "rt/arm5", true),
            ("rt/arm[[=5=]]", "rt/arm6", false),
            ("*er", "rt/chatter", true),
            ("*er", "rt/chatters", false),
            ("a*b*c", "axxbxbxc", true),
            ("a*b*c", "axxbxbx", false),
            ("OwnShip?ata", "OwnShipData", true),
            ("OwnShip?ata", "OwnShipata", false),
            ("?", "ä", true),
            ("[a-c]x", "bx", true),
            ("[a-c]x", "dx", false),
            ("[!a-c]x", "dx", true),
            ("[!a-c]x", "ax", false),
            ("[^a]", "b", true),
            ("[]a]", "]", true),
            ("[a-]", "-", true),
            ("[a", "[a", true),
            ("[a", "a", false),
            ("\\*", "*", true),
            ("\\*", "a", false),
            ("a\\", "a\\", true),
            ("**a", "bba", true),
        ];
        for (pattern, text, expected) in cases {
            assert_eq!(matches(pattern, text), expected, "{pattern} {text}");
        }
    }

    #[test]
    fn many_stars_take_no_exponential_time() {
        let pattern = "a*".repeat(2000) + "b";
        assert!(!matches(&pattern, &"a".repeat(10_000)));
    }

    #[test]
    fn a_partition_with_wildcards_is_contained_only_if_all_it_stands_for_is() {
        assert!(contains("Part*", "Part?1"));
        assert!(contains("*", "*"));
        assert!(contains("a?", "a?"));
        assert!(!contains("?", "*"));
        assert!(!contains("Partition", "Part*"));
        assert!(meets("Partition", "Part*"));
        assert!(meets("[ab]", "?"));
        assert!(!meets("Partition", "Other*"));
    }
}
