#![allow(clippy::unwrap_used)]

use super::*;

const BUS: &str = "name = \"robot\"\n[[bus]]\nname = \"body\"\nport = \"/dev/ttyUSB0\"\nbaud = 2_000_000\nprotocol = \"dynamixel2\"\ncycle_ms = 8\n";

/// A description whose joints begin on line 8.
fn parse(rest: &str) -> Result<Description, DescriptionError> {
    Description::parse("robot.toml", &format!("{BUS}{rest}"))
}

#[track_caller]
fn is_refused(rest: &str, expected: &str) {
    assert_eq!(parse(rest).unwrap_err().to_string(), expected);
}

fn joint(name: &str, id: u8, rest: &str) -> String {
    format!("[[joint]]\nname = \"{name}\"\nid = {id}\nmodel = \"XM430-W350\"\n{rest}\n")
}

#[test]
fn a_joint_converts_between_raw_positions_and_angles() {
    let description =
        parse(&joint("knee", 3, "limits = [-1.0, 1.6]\nsign = -1\ngear = 2.0\noffset = 100")).unwrap();
    let joint = &description.bus("").unwrap().joints[0];
    let quarter = std::f64::consts::FRAC_PI_2;
    assert_eq!(joint.angle(2148), 0.0);
    assert!((joint.angle(100) - quarter).abs() < 1e-12, "half a turn of the servo, against the joint");
    assert_eq!(joint.goal(quarter), Some(100));
    assert_eq!(joint.goal(7.8), joint.goal(1.6));
    assert_eq!(joint.goal(-7.2), joint.goal(-1.0));
    assert_eq!([7.9, -7.3, f64::NAN, f64::INFINITY].map(|angle| joint.goal(angle)), [None; 4]);
}

#[test]
fn defaults_apply_to_joints_that_do_not_say_otherwise() {
    let text = "[defaults]\nmodel = \"XM430-W350\"\ngains = { p = 600 }\nmax_torque = 0.5\n[[joint]]\nname = \"a\"\nid = 1\n\
                limits = [-1, 1]\n[[joint]]\nname = \"b\"\nid = 2\nlimits = [-1, 1]\ngains = { p = 700, d = 10 }\n";
    let description = parse(text).unwrap();
    let [a, b] = &description.buses()[0].joints[..] else { panic!() };
    assert_eq!((a.gains, b.gains), ([None, None, Some(600)], [Some(10), None, Some(700)]));
    assert_eq!((a.max_torque, a.approach_steps), (Some(0.5), 5), "1 rad/s is 5 steps in 8 ms");
}

#[test]
fn two_servos_of_one_id_are_refused() {
    let text = joint("knee", 3, "limits = [-1, 1]") + &joint("ankle", 3, "limits = [-1, 1]");
    is_refused(
        &text,
        "robot.toml:13: joint \"ankle\" has the id 3 of \"knee\" (line 8) on the same bus; give one of the two another id, with `downbeat servo set-id`",
    );
}

#[test]
fn a_joint_without_limits_is_refused() {
    is_refused(
        &joint("knee", 3, ""),
        "robot.toml:8: joint \"knee\" needs \"limits\", its smallest and largest angle in rad, such as limits = [-1.5, 1.5]",
    );
    is_refused(
        &joint("knee", 3, "limits = [nan, 1]"),
        "robot.toml:8: joint \"knee\" has the limits NaN and 1: give the smaller angle first, in rad",
    );
    let error = parse(&joint("knee", 3, "limits = [-1, 4.0]")).unwrap_err().to_string();
    assert!(error.contains("turns from -3.142 to 3.140 rad; check limits, zero, sign and gear"), "{error}");
}

#[test]
fn an_unknown_model_is_refused_with_the_nearest_one() {
    let text = "[[joint]]\nname = \"knee\"\nid = 3\nmodel = \"XM430\"\nlimits = [-1, 1]\n";
    is_refused(
        text,
        "robot.toml:11: unknown model \"XM430\", did you mean \"XM430-W350\"?; a file with its registers can be named in \"models\"",
    );
    is_refused(
        "[[joint]]\nname = \"knee\"\nid = 3\nmodel = \"MX-28\"\nlimits = [-1, 1]\n",
        "robot.toml:11: MX-28 speaks dynamixel1, but bus \"body\" has protocol = \"dynamixel2\"",
    );
}

#[test]
fn wrong_values_are_refused_with_line_and_remedy() {
    let error = |rest: &str| parse(rest).unwrap_err().to_string();
    assert!(error(&joint("a", 255, "limits = [-1, 1]")).contains(":8: 255 is no id of a device"));
    assert!(error(&joint("a", 1, "limits = [-1, 1]\nsing = -1")).contains(":13: unknown field `sing`"));
    assert!(error(&joint("a", 1, "limits = [-1, 1]\nsign = 2")).contains("1, or -1 if the servo turns"));
    assert!(
        error(&joint("a", 1, "limits = [-1, 1]\ngains = { p = 99999 }"))
            .contains("XM430-W350 has 0 to 16383")
    );
    assert!(error(&joint("a", 1, "limits = [-1, 1]\nmax_torque = 1.5")).contains("a share above 0, up to 1"));
    assert!(error(&joint("a", 1, "limits = [-1, 1]\nmax_current_a = 9.0")).contains("up to 3.209 A"));
    let guard = "limits = [-1, 1]\nguard = { temperature_c = { warn = 70, off = 60 } }";
    assert!(error(&joint("a", 1, guard)).contains("warn comes before soften"));
    let guard = "limits = [-1, 1]\nguard = { shutdown_rest_s = 2 }";
    assert!(error(&joint("a", 1, guard)).contains("come back from a shutdown by a reboot only"));
    let device = "[[device]]\nname = \"board\"\nid = 200\nmodel = \"OpenCR\"\nread = [\"buton\"]\n";
    assert!(
        error(device)
            .contains(":12: device \"board\": OpenCR has no register \"buton\", did you mean \"button\"?")
    );
    let imu = |axis: &str| {
        format!(
            "[[device]]\nname = \"b\"\nid = 200\nmodel = \"OpenCR\"\nimu = {{ angular_velocity = [\"gyro_x\", \"{axis}\", \"gyro_z\"], linear_acceleration = [\"acc_x\", \"acc_y\", \"acc_z\"] }}\n"
        )
    };
    assert!(
        error(&imu("-gyro_q"))
            .contains(":12: device \"b\": OpenCR has no register \"gyro_q\", did you mean \"gyro_")
    );
    assert!(
        error(&imu("-acc_x")).contains(":12: \"acc_x\" cannot be an axis of this IMU: it is not in rad/s")
    );
    assert!(error("[[bus]]\n").contains("missing field"));
    let buses = "[[bus]]\nname = \"arm\"\nport = \"x\"\nbaud = 1\nprotocol = \"dynamixel2\"\ncycle_ms = 8\n";
    assert!(error(buses).contains(":8: bus \"arm\" has 1 bit/s"));
    let unknown = BUS.replace("dynamixel2", "dynamixel3");
    let error = Description::parse("x", &unknown).unwrap_err().to_string();
    assert!(error.contains("x:6: unknown protocol \"dynamixel3\"; there are \"dynamixel1\""), "{error}");
}

#[test]
fn a_robot_of_several_buses_needs_the_name_of_one() {
    let arm = "[[bus]]\nname = \"arm\"\nport = \"x\"\nbaud = 1_000_000\nprotocol = \"feetech_sts\"\ncycle_ms = 10\n";
    let text = arm.to_owned()
        + &joint("knee", 1, "bus = \"body\"\nlimits = [-1, 1]")
        + &joint("elbow", 1, "bus = \"body\"\nlimits = [-1, 1]")
            .replace("XM430-W350", "STS3215")
            .replace("\"body\"", "\"arm\"");
    let description = parse(&text).unwrap();
    assert_eq!(
        description.bus("").unwrap_err().to_string(),
        "robot has the buses \"body\", \"arm\": run one module for each, with the setting \"bus\""
    );
    let arm = description.bus("arm").unwrap();
    assert_eq!((&*arm.joints[0].name, &arm.other_joints[..]), ("elbow", &["knee".to_owned()][..]));
    assert!(description.bus("leg").unwrap_err().to_string().contains("has no bus \"leg\""));
}

#[test]
fn a_model_file_is_relative_to_the_description() {
    let folder = tempfile::tempdir().unwrap();
    let model = models::find("STS3215").unwrap();
    assert_eq!(model.protocols, [Protocol::FeetechSts]);
    let text = include_str!("../models/sts3215.toml")
        .replace("STS3215", "SCS99")
        .replace("\"feetech_sts\"", "\"feetech_scs\"");
    std::fs::write(folder.path().join("scs.toml"), &text).unwrap();
    let path = folder.path().join("robot.toml");
    let description = "name = \"r\"\nmodels = [\"scs.toml\"]\n[[bus]]\nname = \"b\"\nport = \"p\"\nbaud = 1000000\nprotocol = \"feetech_scs\"\ncycle_ms = 20\n[[joint]]\nname = \"j\"\nid = 1\nmodel = \"SCS99\"\nlimits = [-1, 1]\n";
    std::fs::write(&path, description).unwrap();
    let path = path.to_string_lossy();
    assert_eq!(Description::load(&path).unwrap().buses()[0].joints[0].model.name, "SCS99");
    std::fs::write(folder.path().join("scs.toml"), text.replace("size = 2", "size = 5")).unwrap();
    let error = Description::load(&path).unwrap_err().to_string();
    assert!(error.contains("scs.toml:") && error.contains("has 5 bytes"), "{error}");
    assert!(
        Description::load("/no/such.toml").unwrap_err().to_string().contains("cannot read the description")
    );
}

/// An arm of a URDF; its plug-in is on line 4, its joints begin on lines 7 and 12.
fn urdf(plugin: &str, hardware: &str, first: &str, second: &str) -> String {
    format!(
        "<robot name=\"arm\">\n<ros2_control name=\"body\" type=\"system\" rw_rate=\"50\">\n<hardware>\n\
         <plugin>{plugin}</plugin>\n{hardware}\n</hardware>\n\
         <joint name=\"pan\">\n<param name=\"id\">11</param>\n{first}\n</joint>\n\n\
         <joint name=\"tilt\">\n<param name=\"id\">12</param>\n{second}\n</joint>\n</ros2_control>\n\
         <ros2_control name=\"touch\" type=\"sensor\"><hardware><plugin>some/Sensor</plugin></hardware></ros2_control>\n\
         <joint name=\"pan\" type=\"revolute\"><limit lower=\"-1.5\" upper=\"1.5\" velocity=\"2.0\" effort=\"1\"/></joint>\n\
         <joint name=\"tilt\" type=\"revolute\"><limit lower=\"-0.5\" upper=\"0.5\" velocity=\"3.0\" effort=\"1\"/></joint>\n\
         </robot>\n"
    )
}

const POSITION: &str = "<command_interface name=\"position\"/>";

#[test]
fn servos_of_a_urdf_are_those_of_its_plug_ins() {
    let port = "<param name=\"port_name\">/dev/ttyUSB1</param><param name=\"baud_rate\">57600</param>";
    let own = "<param name=\"motor_type\">XL330-M288</param><param name=\"gear_ratio\">-2.0</param>\
               <param name=\"offset\">0.7853981633974483</param>\
               <command_interface name=\"position\"><param name=\"min\">-1.0</param></command_interface>";
    let model = "<param name=\"model\">XM430-W350</param>";
    let velocity = "<command_interface name=\"velocity\"/><command_interface name=\"effort\"/>";
    let text = urdf("dynamixel_hardware/DynamixelHardware", &format!("{port}{model}"), own, velocity);
    let description = Description::parse("arm.urdf", &text).unwrap();
    assert_eq!((description.buses().len(), &*description.name), (1, "arm"), "the sensor is no bus");
    let bus = description.bus("body").unwrap();
    assert_eq!((&*bus.port, bus.line.baud, bus.cycle.as_millis()), ("/dev/ttyUSB1", 57_600, 20));
    assert_eq!(bus.line.protocol, Protocol::Dynamixel2);
    let [pan, tilt] = &*bus.joints else { panic!("{:?}", bus.joints) };
    assert_eq!((&*pan.model.name, &*tilt.model.name), ("XL330-M288", "XM430-W350"));
    assert_eq!((pan.min_rad, pan.max_rad, pan.gear, pan.sign), (-1.0, 1.5, 2.0, -1.0));
    assert_eq!(pan.zero, 2048 + 512, "an eighth of a turn");
    let drive = tilt.drive.as_ref().unwrap();
    assert_eq!((drive.quantity, drive.largest), (Quantity::Velocity, 3.0));

    let feetech = "<param name=\"offset\">2100</param><param name=\"p_coefficient\">8</param>\
                   <param name=\"homing_offset\">-12</param><command_interface name=\"position\"/>";
    let port = "<param name=\"usb_port\">/dev/ttyACM0</param>";
    let text = urdf("feetech_ros2_driver/FeetechHardwareInterface", port, feetech, POSITION);
    let description = Description::load(&text).unwrap();
    let [pan, tilt] = &*description.bus("").unwrap().joints else { panic!("{description:?}") };
    assert_eq!((pan.zero, tilt.zero), (2100, 2048));
    assert_eq!(pan.gains, [None, None, Some(8)]);
    assert!(pan.further.iter().any(|(register, raw)| register.name == "homing_offset" && *raw == -12));

    let mock = urdf("mock_components/GenericSystem", "", POSITION, POSITION)
        .replace("<param name=\"id\">", "<param name=\"unused\">");
    let description = Description::load(&mock).unwrap();
    let bus = description.bus("body").unwrap();
    assert_eq!(bus.port, "memory:body");
    assert_eq!(bus.joints.iter().map(|joint| joint.id.to_string()).collect::<Vec<_>>(), ["1", "2"]);
}

#[test]
fn what_is_missing_in_a_urdf_is_named_with_its_line() {
    let refused = |text: &str| Description::parse("arm.urdf", text).unwrap_err().to_string();
    let dynamixel = "dynamixel_hardware/DynamixelHardware";
    let port = "<param name=\"port\">/dev/ttyUSB1</param>";
    for (text, expected) in [
        ("<robot name=\"arm\"/>".to_owned(), "arm.urdf:1: the URDF has no <ros2_control> tag"),
        ("<robot>\n<joint></robot>".to_owned(), "arm.urdf:2: "),
        ("<robot xmlns:xacro=\"http://www.ros.org/wiki/xacro\"/>".to_owned(), "arm.urdf:1: this is xacro"),
        (
            urdf("dynamixel_hardwear/DynamixelHardware", port, POSITION, POSITION),
            "arm.urdf:4: the plug-in \"dynamixel_hardwear/DynamixelHardware\" is not known here, did you mean \"dynamixel_hardware/DynamixelHardware\"?",
        ),
        (urdf(dynamixel, "", POSITION, POSITION), "arm.urdf:2: \"body\" names no port"),
        (urdf(dynamixel, port, POSITION, POSITION), "arm.urdf:7: joint \"pan\" has no model"),
        (
            urdf("downbeat/Feetech", port, POSITION, "<state_interface name=\"position\"/>"),
            "arm.urdf:12: joint \"tilt\" has no <command_interface>",
        ),
        (
            urdf("downbeat/Feetech", port, POSITION, POSITION).replace("12</param>", "11</param>"),
            "arm.urdf:12: ",
        ),
        (
            urdf("downbeat/Feetech", port, POSITION, POSITION).replace("\"50\"", "\"fast\""),
            "arm.urdf:2: \"fast\" is no such number",
        ),
        (
            urdf("downbeat/Feetech", port, POSITION, POSITION).replace("\"50\"", "\"0\""),
            "arm.urdf:2: bus \"body\" has a cycle of inf ms",
        ),
        (
            urdf(
                dynamixel,
                &format!("{port}<param name=\"model\">MINE</param>"),
                &format!("<param name=\"offset\">0.1</param>{POSITION}"),
                POSITION,
            ),
            "arm.urdf:7: joint \"pan\" has an offset in rad",
        ),
        (
            urdf("downbeat/Feetech", port, POSITION, POSITION).replace("-0.5", "low"),
            "arm.urdf:19: \"low\" is no such number",
        ),
        (
            urdf(
                "downbeat/Dynamixel",
                &format!("{port}<param name=\"model\">XM430</param>"),
                POSITION,
                POSITION,
            ),
            "arm.urdf:7: ",
        ),
    ] {
        let problem = refused(&text);
        assert!(problem.starts_with(expected), "{problem}");
    }
}
