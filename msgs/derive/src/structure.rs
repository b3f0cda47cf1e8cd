//! The struct that becomes a message.

use proc_macro2::Span;
use syn::ext::IdentExt;
use syn::spanned::Spanned;
use syn::{Data, DeriveInput, Error, Fields, Ident, LitStr, Result, Type};

use crate::attributes::{self, StructAttributes};

/// A struct with named fields and without parameters.
pub(crate) struct Structure {
    pub ident: Ident,
    pub attributes: StructAttributes,
    /// Its documentation as comment lines.
    pub comment: String,
    pub fields: Vec<StructField>,
}

/// A field of the struct.
pub(crate) struct StructField {
    pub ident: Ident,
    /// Its name in ROS 2.
    pub name: String,
    pub rust_type: Type,
    /// Its ROS 2 type, if set by an attribute.
    pub type_attribute: Option<LitStr>,
    /// Its documentation as comment lines.
    pub comment: String,
}

impl StructField {
    /// The span of its Rust type, for errors; names resolve as in the code of the macro.
    pub fn type_span(&self) -> Span {
        self.rust_type.span().resolved_at(Span::call_site())
    }
}

impl Structure {
    pub fn parse(input: DeriveInput) -> Result<Self> {
        if !input.generics.params.is_empty() {
            return Err(Error::new(
                input.generics.span(),
                "a message has one hash, so its struct cannot have parameters",
            ));
        }
        let fields = match input.data {
            Data::Struct(data) => match data.fields {
                Fields::Named(fields) => fields.named,
                Fields::Unit | Fields::Unnamed(_) => {
                    return Err(Error::new(
                        input.ident.span(),
                        "the fields of a message have names: write `struct Name { … }`, even without fields",
                    ));
                }
            },
            Data::Enum(_) | Data::Union(_) => {
                return Err(Error::new(
                    input.ident.span(),
                    "only a struct can be a message: in ROS 2 an enumeration is an integer with constants",
                ));
            }
        };
        let fields = fields.into_iter().filter_map(|field| {
            let ident = field.ident?;
            Some(attributes::field_type(&field.attrs).map(|type_attribute| StructField {
                name: ros_name(&ident),
                ident,
                rust_type: field.ty,
                type_attribute,
                comment: attributes::comment(&field.attrs),
            }))
        });
        Ok(Self {
            attributes: StructAttributes::parse(&input.attrs)?,
            comment: attributes::comment(&input.attrs),
            fields: fields.collect::<Result<_>>()?,
            ident: input.ident,
        })
    }
}

/// The ROS name of a field: as in generated structs, `r#type` is `type`, and `self_`, which cannot be raw, is
/// `self`.
fn ros_name(ident: &Ident) -> String {
    let name = ident.unraw().to_string();
    match name.strip_suffix('_') {
        Some(keyword @ ("self" | "super" | "crate")) => keyword.into(),
        _ => name,
    }
}
