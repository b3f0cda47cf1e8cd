//! The other process for Zenoh.

fn main() {
    downbeat_conformance::peer::main(&downbeat_conformance::engines::join_zenoh);
}
