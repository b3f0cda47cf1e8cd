//! An empty library; only `Cargo.toml` matters.
