//! The robots of a match as processes of their own.
//!
//! The match and its robots share nothing but: the bytes of a robot's bus, on a pseudo terminal; the pictures
//! of its camera, on DDS in a domain of its own; packets of a GameController and the answers to them, and
//! team messages, as datagrams of the loopback interface. A process of a robot ends with its standard input,
//! so none is left when this one ends, however it ends.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read};
use std::net::UdpSocket;
use std::num::NonZeroUsize;
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow, bail};
use bytes::Bytes;
use downbeat_library_host::parent;
use downbeat_match::Team;
use downbeat_network::udp::keep_free_port;
use tempfile::TempDir;

use super::robot::EVERYBODY;
use crate::logging::Stream;
use crate::own_command::own_command;
use crate::screen::Screen;
use crate::system;
use downbeat_bridge::middleware::{MAX_DOMAIN_ID, ParticipantOptions};
use downbeat_bridge::ros::{MessageType, Node, NodeName, Participant, RemapRules};
use downbeat_edge::Interfaces;
use downbeat_executor::{Core, Inbox, OutletInbox, Received, SettingValue};
use downbeat_msgs::cdr::{self, Cdr};
use downbeat_msgs::printable;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::sensor_msgs::msg::{CameraInfo, Image};
use downbeat_robot::{ModuleEntry, Place, RobotFile};

/// A match whose robots have not started.
pub(super) struct Prepared {
    robots: Vec<Entrant>,
    /// Of the ports of the buses.
    folder: TempDir,
    control_port: u16,
    answer_port: u16,
    team_ports: [u16; 2],
    _kept_ports: Vec<UdpSocket>,
    namespace: String,
}

/// A robot that is to start.
struct Entrant {
    name: String,
    team: Team,
    domain: u16,
    /// The topics of its camera in the core of the match, image and info.
    camera: [String; 2],
}

/// The processes of a match. They are ended when it is dropped.
pub(super) struct Processes {
    robots: Vec<Robot>,
    /// Removed when they have ended.
    _prepared: Prepared,
}

struct Robot {
    name: String,
    domain: u16,
    child: Child,
    /// The process ends when it is closed.
    input: Option<ChildStdin>,
    output: Option<JoinHandle<()>>,
    has_ended: bool,
}

/// How long the processes may take to end.
const PATIENCE: Duration = Duration::from_secs(30);
const LOOK: Duration = Duration::from_millis(20);
/// Longer lines of their logs are cut.
const LONGEST_LINE: u64 = 16 << 10;
/// How many pictures wait to be sent, of all robots.
const WAITING: NonZeroUsize = NonZeroUsize::new(16).expect("not zero");

impl Prepared {
    /// Takes the robots of the match out of its file, which gets ports for them. The first robot is in this
    /// domain, the others in the next ones.
    pub(super) fn take_robots(file: &mut RobotFile, first_domain: u16) -> anyhow::Result<Self> {
        let game = super::match_of(file)?;
        let (options, place) = (game.options(), game.place());
        let names = match options.settings.get("robots") {
            Some(SettingValue::Texts(names)) => names.clone(),
            _ => bail!(
                "{}",
                file.error_at(
                    &place,
                    "\"robots\" does not say who plays: give names, such as [\"blue_1\", \"red_1\"]"
                )
            ),
        };
        let seats = downbeat_match::seats(&names).map_err(|problem| anyhow!("{problem}"))?;
        let last_domain = usize::from(first_domain) + names.len() - 1;
        if last_domain > usize::from(MAX_DOMAIN_ID) {
            bail!(
                "{} robots need the domains {first_domain} to {last_domain}, and domains end at {MAX_DOMAIN_ID}: choose the first with --robot-domains",
                names.len()
            );
        }
        let mut robots = Vec::with_capacity(names.len());
        for ((name, seat), domain) in names.iter().zip(&seats).zip(first_domain..) {
            let modules = file.take_out(name);
            check_player(file, &place, name, &modules)?;
            let topic = |topic: &str| options.resolved(&format!("{name}/camera/{topic}"));
            robots.push(Entrant {
                name: name.clone(),
                team: seat.team,
                domain,
                camera: [topic("image_raw"), topic("camera_info")],
            });
        }
        let hz = match options.settings.get("camera_hz") {
            Some(SettingValue::Double(hz)) => *hz,
            Some(SettingValue::Integer(hz)) => *hz as f64,
            _ => 0.0,
        };
        if hz <= 0.0 {
            let problem = "robots in processes of their own know the field only from pictures: give the match \"camera_hz\", such as 10.0";
            bail!("{}", file.error_at(&place, problem));
        }
        let folder = system::private_folder("downbeat_match_")
            .context("cannot create a folder for the ports of the robots")?;
        file.furnish("football_match", "", [("ports", folder.path().display().to_string().into())])?;
        let ports = "cannot find free UDP ports";
        let mut kept: Vec<_> =
            std::iter::repeat_with(keep_free_port).take(4).collect::<Result<_, _>>().context(ports)?;
        let [control_port, blue, red, answer_port] = [0, 1, 2, 3].map(|index: usize| kept[index].1);
        // Of the match alone, which opens it soon.
        kept.truncate(3);
        file.furnish(
            "game_controller_sender",
            &options.namespace,
            [
                ("players", SettingValue::Texts(names)),
                ("to", SettingValue::Text(EVERYBODY.to_owned())),
                ("port", i64::from(control_port).into()),
                ("address", SettingValue::Text("127.0.0.1".to_owned())),
                ("answer_port", i64::from(answer_port).into()),
            ],
        )?;
        Ok(Self {
            robots,
            folder,
            control_port,
            answer_port,
            team_ports: [blue, red],
            _kept_ports: kept.into_iter().map(|(socket, _)| socket).collect(),
            namespace: file.namespace.clone(),
        })
    }

    /// Shows each robot the pictures of its camera, in its domain.
    pub(super) fn show_pictures(
        &self,
        core: &mut Core,
        interfaces: &Interfaces,
        options: &ParticipantOptions,
    ) -> anyhow::Result<()> {
        let inbox = OutletInbox::new("pictures", Inbox::KeepLast(WAITING));
        for Entrant { name, domain, camera: [image, info], .. } in &self.robots {
            let options = ParticipantOptions { domain_id: *domain, ..options.clone() };
            let participant = Participant::join_with(&options, RemapRules::default(), interfaces.clone())
                .with_context(|| format!("cannot join domain {domain} for {name}"))?;
            let namespace = format!("{}/{name}", self.namespace.trim_end_matches('/'));
            let node = participant.create_node(NodeName::new(&namespace, "camera")?)?;
            show::<Image>(core, &node, image, "image_raw", "sensor_msgs/msg/Image", &inbox)?;
            show::<CameraInfo>(core, &node, info, "camera_info", "sensor_msgs/msg/CameraInfo", &inbox)?;
        }
        Ok(())
    }

    /// Starts the robots, once the match runs. They are given these arguments; with `bags`, each records into
    /// a folder there.
    pub(super) fn start(
        self,
        file: &Path,
        arguments: &[OsString],
        bags: Option<&Path>,
        screen: &Screen,
    ) -> anyhow::Result<Processes> {
        let (program, before) = own_command("match")?;
        let mut processes = Processes { robots: Vec::with_capacity(self.robots.len()), _prepared: self };
        for Entrant { name, team, domain, .. } in &processes._prepared.robots {
            let prepared = &processes._prepared;
            let mut command = Command::new(&program);
            command.args(&before).arg("match-robot").arg(file).arg(name).args(arguments);
            command.arg("--port").arg(prepared.folder.path().join(name));
            let team_port = prepared.team_ports[usize::from(*team == Team::Red)];
            let numbers = [
                ("--domain", domain),
                ("--control-port", &prepared.control_port),
                ("--answer-port", &prepared.answer_port),
                ("--team-port", &team_port),
            ];
            for (flag, number) in numbers {
                command.arg(flag).arg(number.to_string());
            }
            if let Some(bags) = bags {
                command.arg("--record").arg(bags.join(name));
            }
            for (variable, value) in
                [("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"), ("DOWNBEAT_LOG", "warn")]
            {
                if std::env::var_os(variable).is_none() {
                    command.env(variable, value);
                }
            }
            // In a group of its own: Ctrl-C is for the match, which ends its robots.
            parent::in_own_group(&mut command);
            command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
            let mut child =
                parent::spawn(command).with_context(|| format!("cannot start a process for {name}"))?;
            let (input, log) = (child.stdin.take(), child.stderr.take());
            let screen = screen.clone();
            let thread = std::thread::Builder::new().name(name.clone());
            let output = log.map(|log| thread.spawn(move || pass_on(log, &screen))).transpose();
            let robot =
                Robot { name: name.clone(), domain: *domain, child, input, output: None, has_ended: false };
            processes.robots.push(robot);
            let output = output.with_context(|| format!("cannot start a thread for {name}"))?;
            if let Some(robot) = processes.robots.last_mut() {
                robot.output = output;
            }
        }
        Ok(processes)
    }
}

impl Processes {
    /// A line for each robot: its domain and its process.
    pub(super) fn lines(&self) -> impl Iterator<Item = String> {
        self.robots
            .iter()
            .map(|robot| format!("{}  domain {}  process {}", robot.name, robot.domain, robot.child.id()))
    }

    /// Reports robots whose processes have ended since the last call.
    pub(super) fn report_ends(&mut self) {
        for robot in self.robots.iter_mut().filter(|robot| !robot.has_ended) {
            let status = match robot.child.try_wait() {
                Ok(None) => continue,
                Ok(Some(status)) => status.to_string(),
                Err(error) => error.to_string(),
            };
            robot.has_ended = true;
            tracing::error!(
                "the process of {} has ended: {status}; its servos keep their last goals, and the match goes on",
                robot.name
            );
        }
    }

    fn end(&mut self) {
        self.report_ends();
        self.robots.iter_mut().for_each(|robot| robot.input = None);
        let deadline = Instant::now() + PATIENCE;
        for robot in &mut self.robots {
            while !robot.has_ended && Instant::now() < deadline {
                match robot.child.try_wait() {
                    Ok(None) => std::thread::sleep(LOOK),
                    Ok(Some(status)) => {
                        robot.has_ended = true;
                        if !status.success() {
                            tracing::error!("the process of {} did not end well: {status}", robot.name);
                        }
                    }
                    Err(_) => break,
                }
            }
            if !robot.has_ended {
                tracing::error!("the process of {} did not end in time and was killed", robot.name);
                // Without an effect if it has ended since.
                let _ = robot.child.kill();
                let _ = robot.child.wait();
            }
            if let Some(output) = robot.output.take() {
                let _ = output.join();
            }
        }
    }
}

impl Drop for Processes {
    fn drop(&mut self) {
        self.end();
    }
}

/// Refuses a player that could not play in a process of its own.
fn check_player(
    file: &RobotFile,
    of_match: &Place,
    name: &str,
    modules: &[ModuleEntry],
) -> anyhow::Result<()> {
    let of_kind = |kind: &str| modules.iter().find(|module| module.kind.name() == kind);
    if let Some(module) = of_kind("truth_beliefs") {
        let problem = format!(
            "\"{}\" believes the ground truth, which does not leave the match with --processes: include football/seeing_player.toml, as \
             robots/seeing_teams.toml does",
            module.name
        );
        bail!("{}", file.error_at(&module.place(), problem));
    }
    if of_kind("darwin_op").is_none() {
        let problem = format!(
            "\"{name}\" cannot play in a process of its own: no [[include]] with namespace = \"{name}\" has a module of kind \"darwin_op\""
        );
        bail!("{}", file.error_at(of_match, problem));
    }
    Ok(())
}

/// Publishes a topic of the core while somebody receives it.
fn show<T: Cdr + Send + Sync + 'static>(
    core: &mut Core,
    node: &Node,
    topic: &str,
    name: &str,
    message_type: &str,
    inbox: &OutletInbox,
) -> anyhow::Result<()> {
    let qos = QosProfile::DEFAULT.keep_last(2);
    let publisher = node.publish(&format!("camera/{name}"), &MessageType::new(message_type)?, qos)?;
    let mut has_failed = false;
    let send = move |message: Received<'_, T>| {
        if publisher.matched_subscriptions() == 0 {
            return;
        }
        if let Err(error) = publisher.publish(Bytes::from(cdr::to_vec(&*message)))
            && !std::mem::replace(&mut has_failed, true)
        {
            tracing::warn!("{} was not sent: {error}; further errors are not reported", publisher.topic());
        }
    };
    core.outlet(topic, inbox, send)?.keep();
    Ok(())
}

/// Passes the log of a robot on to the screen until it ends.
fn pass_on(log: impl Read, screen: &Screen) {
    let mut log = BufReader::new(log);
    let mut bytes = Vec::new();
    loop {
        bytes.clear();
        match (&mut log).take(LONGEST_LINE).read_until(b'\n', &mut bytes) {
            Ok(0) | Err(_) => return,
            Ok(_) => {
                let line = String::from_utf8_lossy(&bytes);
                screen.log(Stream::Error, format!("{}\n", printable(line.trim_end())));
            }
        }
    }
}
