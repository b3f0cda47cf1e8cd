//! Hand-written structs as messages, compared with the equivalent generated ones.

#![cfg(feature = "derive")]
#![allow(clippy::unwrap_used)]

use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::std_msgs::msg::Header;
use downbeat_msgs::{Message, WString, cdr, rmw_dds_common, sensor_msgs, test_msgs};

/// As `sensor_msgs/msg/JointState`.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "sensor_msgs/msg/JointState")]
struct JointState {
    header: Header,
    name: Vec<String>,
    position: Vec<f64>,
    velocity: Vec<f64>,
    effort: Vec<f64>,
}

#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(
    name = "rmw_dds_common/msg/NodeEntitiesInfo",
    file = "interfaces/rmw_dds_common/msg/NodeEntitiesInfo.msg"
)]
struct NodeEntities {
    node_namespace: String,
    node_name: String,
    reader_gid_seq: Vec<rmw_dds_common::msg::Gid>,
    writer_gid_seq: Vec<rmw_dds_common::msg::Gid>,
}

#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(file = "interfaces/test_msgs/msg/Empty.msg")]
struct Empty {}

#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(file = "interfaces/test_msgs/msg/Defaults.msg")]
struct Defaults {
    bool_value: bool,
    byte_value: u8,
    char_value: u8,
    float32_value: f32,
    float64_value: f64,
    int8_value: i8,
    uint8_value: u8,
    int16_value: i16,
    uint16_value: u16,
    int32_value: i32,
    uint32_value: u32,
    int64_value: i64,
    uint64_value: u64,
}

/// One leg of a robot.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "my_msgs/msg/Leg")]
struct Leg {
    /// When it was measured.
    header: Header,
    /// From the hip down [rad].
    angles: [f64; 6],
    joint: JointState,
    #[message(type = "string<=3[<=2]")]
    contacts: Vec<String>,
    #[message(type = "byte")]
    flags: u8,
    r#type: WString,
    stamps: Vec<Time>,
}

/// A message of messages that are hand-written.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "my_msgs/msg/Legs")]
struct Legs {
    legs: Vec<Leg>,
    empty: Empty,
}

#[test]
fn hash_definition_and_description_are_those_of_the_generated_type() {
    fn assert_same<Ours: Message, Theirs: Message>() {
        assert_eq!(Ours::TYPE_NAME, Theirs::TYPE_NAME);
        assert_eq!(Ours::TYPE_HASH, Theirs::TYPE_HASH);
        assert_eq!(Ours::DEFINITION, Theirs::DEFINITION);
        assert_eq!(Ours::type_description(), Theirs::type_description());
        assert_eq!(Ours::LEAST_SIZE, Theirs::LEAST_SIZE);
    }
    assert_same::<NodeEntities, rmw_dds_common::msg::NodeEntitiesInfo>();
    assert_same::<Empty, test_msgs::msg::Empty>();
    assert_same::<Defaults, test_msgs::msg::Defaults>();

    // Without a file, the definition contains the comments of the struct.
    type Generated = sensor_msgs::msg::JointState;
    assert_eq!(JointState::TYPE_HASH, Generated::TYPE_HASH);
    assert!(
        JointState::DEFINITION.starts_with("# As `sensor_msgs/msg/JointState`.\n\nstd_msgs/Header header\n")
    );
    assert_eq!(without_comments(JointState::DEFINITION), without_comments(Generated::DEFINITION));
}

#[test]
fn the_bytes_are_those_of_the_generated_type() {
    let generated = sensor_msgs::msg::JointState {
        header: Header { stamp: Time { sec: 1, nanosec: 2 }, frame_id: "body".into() },
        name: vec!["a".into(), "bcd".into()],
        position: vec![0.25, f64::INFINITY],
        ..Default::default()
    };
    let bytes = cdr::to_vec(&generated);
    let ours: JointState = cdr::from_slice(&bytes).unwrap();
    assert_eq!((ours.name.as_slice(), ours.position[0]), (generated.name.as_slice(), 0.25));
    assert_eq!(cdr::to_vec(&ours), bytes);
    assert_eq!(cdr::encoded_size(&ours), bytes.len());
    assert_eq!(cdr::to_vec(&Empty {}), cdr::to_vec(&test_msgs::msg::Empty {}));
    cdr::from_slice::<Empty>(&cdr::to_vec(&Empty {})).unwrap();
}

#[test]
fn a_message_without_a_file_defines_itself_as_its_file_would() {
    let rule = "=".repeat(80);
    let own = "# One leg of a robot.\n\n# When it was measured.\nstd_msgs/Header header\n# From the hip down [rad].\n\
               float64[6] angles\nsensor_msgs/JointState joint\nstring<=3[<=2] contacts\nbyte flags\nwstring type\n\
               builtin_interfaces/Time[] stamps\n";
    assert!(
        Leg::DEFINITION.starts_with(&format!("{own}\n{rule}\nMSG: builtin_interfaces/Time\n")),
        "{}",
        Leg::DEFINITION
    );

    // The hash computed from the definitions alone.
    let mut catalog = downbeat_msgs_definitions::Catalog::new();
    let interfaces = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("interfaces");
    catalog.add_packages(&interfaces).unwrap();
    catalog.add_message("my_msgs/msg/Leg".parse().unwrap(), own, "Leg.msg").unwrap();
    let legs =
        "# A message of messages that are hand-written.\n\nmy_msgs/Leg[] legs\ntest_msgs/Empty empty\n";
    catalog.add_message("my_msgs/msg/Legs".parse().unwrap(), legs, "Legs.msg").unwrap();
    assert_eq!(Leg::TYPE_HASH, catalog.type_hash(&"my_msgs/msg/Leg".parse().unwrap()).unwrap());
    assert_eq!(Legs::TYPE_HASH, catalog.type_hash(&"my_msgs/msg/Legs".parse().unwrap()).unwrap());
    let text = catalog.definition_text(&"my_msgs/msg/Legs".parse().unwrap()).unwrap();
    // JointState is hand-written too, with another comment than the file.
    assert_eq!(without_comments(Legs::DEFINITION), without_comments(&text));
}

/// The lines with code.
fn without_comments(text: &str) -> Vec<&str> {
    let code = text.lines().map(|line| line.split('#').next().unwrap().trim());
    code.filter(|line| !line.is_empty()).collect()
}

#[test]
fn bounds_are_checked_and_errors_name_the_field() {
    let leg = Leg { contacts: vec!["toe".into(); 2], r#type: "left".into(), ..Leg::default() };
    let bytes = cdr::try_to_vec(&leg).unwrap();
    assert_eq!(cdr::from_slice::<Leg>(&bytes).unwrap(), leg);
    assert_eq!(cdr::encoded_size(&leg), bytes.len());

    let legs = |contacts: &[&str]| Legs {
        legs: vec![Leg { contacts: contacts.iter().map(ToString::to_string).collect(), ..Leg::default() }],
        ..Legs::default()
    };
    for (contacts, found, bound) in [(&["a", "b", "c"] as &[_], 3, 2), (&["heel"], 4, 3)] {
        let error = cdr::from_slice::<Legs>(&cdr::to_vec(&legs(contacts))).unwrap_err();
        assert_eq!(error.path, "legs[0].contacts");
        assert_eq!(error.problem, cdr::Problem::Bound { found, bound });
        assert_eq!(
            cdr::try_to_vec(&legs(contacts)).unwrap_err().to_string(),
            format!(
                "cannot encode field `legs[0].contacts`: has the length {found}, the type allows {bound}"
            )
        );
    }
    let error = cdr::from_slice::<Leg>(&bytes[..20]).unwrap_err();
    assert_eq!(error.path, "angles[0]");
}
