//! The implementation of `Cdr`.

use downbeat_msgs_definitions::{Element, Field, Shape};
use downbeat_msgs_generator::generated;
use proc_macro2::TokenStream;
use quote::{format_ident, quote, quote_spanned};
use syn::{Path, Result};

use crate::definition::Definition;
use crate::structure::{StructField, Structure};
use crate::tokens::tokens;

/// Field by field, as in generated messages without a fixed layout.
pub(crate) fn implementation(
    structure: &Structure,
    definition: &Definition,
    runtime: &Path,
) -> Result<TokenStream> {
    let ident = &structure.ident;
    let fields: Vec<_> = structure.fields.iter().map(|field| &field.ident).collect();
    let types: Vec<_> = structure.fields.iter().map(|field| &field.rust_type).collect();
    let mut decoded = Vec::new();
    let mut checks = Vec::new();
    for (field, defined) in structure.fields.iter().zip(&definition.fields) {
        decoded.push(decode(field, defined.as_ref())?);
        checks.push(check_bounds(field, defined.as_ref(), runtime));
    }
    let (least, end, encode, decode) = if fields.is_empty() {
        (quote!(1), quote!(position + 1), quote!(writer.empty_message();), quote!(reader.empty_message()?;))
    } else {
        (
            quote!(0 #(+ <#types as #runtime::cdr::Cdr>::LEAST_SIZE)*),
            quote! {
                #(let position = #runtime::cdr::Cdr::end(&self.#fields, position);)*
                position
            },
            quote!(#(writer.value(&self.#fields);)*),
            TokenStream::new(),
        )
    };
    Ok(quote! {
        impl #runtime::cdr::Cdr for #ident {
            const LEAST_SIZE: ::core::primitive::usize = #least;

            fn end(&self, position: ::core::primitive::usize) -> ::core::primitive::usize {
                #end
            }

            fn encode(&self, writer: &mut #runtime::cdr::Writer<'_>) {
                #encode
            }

            fn decode(reader: &mut #runtime::cdr::Reader<'_>) -> #runtime::cdr::Result<Self> {
                reader.message(|reader| {
                    #decode
                    ::core::result::Result::Ok(Self { #(#decoded),* })
                })
            }

            fn check_bounds(&self) -> ::core::result::Result<(), #runtime::cdr::EncodeError> {
                #(#checks)*
                ::core::result::Result::Ok(())
            }
        }
    })
}

fn decode(field: &StructField, defined: Option<&Field>) -> Result<TokenStream> {
    let (ident, name) = (&field.ident, &field.name);
    let call = match defined {
        Some(defined) => tokens(&generated::decode_call(defined))?,
        None => quote!(reader.field(#name)?),
    };
    Ok(quote_spanned!(field.type_span()=> #ident: #call))
}

fn check_bounds(field: &StructField, defined: Option<&Field>, runtime: &Path) -> TokenStream {
    let (ident, name) = (&field.ident, &field.name);
    let call = |function: &str, bound: Option<u64>| {
        let function = format_ident!("{function}");
        let bound = bound.map(|bound| bound as usize).into_iter(); // Fits in 32 bits.
        quote!(#runtime::cdr::#function(#name, &self.#ident #(, #bound)*)?;)
    };
    let Some(defined) = defined else { return call("check_field", None) };
    let mut checks = TokenStream::new();
    if let Shape::Bounded(bound) = defined.field_type.shape {
        checks.extend(call("check_count", Some(bound)));
    }
    match defined.field_type.element {
        Element::String { bound: Some(bound) } | Element::WString { bound: Some(bound) } => {
            checks.extend(call("check_text", Some(bound)));
        }
        Element::Message(_) => checks.extend(call("check_field", None)),
        _ => {}
    }
    checks
}
