//! `.idl` files, and definition texts in that language.

use downbeat_msgs::definitions::{DefinitionEncoding, parse_idl};

use super::interface_files::derive;

pub fn run(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let Ok(definitions) = parse_idl(text, "B.idl") else { return };
    for definition in &definitions {
        derive(definition.name(), DefinitionEncoding::Ros2Idl, text);
    }
}
