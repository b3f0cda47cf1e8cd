//! The attribute `#[message(...)]`, and comments.

use syn::{Attribute, Expr, ExprLit, Lit, LitStr, Meta, Path, Result};

/// The attributes of the struct.
#[derive(Default)]
pub(crate) struct StructAttributes {
    /// `name = "my_msgs/msg/Leg"`
    pub name: Option<LitStr>,
    /// `file = "msg/Leg.msg"`
    pub file: Option<LitStr>,
    /// `crate = "some::path"`
    pub runtime: Option<Path>,
}

impl StructAttributes {
    pub fn parse(attributes: &[Attribute]) -> Result<Self> {
        let mut found = Self::default();
        for attribute in attributes.iter().filter(|attribute| attribute.path().is_ident("message")) {
            attribute.parse_nested_meta(|meta| {
                if meta.path.is_ident("name") {
                    found.name = Some(meta.value()?.parse()?);
                } else if meta.path.is_ident("file") {
                    found.file = Some(meta.value()?.parse()?);
                } else if meta.path.is_ident("crate") {
                    found.runtime = Some(meta.value()?.parse::<LitStr>()?.parse()?);
                } else {
                    return Err(meta.error("expected `name = \"…\"`, `file = \"…\"` or `crate = \"…\"`"));
                }
                Ok(())
            })?;
        }
        Ok(found)
    }
}

/// The attribute of a field: `type = "string<=10"`.
pub(crate) fn field_type(attributes: &[Attribute]) -> Result<Option<LitStr>> {
    let mut found = None;
    for attribute in attributes.iter().filter(|attribute| attribute.path().is_ident("message")) {
        attribute.parse_nested_meta(|meta| {
            if meta.path.is_ident("type") {
                found = Some(meta.value()?.parse()?);
                Ok(())
            } else {
                Err(meta.error("expected `type = \"…\"`, the type as in a definition"))
            }
        })?;
    }
    Ok(found)
}

/// The documentation as comment lines of a definition, or empty.
pub(crate) fn comment(attributes: &[Attribute]) -> String {
    let mut comment = String::new();
    for attribute in attributes.iter().filter(|attribute| attribute.path().is_ident("doc")) {
        let Meta::NameValue(pair) = &attribute.meta else { continue };
        let Expr::Lit(ExprLit { lit: Lit::Str(text), .. }) = &pair.value else { continue };
        for line in text.value().lines() {
            comment.push_str(&format!("#{line}"));
            comment.truncate(comment.trim_end().len());
            comment.push('\n');
        }
    }
    comment
}
