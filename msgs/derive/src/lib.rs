//! The derive macro `Message` of [`downbeat-msgs`](https://docs.rs/downbeat-msgs), which re-exports and documents it.

mod attributes;
mod cdr;
mod definition;
mod expand;
mod structure;

/// Makes a ROS 2 message of a struct: it gets `Cdr` and `Message`, with the bytes, the definition text and the hash of a
/// generated one.
///
/// See `downbeat_msgs::Message` for what the attributes mean.
#[proc_macro_derive(Message, attributes(message))]
pub fn derive_message(input: proc_macro::TokenStream) -> proc_macro::TokenStream {
    expand::expand(input.into()).unwrap_or_else(syn::Error::into_compile_error).into()
}
