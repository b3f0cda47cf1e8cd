//! Modules and the declarations in them.

use std::collections::{HashMap, HashSet};

use super::lexer::{Lexer, Token, TokenKind};
use super::literal::{Literal, default_value};
use crate::definition::MOST_MEMBERS;
use crate::derived::without_bound;
use crate::{
    Constant, Element, Error, Field, FieldType, Kind, MessageDefinition, Place, Primitive, Shape, TypeName,
};

/// The member that rosidl adds to an empty struct.
const PLACEHOLDER: &str = "structure_needs_at_least_one_member";

/// More modules within modules than any interface has.
const DEEPEST_MODULE: usize = 8;

/// A message whose text is not written yet, and the position of its name.
pub(super) struct Struct {
    pub(super) message: MessageDefinition,
    pub(super) place: Place,
}

/// All structs of a text, in order. Their names are distinct.
pub(super) fn parse(text: &str, origin: &str, first_line: usize) -> Result<Vec<Struct>, Error> {
    let mut lexer = Lexer::new(text, origin, first_line);
    let token = lexer.next()?;
    let mut parser = Parser {
        lexer,
        origin,
        token,
        scope: Vec::new(),
        typedefs: HashMap::new(),
        values: HashMap::new(),
        constants: HashMap::new(),
        structs: Vec::new(),
        members: 0,
        names: HashSet::new(),
    };
    parser.specification()?;
    for of in &mut parser.structs {
        let name = &of.message.name;
        let module = format!("{}::{}::{}_Constants", name.package, name.kind.as_str(), name.name);
        of.message.constants = parser.constants.remove(&module).unwrap_or_default();
    }
    Ok(parser.structs)
}

pub(super) struct Parser<'a> {
    lexer: Lexer<'a>,
    origin: &'a str,
    /// The next token.
    pub(super) token: Token<'a>,
    /// The enclosing modules, the outermost first.
    pub(super) scope: Vec<&'a str>,
    /// By path, as in `a::b::name`.
    pub(super) typedefs: HashMap<String, FieldType>,
    /// The values of constants, by path.
    pub(super) values: HashMap<String, Literal>,
    /// By the path of their module.
    constants: HashMap<String, Vec<Constant>>,
    structs: Vec<Struct>,
    /// The number of members of all structs, and of constants.
    members: usize,
    names: HashSet<TypeName>,
}

/// The annotations before a declaration.
#[derive(Default)]
struct Annotations {
    comment: Vec<String>,
    /// With its line and column.
    default: Option<(Literal, usize, usize)>,
}

impl<'a> Parser<'a> {
    fn specification(&mut self) -> Result<(), Error> {
        loop {
            let annotations = self.annotations()?;
            match self.token.kind {
                TokenKind::Word("module") => {
                    let (line, column) = (self.token.line, self.token.column);
                    self.advance()?;
                    let name = self.identifier("the name of the module")?;
                    self.expect("{")?;
                    if self.scope.len() == DEEPEST_MODULE {
                        let fault = format!("modules are nested deeper than {DEEPEST_MODULE}");
                        return Err(self.fault(line, column, fault));
                    }
                    self.scope.push(name);
                }
                TokenKind::Symbol("}") if !self.scope.is_empty() => {
                    self.advance()?;
                    self.expect(";")?;
                    self.scope.pop();
                }
                TokenKind::Word("const") => self.constant(annotations)?,
                TokenKind::Word("typedef") => self.typedef()?,
                TokenKind::Word("struct") => self.structure(annotations)?,
                TokenKind::Word(word @ ("enum" | "union" | "bitset" | "bitmask" | "interface")) => {
                    let fault = format!("ROS 2 interfaces have no `{word}`");
                    return Err(self.fault(self.token.line, self.token.column, fault));
                }
                TokenKind::End if self.scope.is_empty() => return Ok(()),
                TokenKind::End => return Err(self.unexpected("`}` at the end of a module")),
                _ => return Err(self.unexpected("`module`, `struct`, `typedef` or `const`")),
            }
        }
    }

    fn constant(&mut self, annotations: Annotations) -> Result<(), Error> {
        self.advance()?;
        let (line, column) = (self.token.line, self.token.column);
        let FieldType { element, shape } = self.type_spec()?;
        if shape != Shape::Single || matches!(element, Element::Message(_)) {
            let fault = "only primitives and strings can be the type of a constant".into();
            return Err(self.fault(line, column, fault));
        }
        let (line, column) = (self.token.line, self.token.column);
        let name = self.identifier("the name of the constant")?;
        self.expect("=")?;
        let (value_line, value_column) = (self.token.line, self.token.column);
        let literal = self.constant_value()?;
        self.expect(";")?;
        if self.values.insert(self.path(name), literal.clone()).is_some() {
            return Err(self.fault(line, column, format!("the constant `{name}` is defined twice")));
        }
        let value =
            literal.into_value(&element).map_err(|fault| self.fault(value_line, value_column, fault))?;
        self.constants.entry(self.scope.join("::")).or_default().push(Constant {
            name: name.into(),
            element: without_bound(element),
            value,
            comment: annotations.comment,
        });
        Ok(())
    }

    fn typedef(&mut self) -> Result<(), Error> {
        self.advance()?;
        let base = self.type_spec()?;
        loop {
            let (line, column) = (self.token.line, self.token.column);
            let (name, field_type) = self.declarator(&base)?;
            match self.typedefs.get(&self.path(name)) {
                Some(first) if *first != field_type => {
                    let fault = format!("`{name}` is already `{first}` and cannot be `{field_type}`");
                    return Err(self.fault(line, column, fault));
                }
                _ => self.typedefs.insert(self.path(name), field_type),
            };
            if !self.accept(",")? {
                return self.expect(";");
            }
        }
    }

    fn structure(&mut self, annotations: Annotations) -> Result<(), Error> {
        self.advance()?;
        let place = self.lexer.place(self.token.line, self.token.column);
        let name = self.identifier("the name of the struct")?;
        if self.accept(";")? {
            return Ok(()); // A forward declaration.
        }
        let fault = |message: String| Error::Syntax { place: place.clone(), message };
        let name = self.interface_name(name).map_err(fault)?;
        if !self.names.insert(name.clone()) {
            return Err(fault(format!("{name} is defined twice")));
        }
        self.expect("{")?;
        let mut fields = Vec::new();
        let mut names = HashSet::new();
        while !self.accept("}")? {
            self.members(&mut fields, &mut names)?;
        }
        self.expect(";")?;
        if let [Field { name, field_type, .. }] = fields.as_slice()
            && name == PLACEHOLDER
            && *field_type
                == (FieldType { element: Element::Primitive(Primitive::UInt8), shape: Shape::Single })
        {
            fields.clear();
        }
        let message = MessageDefinition {
            name,
            comment: annotations.comment,
            fields,
            constants: Vec::new(),
            text: String::new(),
            origin: self.origin.into(),
        };
        self.structs.push(Struct { message, place });
        Ok(())
    }

    /// Derives the name of a struct from the enclosing modules.
    fn interface_name(&self, name: &str) -> Result<TypeName, String> {
        let kind_of = |module: &str| Kind::ALL.into_iter().find(|kind| kind.as_str() == module);
        match self.scope.as_slice() {
            [package, kind] => kind_of(kind).and_then(|kind| TypeName::checked(package, kind, name)),
            _ => None,
        }
        .ok_or_else(|| {
            format!(
                "`{name}` in the modules `{}` cannot name an interface: expected `module <package> {{ module msg {{` \
                 (or `srv`, `action`) around it, and letters and digits, a capital first",
                self.scope.join("::")
            )
        })
    }

    /// The members declared with one type.
    fn members(&mut self, fields: &mut Vec<Field>, names: &mut HashSet<&'a str>) -> Result<(), Error> {
        let annotations = self.annotations()?;
        let place = self.lexer.place(self.token.line, self.token.column);
        let base = self.type_spec()?;
        loop {
            let (line, column) = (self.token.line, self.token.column);
            let (name, field_type) = self.declarator(&base)?;
            if !names.insert(name) {
                return Err(self.fault(line, column, format!("the field `{name}` is defined twice")));
            }
            self.count_member(line, column)?;
            let default = match &annotations.default {
                None => None,
                Some((literal, line, column)) => Some(
                    default_value(literal.clone(), &field_type)
                        .map_err(|fault| self.fault(*line, *column, fault))?,
                ),
            };
            fields.push(Field {
                name: name.into(),
                field_type,
                default,
                comment: annotations.comment.clone(),
                place: place.clone(),
            });
            if !self.accept(",")? {
                return self.expect(";");
            }
        }
    }

    fn count_member(&mut self, line: usize, column: usize) -> Result<(), Error> {
        self.members += 1;
        if self.members > MOST_MEMBERS {
            let fault = format!("a text of more than {MOST_MEMBERS} fields and constants is not supported");
            return Err(self.fault(line, column, fault));
        }
        Ok(())
    }

    fn annotations(&mut self) -> Result<Annotations, Error> {
        let mut annotations = Annotations::default();
        while self.accept("@")? {
            let mut name = self.identifier("the name of the annotation")?;
            while self.accept("::")? {
                name = self.identifier("the name of the annotation")?;
            }
            match name {
                "verbatim" | "default" | "unit" => self.parameters(name, &mut annotations)?,
                _ => self.skip_parameters()?,
            }
        }
        Ok(annotations)
    }

    fn parameters(&mut self, annotation: &str, annotations: &mut Annotations) -> Result<(), Error> {
        self.expect("(")?;
        let mut language = None;
        let mut text = None;
        loop {
            let (line, column) = (self.token.line, self.token.column);
            // Without a name, it is the only value.
            let (name, value) = match self.token.kind {
                TokenKind::Word(name @ ("language" | "placement" | "text" | "value")) => {
                    self.advance()?;
                    self.expect("=")?;
                    // The values of a placement are identifiers.
                    if name == "placement" && matches!(self.token.kind, TokenKind::Word(_)) {
                        self.advance()?;
                        (name, None)
                    } else {
                        (name, Some(self.constant_value()?))
                    }
                }
                _ => ("value", Some(self.constant_value()?)),
            };
            match (annotation, name, value) {
                ("default", "value", Some(value)) => annotations.default = Some((value, line, column)),
                ("unit", "value", Some(Literal::Text(unit))) => annotations.comment.push(format!("[{unit}]")),
                ("verbatim", "language", Some(Literal::Text(word))) => language = Some(word),
                ("verbatim", "text", Some(Literal::Text(lines))) => text = Some(lines),
                _ => {}
            }
            if !self.accept(",")? {
                break;
            }
        }
        if let (Some("comment"), Some(text)) = (language.as_deref(), text) {
            annotations.comment.extend(text.lines().map(|line| line.trim().to_owned()));
        }
        self.expect(")")
    }

    /// Skips the parenthesised parameters of an ignored annotation.
    fn skip_parameters(&mut self) -> Result<(), Error> {
        if self.token.kind != TokenKind::Symbol("(") {
            return Ok(());
        }
        let mut open = 0_usize;
        loop {
            match self.token.kind {
                TokenKind::Symbol("(") => open += 1,
                TokenKind::Symbol(")") => open -= 1,
                TokenKind::End => return Err(self.unexpected("`)`")),
                _ => {}
            }
            self.advance()?;
            if open == 0 {
                return Ok(());
            }
        }
    }

    /// Looks up a path, in the innermost module first.
    pub(super) fn lookup<'b, T>(&self, known: &'b HashMap<String, T>, path: &str) -> Option<&'b T> {
        if let Some(absolute) = path.strip_prefix("::") {
            return known.get(absolute);
        }
        (0..=self.scope.len()).rev().find_map(|depth| {
            let modules = &self.scope[..depth];
            let candidate: Vec<&str> = modules.iter().copied().chain([path]).collect();
            known.get(&candidate.join("::"))
        })
    }

    fn path(&self, name: &str) -> String {
        self.scope.iter().copied().chain([name]).collect::<Vec<_>>().join("::")
    }

    pub(super) fn identifier(&mut self, what: &str) -> Result<&'a str, Error> {
        match self.token.kind {
            TokenKind::Word(word) => self.advance().map(|()| word),
            _ => Err(self.unexpected(what)),
        }
    }

    pub(super) fn accept(&mut self, symbol: &str) -> Result<bool, Error> {
        let is_there = matches!(self.token.kind, TokenKind::Symbol(found) if found == symbol);
        if is_there {
            self.advance()?;
        }
        Ok(is_there)
    }

    pub(super) fn expect(&mut self, symbol: &str) -> Result<(), Error> {
        if self.accept(symbol)? { Ok(()) } else { Err(self.unexpected(&format!("`{symbol}`"))) }
    }

    pub(super) fn advance(&mut self) -> Result<(), Error> {
        self.token = self.lexer.next()?;
        Ok(())
    }

    pub(super) fn unexpected(&self, expected: &str) -> Error {
        let fault = format!("expected {expected}, found {}", self.token.kind.quoted());
        self.fault(self.token.line, self.token.column, fault)
    }

    pub(super) fn fault(&self, line: usize, column: usize, message: String) -> Error {
        Error::Syntax { place: self.lexer.place(line, column), message }
    }
}
