#![allow(clippy::unwrap_used)]

use super::{parse_action, parse_message, parse_service};
use crate::{Element, Primitive, Shape, Value};

fn error_of(text: &str) -> String {
    parse_message("a_pkg/msg/A".parse().unwrap(), text, "A.msg").unwrap_err().to_string()
}

#[test]
fn fields_constants_defaults_and_comments_are_read() {
    let text = "# What it is.\n\n# How far [m]\nfloat64 range 1.5  # never negative\n\
                uint8  ON = 0x01\nOther[<=3]\tothers\nstring<=5[2] names [\"a\", \"b\"]\n";
    let message = parse_message("a_pkg/msg/A".parse().unwrap(), text, "A.msg").unwrap();
    assert_eq!(message.comment, ["What it is."]);
    assert_eq!(message.text, text);
    let [range, others, names] = message.fields.as_slice() else { panic!("{:?}", message.fields) };
    assert_eq!(range.comment, ["How far [m]", "never negative"]);
    assert_eq!(range.default, Some(Value::Float(1.5)));
    assert_eq!(others.field_type.element, Element::Message("a_pkg/msg/Other".parse().unwrap()));
    assert_eq!(others.field_type.shape, Shape::Bounded(3));
    assert_eq!(names.field_type.to_string(), "string<=5[2]");
    assert_eq!(names.default, Some(Value::List(vec![Value::Text("a".into()), Value::Text("b".into())])));
    assert_eq!(message.constants[0].element, Element::Primitive(Primitive::UInt8));
    assert_eq!(message.constants[0].value, Value::Integer(1));
}

#[test]
fn an_indented_comment_continues_that_of_the_line_above() {
    let text = "# Top.\n\n    # of nothing\nuint8 LOST = 9   # Sent no more\n                 #   and never will be.\n# Why\nint8 x\n\t# not\n";
    let message = parse_message("a/msg/A".parse().unwrap(), text, "A.msg").unwrap();
    assert_eq!(message.constants[0].comment, ["Sent no more", "and never will be."]);
    assert_eq!(message.fields[0].comment, ["Why", "not"]);
}

#[test]
fn a_hash_sign_begins_a_comment_even_within_quotes_as_in_rosidl() {
    let message = parse_message("a/msg/A".parse().unwrap(), "string S=\"a#b\"", "A.msg").unwrap();
    assert_eq!(message.constants[0].value, Value::Text("\"a".into()));
}

#[test]
fn an_equals_sign_within_a_default_does_not_make_a_constant() {
    let message = parse_message("a/msg/A".parse().unwrap(), "string s \"a=b\"", "A.msg").unwrap();
    assert_eq!(message.fields[0].default, Some(Value::Text("a=b".into())));
}

#[test]
fn a_service_has_two_halves_and_places_count_from_the_top_of_the_file() {
    let name = || "a/srv/S".parse().unwrap();
    let service = parse_service(name(), "bool on\n---\nstring said\n", "S.srv").unwrap();
    assert_eq!(service.request.name.to_string(), "a/srv/S_Request");
    assert_eq!(service.response.fields[0].name, "said");
    assert_eq!(
        parse_service(name(), "bool on\n", "S.srv").unwrap_err().to_string(),
        "S.srv:1:1: a service is a request and a response with one line `---` between them, found 0"
    );
    assert_eq!(
        parse_service(name(), "---\nbool on\n---\n", "S.srv").unwrap_err().to_string(),
        "S.srv:3:1: a service is a request and a response with one line `---` between them, found 2"
    );
    let error = parse_service(name(), "bool on\n---\n\nstrin said\n", "S.srv").unwrap_err().to_string();
    assert!(error.starts_with("S.srv:4:1: `strin` is neither"), "{error}");
}

#[test]
fn an_action_has_three_parts_and_places_count_from_the_top_of_the_file() {
    let name = || "a/action/S".parse().unwrap();
    let action = parse_action(name(), "int32 order\n---\n---\nfloat32 done\n", "S.action").unwrap();
    assert_eq!(action.goal.name.to_string(), "a/action/S_Goal");
    assert_eq!(action.result.fields, []);
    assert_eq!((action.feedback.text.as_str(), action.feedback.fields[0].place.line), ("float32 done\n", 4));
    assert_eq!(
        parse_action(name(), "int32 order\n---\n\n", "S.action").unwrap_err().to_string(),
        "S.action:3:1: an action is a goal, a result and a feedback with two lines `---` between them, found 1"
    );
    let error = parse_action(name(), "---\n---\n\nint32\n", "S.action").unwrap_err().to_string();
    assert!(error.starts_with("S.action:4:6: expected a name"), "{error}");
}

#[test]
fn errors_name_file_line_and_column() {
    for (text, start) in [
        ("int8", "A.msg:1:5: expected a name"),
        ("\nint8 Name", "A.msg:2:6: `Name` cannot name a field"),
        ("int8 x 300", "A.msg:1:8: expected an integer from -128 to 127"),
        ("int8 x\nint16 x", "A.msg:2:7: the field `x` is defined twice"),
        ("int8 X=1\nint8 X=1", "A.msg:2:6: the constant `X` is defined twice"),
        ("int8 x=1", "A.msg:1:6: `x` cannot name a constant"),
        ("int8[2] X=1", "A.msg:1:1: `int8[2]` cannot be the type of a constant"),
        ("  int8[0] x", "A.msg:1:3: `int8[0]`: the size must be"),
        ("int8[<=-1] x", "A.msg:1:1: `int8[<=-1]`: the size must be"),
        ("int8] x", "A.msg:1:1: `int8]` has a `]`"),
        ("time stamp", "A.msg:1:1: ROS 2 has no type `time`"),
        ("std_msgs/msg/Header h", "A.msg:1:1: `std_msgs/msg/Header`: within a definition"),
        ("Other x 1", "A.msg:1:9: a field of type `a_pkg/Other` cannot have a default"),
        ("string<=1 s 'éü'", "A.msg:1:13: the string may have 1"),
    ] {
        let error = error_of(text);
        assert!(error.starts_with(start), "{text:?} gave {error}");
    }
}

#[test]
fn no_text_makes_the_parser_panic() {
    // Every prefix and every single-character replacement of a rich definition.
    let rich = "# c\nint8[<=3] x [1, -2]\nstring<=4 s 'ä\\'b'\nuint64 MAX=0xFF # é\npkg/Type[2] t\n---\nbool b true\n";
    let parse = |text: &str| {
        let _ = parse_message("a/msg/A".parse().unwrap(), text, "A.msg");
        let _ = parse_service("a/srv/A".parse().unwrap(), text, "A.srv");
        let _ = parse_action("a/action/A".parse().unwrap(), text, "A.action");
    };
    for (at, character) in rich.char_indices() {
        parse(&rich[..at]);
        for other in ["", "\"", "'", "[", "]", "=", "<", " ", "é", "\\", "-", "\n"] {
            parse(&[&rich[..at], other, &rich[at + character.len_utf8()..]].concat());
        }
    }
}
