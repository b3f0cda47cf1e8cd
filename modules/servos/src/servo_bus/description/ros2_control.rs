//! Servos that the `<ros2_control>` tags of a URDF describe.
//!
//! A tag is a bus, its plug-in says what is on it. Where a joint has no limits for its commands, those of the
//! URDF are taken.
//!
//! # References
//! - ros2_control, branch jazzy: `hardware_interface/src/component_parser.cpp`.
//! - youtalk/dynamixel_hardware, ROBOTIS-GIT/dynamixel_hardware_interface, JafarAbdi/feetech_ros2_driver
//!   (`doc/user.md`) and adityakamath's `feetech_sts_hardware`, README: the parameters of their plug-ins.

use super::super::models::{self, ProtocolName};
use super::super::protocol::{Protocol, UnknownProtocol};
use super::file::{BusEntry, Defaults, File, Gains, JointEntry, Mode};
use super::{DescriptionError, Source};
use downbeat_files::suggestion;
use downbeat_files::toml::Spanned;
use roxmltree::{Document, Node};
use std::collections::BTreeMap;

/// What is behind a plug-in.
struct Plugin {
    class: &'static str,
    protocol: Protocol,
    /// The model of its servos; `None` if it finds out.
    model: Option<&'static str>,
    /// What the parameter `offset` of a joint means.
    offset: Offset,
    /// Whether there are no servos: they are emulated, in the memory of the robot.
    is_emulated: bool,
}

#[derive(Clone, Copy)]
enum Offset {
    /// As in a description.
    Raw,
    /// The raw position of the joint's zero.
    Zero,
    /// The angle of the servo at the joint's zero, in rad.
    Angle,
}

const fn plugin(
    class: &'static str,
    protocol: Protocol,
    model: Option<&'static str>,
    offset: Offset,
) -> Plugin {
    Plugin { class, protocol, model, offset, is_emulated: false }
}

const fn emulated(class: &'static str) -> Plugin {
    let model = Some("XM430-W350");
    Plugin { class, protocol: Protocol::Dynamixel2, model, offset: Offset::Raw, is_emulated: true }
}

const PLUGINS: &[Plugin] = &[
    plugin("downbeat/Dynamixel", Protocol::Dynamixel2, None, Offset::Raw),
    plugin("downbeat/Feetech", Protocol::FeetechSts, Some("STS3215"), Offset::Raw),
    emulated("downbeat/Emulator"),
    plugin("dynamixel_hardware/DynamixelHardware", Protocol::Dynamixel2, None, Offset::Angle),
    plugin("dynamixel_hardware_interface/DynamixelHardware", Protocol::Dynamixel2, None, Offset::Angle),
    plugin(
        "dynamixel_hardware_interface/DynamixelHardwareInterface",
        Protocol::Dynamixel2,
        None,
        Offset::Angle,
    ),
    plugin(
        "feetech_ros2_driver/FeetechHardwareInterface",
        Protocol::FeetechSts,
        Some("STS3215"),
        Offset::Zero,
    ),
    plugin("feetech_sts_hardware/FeetechSTSHardware", Protocol::FeetechSts, Some("STS3215"), Offset::Zero),
    emulated("mock_components/GenericSystem"),
    emulated("gz_ros2_control/GazeboSimSystem"),
    emulated("ign_ros2_control/IgnitionSystem"),
    emulated("mujoco_ros2_control/MujocoSystemInterface"),
];

const PORTS: [&str; 4] = ["port", "port_name", "usb_port", "serial_port"];
const BAUDS: [&str; 3] = ["baud", "baud_rate", "baudrate"];
const BAUD: u32 = 1_000_000;
const CYCLE_MS: f64 = 10.0;

/// Other names of registers.
const REGISTERS: [(&str, &str); 4] = [
    ("range_min", "min_position_limit"),
    ("range_max", "max_position_limit"),
    ("return_delay_time", "return_delay"),
    ("max_torque_limit", "max_torque"),
];

/// Reads the buses and joints of a URDF.
pub(super) fn file(source: &Source<'_>) -> Result<File, DescriptionError> {
    let text = source.0.text();
    if text.contains("xmlns:xacro") || text.contains("<xacro:") {
        let problem = "this is xacro: make a URDF of it first, with `xacro ROBOT.urdf.xacro > robot.urdf`";
        return Err(source.error(0, problem.to_owned()));
    }
    let document = Document::parse(text).map_err(|error| {
        DescriptionError::File(source.0.error_on(error.pos().row as usize, error.to_string()))
    })?;
    let robot = document.root_element();
    let mut file = File {
        name: robot.attribute("name").unwrap_or("robot").to_owned(),
        models: Vec::new(),
        bus: Vec::new(),
        defaults: Defaults::default(),
        joint: Vec::new(),
        device: Vec::new(),
    };
    let mut others = Vec::new();
    for tag in children(robot, "ros2_control").filter(|tag| tag.attribute("type") != Some("sensor")) {
        let hardware = children(tag, "hardware").next();
        let Some(class) = hardware.and_then(|hardware| children(hardware, "plugin").next()) else {
            return Err(
                source.error(at(tag), "this <ros2_control> has no <hardware> with a <plugin>".to_owned())
            );
        };
        let name = class.text().unwrap_or_default().trim();
        match PLUGINS.iter().find(|plugin| plugin.class == name) {
            Some(plugin) => Tag { source, robot, tag, plugin }.read(&mut file)?,
            None => others.push((at(class), name.to_owned())),
        }
    }
    match others.first() {
        Some((at, name)) if file.bus.is_empty() => {
            let known = PLUGINS.iter().map(|plugin| plugin.class);
            let hint = suggestion(name, known.clone());
            let known: Vec<_> = known.collect();
            let problem =
                format!("the plug-in \"{name}\" is not known here{hint}; known are {}", known.join(", "));
            Err(source.error(*at, problem))
        }
        None if file.bus.is_empty() => {
            Err(source.error(0, "the URDF has no <ros2_control> tag, which names its servos".to_owned()))
        }
        _ => {
            for (_, name) in others {
                tracing::info!("{}: what \"{name}\" drives is left out", source.0.path().display());
            }
            Ok(file)
        }
    }
}

fn children<'a, 'input>(
    node: Node<'a, 'input>,
    name: &'static str,
) -> impl Iterator<Item = Node<'a, 'input>> {
    node.children().filter(move |child| child.has_tag_name(name))
}

fn at(node: Node<'_, '_>) -> usize {
    node.range().start
}

/// The parameters of a node, with where they are.
type Parameters<'a> = BTreeMap<&'a str, (usize, &'a str)>;

fn parameters<'a>(node: Node<'a, '_>) -> Parameters<'a> {
    let value = |node: Node<'a, '_>| (at(node), node.text().unwrap_or_default().trim());
    children(node, "param").filter_map(|node| Some((node.attribute("name")?, value(node)))).collect()
}

/// A `<ros2_control>` tag.
struct Tag<'a> {
    source: &'a Source<'a>,
    robot: Node<'a, 'a>,
    tag: Node<'a, 'a>,
    plugin: &'a Plugin,
}

impl Tag<'_> {
    fn read(&self, file: &mut File) -> Result<(), DescriptionError> {
        let Self { source, tag, plugin, .. } = self;
        let parameters = children(*tag, "hardware").next().map(parameters).unwrap_or_default();
        let given = |names: &[&str]| names.iter().find_map(|name| parameters.get(name)).copied();
        let name = tag.attribute("name").unwrap_or("bus").to_owned();
        let is_emulated =
            plugin.is_emulated || given(&["use_dummy"]).is_some_and(|(_, value)| value == "true");
        let port = match given(&PORTS) {
            _ if is_emulated => format!("memory:{name}"),
            Some((_, port)) => port.to_owned(),
            None => {
                let problem = format!(
                    "\"{name}\" names no port: give its <hardware> a <param name=\"port\">/dev/ttyUSB0</param>"
                );
                return Err(source.error(at(*tag), problem));
            }
        };
        let rate = tag.attribute("rw_rate").map(|rate| (at(*tag), rate));
        let bus = BusEntry {
            name: name.clone(),
            port,
            baud: self.number(given(&BAUDS))?.unwrap_or(BAUD),
            protocol: ProtocolName(self.protocol(given(&["protocol"]))?),
            cycle_ms: self.number::<f64>(rate)?.map_or(CYCLE_MS, |rate| 1000.0 / rate),
            fast_reads: false,
        };
        file.bus.push(Spanned::new(tag.range(), bus));
        if let Some((at, model)) = given(&["model_file"]) {
            file.models.push(Spanned::new(at..at, model.to_owned()));
        }
        let model = given(&["model"]).map(|(_, model)| model).or(plugin.model);
        let joints = children(*tag, "joint").filter(|joint| !is_mimic(*joint));
        for (index, joint) in joints.enumerate() {
            let number = u8::try_from(index + 1).ok().filter(|_| is_emulated);
            let entry = JointEntry {
                bus: Some(Spanned::new(joint.range(), name.clone())),
                ..self.joint(joint, model, number)?
            };
            file.joint.push(Spanned::new(joint.range(), entry));
        }
        Ok(())
    }

    fn protocol(&self, given: Option<(usize, &str)>) -> Result<Protocol, DescriptionError> {
        let Some((at, name)) = given else { return Ok(self.plugin.protocol) };
        name.parse().map_err(|unknown: UnknownProtocol| self.source.error(at, unknown.to_string()))
    }

    fn number<T: std::str::FromStr>(
        &self,
        given: Option<(usize, &str)>,
    ) -> Result<Option<T>, DescriptionError> {
        let parse = |(at, text): (usize, &str)| {
            text.parse().map_err(|_| self.source.error(at, format!("\"{text}\" is no such number")))
        };
        given.map(parse).transpose()
    }

    /// `number` is the id of a servo that has none.
    fn joint(
        &self,
        joint: Node<'_, '_>,
        model: Option<&str>,
        number: Option<u8>,
    ) -> Result<JointEntry, DescriptionError> {
        let name = joint.attribute("name").unwrap_or_default();
        let error = |problem: &str| self.source.error(at(joint), format!("joint \"{name}\" {problem}"));
        let mut parameters = parameters(joint);
        let mut take = |names: &[&str]| names.iter().find_map(|name| parameters.remove(*name));
        let id = self.number(take(&["id", "ID"]))?.or(number);
        let id = id.ok_or_else(|| error("has no id: give it a <param name=\"id\">1</param>"))?;
        let own_model = take(&["model", "motor_type"]).map(|(_, model)| model);
        let model_name = own_model.or(model).ok_or_else(|| {
            error("has no model: give it, or <hardware>, a <param name=\"model\">XM430-W350</param>")
        })?;
        let model = models::built_in().iter().find(|known| known.name == model_name);
        let register = |name: &str| model.and_then(|model| model.register(name));
        let gear = self.number::<f64>(take(&["gear", "gear_ratio"]))?;
        let sign = self.number(take(&["sign"]))?;
        let mut zero = self.number(take(&["zero", "zero_offset"]))?;
        let shift = take(&["offset"]);
        let offset = match (self.plugin.offset, shift) {
            (Offset::Raw, raw) => self.number(raw)?,
            (Offset::Zero, raw) => {
                zero = self.number(raw)?.or(zero);
                None
            }
            (Offset::Angle, angle) => match (self.number::<f64>(angle)?, register("goal_position")) {
                (Some(angle), Some(position)) => Some(position.steps(angle).round() as i64),
                (Some(_), None) => {
                    return Err(error(
                        "has an offset in rad, which only built-in models can have: use its zero",
                    ));
                }
                (None, _) => None,
            },
        };
        let gains = ["p", "i", "d"].map(|key| {
            let robotis = format!("Position {} Gain", key.to_uppercase());
            self.number(take(&[key, &format!("{key}_coefficient"), &robotis]))
        });
        let [p, i, d] = gains;
        let (p, i, d) = (p?, i?, d?);
        let max_current_a = self.number(take(&["max_current_a"]))?;
        let max_torque = self.number(take(&["max_torque"]))?;
        let mut registers = BTreeMap::new();
        for (key, (at, value)) in parameters {
            let known = key.to_lowercase().replace(' ', "_");
            let known = REGISTERS.iter().find(|(other, _)| *other == known).map_or(&*known, |(_, name)| name);
            match (register(known), value.parse()) {
                (Some(_), Ok(raw)) => drop(registers.insert(known.to_owned(), Spanned::new(at..at, raw))),
                _ => {
                    let path = self.source.0.path().display();
                    let line = self.source.0.line_of(at);
                    tracing::warn!(
                        "{path}:{line}: the parameter \"{key}\" of joint \"{name}\" is not used here"
                    );
                }
            }
        }
        let commanded = |quantity: &str| {
            children(joint, "command_interface").find(|one| one.attribute("name") == Some(quantity))
        };
        let mode = match (commanded("position"), commanded("velocity"), commanded("effort")) {
            (Some(_), ..) => Mode::Position,
            (None, Some(_), _) => Mode::Velocity,
            (None, None, Some(_)) => Mode::Effort,
            (None, None, None) => {
                return Err(error("has no <command_interface> \"position\", \"velocity\" or \"effort\""));
            }
        };
        let [lower, upper] = [("min", "lower"), ("max", "upper")]
            .map(|(own, of_urdf)| self.limit(name, commanded("position"), own, of_urdf));
        Ok(JointEntry {
            name: name.to_owned(),
            id,
            bus: None,
            model: Some(Spanned::new(joint.range(), model_name.to_owned())),
            limits: lower?.zip(upper?).map(|(lower, upper)| [lower, upper]),
            sign: sign.or(gear.filter(|gear| *gear < 0.0).map(|_| -1)),
            zero,
            offset,
            gear: gear.map(f64::abs),
            gains: (p.is_some() || i.is_some() || d.is_some()).then_some(Gains { p, i, d }),
            max_torque,
            max_current_a,
            mode: Some(mode),
            max_velocity_rad_s: match mode {
                Mode::Velocity => self.limit(name, commanded("velocity"), "max", "velocity")?,
                Mode::Position | Mode::Effort => None,
            },
            command_timeout_s: None,
            approach_rad_s: None,
            guard: None,
            registers,
        })
    }

    /// A limit of a joint: that of its command interface, otherwise that of the URDF.
    fn limit(
        &self,
        joint: &str,
        command: Option<Node<'_, '_>>,
        own: &str,
        of_urdf: &str,
    ) -> Result<Option<f64>, DescriptionError> {
        let commanded = command.and_then(|command| parameters(command).get(own).copied());
        let declared = children(self.robot, "joint").find(|known| known.attribute("name") == Some(joint));
        let limit = declared.and_then(|declared| children(declared, "limit").next());
        let described = limit.and_then(|limit| Some((at(limit), limit.attribute(of_urdf)?)));
        self.number(commanded.or(described))
    }
}

/// A joint that follows another one, without a servo.
fn is_mimic(joint: Node<'_, '_>) -> bool {
    joint.attribute("mimic") == Some("true") || parameters(joint).contains_key("mimic")
}
