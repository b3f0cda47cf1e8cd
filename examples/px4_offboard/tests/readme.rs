//! The README does what it says.

#[test]
fn the_commands_of_the_readme_print_what_it_says() {
    readme_runner::Readme::of(env!("CARGO_MANIFEST_DIR"), env!("CARGO_BIN_EXE_px4_offboard")).check();
}
