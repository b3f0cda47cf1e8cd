//! Packages that other crates generate: theirs must compile whatever the names in them, and mean what they say.

use downbeat_msgs::{Message, Service, WString, cdr, test_msgs};

use crate::odd_msgs;

#[test]
fn constants_and_defaults_are_those_of_the_definition() {
    use test_msgs::msg::{Arrays, Constants, Defaults, Strings, WStrings};

    assert_eq!(Constants::INT64_CONST, -40_000_000);
    assert_eq!(
        (Constants::BOOL_CONST, Constants::FLOAT32_CONST, Constants::FLOAT64_CONST),
        (true, 1.125, 1.125)
    );
    assert_eq!(Strings::STRING_CONST, "Hello world!");
    assert_eq!(Strings::default().bounded_string_value_default4, "Hello'world!");
    assert_eq!(WStrings::default().wstring_value_default3, WString::from("ハローワールド"));
    assert_eq!(Arrays::default().int8_values_default, [0, 127, -128]);
    assert_eq!(Arrays::default().string_values_default, ["", "max value", "min value"]);
    assert_eq!(Defaults::default().int8_value, -50);
}

#[test]
fn numbers_at_the_edge_are_written_exactly() {
    use odd_msgs::msg::Long;

    assert_eq!(Long::INFINITE, f64::INFINITY);
    assert!(Long::UNKNOWN.is_nan());
    assert_eq!((Long::TENTH, Long::TENTH_32), (0.1_f64, 0.1_f32));
    assert_eq!(Long::LEAST, i64::MIN);
}

#[test]
fn type_names_of_the_standard_library_are_no_trouble() {
    use odd_msgs::msg::{Default as DefaultMessage, Error, Message as MessageMessage, Vec as VecMessage};

    let message = MessageMessage {
        errors: vec![Error {
            cause: DefaultMessage { vec: VecMessage::default(), ..DefaultMessage::default() },
        }],
    };
    assert_eq!(message.errors[0].cause.value, 3);
    assert_eq!(cdr::from_slice::<MessageMessage>(&cdr::to_vec(&message)).unwrap(), message);
    // Its own constant does not hide the trait's.
    assert_eq!((Error::TYPE_NAME, <Error as Message>::TYPE_NAME), (1, "odd_msgs/msg/Error"));
    assert_eq!(<odd_msgs::srv::Ok as Service>::Response::TYPE_NAME, "odd_msgs/srv/Ok_Response");
}

#[test]
fn fields_named_as_keywords_keep_their_names_for_serde_and_errors() {
    use odd_msgs::msg::Keywords;

    let mut keywords = Keywords { r#type: 1, self_: true, r#yield: 0.5, ..Keywords::default() };
    assert_eq!(keywords.r#match, ["a", "b"]);
    let json = serde_json::to_value(&keywords).unwrap();
    assert_eq!((&json["type"], &json["self"], &json["yield"]), (&1.into(), &true.into(), &0.5.into()));
    assert_eq!(serde_json::from_value::<Keywords>(json).unwrap(), keywords);

    for (texts, found, bound) in [(vec!["a"; 3], 3, 2), (vec!["abcd"], 4, 3)] {
        keywords.r#match = texts.into_iter().map(String::from).collect();
        let error = cdr::from_slice::<Keywords>(&cdr::to_vec(&keywords)).unwrap_err();
        assert_eq!((error.path.as_str(), error.problem), ("match", cdr::Problem::Bound { found, bound }));
    }
}

#[test]
fn the_definition_text_is_that_of_the_file_to_the_byte() {
    use odd_msgs::msg::{Commented, Quoted};

    assert_eq!(Commented::DEFINITION, include_str!("../data/odd_msgs/msg/Commented.msg"));
    assert_eq!(Quoted::DEFINITION, include_str!("../data/odd_msgs/msg/Quoted.msg"));
    assert_eq!((Quoted::default().quoted.as_str(), Commented::default().speed), ("a \"b\"", 1e-3));
}
