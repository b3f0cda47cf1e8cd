//! Tells Copper's code generator where its files go.

fn main() {
    cu29_build::setup();
}
