//! `.msg`, `.srv` and `.action` files, and the definition texts of bags.

use downbeat_msgs::definitions::{
    Catalog, DefinitionEncoding, TypeName, parse_action, parse_message, parse_service,
};

pub fn run(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let name = |name: &str| name.parse::<TypeName>().expect("a valid name");
    let _ = parse_service(name("a/srv/B"), text, "B.srv");
    let _ = parse_action(name("a/action/B"), text, "B.action");
    let of = name("a/msg/B");
    if let Ok(message) = parse_message(of.clone(), text, "B.msg") {
        let again =
            parse_message(of.clone(), &message.text, "B.msg").expect("the text of a definition defines it");
        assert_eq!(again.fields.len(), message.fields.len());
    }
    derive(&of, DefinitionEncoding::Ros2Msg, text);
}

/// Derives everything that can be derived from a definition text.
pub fn derive(name: &TypeName, encoding: DefinitionEncoding, text: &str) {
    let mut catalog = Catalog::new();
    if catalog.add_definition_text(name, encoding, text, "fuzzer").is_err()
        || catalog.check_type(name).is_err()
    {
        return;
    }
    let hash = catalog.type_hash(name).expect("a checked type has a hash");
    let written = catalog.definition_text(name).expect("a checked type has a text");
    let mut read = Catalog::new();
    read.add_definition_text(name, DefinitionEncoding::Ros2Msg, &written, "written")
        .expect("our own text is valid");
    assert_eq!(read.type_hash(name).expect("the same type"), hash, "{written}");
}
