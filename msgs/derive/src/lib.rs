//! The derive macro `Message` of [`downbeat-msgs`](https://docs.rs/downbeat-msgs), which re-exports and
//! documents it.

mod attributes;
mod cdr;
mod definition;
mod expand;
mod structure;
mod tokens;

/// Makes a struct a ROS 2 message: implements `Cdr` and `Message` with the same bytes, definition text and
/// hash as a generated one.
///
/// See `downbeat_msgs::Message` for the attributes.
#[proc_macro_derive(Message, attributes(message))]
pub fn derive_message(input: proc_macro::TokenStream) -> proc_macro::TokenStream {
    expand::expand(input.into()).unwrap_or_else(syn::Error::into_compile_error).into()
}
