//! The robots of a match as processes of their own.
//!
//! The match and its robots share nothing but: the bytes of a robot's bus, on a pseudo terminal; the pictures
//! of its camera, on DDS in a domain of its own; packets of a GameController and the answers to them, and
//! team messages, as datagrams of the loopback interface. A process of a robot ends with its standard input,
//! and on Linux by a signal from the system as well, so none is left when this one ends, however it ends. One
//! that dies is started again.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read};
use std::net::UdpSocket;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow, bail};
use bytes::Bytes;
use downbeat_library_host::parent;
use downbeat_match::Team;
use downbeat_network::udp::keep_free_port;
use tempfile::TempDir;

use super::restarts::Restarts;
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

/// What starts the process of any robot.
struct Starter {
    program: PathBuf,
    /// Before those of `match-robot`.
    arguments: Vec<OsString>,
    file: PathBuf,
    /// Of the command line, for the robot file.
    settings: Vec<OsString>,
    /// The folder of the bags.
    bags: Option<PathBuf>,
    screen: Screen,
}

/// The processes of a match. They are ended when it is dropped.
pub(super) struct Processes {
    robots: Vec<Robot>,
    starter: Starter,
    /// Removed when they have ended.
    prepared: Prepared,
}

struct Robot {
    /// `None` between two processes, and if there is none any more.
    process: Option<Process>,
    restarts: Restarts,
    starts_again_at: Option<Instant>,
}

struct Process {
    child: Child,
    started: Instant,
    /// The process ends when it is closed.
    input: Option<ChildStdin>,
    output: Option<JoinHandle<()>>,
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

    /// Starts the robots, once the match runs. They are given these settings; with `bags`, each records into
    /// a folder there.
    pub(super) fn start(
        self,
        file: &Path,
        settings: Vec<OsString>,
        bags: Option<&Path>,
        screen: &Screen,
    ) -> anyhow::Result<Processes> {
        let (program, before) = own_command("match")?;
        let starter = Starter {
            program,
            arguments: before.into_iter().map(OsString::from).collect(),
            file: file.to_owned(),
            settings,
            bags: bags.map(Path::to_owned),
            screen: screen.clone(),
        };
        let robots = Vec::with_capacity(self.robots.len());
        let mut processes = Processes { robots, starter, prepared: self };
        for entrant in &processes.prepared.robots {
            let process = processes.starter.start(entrant, &processes.prepared)?;
            let (restarts, starts_again_at) = (Restarts::default(), None);
            processes.robots.push(Robot { process: Some(process), restarts, starts_again_at });
        }
        Ok(processes)
    }
}

impl Starter {
    fn start(&self, robot: &Entrant, prepared: &Prepared) -> anyhow::Result<Process> {
        let Entrant { name, team, domain, .. } = robot;
        let mut command = Command::new(&self.program);
        command.args(&self.arguments).arg("match-robot").arg(&self.file).arg(name).args(&self.settings);
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
        if let Some(bags) = &self.bags {
            command.arg("--record").arg(bags.join(name));
        }
        for (variable, value) in [("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"), ("DOWNBEAT_LOG", "warn")] {
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
        let mut process = Process { child, started: Instant::now(), input, output: None };
        let screen = self.screen.clone();
        let thread = std::thread::Builder::new().name(name.clone());
        let output = log.map(|log| thread.spawn(move || pass_on(log, &screen))).transpose();
        match output {
            Ok(output) => process.output = output,
            Err(error) => {
                process.end(name, Instant::now());
                return Err(error).with_context(|| format!("cannot start a thread for {name}"));
            }
        }
        Ok(process)
    }
}

impl Process {
    fn ask_to_end(&mut self) {
        self.input = None;
    }

    /// Ends it, in order until the deadline.
    fn end(&mut self, name: &str, deadline: Instant) {
        self.ask_to_end();
        loop {
            match self.child.try_wait() {
                Ok(None) if Instant::now() < deadline => std::thread::sleep(LOOK),
                Ok(Some(status)) => {
                    if !status.success() {
                        tracing::error!("the process of {name} did not end well: {status}");
                    }
                    break;
                }
                Ok(None) | Err(_) => {
                    tracing::error!("the process of {name} did not end in time and was killed");
                    // Without an effect if it has ended since.
                    let _ = self.child.kill();
                    let _ = self.child.wait();
                    break;
                }
            }
        }
        if let Some(output) = self.output.take() {
            let _ = output.join();
        }
    }
}

impl Processes {
    /// A line for each robot: its domain and its process.
    pub(super) fn lines(&self) -> impl Iterator<Item = String> {
        let of_robot = |(robot, entrant): (&Robot, &Entrant)| Some(line(entrant, robot.process.as_ref()?));
        self.robots.iter().zip(&self.prepared.robots).filter_map(of_robot)
    }

    /// Starts processes again that have died, after a pause, and returns the robots whose processes have died
    /// since the last call.
    pub(super) fn tend(&mut self) -> Vec<String> {
        let now = Instant::now();
        let mut died = Vec::new();
        for (robot, entrant) in self.robots.iter_mut().zip(&self.prepared.robots) {
            let name = &entrant.name;
            if robot.starts_again_at.is_some_and(|at| at <= now) {
                match self.starter.start(entrant, &self.prepared) {
                    Ok(process) => {
                        tracing::warn!("started again: {}", line(entrant, &process));
                        (robot.process, robot.starts_again_at) = (Some(process), None);
                    }
                    Err(error) => {
                        robot.wait(name, &format!("cannot be started again: {error:#}"), Duration::ZERO)
                    }
                }
            }
            let Some(process) = &mut robot.process else { continue };
            let (was_asked, end) = match process.child.try_wait() {
                Ok(None) => continue,
                Ok(Some(status)) => (status.success(), format!("has ended: {status}")),
                Err(error) => (false, format!("cannot be watched: {error}")),
            };
            let ran = now.saturating_duration_since(process.started);
            robot.process = None;
            if was_asked {
                tracing::warn!(
                    "the process of {name} has ended in order; it is not started again, and the match goes on"
                );
                continue;
            }
            robot.wait(name, &end, ran);
            died.push(name.clone());
        }
        died
    }
}

impl Robot {
    /// Plans the next process after one that ran for this long.
    fn wait(&mut self, name: &str, what: &str, ran: Duration) {
        let pause = self.restarts.pause_after(ran);
        self.starts_again_at = pause.map(|pause| Instant::now() + pause);
        const GOES_ON: &str = "its servos keep their last goals, and the match goes on";
        match pause {
            Some(pause) => {
                tracing::error!("the process of {name} {what}; {GOES_ON}; it is started again in {pause:?}");
            }
            None => {
                tracing::error!("the process of {name} {what}; {GOES_ON}; it is not started again");
            }
        }
    }
}

impl Drop for Processes {
    fn drop(&mut self) {
        let deadline = Instant::now() + PATIENCE;
        let mut running: Vec<_> = self.robots.iter_mut().zip(&self.prepared.robots).collect();
        // All of them at once, before any is waited for.
        running.iter_mut().filter_map(|(robot, _)| robot.process.as_mut()).for_each(Process::ask_to_end);
        for (robot, entrant) in running {
            if let Some(process) = &mut robot.process {
                process.end(&entrant.name, deadline);
            }
        }
    }
}

fn line(robot: &Entrant, process: &Process) -> String {
    format!("{}  domain {}  process {}", robot.name, robot.domain, process.child.id())
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
