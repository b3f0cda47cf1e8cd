//! Gives Copper's code generator its output folder.

fn main() {
    cu29_build::setup();
}
