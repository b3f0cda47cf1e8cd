//! Compares our parser with `rosidl_adapter`.

use downbeat_msgs_definitions::{Constant, FieldType, MessageDefinition, Shape, parse_message};
use python_peer::Python;
use serde_json::{Value as Json, json};

use crate::peer;

/// Texts that both accept, or both reject. Each is one file.
const ALIKE: &[&str] = &[
    // Spaces and comments.
    "",
    "\n\n",
    "int8 x",
    "int8\tx\t\t5  # five\r\nint8 y\r\n",
    "# a\n#b\n\n  # c\nint8 x # d\n    # e\n",
    "int8    x    ",
    "int8",
    "int8 # x",
    "---",
    "int8 x;",
    // Names.
    "int8 X",
    "int8 x_",
    "int8 _x",
    "int8 x__y",
    "int8 x-y",
    "int8 1x",
    "int8 é",
    "int8 x\nint8 x",
    "int8 X=1\nint8 X=1",
    "int8 x\nint8 X=1",
    "int8 Xy=1",
    "int8 X_=1",
    "int8 X__Y=1",
    "int8 X1_Y=1",
    "int8 x=1",
    "int8 X Y=1",
    "int8 =1",
    "A_Request x",
    "A_Feedback[] x",
    "A_Other x",
    // Types.
    "a/B x",
    "a/b x",
    "A/B x",
    "a/msg/B x",
    "a//B x",
    "/B x",
    "a/ x",
    "b x",
    "int9 x",
    "Int8 x",
    "int8[] x",
    "int8[3] x",
    "int8[<=3] x",
    "int8[03] x",
    "int8[+3] x",
    "int8[1_0] x",
    "int8[1__0] x",
    "int8[0] x",
    "int8[-1] x",
    "int8[<=0] x",
    "int8[0x3] x",
    "int8[a] x",
    "int8[3][2] x",
    "int8[<3] x",
    "int8] x",
    "int8[ x",
    "int8[]] x",
    "[3] x",
    "string<=5 x",
    "string<=0 x",
    "string<=-1 x",
    "string<= x",
    "string<=a x",
    "string<5 x",
    "wstring<=5[<=6] x",
    "string<=5[] x",
    "int8<=5 x",
    "A<=5 x",
    // Integers.
    "int8 x -128",
    "int8 x -129",
    "int8 x 127",
    "int8 x 128",
    "uint8 x -0",
    "uint8 x 0xfF",
    "uint8 x 0XFF",
    "uint8 x 0x_f",
    "uint8 x 0b101",
    "uint8 x 0o17",
    "uint8 x 017",
    "uint8 x 1_0",
    "uint8 x _1",
    "uint8 x 1_",
    "uint8 x 1__0",
    "uint8 x 0b_1_1",
    "uint8 x 0b__1",
    "uint8 x 0b",
    "uint8 x 0x-5",
    "float64 x 1_e5",
    "float64 x 1e1_0",
    "float64 x _1.5",
    "float64 x 1._5",
    "float64 x na_n",
    "uint8 x +5",
    "uint8 x ++5",
    "uint8 x 5.0",
    "uint8 x 1e2",
    "uint8 x a",
    "int8 x - 5",
    "int8 x -0x10",
    "uint64 x 18446744073709551615",
    "uint64 x 18446744073709551616",
    "int64 X=-9223372036854775808",
    "byte x 255",
    "byte x 256",
    "char x 97",
    "char x 'a'",
    "int8 X=",
    "int8 X = 5 ",
    "int8 X=5 # five",
    "int8 X=5=6",
    // Booleans.
    "bool x true",
    "bool x TRUE",
    "bool x 1",
    "bool x 0",
    "bool x False",
    "bool x 2",
    "bool x yes",
    // Floating-point numbers.
    "float32 x 1.5",
    "float64 x .5",
    "float64 x 5.",
    "float64 x -1e-5",
    "float64 x 1e400",
    "float64 x inf",
    "float64 x -Infinity",
    "float64 x 1_0.5",
    "float64 x 1__0.5",
    "float64 x 1,5",
    "float64 x 0x10",
    "float64 x 1f",
    "float64 x one",
    // Strings.
    "string x a",
    "string x a b",
    "string x \"a b\"",
    "string x 'a b'",
    "string x \"a",
    "string x a\"",
    "string x \"",
    "string x '",
    "string x \"\"",
    "string x \"a\"b\"",
    r#"string x "a\"b""#,
    r"string x 'a\'b'",
    "string x 'a\"b'",
    "string x \"a'",
    r#"string x "a\\""#,
    "string X=",
    "string X=\"a b\"",
    "string X= a b ",
    "string X=a=b",
    "string<=5 X=a",
    "string[] X=a",
    "A X=1",
    "string<=3 x \"abc\"",
    "string<=3 x \"abcd\"",
    "wstring x \"ä漢\"",
    "wstring<=2 x \"ä漢\"",
    "wstring<=1 x \"ä漢\"",
    "string x \"a#b\"",
    // Lists.
    "int8[] x [1, 2]",
    "int8[] x [ 1 ,2 ]",
    "int8[] x []",
    "int8[] x [1,]",
    "int8[] x [,]",
    "int8[] x 1",
    "int8[] x [1",
    "int8[] x (1)",
    "int8[2] x [1]",
    "int8[2] x [1, 2]",
    "int8[<=2] x [1, 2, 3]",
    "int8[<=2] x []",
    "bool[] x [true, 0]",
    "float64[2] x [1, .5]",
    "string[] x [a, b]",
    "string[] x [\"a\", 'b']",
    "string[] x [\"a, b\", 'c']",
    "string[] x [\"\"]",
    "string[] x []",
    "string[] x [,]",
    "string[] x [\"a]",
    "string[2] x [\"a\"]",
    "string<=1[] x [\"ab\"]",
    r#"string[] x ["a\"b"]"#,
    "A[] x [1]",
    "A x 1",
];

/// Texts that we accept and rosidl rejects: their meaning is clear.
const READ_BY_US_ALONE: &[&str] = &[
    "  int8 x",
    "A_Event x",
    "A_SendGoal_Request x",
    "\tint8 x",
    "string x \"a=b\"",
    "string[] x [\"a=b\"]",
    "int8[] x [ ]",
];

/// Texts that we reject and rosidl accepts: ROS 2 has no such type, nothing can be sent, or the meaning is
/// obscure.
const READ_BY_ROSIDL_ALONE: &[&str] = &[
    "int8[4294967296] x",
    "string<=4294967296 x",
    // A naming scheme of early DDS types.
    "Sample_A x",
    // Two characters, four bytes: the bound counts bytes on the wire.
    "string<=2 x \"ää\"",
];

#[test]
fn rosidl_reads_and_refuses_the_same_texts() {
    let Some(peer) = Python::find() else { return };
    let differing: Vec<String> = ask(&peer, ALIKE)
        .into_iter()
        .filter(|(text, theirs)| ours(text) != *theirs)
        .map(|(text, theirs)| format!("{text:?}: rosidl reads {theirs}, we {}", ours(text)))
        .collect();
    assert!(differing.is_empty(), "{differing:#?}");
    for (text, theirs) in ask(&peer, READ_BY_US_ALONE) {
        assert!(
            theirs.is_null() && !ours(text).is_null(),
            "{text:?}: rosidl reads {theirs}, we {}",
            ours(text)
        );
    }
    for (text, theirs) in ask(&peer, READ_BY_ROSIDL_ALONE) {
        assert!(
            !theirs.is_null() && ours(text).is_null(),
            "{text:?}: rosidl reads {theirs}, we {}",
            ours(text)
        );
    }
}

#[test]
fn rosidl_reads_every_value_for_every_type_as_we_do() {
    const TYPES: &[&str] = &[
        "bool",
        "byte",
        "char",
        "int8",
        "uint8",
        "int16",
        "uint32",
        "int64",
        "uint64",
        "float32",
        "float64",
        "string",
        "wstring",
        "string<=3",
        "A",
        "a/B",
        "bool[]",
        "int8[2]",
        "uint8[<=2]",
        "float64[]",
        "string[]",
        "string[2]",
        "wstring[<=2]",
        "A[]",
    ];
    const VALUES: &[&str] = &[
        "",
        " ",
        " 0",
        " 1",
        " -1",
        " 255",
        " 256",
        " 70000",
        " -9223372036854775809",
        " 1.5",
        " -0.0",
        " 1e10",
        " nan",
        " true",
        " FALSE",
        " a",
        " abcd",
        " 'a'",
        " \"a\"",
        " \"a'b\"",
        " 'a\"b'",
        " \"\"",
        " ''",
        " \"a b\"  ",
        " \"ab'",
        " \"a\\\"b\"",
        " ü",
        " []",
        " [1]",
        " [1,2]",
        " [1, 2, 3]",
        " [true, false]",
        " [1.5, -2]",
        " [a]",
        " ['a', \"b\"]",
        " ['a',b]",
        " ['a' ,'b']",
        " [\"\", '']",
        " ['a, b', \"c\"]",
        " ['a]",
        " [a,]",
        " [1;2]",
        " {1}",
        " [1",
        " 1]",
        " [['a']]",
        "=",
        "=1",
        "= 'a'",
        " = true ",
        "=1.5",
        "=-1",
        "=[1]",
        "=0x10",
        "=1_0",
        " # c",
        " 1 # c",
        "=1# c",
    ];
    let Some(peer) = Python::find() else { return };
    let mut texts = Vec::new();
    for field_type in TYPES {
        for value in VALUES {
            texts.extend(["x", "X"].map(|name| format!("{field_type} {name}{value}")));
        }
    }
    let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
    let differing: Vec<String> = ask(&peer, &texts)
        .into_iter()
        .filter(|(text, theirs)| ours(text) != *theirs)
        .map(|(text, theirs)| format!("{text:?}: rosidl reads {theirs}, we {}", ours(text)))
        .collect();
    assert!(differing.is_empty(), "{} of {}: {differing:#?}", differing.len(), texts.len());
}

fn ask<'a>(peer: &Python, texts: &[&'a str]) -> Vec<(&'a str, Json)> {
    let input: String = texts.iter().map(|text| format!("{}\n", json!(text))).collect();
    let answers = peer::ask(peer, "parse", &input);
    let answers: Vec<Json> = answers.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(answers.len(), texts.len());
    texts.iter().copied().zip(answers).collect()
}

/// Our result in the format of `peer.py`.
fn ours(text: &str) -> Json {
    let Ok(message) = parse_message("pkg/msg/Name".parse().unwrap(), text, "Name.msg") else {
        return Json::Null;
    };
    let MessageDefinition { fields, constants, .. } = message;
    let fields: Vec<Json> = fields
        .iter()
        .map(|field| {
            json!([
                // rosidl names parts of services and actions, which files cannot refer to, without their
                // kind.
                field.field_type.to_string().replace("/srv/", "/").replace("/action/", "/"),
                field.name,
                field.default.as_ref().map_or(Json::Null, value)
            ])
        })
        .collect();
    let constants: Vec<Json> = constants.iter().map(constant).collect();
    json!({ "fields": fields, "constants": constants })
}

/// A constant in the format of `peer.py`.
pub fn constant(of: &Constant) -> Json {
    let field_type = FieldType { element: of.element.clone(), shape: Shape::Single };
    json!([field_type.to_string(), of.name, value(&of.value)])
}

fn value(of: &downbeat_msgs_definitions::Value) -> Json {
    use downbeat_msgs_definitions::Value;

    match of {
        Value::Bool(value) => json!(value),
        Value::Integer(value) => serde_json::from_str(&value.to_string()).unwrap(),
        Value::Float(value) => json!({ "bits": format!("{:016x}", value.to_bits()) }),
        Value::Text(text) => json!(text),
        Value::List(values) => values.iter().map(self::value).collect(),
    }
}
