//! The other process for rustdds.

fn main() {
    downbeat_conformance::peer::main(&downbeat_conformance::engines::join_rustdds);
}
