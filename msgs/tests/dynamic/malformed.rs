//! Invalid and hostile definitions and bytes cause errors, no panics, and bounded use of memory.

use std::fmt::Write as _;

use downbeat_msgs::cdr::Problem;
use downbeat_msgs::definitions::Catalog;
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType, TypeError};
use proptest::prelude::*;

fn compile(messages: &[(&str, &str)]) -> Result<DynamicType, TypeError> {
    let mut catalog = Catalog::new();
    for (name, text) in messages {
        catalog.add_message(format!("a/msg/{name}").parse().unwrap(), text, name).unwrap();
    }
    DynamicType::new(&catalog, &"a/msg/A".parse().unwrap())
}

fn error(messages: &[(&str, &str)]) -> String {
    compile(messages).unwrap_err().to_string()
}

/// Messages that each hold the next: `A`, `L1`, `L2`, … The last one is empty.
fn levels(count: usize, field: impl Fn(&str) -> String) -> Result<DynamicType, TypeError> {
    let name = |level: usize| if level == 0 { "A".into() } else { format!("L{level}") };
    let texts: Vec<(String, String)> = (0..count)
        .map(|level| (name(level), if level + 1 == count { String::new() } else { field(&name(level + 1)) }))
        .collect();
    let messages: Vec<(&str, &str)> =
        texts.iter().map(|(name, text)| (name.as_str(), text.as_str())).collect();
    compile(&messages)
}

#[test]
fn missing_and_recursive_types_are_reported() {
    assert_eq!(error(&[("A", "B b\n")]), "a/msg/B is not in the catalog, did you mean a/msg/A?");
    assert_eq!(
        error(&[("A", "B b\n"), ("B", "int8 x\nC[] c\n"), ("C", "B b\n")]),
        "C:1:1: a/msg/B contains itself: a/msg/B -> a/msg/C -> a/msg/B"
    );
}

#[test]
fn excessive_types_are_refused_quickly() {
    assert!(levels(32, |next| format!("{next} next\n")).is_ok());
    assert_eq!(
        levels(33, |next| format!("{next} next\n")).unwrap_err().to_string(),
        "a/msg/A contains messages nested more than 32 levels deep"
    );
    for field in ["{} a\n{} b\n", "{}[] a\n{}[] b\n", "{}[2] a\n"] {
        let error = levels(31, |next| field.replace("{}", next)).unwrap_err();
        assert!(
            matches!(error, TypeError::TooManyFields { .. } | TypeError::TooLarge { .. }),
            "{field} {error}"
        );
    }
    assert_eq!(
        error(&[("A", "uint8[4294967295] huge\n")]),
        "a/msg/A always takes more than 67108864 bytes of memory: its fixed arrays are too long"
    );
    assert!(error(&[("A", "B[65536] b\n"), ("B", "string[65536] s\n")]).contains("too long"));
    assert!(error(&[("A", "B[4294967295] b\n"), ("B", "")]).contains("too long"));
}

#[test]
fn a_definition_text_is_parsed_or_refused() {
    let line = "=".repeat(80);
    let read = |text: &str| DynamicType::from_definition_text("a/msg/A", "ros2msg", text);
    let inner = format!("B b\nc/D d\n\n{line}\nMSG: a/B\nint8 x\n\n{line}\nMSG: c/D\nint8 y\n");
    assert_eq!(read(&inner).unwrap().fields().count(), 2);
    assert_eq!(read(&inner.replace('\n', "\r\n")).unwrap().fields().count(), 2);
    for (text, end) in [
        (
            format!("B b\n{line}\nMSG a/B\n"),
            "definition of a/msg/A:3:1: expected a line such as `MSG: package/Type`",
        ),
        (
            format!("B b\n{line}\nMSG: a/B\nint8\n"),
            "definition of a/msg/A:4:5: expected a name after the type",
        ),
        (format!("B b\n{line}\nMSG: a/C\nint8 x\n"), "a/msg/B is not in the catalog"),
    ] {
        let error = read(&text).unwrap_err().to_string();
        assert!(error.contains(end), "{text}: {error}");
    }
    let error = DynamicType::from_definition_text("a/msg/A", "protobuf", "").unwrap_err().to_string();
    assert!(error.contains("`protobuf`"), "{error}");
    assert!(DynamicType::from_definition_text("A", "ros2msg", "").is_err());
}

#[test]
fn services_of_bags_are_read() {
    use downbeat_msgs::Service;
    type SetBool = downbeat_msgs::std_srvs::srv::SetBool;
    let of = DynamicType::from_definition_text("std_srvs/srv/SetBool_Event", "ros2msg", SetBool::DEFINITION)
        .unwrap();
    let mut event = DynamicMessage::new(&of);
    event.resize("request", 1).unwrap();
    event.set("request[0].data", true).unwrap();
    let typed: <SetBool as Service>::Event = event.to_typed().unwrap();
    assert!(typed.request[0].data);
}

#[test]
fn lengths_are_not_trusted() {
    let text = "int8[] bytes\nB[] bs\nstring s\nwstring w\n";
    let of = compile(&[("A", text), ("B", "float64[3] xyz\n")]).unwrap();
    let huge = [0, 1, 0, 0, 255, 255, 255, 255, 0, 0];
    let error = DynamicMessage::from_cdr(&of, &huge).unwrap_err();
    assert_eq!(
        error.to_string(),
        "cannot decode CDR at byte 8, field `bytes`: says that 4294967295 elements follow, of at least 1 bytes each, \
         but the input has 2 bytes left"
    );
    let second = [0, 1, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0];
    let error = DynamicMessage::from_cdr(&of, &second).unwrap_err();
    assert_eq!(
        (error.path.as_str(), error.problem),
        ("bs", Problem::Length { count: 2, least_size: 24, left: 4 })
    );
    let error = DynamicMessage::from_cdr(&of, &[9, 9, 0, 0, 0]).unwrap_err().to_string();
    assert!(error.contains("0x0909"), "{error}");
}

/// Definition texts of one to four messages that may refer to each other, valid or not.
fn definitions() -> impl Strategy<Value = Vec<String>> {
    let element = prop_oneof![
        6 => proptest::sample::select(vec![
            "bool", "byte", "char", "int8", "uint16", "int32", "uint64", "float32", "float64", "string", "wstring",
            "string<=3", "wstring<=2",
        ]),
        3 => proptest::sample::select(vec!["M1", "M2", "M3"]),
    ];
    let shape = proptest::sample::select(vec!["", "", "", "[]", "[3]", "[<=2]", "[50]"]);
    let fields = proptest::collection::vec((element, shape), 0..6);
    proptest::collection::vec(fields, 4).prop_map(|messages| {
        messages
            .iter()
            .enumerate()
            .map(|(number, fields)| {
                let mut text = String::new();
                for (index, (element, shape)) in fields.iter().enumerate() {
                    // Messages mostly refer to later ones only, so that most definitions are valid.
                    let later = element
                        .strip_prefix('M')
                        .and_then(|of| of.parse().ok())
                        .is_none_or(|of: usize| of > number);
                    let element = if later { element } else { "int16" };
                    writeln!(text, "{element}{shape} f{index}").unwrap();
                }
                text
            })
            .collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn no_text_makes_compiling_panic(text in "[ -~\n=]{0,300}|(MSG: a/B\n|={80}\n|int8 x\n|B\\[\\] b\n|a/B\\[9999\\] b\n){0,8}") {
        if let Ok(of) = DynamicType::from_definition_text("a/msg/A", "ros2msg", &text) {
            prop_assert_eq!(DynamicMessage::new(&of), DynamicMessage::new(&of));
        }
    }

    #[test]
    fn no_bytes_make_reading_panic_and_what_is_read_is_stable(
        texts in definitions(),
        big in any::<bool>(),
        // Mostly zeros and small numbers: lengths that are plausible lead deeper into a message.
        body in proptest::collection::vec(prop_oneof![8 => Just(0_u8), 3 => 1_u8..4, 1 => any::<u8>()], 0..600),
    ) {
        let mut catalog = Catalog::new();
        for (number, text) in texts.iter().enumerate() {
            catalog.add_message(format!("a/msg/M{number}").parse().unwrap(), text, "").unwrap();
        }
        let of = DynamicType::new(&catalog, &"a/msg/M0".parse().unwrap()).unwrap();
        let default = DynamicMessage::new(&of);
        prop_assert_eq!(&DynamicMessage::from_cdr(&of, &default.to_cdr()).unwrap(), &default);
        let bytes = [&[0, u8::from(!big), 0, 0], body.as_slice()].concat();
        if let Ok(message) = DynamicMessage::from_cdr(&of, &bytes) {
            let written = message.to_cdr();
            // Compares bytes, not messages: NaN is not equal to itself.
            prop_assert_eq!(DynamicMessage::from_cdr(&of, &written).unwrap().to_cdr(), written);
        }
    }
}
