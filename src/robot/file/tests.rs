#![allow(clippy::unwrap_used)]
use super::*;

fn parse(text: &str) -> Result<RobotFile> {
    RobotFile::parse(Source::new(Path::new("robots/test.toml"), text.into()))
}

fn problem(text: &str) -> String {
    parse(text).err().unwrap().to_string()
}

const ROBOT: &str = "[robot]\nname = \"r\"\n[[module]]\nkind = \"darwin_op\"\n";

#[test]
fn what_is_not_said_has_a_default() {
    let file = parse(ROBOT).unwrap();
    assert_eq!((file.name.as_str(), file.namespace.as_str()), ("r", "/"));
    assert_eq!(file.launcher, LauncherChoice::Linear);
    assert_eq!(file.modules[0].name, "darwin_op");
    assert!(file.expose.is_empty() && file.record.topics.is_none() && !file.is_emulated());
}

#[test]
fn an_exposed_topic_may_have_another_name_a_type_and_a_quality_of_service() {
    let file = parse(&format!(
        "{ROBOT}[expose]\nout = [\"a\", {{ topic = \"b\", as = \"c\", qos = {{ preset = \"sensor_data\", depth = 2 }} }}]\n\
         in = [{{ topic = \"d\", type = \"sensor_msgs/msg/JointState\", qos = \"latched\" }}]"
    ))
    .unwrap();
    let [a, b, d] = file.expose.as_slice() else { panic!("three topics") };
    assert_eq!((a.direction, a.qos), (Direction::Out, QosProfile::DEFAULT));
    assert_eq!((b.ros_topic.as_str(), b.qos), ("c", QosProfile::SENSOR_DATA.keep_last(2)));
    assert_eq!((d.direction, d.qos), (Direction::In, QosProfile::LATCHED));
}

#[test]
fn mistakes_are_told_with_file_line_and_the_nearest_name() {
    let wrong_type = format!("{ROBOT}[expose]\nin = [{{ topic = \"x\", type = \"sensor_msgs/Imu\" }}]");
    let expected = "robots/test.toml:6: unknown topic type \"sensor_msgs/Imu\", \
                    did you mean \"sensor_msgs/msg/Imu\"?";
    assert_eq!(problem(&wrong_type), expected);
    let cases = [
        ("[robot]\nnmae = \"r\"", "test.toml:1: [robot] needs \"name\""),
        (
            "[robot]\nname = \"r\"\nluncher = \"pool\"",
            ":3: [robot] has no \"luncher\", did you mean \"launcher\"?",
        ),
        (
            "[robot]\nname = \"r\"\nlauncher = \"lineal\"",
            ":3: unknown launcher \"lineal\", did you mean \"linear\"?",
        ),
        (
            "[robot]\nname = \"r\"\nthreads = 0\nlauncher = \"pool\"",
            ":3: expected a whole number greater than 0",
        ),
        ("[robot]\nname = \"1r\"", ":2: \"1r\" is not a name"),
        (
            "[robot]\nname = \"r\"\n[[module]]\nkind = \"darwin\"",
            ":4: unknown kind of module \"darwin\", did you mean \"darwin_op\"?",
        ),
        ("[robot]\nname = r", ":2:"),
    ];
    for (text, expected) in cases {
        let problem = problem(text);
        assert!(problem.contains(expected), "{problem}\n  should contain\n{expected}");
    }
    let wrong_qos = format!("{ROBOT}[expose]\nout = [\n  {{ topic = \"x\", qos = \"sensor\" }}\n]");
    assert!(problem(&wrong_qos).contains(":7: unknown QoS preset \"sensor\", did you mean \"sensor_data\"?"));
    let mixed = "[robot]\nname = \"r\"\n[[module]]\nkind = \"darwin_op\"\nsettings.offsets = [1, \"a\"]";
    assert!(
        problem(mixed).contains(":5: expected a list of numbers only, or of texts only, found [1, \"a\"]")
    );
}
