//! Generated source text as tokens.

use proc_macro2::TokenStream;
use syn::{Error, Result};

/// Source text as tokens, with the span of the derive.
pub(crate) fn tokens(source: &str) -> Result<TokenStream> {
    source.parse().map_err(Error::from)
}
