//! The other process for the engine of this project with DDS Security.

fn main() {
    downbeat_conformance::peer::main(&downbeat_conformance::engines::join_secured);
}
