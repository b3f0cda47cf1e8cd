//! Nothing: what matters is `Cargo.toml`.
