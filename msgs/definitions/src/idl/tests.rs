#![allow(clippy::unwrap_used)]

use super::{Definition, parse_idl};
use crate::{Element, Error, MessageDefinition, Value};

/// Parses the message `a/msg/A` with these declarations in and before its struct.
fn message(before: &str, members: &str) -> Result<MessageDefinition, Error> {
    let text = format!("module a {{ module msg {{ {before}\nstruct A {{ {members} }}; }}; }};");
    match parse_idl(&text, "A.idl")?.pop() {
        Some(Definition::Message(message)) => Ok(message),
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_type_has_its_ros_name() {
    let members = "boolean a; octet b; int8 c; uint8 d; short e; int16 f; unsigned short g; uint16 h; long i; int32 j;
        unsigned long k; uint32 l; long long m; int64 n; unsigned long long o; uint64 p; float q; double r; string s;
        string<5> t; wstring u; wstring<6> v; sequence<string<7>, 8> w; sequence<other::msg::B> x; int8 y[9]; B z;";
    let message = message("", members).unwrap();
    assert_eq!(
        message.text,
        "bool a\nbyte b\nint8 c\nuint8 d\nint16 e\nint16 f\nuint16 g\nuint16 h\nint32 i\nint32 j\nuint32 k\nuint32 l\n\
         int64 m\nint64 n\nuint64 o\nuint64 p\nfloat32 q\nfloat64 r\nstring s\nstring<=5 t\nwstring u\nwstring<=6 v\n\
         string<=7[<=8] w\nother/B[] x\nint8[9] y\na/B z\n"
    );
}

#[test]
fn typedefs_and_constants_are_looked_up_from_the_inside_out() {
    let text = "const short SIZE = 2; typedef long Number;
        module a { const short SIZE = 3; module msg {
          typedef Number Three[SIZE]; typedef Number Two[::SIZE], One[1]; typedef sequence<Number, a::SIZE> Some;
          struct A { Three three; Two two; One one; a::msg::Some some; msg::B b; sequence<Number> more; };
        }; };";
    let [Definition::Message(message)] = &parse_idl(text, "A.idl").unwrap()[..] else { panic!() };
    assert_eq!(
        message.text,
        "int32[3] three\nint32[2] two\nint32[1] one\nint32[<=3] some\na/B b\nint32[] more\n"
    );
}

#[test]
fn constants_defaults_units_and_comments_belong_to_the_following_declaration() {
    let before = r#"
        module A_Constants { @verbatim (language="comment", text="first" "\n" " second") const uint8 ON = 0x01;
          const string NAME = "it\"s \\ ok"; const double NONE = nan; const float LOW = -1e-05; const boolean YES = TRUE; };
        module B_Constants { const uint8 OTHER = 2; };
        @verbatim (language="comment", text="What it is.") @extensibility(FINAL)"#;
    let members = r#"@unit (value="m") @default (value=-5) @key int8 x;
        @default (value="(1, 2)") @optional(value=FALSE) int8 y[2];
        @default (value="a#b") string z; @default (value=L"ü") wstring<1> w; double unset, also; "#;
    let message = message(before, members).unwrap();
    assert_eq!(message.comment, ["What it is."]);
    let names: Vec<&str> = message.constants.iter().map(|constant| constant.name.as_str()).collect();
    assert_eq!(names, ["ON", "NAME", "NONE", "LOW", "YES"]);
    assert_eq!(message.constants[0].comment, ["first", "second"]);
    assert_eq!(message.constants[1].value, Value::Text("it\"s \\ ok".into()));
    assert_eq!(message.constants[3].value, Value::Float(-1e-5));
    assert_eq!(message.fields[0].comment, ["[m]"]);
    assert_eq!(message.fields[0].default, Some(Value::Integer(-5)));
    assert_eq!(message.fields[1].default, Some(Value::List(vec![Value::Integer(1), Value::Integer(2)])));
    assert_eq!(message.fields[2].default, Some(Value::Text("a#b".into())));
    assert_eq!((message.fields[5].name.as_str(), &message.fields[5].default), ("also", &None));
    // A `.msg` file cannot have `#` in a string.
    assert_eq!(
        message.text,
        "uint8 ON=1\nstring NAME='it\"s \\ ok'\nfloat64 NONE=NaN\nfloat32 LOW=-1e-5\nbool YES=true\n\
         int8 x -5\nint8[2] y [1, 2]\nstring z\nwstring<=1 w \"ü\"\nfloat64 unset\nfloat64 also\n"
    );
    let again = crate::parse_message(message.name.clone(), &message.text, "A.msg").unwrap();
    assert_eq!(again.constants.len(), 5);
}

#[test]
fn an_empty_struct_is_one_without_fields_or_with_the_placeholder_of_rosidl() {
    assert_eq!(message("", "").unwrap().fields, []);
    assert_eq!(message("", "uint8 structure_needs_at_least_one_member;").unwrap().fields, []);
    assert_eq!(message("", "int8 structure_needs_at_least_one_member;").unwrap().fields.len(), 1);
}

#[test]
fn structs_of_services_and_actions_are_put_together() {
    let text = "module a { module srv { struct S_Response { boolean ok; }; struct S_Request {}; }; };
        module a { module action { struct F_Goal { long order; }; struct F_Result {}; struct F_Feedback {}; }; };";
    let definitions = parse_idl(text, "a.idl").unwrap();
    let [Definition::Action(action), Definition::Service(service)] = &definitions[..] else {
        panic!("{definitions:?}")
    };
    assert_eq!((service.name.to_string().as_str(), service.text.as_str()), ("a/srv/S", "---\nbool ok\n"));
    assert_eq!(
        (action.name.to_string().as_str(), action.text.as_str()),
        ("a/action/F", "int32 order\n---\n---\n")
    );
    for text in [
        "module a { module srv { struct S_Request {}; }; };",
        "module a { module srv { struct S_Request {}; struct S_Response {}; struct S_Event {}; }; };",
        "module a { module srv { struct S {}; }; };",
    ] {
        assert_eq!(
            parse_idl(text, "S.idl").unwrap_err().to_string(),
            "S.idl:1:32: a/srv/S needs exactly the structs `S_Request`, `S_Response`"
        );
    }
}

#[test]
fn includes_comments_and_forward_declarations_are_ignored() {
    let text =
        "// c\n#include \"a/msg/B.idl\"\n  # pragma once\nmodule a { /* struct X {}; \n */ module msg {
        struct B; struct A { B b; /**/ }; }; };";
    assert_eq!(parse_idl(text, "A.idl").unwrap().len(), 1);
    assert!(parse_idl("", "A.idl").unwrap().is_empty());
}

#[test]
fn errors_name_file_line_and_column() {
    for (before, members, fault) in [
        ("", "int8 x", "A.idl:2:19: expected `;`, found `}`"),
        ("", "int8 x; int8 x;", "A.idl:2:25: the field `x` is defined twice"),
        ("", "int8 _x;", "A.idl:2:17: expected a name, found `_`"),
        ("", "int8;", "A.idl:2:16: expected a name, found `;`"),
        ("", "int8 x[0];", "A.idl:2:19: the size must be a number from 1 to 4294967295, found 0"),
        (
            "",
            "string<4294967296> x;",
            "A.idl:2:19: the size must be a number from 1 to 4294967295, found 4294967296",
        ),
        (
            "",
            "sequence<int8, TRUE> x;",
            "A.idl:2:27: the size must be a number from 1 to 4294967295, found true",
        ),
        ("", "int8 x[2][2];", "A.idl:2:18: ROS 2 has no arrays of arrays"),
        ("", "sequence<sequence<int8>> x;", "A.idl:2:21: ROS 2 has no arrays of arrays"),
        ("typedef int8 T[2];", "sequence<T> x;", "A.idl:2:21: ROS 2 has no arrays of arrays"),
        (
            "typedef int8 T[2]; typedef int8 T[3];",
            "T x;",
            "A.idl:1:57: `T` is already `int8[2]` and cannot be `int8[3]`",
        ),
        ("", "char x;", "A.idl:2:12: ROS 2 has no type for `char`"),
        ("", "long double x;", "A.idl:2:17: ROS 2 has no type for `long double`"),
        ("", "other::B x;", "A.idl:2:12: `other::B` is neither a type of IDL"),
        ("", "lower x;", "A.idl:2:12: `lower` is neither a type of IDL"),
        ("", "@default (value=300) int8 x;", "A.idl:2:22: expected an integer from -128 to 127 as the value"),
        ("", "@default (value=1+1) int8 x;", "A.idl:2:29: expressions are not supported"),
        ("", "@default (value=) int8 x;", "A.idl:2:28: expected a value, found `)`"),
        (
            "",
            "@default (value=\"(1)\") B x;",
            "A.idl:2:22: a field of type a/msg/B cannot have a default value",
        ),
        ("const uint8 X = 1; const uint8 X = 2;", "", "A.idl:1:56: the constant `X` is defined twice"),
        ("const uint8 X = Y;", "", "A.idl:1:41: `Y` is neither a value nor a constant above"),
        (
            "const sequence<int8> X = 1;",
            "",
            "A.idl:1:31: only primitives and strings can be the type of a constant",
        ),
        ("const uint8 X = -\"a\";", "", "A.idl:1:41: only a number can have a sign"),
        ("const uint8 X = 0b1;", "", "A.idl:1:41: `0b1` is not a number"),
        ("const string X = \"a", "", "A.idl:1:42: the string is not closed"),
        ("const string X = \"\\xZ\";", "", "A.idl:1:44: the escape after this backslash is not a character"),
        ("enum E { ONE };", "", "A.idl:1:25: ROS 2 interfaces have no `enum`"),
        ("/* never closed", "", "A.idl:1:25: the comment `/*` is not closed"),
        ("\n#if X", "", "A.idl:2:1: `#if X`: only the preprocessor lines"),
        ("struct A {};", "", "A.idl:2:8: a/msg/A is defined twice"),
        ("struct lower {};", "", "A.idl:1:32: `lower` in the modules `a::msg` cannot name an interface"),
        (
            "module deeper { struct B {}; };",
            "",
            "A.idl:1:48: `B` in the modules `a::msg::deeper` cannot name",
        ),
        ("};", "", "A.idl:2:8: `A` in the modules `a` cannot name an interface"),
    ] {
        let error = message(before, members).unwrap_err().to_string();
        assert!(error.starts_with(fault), "{before:?} {members:?} gave {error}");
    }
    assert_eq!(
        parse_idl("module a {\n", "A.idl").unwrap_err().to_string(),
        "A.idl:2:1: expected `}` at the end of a module, found the end of the text"
    );
    let deep = "module a { ".repeat(100_000);
    assert_eq!(
        parse_idl(&deep, "A.idl").unwrap_err().to_string(),
        "A.idl:1:89: modules are nested deeper than 8"
    );
    let deep =
        format!("module a {{ module msg {{ struct A {{ {} x; }}; }}; }};", "sequence<".repeat(100_000));
    let fault = parse_idl(&deep, "A.idl").unwrap_err().to_string();
    assert_eq!(fault, "A.idl:1:45: ROS 2 has no arrays of arrays: put the inner one into a struct");
}

#[test]
fn the_bound_of_a_constant_string_is_ignored() {
    let message = message("module A_Constants { const string<5> X = \"abc\"; };", "").unwrap();
    assert_eq!(message.constants[0].element, Element::String { bound: None });
}

#[test]
fn no_text_makes_the_parser_panic() {
    let rich = "#include \"b\"\nmodule a { module msg { typedef int8 t[3]; module A_Constants { const string S = \"a\\x41\" \"b\"; };\n\
                @verbatim (language=\"comment\", text=\"ä\") struct A { @default (value=\"('a', 1)\") sequence<string<4>, 2> x; t y; \
                /* é */ a::msg::B b[2]; }; }; };";
    let parse = |text: &str| drop(parse_idl(text, "A.idl"));
    parse(rich);
    for (at, character) in rich.char_indices() {
        parse(&rich[..at]);
        for other in [
            "", "\"", "'", "(", ")", "[", "]", "{", "}", "<", ">", "=", "::", "@", "#", "é", "\\", "-", "/*",
            "\n", "0",
        ] {
            parse(&[&rich[..at], other, &rich[at + character.len_utf8()..]].concat());
        }
    }
}
