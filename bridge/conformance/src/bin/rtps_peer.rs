//! The other process for the engine of this project.

fn main() {
    downbeat_conformance::peer::main(&downbeat_conformance::engines::join_rtps);
}
