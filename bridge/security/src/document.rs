//! Strict reading of the XML documents of DDS Security and SROS2: an element or attribute that is not known
//! is an error, because a rule that is silently ignored opens a door.

use roxmltree::{Document, Node, ParsingOptions};

/// Longer documents are refused before they are parsed.
const MAX_BYTES: usize = 1 << 20;
const MAX_NODES: u32 = 1 << 17;

/// Why a document is refused, and the line.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {problem}")]
pub struct DocumentError {
    /// Counted from 1.
    pub line: u32,
    /// What is wrong there.
    pub problem: Problem,
}

/// What is wrong in a document.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// The document is too long; its length.
    #[error("the document has {0} bytes, the most that is read is {MAX_BYTES}")]
    TooLong(usize),
    /// The text is not XML, or has a document type; the message of the parser.
    #[error("this is not XML as it is read here: {0}")]
    Xml(String),
    /// The first element is another one than expected; both are named.
    #[error("the document begins with <{0}> instead of <{1}>")]
    Root(String, &'static str),
    /// An element that is not known where it is.
    #[error("<{found}> is unknown in <{parent}>, which takes {known}")]
    UnknownElement {
        /// Its name.
        found: String,
        /// The element that holds it.
        parent: String,
        /// The elements that are known there.
        known: String,
    },
    /// An attribute that is not known, and its element.
    #[error("attribute {0:?} is unknown in <{1}>")]
    UnknownAttribute(String, String),
    /// An element without the attribute.
    #[error("<{0}> lacks attribute {1:?}")]
    NoAttribute(String, &'static str),
    /// An element without the child.
    #[error("<{0}> lacks <{1}>")]
    Missing(String, &'static str),
    /// An element that may be there once.
    #[error("<{0}> is here for a second time; keep one")]
    Repeated(String),
    /// Text in an element that holds elements.
    #[error("<{0}> holds text; only elements may be here")]
    Text(String),
    /// A value that is not understood.
    #[error("{found:?} is no value of {of}, which is {expected}")]
    Value {
        /// The value.
        found: String,
        /// The element or attribute.
        of: String,
        /// What is understood there.
        expected: &'static str,
    },
    /// A range of domains that ends before its begin.
    #[error("the range of domains begins at {0} and ends at {1}")]
    EmptyRange(u32, u32),
    /// A part that is in another file.
    #[error(
        "<{0}> includes another file, which is not supported; insert its content, for example by `xmllint \
         --xinclude`"
    )]
    Include(String),
}

/// Parses a document whose root element has the name `root`.
pub(crate) fn read<T>(
    text: &str,
    root: &'static str,
    read: impl FnOnce(Element) -> Result<T, DocumentError>,
) -> Result<T, DocumentError> {
    if text.len() > MAX_BYTES {
        return Err(DocumentError { line: 1, problem: Problem::TooLong(text.len()) });
    }
    let options = ParsingOptions { nodes_limit: MAX_NODES, ..ParsingOptions::default() };
    let document = Document::parse_with_options(text, options)
        .map_err(|error| DocumentError { line: error.pos().row, problem: Problem::Xml(error.to_string()) })?;
    let element = Element(document.root_element());
    if element.name() != root {
        return Err(element.error(Problem::Root(element.name().to_owned(), root)));
    }
    read(element)
}

/// An element of a document.
#[derive(Clone, Copy)]
pub(crate) struct Element<'a>(Node<'a, 'a>);

impl<'a> Element<'a> {
    pub fn name(self) -> &'a str {
        self.0.tag_name().name()
    }

    /// A problem at this element.
    pub fn error(self, problem: Problem) -> DocumentError {
        let line = self.0.document().text_pos_at(self.0.range().start).row;
        DocumentError { line, problem }
    }

    /// The content of an element without children, without white space around it.
    pub fn text(self) -> Result<String, DocumentError> {
        if let Some(child) = self.0.first_element_child() {
            return Err(Element(child).unknown_in(self, &[]));
        }
        self.expect_attributes(&[])?;
        let text: String =
            self.0.children().filter_map(|node| node.text().filter(|_| node.is_text())).collect();
        Ok(text.trim().to_owned())
    }

    /// The content as a value that `parse` understands.
    pub fn value<T>(
        self,
        expected: &'static str,
        parse: impl FnOnce(&str) -> Option<T>,
    ) -> Result<T, DocumentError> {
        let text = self.text()?;
        parse(&text).ok_or_else(|| {
            self.error(Problem::Value { found: text, of: format!("<{}>", self.name()), expected })
        })
    }

    /// The children, each of which has one of the names, of an element without attributes.
    pub fn children(self, known: &[&'static str]) -> Result<Children<'a>, DocumentError> {
        self.children_with(&[], known)
    }

    /// The children, each of which has one of the names, of an element with no other attributes than these.
    pub fn children_with(
        self,
        attributes: &[&str],
        known: &[&'static str],
    ) -> Result<Children<'a>, DocumentError> {
        self.expect_attributes(attributes)?;
        let mut elements = Vec::new();
        for node in self.0.children() {
            if node.is_element() {
                let child = Element(node);
                if !known.contains(&child.name()) {
                    return Err(child.unknown_in(self, known));
                }
                elements.push(child);
            } else if node.is_text() && node.text().is_some_and(|text| !text.trim().is_empty()) {
                return Err(Element(node).error(Problem::Text(self.name().to_owned())));
            }
        }
        Ok(Children { parent: self, elements })
    }

    /// The value of an attribute.
    pub fn attribute(self, name: &str) -> Option<&'a str> {
        self.0.attribute(name)
    }

    /// The value of an attribute that must be there.
    pub fn required(self, attribute: &'static str) -> Result<&'a str, DocumentError> {
        let missing = || self.error(Problem::NoAttribute(self.name().to_owned(), attribute));
        self.attribute(attribute).ok_or_else(missing)
    }

    /// Refuses attributes other than these; those of a namespace (schema locations) say nothing here.
    fn expect_attributes(self, known: &[&str]) -> Result<(), DocumentError> {
        let is_unknown = |name: &str| !known.contains(&name);
        let mut plain = self.0.attributes().filter(|attribute| attribute.namespace().is_none());
        plain.find(|attribute| is_unknown(attribute.name())).map_or(Ok(()), |attribute| {
            let (found, element) = (attribute.name().to_owned(), self.name().to_owned());
            Err(self.error(Problem::UnknownAttribute(found, element)))
        })
    }

    fn unknown_in(self, parent: Element, known: &[&'static str]) -> DocumentError {
        let found = self.name().to_owned();
        if found == "include" && self.0.tag_name().namespace().is_some() {
            return self.error(Problem::Include(found));
        }
        let names: Vec<String> = known.iter().map(|name| format!("<{name}>")).collect();
        let known = if names.is_empty() { "text only".to_owned() } else { names.join(", ") };
        self.error(Problem::UnknownElement { found, parent: parent.name().to_owned(), known })
    }
}

/// The children of an element.
pub(crate) struct Children<'a> {
    parent: Element<'a>,
    elements: Vec<Element<'a>>,
}

impl<'a> Children<'a> {
    /// The children in their order.
    pub fn iter(&self) -> impl Iterator<Item = Element<'a>> {
        self.elements.iter().copied()
    }

    /// The children, of which there must be one or more; `element` is their name.
    pub fn some(&self, element: &'static str) -> Result<&[Element<'a>], DocumentError> {
        if self.elements.is_empty() { Err(self.missing(element)) } else { Ok(&self.elements) }
    }

    /// The only child with this name.
    pub fn one(&self, name: &'static str) -> Result<Element<'a>, DocumentError> {
        self.optional(name)?.ok_or_else(|| self.missing(name))
    }

    /// The only child with this name, if there is one.
    pub fn optional(&self, name: &str) -> Result<Option<Element<'a>>, DocumentError> {
        let mut named = self.iter().filter(|child| child.name() == name);
        let first = named.next();
        match named.next() {
            Some(second) => Err(second.error(Problem::Repeated(name.to_owned()))),
            None => Ok(first),
        }
    }

    fn missing(&self, element: &'static str) -> DocumentError {
        self.parent.error(Problem::Missing(self.parent.name().to_owned(), element))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(text: &str) -> Result<Vec<String>, DocumentError> {
        read(text, "list", |list| list.children(&["item"])?.iter().map(Element::text).collect())
    }

    #[test]
    fn comments_and_white_space_are_left_out_of_a_text() {
        let text = "<list>\n <!-- two --> <item> a<!-- --> b </item><item/>\n</list>";
        assert_eq!(texts(text), Ok(vec!["a b".to_owned(), String::new()]));
    }

    #[test]
    fn a_problem_names_its_line_and_what_is_known_there() {
        let error = texts("<list>\n  <item>a</item>\n  <itm>b</itm>\n</list>").unwrap_err();
        assert_eq!(error.to_string(), "line 3: <itm> is unknown in <list>, which takes <item>");
        let error = texts("<list>\n  <item>a<b/></item>\n</list>").unwrap_err();
        assert_eq!(error.to_string(), "line 2: <b> is unknown in <item>, which takes text only");
        let error = texts("<list>\n  <item kind='c'>a</item>\n</list>").unwrap_err();
        assert_eq!(error.to_string(), "line 2: attribute \"kind\" is unknown in <item>");
        let error = texts("<list kind='c'><item>a</item></list>").unwrap_err();
        assert_eq!(error.to_string(), "line 1: attribute \"kind\" is unknown in <list>");
        assert_eq!(texts("<list>a</list>").unwrap_err().problem, Problem::Text("list".to_owned()));
        assert!(matches!(texts("<lists/>").unwrap_err().problem, Problem::Root(..)));
    }

    #[test]
    fn a_document_type_a_document_that_is_cut_off_and_one_without_end_are_refused() {
        let entity = "<!DOCTYPE list [<!ENTITY a 'b'>]><list><item>&a;</item></list>";
        for text in [entity, "<list><item>", "", "<list>\0</list>", "<list><item>&a;</item></list>"] {
            assert!(matches!(texts(text).unwrap_err().problem, Problem::Xml(_)), "{text}");
        }
        let long = format!("<list>{}</list>", " ".repeat(MAX_BYTES));
        assert_eq!(texts(&long).unwrap_err().problem, Problem::TooLong(MAX_BYTES + 13));
        let nested = "<list>".repeat(MAX_BYTES / 8);
        assert!(matches!(texts(&nested).unwrap_err().problem, Problem::Xml(_)));
        let many = format!("<list>{}</list>", "<item/>".repeat(MAX_BYTES / 7 - 2));
        assert!(matches!(texts(&many).unwrap_err().problem, Problem::Xml(_)));
    }
}
