//! The program `downbeat` of a checkout.

// Not `required-features` in Cargo.toml: cargo-ament-build knows no default features and would not install it.
#[cfg(not(feature = "cli"))]
compile_error!("the program needs the feature \"cli\"");

fn main() -> std::process::ExitCode {
    downbeat::App::with_built_in_kinds().main()
}
