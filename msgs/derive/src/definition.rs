//! The name of the message and the definitions of its fields.

use std::path::{Path, PathBuf};

use downbeat_msgs_definitions::{
    Error as DefinitionError, Field, Kind, MessageDefinition, TypeName, parse_message,
};
use proc_macro2::Span;
use syn::{Error, LitStr, Result};

use crate::structure::{StructField, Structure};

/// What is known of a message when the macro runs.
pub(crate) struct Definition {
    pub name: TypeName,
    /// The path of the definition file.
    pub file: Option<PathBuf>,
    /// For each field of the struct, its type by definition or attribute, if any.
    pub fields: Vec<Option<Field>>,
}

/// The crate being compiled.
pub(crate) struct Crate {
    pub name: String,
    pub folder: PathBuf,
}

impl Crate {
    /// Reads it from cargo's environment variables.
    pub fn from_cargo() -> Result<Self> {
        let variable = |name: &str| {
            std::env::var(name)
                .map_err(|_| Error::new(Span::call_site(), format!("cargo sets {name}, but it is not set")))
        };
        Ok(Self { name: variable("CARGO_PKG_NAME")?, folder: variable("CARGO_MANIFEST_DIR")?.into() })
    }
}

impl Definition {
    pub fn of(structure: &Structure, here: &Crate) -> Result<Self> {
        let name = type_name(structure, here)?;
        let Some(file) = &structure.attributes.file else {
            let fields = structure.fields.iter().map(|field| field_by_attribute(field, &name));
            return Ok(Self { file: None, fields: fields.collect::<Result<_>>()?, name });
        };
        let path = here.folder.join(file.value());
        let text = std::fs::read_to_string(&path)
            .map_err(|error| Error::new(file.span(), format!("cannot read {}: {error}", path.display())))?;
        let message = parse_message(name.clone(), &text, &file.value())
            .map_err(|error| Error::new(file.span(), error.to_string()))?;
        if message.name.name != stem(file) {
            return Err(Error::new(
                file.span(),
                format!("{} defines a message `{}`, not {name}", file.value(), stem(file)),
            ));
        }
        let fields = fields_of_file(structure, message, &file.value())?;
        Ok(Self { name, file: Some(path), fields })
    }
}

/// The name in the attribute, or else derived from the path of the file, or from crate and struct.
fn type_name(structure: &Structure, here: &Crate) -> Result<TypeName> {
    let of_crate = here.name.replace('-', "_");
    let (text, span) = match (&structure.attributes.name, &structure.attributes.file) {
        (Some(name), _) => (name.value(), name.span()),
        (None, Some(file)) => {
            let path = PathBuf::from(file.value());
            let package = path.parent().and_then(Path::parent).and_then(Path::file_name);
            let package = package.map_or(of_crate, |package| package.to_string_lossy().into_owned());
            (format!("{package}/msg/{}", stem(file)), file.span())
        }
        (None, None) => (format!("{of_crate}/msg/{}", structure.ident), structure.ident.span()),
    };
    match text.parse::<TypeName>() {
        Ok(name) if name.kind == Kind::Message => Ok(name),
        _ => Err(Error::new(
            span,
            format!(
                "`{text}` is not the name of a message: set one such as `my_msgs/msg/Leg` with `name = \"…\"`"
            ),
        )),
    }
}

fn stem(file: &LitStr) -> String {
    Path::new(&file.value()).file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// The fields of the file, which must match those of the struct.
fn fields_of_file(
    structure: &Structure,
    message: MessageDefinition,
    file: &str,
) -> Result<Vec<Option<Field>>> {
    let mut fields = Vec::new();
    let mut theirs = message.fields.into_iter();
    for ours in &structure.fields {
        if let Some(attribute) = &ours.type_attribute {
            return Err(Error::new(attribute.span(), format!("the type of this field is defined in {file}")));
        }
        match theirs.next() {
            Some(field) if field.name == ours.name => fields.push(Some(field)),
            Some(field) => {
                return Err(Error::new(
                    ours.ident.span(),
                    format!("{}: the field here is `{} {}`", field.place, field.field_type, field.name),
                ));
            }
            None => return Err(Error::new(ours.ident.span(), format!("{file} has no more fields"))),
        }
    }
    match theirs.next() {
        None => Ok(fields),
        Some(field) => Err(Error::new(
            structure.ident.span(),
            format!("{}: the struct lacks the field `{} {}`", field.place, field.field_type, field.name),
        )),
    }
}

/// The type in the attribute of a field. Without an attribute, the type follows from the Rust type.
fn field_by_attribute(field: &StructField, name: &TypeName) -> Result<Option<Field>> {
    let (type_text, span) = match &field.type_attribute {
        Some(attribute) => (attribute.value(), attribute.span()),
        None => ("bool".into(), field.ident.span()), // Checks the name only.
    };
    if type_text.contains(|character: char| character.is_whitespace() || character == '#') {
        return Err(Error::new(span, format!("`{type_text}` is not the type of a field")));
    }
    let line = format!("{type_text} {}", field.name);
    let message = parse_message(name.clone(), &line, "").map_err(|error| match error {
        DefinitionError::Syntax { message, .. } => Error::new(span, message),
        other => Error::new(span, other.to_string()),
    })?;
    Ok(message.fields.into_iter().next().filter(|_| field.type_attribute.is_some()))
}
