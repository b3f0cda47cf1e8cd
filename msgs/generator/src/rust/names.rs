//! Rust names for ROS 2 names.

use std::collections::BTreeMap;

use super::RustSource;
use downbeat_msgs_definitions::{Element, FieldType, Kind, Primitive, Shape, TypeName};

/// The keywords of Rust 2024.
const KEYWORDS: [&str; 47] = [
    "abstract", "as", "async", "await", "become", "box", "break", "const", "continue", "do", "dyn", "else",
    "enum", "extern", "false", "final", "fn", "for", "gen", "if", "impl", "in", "let", "loop", "macro",
    "match", "mod", "move", "mut", "override", "priv", "pub", "ref", "return", "static", "struct", "trait",
    "true", "try", "type", "typeof", "unsafe", "unsized", "use", "virtual", "where", "while",
];

/// A field or module name; keywords in their raw form.
pub(super) fn identifier(name: &str) -> String {
    match name {
        // These have no raw form.
        "self" | "super" | "crate" => format!("{name}_"),
        "yield" => "r#yield".into(),
        _ if KEYWORDS.contains(&name) => format!("r#{name}"),
        _ => name.into(),
    }
}

/// The name of the Rust type of a message, service or action: `SetBoolRequest` for `SetBool_Request`.
pub(super) fn struct_name(name: &TypeName) -> String {
    match name.name.as_str() {
        "Self" => "Self_".into(),
        name => name.replace('_', ""),
    }
}

/// The Rust type of a primitive type.
#[must_use]
pub fn primitive(primitive: Primitive) -> &'static str {
    match primitive {
        Primitive::Bool => "bool",
        Primitive::Byte | Primitive::Char | Primitive::UInt8 => "u8",
        Primitive::Int8 => "i8",
        Primitive::Int16 => "i16",
        Primitive::UInt16 => "u16",
        Primitive::Int32 => "i32",
        Primitive::UInt32 => "u32",
        Primitive::Int64 => "i64",
        Primitive::UInt64 => "u64",
        Primitive::Float32 => "f32",
        Primitive::Float64 => "f64",
    }
}

impl RustSource<'_> {
    /// The type of a field of the message `owner`.
    pub(super) fn field_type(&self, field_type: &FieldType, owner: &TypeName) -> String {
        let element = match &field_type.element {
            Element::Primitive(of) => primitive(*of).to_owned(),
            Element::String { .. } => self.prelude("String", "::std::string::String", owner),
            Element::WString { .. } => format!("{}::WString", self.modules.runtime),
            Element::Message(name) => self.type_path(name, owner),
        };
        match field_type.shape {
            Shape::Single => element,
            Shape::Array(count) => format!("[{element}; {count}]"),
            Shape::Bounded(_) | Shape::Sequence => {
                format!("{}<{element}>", self.prelude("Vec", "::std::vec::Vec", owner))
            }
        }
    }

    /// The shortest path of a struct from where `owner` is defined.
    pub(super) fn type_path(&self, name: &TypeName, owner: &TypeName) -> String {
        if name.package == owner.package && name.kind == owner.kind {
            struct_name(name)
        } else if name.package == owner.package {
            format!("super::{}::{}", name.kind.as_str(), struct_name(name))
        } else {
            self.full_path(self.modules.of(&name.package), name)
        }
    }

    pub(super) fn full_path(&self, module: &str, name: &TypeName) -> String {
        format!("{module}::{}::{}::{}", identifier(&name.package), name.kind.as_str(), struct_name(name))
    }

    /// Two types of a package that would have the same name in Rust, if any: the service `FooRequest` beside
    /// the request of the service `Foo`.
    pub(crate) fn name_clash(&self, package: &str) -> Option<[&TypeName; 2]> {
        let mut known: BTreeMap<(Kind, String), &TypeName> = BTreeMap::new();
        let messages = self.catalog.messages().map(|message| &message.name);
        let services = self.catalog.services().map(|service| &service.name);
        let actions = self.catalog.actions().map(|action| &action.name);
        messages
            .chain(services)
            .chain(actions)
            .filter(|name| name.package == package)
            .find_map(|name| known.insert((name.kind, struct_name(name)), name).map(|first| [first, name]))
    }

    /// A name of the standard prelude, or its full path if a ROS 2 type of the same module has that name.
    pub(super) fn prelude(&self, short: &str, full: &str, owner: &TypeName) -> String {
        let shadowed = TypeName { name: short.into(), ..owner.clone() };
        let is_shadowed = self.catalog.message(&shadowed).is_ok()
            || self.catalog.service(&shadowed).is_ok()
            || self.catalog.action(&shadowed).is_ok();
        if is_shadowed { full } else { short }.into()
    }
}
