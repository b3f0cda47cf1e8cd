//! Networks compared with onnxruntime, and the module that binds them to topics.
#![allow(clippy::unwrap_used, missing_docs)]

mod module;
mod networks;
mod onnx;
