//! The README does what it says.

#[test]
fn the_commands_of_the_readme_print_what_it_says() {
    readme_runner::Readme::of(env!("CARGO_MANIFEST_DIR"), env!("CARGO_BIN_EXE_embedding")).check();
}

#[test]
fn nothing_of_the_command_line_is_linked() {
    let manifest = concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml");
    let arguments =
        ["tree", "--offline", "--edges", "normal", "--prefix", "none", "--manifest-path", manifest];
    let tree = std::process::Command::new(env!("CARGO")).args(arguments).output().expect("cargo runs");
    let tree = String::from_utf8_lossy(&tree.stdout);
    assert!(tree.contains("downbeat-bridge"), "{tree}");
    for package in ["clap", "parquet", "plotters", "ratatui"] {
        assert!(!tree.lines().any(|line| line.split(' ').next() == Some(package)), "{package} in\n{tree}");
    }
}
