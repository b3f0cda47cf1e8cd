//! What a Rust file declares and names, read from its tokens.

use std::collections::BTreeSet;
use std::str::FromStr;

use anyhow::anyhow;
use proc_macro2::{Delimiter, TokenStream, TokenTree};

/// The content of one module, without what only tests or the documentation use.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Content {
    /// Modules in files of their own, with the file that `#[path]` names.
    pub(super) files: Vec<(String, Option<String>)>,
    pub(super) inline: Vec<(String, Content)>,
    pub(super) imports: Vec<Import>,
    /// Paths in code, of two segments or more.
    pub(super) paths: BTreeSet<Vec<String>>,
    /// Names of functions, types and other items.
    pub(super) items: BTreeSet<String>,
}

/// One name that a `use` brings in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Import {
    pub(super) path: Vec<String>,
    /// The name in this module; `*` for all that the path holds.
    pub(super) name: String,
}

pub(super) fn read(source: &str) -> anyhow::Result<Content> {
    let tokens =
        TokenStream::from_str(source).map_err(|error| anyhow!("these are no tokens of Rust: {error}"))?;
    Ok(content(&tokens.into_iter().collect::<Vec<_>>()))
}

fn content(tokens: &[TokenTree]) -> Content {
    let mut content = Content::default();
    let mut at = 0;
    while at < tokens.len() {
        let attributes = attributes(&tokens[at..]);
        if attributes.is_left_out {
            at += attributes.count;
            at += item_length(&tokens[at..]);
            continue;
        }
        at += attributes.count;
        at += visibility_length(&tokens[at..]);
        at += match word(tokens.get(at)).as_deref() {
            Some("use") => content.add_import(&tokens[at..]),
            Some("mod") => content.add_module(&tokens[at..], attributes.path),
            Some(keyword @ ("fn" | "struct" | "enum" | "union" | "trait" | "type" | "const" | "static")) => {
                content.add_item(keyword, &tokens[at..])
            }
            Some("macro_rules") => {
                content.items.extend(word(tokens.get(at + 2)));
                1
            }
            Some(_) => content.add_path(&tokens[at..]),
            None => {
                if let Some(TokenTree::Group(group)) = tokens.get(at) {
                    content.add_nested(&group.stream().into_iter().collect::<Vec<_>>());
                }
                1
            }
        };
    }
    content
}

impl Content {
    /// `tokens` begin with `use`; returns how many belong to it.
    fn add_import(&mut self, tokens: &[TokenTree]) -> usize {
        let length = item_length(tokens);
        self.add_import_tree(&tokens[1..length], &[]);
        length
    }

    fn add_import_tree(&mut self, tokens: &[TokenTree], before: &[String]) {
        for tree in tokens.split(|token| is_punct(token, ',') || is_punct(token, ';')) {
            let mut path = before.to_vec();
            let mut alias = None;
            let mut is_group = false;
            for (index, token) in tree.iter().enumerate() {
                match token {
                    TokenTree::Ident(ident) if *ident == "as" => {
                        alias = word(tree.get(index + 1));
                        break;
                    }
                    TokenTree::Ident(ident) => path.push(plain(&ident.to_string())),
                    TokenTree::Punct(punct) if punct.as_char() == '*' => alias = Some("*".to_owned()),
                    TokenTree::Group(group) => {
                        self.add_import_tree(&group.stream().into_iter().collect::<Vec<_>>(), &path);
                        is_group = true;
                    }
                    _ => {}
                }
            }
            if path.last().is_some_and(|last| last == "self") && path.len() > 1 {
                path.pop();
            }
            if let (false, Some(last)) = (is_group, path.last()) {
                self.imports.push(Import { name: alias.unwrap_or_else(|| last.clone()), path });
            }
        }
    }

    /// `tokens` begin with `mod`.
    fn add_module(&mut self, tokens: &[TokenTree], file: Option<String>) -> usize {
        let Some(name) = word(tokens.get(1)) else { return 1 };
        match tokens.get(2) {
            Some(TokenTree::Group(group)) => {
                let inner = content(&group.stream().into_iter().collect::<Vec<_>>());
                self.inline.push((name, inner));
            }
            _ => self.files.push((name, file)),
        }
        3
    }

    /// `tokens` begin with the keyword of an item; its body is read with what follows.
    fn add_item(&mut self, keyword: &str, tokens: &[TokenTree]) -> usize {
        let name = match (keyword, word(tokens.get(1)).as_deref()) {
            // `const fn name`, `static mut NAME`.
            ("const" | "static", Some("fn" | "unsafe" | "extern" | "mut")) => return 1,
            (_, Some(name)) => name.to_owned(),
            _ => return 1,
        };
        self.items.insert(name);
        2
    }

    /// `tokens` begin with a word, with which a path may begin.
    fn add_path(&mut self, tokens: &[TokenTree]) -> usize {
        let mut path: Vec<String> = word(tokens.first()).into_iter().collect();
        let mut length = 1;
        while is_separator(&tokens[length..]) {
            let Some(next) = word(tokens.get(length + 2)) else { break };
            path.push(next);
            length += 3;
        }
        if path.len() > 1 {
            self.paths.insert(path);
        }
        length
    }

    /// Code in brackets: what it imports and names counts as that of the module.
    fn add_nested(&mut self, tokens: &[TokenTree]) {
        let inner = content(tokens);
        self.imports.extend(inner.imports);
        self.paths.extend(inner.paths);
        for (_, module) in inner.inline {
            self.imports.extend(module.imports);
            self.paths.extend(module.paths);
        }
    }
}

/// The tokens of `pub` or `pub(…)` at the beginning of `tokens`.
fn visibility_length(tokens: &[TokenTree]) -> usize {
    match tokens {
        [TokenTree::Ident(word), TokenTree::Group(group), ..]
            if *word == "pub" && group.delimiter() == Delimiter::Parenthesis =>
        {
            2
        }
        [TokenTree::Ident(word), ..] if *word == "pub" => 1,
        _ => 0,
    }
}

struct Attributes {
    count: usize,
    is_left_out: bool,
    path: Option<String>,
}

/// The attributes at the beginning of `tokens`.
fn attributes(tokens: &[TokenTree]) -> Attributes {
    let mut found = Attributes { count: 0, is_left_out: false, path: None };
    loop {
        match &tokens[found.count..] {
            [TokenTree::Punct(hash), TokenTree::Group(group), ..]
                if hash.as_char() == '#' && group.delimiter() == Delimiter::Bracket =>
            {
                let text = group.stream().to_string();
                let condition =
                    text.strip_prefix("cfg").is_some_and(|text| text.trim_start().starts_with('('));
                found.is_left_out |= condition && names_tests_or_docs(&text);
                if let Some(path) = text.strip_prefix("path") {
                    found.path = path.split('"').nth(1).map(str::to_owned);
                }
                found.count += 2;
            }
            _ => return found,
        }
    }
}

fn names_tests_or_docs(condition: &str) -> bool {
    let mut words = condition.split(|letter: char| !(letter.is_alphanumeric() || letter == '_'));
    !condition.contains("not") && words.any(|word| matches!(word, "test" | "doc"))
}

/// The tokens up to the end of what an attribute stands before: an item, a statement, a field or a variant.
fn item_length(tokens: &[TokenTree]) -> usize {
    let begin: Vec<String> = tokens.iter().take(5).filter_map(|token| word(Some(token))).collect();
    let is_use = begin.iter().any(|word| word == "use");
    // Commas separate fields and variants, and stand between the generics of items.
    let is_item = is_use || begin.iter().any(|word| ITEMS.contains(&word.as_str()));
    let end = tokens.iter().position(|token| match token {
        TokenTree::Group(group) => !is_use && group.delimiter() == Delimiter::Brace,
        token => is_punct(token, ';') || (!is_item && is_punct(token, ',')),
    });
    end.map_or(tokens.len(), |end| end + 1)
}

const ITEMS: [&str; 11] =
    ["fn", "struct", "enum", "union", "trait", "type", "const", "static", "impl", "mod", "macro_rules"];

fn word(token: Option<&TokenTree>) -> Option<String> {
    match token {
        Some(TokenTree::Ident(ident)) => Some(plain(&ident.to_string())),
        _ => None,
    }
}

fn plain(ident: &str) -> String {
    ident.strip_prefix("r#").unwrap_or(ident).to_owned()
}

fn is_punct(token: &TokenTree, character: char) -> bool {
    matches!(token, TokenTree::Punct(punct) if punct.as_char() == character)
}

fn is_separator(tokens: &[TokenTree]) -> bool {
    matches!(tokens, [first, second, ..] if is_punct(first, ':') && is_punct(second, ':'))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn import(path: &str, name: &str) -> Import {
        Import { path: path.split("::").map(str::to_owned).collect(), name: name.to_owned() }
    }

    #[test]
    fn imports_modules_items_and_paths_are_found_and_those_of_tests_are_not() {
        let source = r##"
            //! A file with `use crate::not_code;` in its comment.
            mod parse;
            #[path = "other_file.rs"]
            pub(crate) mod other;
            #[cfg(test)]
            mod tests { use crate::only_in_tests; }
            #[cfg(all(test, unix))]
            use crate::only_in_tests;
            #[cfg(not(test))]
            use crate::outside_of_tests;
            pub use self::parse::{self, Tree, tree as grow, inner::*};
            const TEXT: &str = "use crate::text;";
            pub(super) fn work(at: &super::Place) -> Option<u32> {
                let _ = r#"crate::raw"#;
                use crate::late::Import;
                crate::deep::er::function(TEXT);
                None
            }
            mod inline { pub struct Inner; }
        "##;
        let content = read(source).unwrap();
        assert_eq!(
            content.files,
            [("parse".to_owned(), None), ("other".to_owned(), Some("other_file.rs".to_owned()))]
        );
        let expected = [
            import("crate::outside_of_tests", "outside_of_tests"),
            import("self::parse", "parse"),
            import("self::parse::Tree", "Tree"),
            import("self::parse::tree", "grow"),
            import("self::parse::inner", "*"),
            import("crate::late::Import", "Import"),
        ];
        assert_eq!(content.imports, expected);
        let paths: Vec<String> = content.paths.iter().map(|path| path.join("::")).collect();
        assert_eq!(paths, ["crate::deep::er::function", "super::Place"]);
        assert_eq!(content.items.iter().collect::<Vec<_>>(), ["TEXT", "work"]);
        assert_eq!(content.inline[0].1.items.iter().collect::<Vec<_>>(), ["Inner"]);
    }
}
