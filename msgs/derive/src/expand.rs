//! Generates the code that is added to the struct.

use downbeat_msgs_definitions::{Element, Field, Shape};
use downbeat_msgs_generator::generated;
use proc_macro2::TokenStream;
use quote::{format_ident, quote, quote_spanned};
use syn::{Error, Path, Result, parse_quote};

use crate::cdr;
use crate::definition::{Crate, Definition};
use crate::structure::{StructField, Structure};
use crate::tokens::tokens;

/// The implementations for the struct in `input`.
pub(crate) fn expand(input: TokenStream) -> Result<TokenStream> {
    let structure = Structure::parse(syn::parse2(input)?)?;
    expand_in(&structure, &Crate::from_cargo()?)
}

fn expand_in(structure: &Structure, here: &Crate) -> Result<TokenStream> {
    let definition = Definition::of(structure, here)?;
    let runtime: Path = structure.attributes.runtime.clone().unwrap_or_else(|| parse_quote!(::downbeat_msgs));
    let ident = &structure.ident;
    let name = definition.name.to_string();

    let pairs = || structure.fields.iter().zip(&definition.fields);
    let checks = pairs().filter_map(|(field, defined)| Some(check(field, defined.as_ref()?, &runtime)));
    let fields = pairs().map(|(field, defined)| described(field, defined.as_ref(), &runtime));
    let fields = fields.collect::<Result<Vec<_>>>()?;
    let own_text = own_text(structure, &definition, &runtime)?;
    let cdr = cdr::implementation(structure, &definition, &runtime)?;

    Ok(quote! {
        #(#checks)*

        #cdr

        impl #ident {
            /// The interface set of this message, for registration.
            #[allow(dead_code)]
            pub const INTERFACES: #runtime::OneMessage<Self> = <Self as #runtime::Message>::INTERFACES;
        }

        // For a message that refers to many others, computing the hash takes the compiler a moment.
        #[allow(long_running_const_eval)]
        impl #runtime::Message for #ident {
            const TYPE_NAME: &'static ::core::primitive::str = #name;
            const TYPE_HASH: &'static ::core::primitive::str = {
                const HASH: &#runtime::description::Hash =
                    &#runtime::description::hash(#name, <#ident as #runtime::Message>::FIELDS);
                HASH.as_str()
            };
            const DEFINITION: &'static ::core::primitive::str = {
                const FIELDS: &[#runtime::description::Field] = <#ident as #runtime::Message>::FIELDS;
                const OWN: #runtime::description::OwnText = #own_text;
                const LENGTH: ::core::primitive::usize = #runtime::description::definition::<0>(OWN, FIELDS).len();
                const TEXT: &#runtime::description::Text<LENGTH> =
                    &#runtime::description::definition::<LENGTH>(OWN, FIELDS);
                TEXT.as_str()
            };
            const FIELDS: &'static [#runtime::description::Field] = &[#(#fields),*];
        }
    })
}

/// Fails the build at the type of the field if it does not match the definition.
fn check(field: &StructField, defined: &Field, runtime: &Path) -> TokenStream {
    let rust_type = &field.rust_type;
    let defined_type = &defined.field_type;
    let place = if field.type_attribute.is_none() { format!("{}: ", defined.place) } else { String::new() };
    let message =
        format!("{place}`{}` is `{defined_type}`, in Rust {}", field.name, generated::in_rust(defined_type));
    let element = match &defined_type.element {
        Element::Message(name) => {
            let name = name.to_string();
            quote!(Message(#name))
        }
        Element::Primitive(primitive) => {
            let primitive = format_ident!("{primitive:?}");
            quote!(Primitive(#runtime::definitions::Primitive::#primitive))
        }
        Element::String { .. } => quote!(String { bound: None }),
        Element::WString { .. } => quote!(WString { bound: None }),
    };
    let shape = match defined_type.shape {
        Shape::Single => quote!(Single),
        Shape::Array(count) => quote!(Array(#count)),
        Shape::Bounded(_) | Shape::Sequence => quote!(Sequence),
    };
    quote_spanned! {field.type_span()=>
        const _: () = #runtime::description::check::<#rust_type>(
            #runtime::definitions::FieldType {
                element: #runtime::definitions::Element::#element,
                shape: #runtime::definitions::Shape::#shape,
            },
            #message
        );
    }
}

/// The field as in the constant `FIELDS`.
fn described(field: &StructField, defined: Option<&Field>, runtime: &Path) -> Result<TokenStream> {
    let (name, rust_type) = (&field.name, &field.rust_type);
    let modifiers = tokens(&defined.map(generated::modifiers).unwrap_or_default())?;
    Ok(quote_spanned! {field.type_span()=>
        #runtime::description::Field::of::<#rust_type>(#name) #modifiers
    })
}

fn own_text(structure: &Structure, definition: &Definition, runtime: &Path) -> Result<TokenStream> {
    let Some(file) = &definition.file else {
        let comment = &structure.comment;
        let comments = structure.fields.iter().map(|field| &field.comment);
        return Ok(quote! {
            #runtime::description::OwnText::Fields { comment: #comment, comments: &[#(#comments),*] }
        });
    };
    let Some(path) = file.to_str() else {
        return Err(Error::new(structure.ident.span(), format!("{} is not UTF-8", file.display())));
    };
    // This also makes cargo recompile the crate when the file changes.
    Ok(quote!(#runtime::description::OwnText::File(::core::include_str!(#path))))
}

#[cfg(test)]
#[path = "expand_tests.rs"]
mod tests;
