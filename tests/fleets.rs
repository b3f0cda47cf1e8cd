//! What `docs/fleets.md` shows of several robots: certificates, access control, two sites. The files are
//! those of the page, with other addresses.
#![cfg(feature = "zenoh")]
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::program::{Program, Way};
use common::{downbeat, recorded_messages, robot_file, wait_until};
use rustix::process::Signal;
use std::fs::File;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Output};
use test_machine::{free_domain, has_program, missing};

const PAGE: &str = include_str!("../docs/fleets.md");

/// What a block of the page holds; its first line names the file.
fn file_of_the_page(name: &str) -> String {
    let (_, block) = PAGE.split_once(&format!("// {name}\n")).unwrap();
    block.split("```").next().unwrap().to_owned()
}

fn free_port() -> u16 {
    TcpListener::bind(("127.0.0.1", 0)).unwrap().local_addr().unwrap().port()
}

/// A folder with certificates, as the page makes them, and a domain.
struct Site {
    folder: tempfile::TempDir,
    domain: u16,
}

impl Site {
    fn new() -> Option<Self> {
        if !has_program("openssl") {
            missing("openssl", "Debian: the package openssl");
            return None;
        }
        let site = Self { folder: tempfile::tempdir().unwrap(), domain: free_domain() };
        site.make_certificates("");
        Some(site)
    }

    /// Runs the lines of the page, for its hosts and for `localhost`, in a folder below.
    fn make_certificates(&self, below: &str) {
        let folder = self.path(below);
        std::fs::create_dir_all(&folder).unwrap();
        let lines = PAGE.split("```sh\n").find(|block| block.starts_with("openssl")).unwrap();
        let lines =
            lines.split("```").next().unwrap().replace("DNS:$name.local", "DNS:$name.local,DNS:localhost");
        let output = Command::new("sh").args(["-e", "-c", &lines]).current_dir(folder).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.folder.path().join(name)
    }

    /// Writes a file of the page, with `localhost` and a port in place of its addresses.
    fn write(&self, name: &str, port: u16) -> std::path::PathBuf {
        let text = file_of_the_page(name);
        let text =
            text.replace("tls/[::]:7447", "tls/localhost:7447").replace("base.local:7447", "localhost:7447");
        let text = text
            .replace(":7447", &format!(":{port}"))
            .replace("/etc/fleet/", &format!("{}/", self.folder.path().display()));
        let path = self.path(name);
        std::fs::write(&path, text).unwrap();
        path
    }

    /// A command of somebody, with a configuration of sessions.
    fn command(&self, line: &[&str], session: &Path) -> Command {
        let mut command = downbeat(line);
        command.env("ROS_DOMAIN_ID", self.domain.to_string()).env("ZENOH_SESSION_CONFIG_URI", session);
        command
    }

    fn router(&self, file: &Path) -> Program {
        let mut command = downbeat(&["router"]);
        command.env("ZENOH_ROUTER_CONFIG_URI", file);
        let router = Program::start(command);
        router.wait_for_output("listens on");
        router
    }
}

fn output(command: &mut Command) -> String {
    let Output { stdout, stderr, .. } = command.output().unwrap();
    [stdout, stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).concat()
}

const FLEET: &str = r#"
[networks.fleet]
engine = "zenoh"
config = "robot_1.json5"
out = ["battery_state", { topic = "joint_states", as = "/robot_2/joint_states", rate_hz = 5.0 }]
in = [{ topic = "plan", as = "/fleet/plan", type = "std_msgs/msg/String", raw = true }]
"#;

#[test]
fn certificates_and_rules_of_the_page_let_a_robot_do_what_it_may_and_no_more() {
    let Some(site) = Site::new() else { return };
    let port = free_port();
    let [base_router, base, robot] =
        ["base_router.json5", "base.json5", "robot_1.json5"].map(|name| site.write(name, port));
    let router = site.router(&base_router);
    router.wait_for_output("access control is on");
    let robot_file = robot_file(site.folder.path(), |text| {
        let text = text.replacen("[robot]\n", "[robot]\nnamespace = \"/robot_1\"\n", 1);
        format!("{text}\n{FLEET}")
    });
    let bag = site.path("bag");
    let mut command = downbeat(&["run", robot_file.to_str().unwrap(), "--record", bag.to_str().unwrap()]);
    let mut running = Program::start({
        command.env("ROS_DOMAIN_ID", site.domain.to_string());
        command
    });
    running.wait_for_output("joined network fleet");
    let of_base = |line: &[&str]| output(&mut site.command(line, &base));
    wait_until("the base sees the robot", || {
        of_base(&["topic", "list", "--engine", "zenoh"]).contains("/robot_1/battery_state")
    });
    let battery = of_base(&["topic", "echo", "--engine", "zenoh", "--once", "/robot_1/battery_state"]);
    assert!(battery.contains("voltage:"), "{battery}");

    // The robot sees the graph. It may not publish in another robot's namespace, nor orders for all.
    let topics =
        output(&mut site.command(&["topic", "list", "--engine", "zenoh", "--spin-time", "2"], &robot));
    assert!(topics.contains("/robot_1/battery_state"), "{topics}");
    for (topic, message_type, control, forbidden) in [
        ("/robot_2/joint_states", "sensor_msgs/msg/JointState", "{name: [first]}", "head_tilt"),
        ("/fleet/plan", "std_msgs/msg/String", "{data: first}", "data: no"),
    ] {
        let echo = ["topic", "echo", "--engine", "zenoh", topic, message_type];
        let heard = Program::start(site.command(&echo, &base));
        let say = |said: &str, wanted: &str, config: &Path| {
            let line =
                ["topic", "pub", "--engine", "zenoh", "--times", "20", "-w", wanted, "-r", "10", topic];
            output(site.command(&line, config).args([message_type, said]))
        };
        say(control, "1", &base);
        wait_until("the base hears itself", || heard.output().contains("first"));
        if topic == "/fleet/plan" {
            // It is not told that somebody listens, which it could wait for.
            say("{data: no}", "0", &robot);
        }
        say(&control.replace("first", "last"), "1", &base);
        wait_until("the base hears what comes after", || heard.output().contains("last"));
        assert!(!heard.output().contains(forbidden), "{}", heard.output());
    }
    running.ask(Way::Signal(Signal::INT));
    assert!(running.wait().success(), "{}", running.output());
    assert!(recorded_messages(&bag, "/plan") > 0, "the robot has the orders of the base");
}

#[test]
fn who_has_no_certificate_of_the_fleet_is_refused_and_told_where_to_look() {
    let Some(site) = Site::new() else { return };
    site.make_certificates("stranger");
    let port = free_port();
    let _router = site.router(&site.write("base_router.json5", port));
    let base = std::fs::read_to_string(site.write("base.json5", port)).unwrap();
    let endpoint = format!("tls/localhost:{port}");
    let folder = site.folder.path().display().to_string();
    for (name, changed) in [
        // Signed by another authority.
        ("stranger.json5", base.replace(&format!("{folder}/base"), &format!("{folder}/stranger/base"))),
        // Does not believe the router.
        (
            "unbelieving.json5",
            base.replace(&format!("{folder}/ca.pem"), &format!("{folder}/stranger/ca.pem")),
        ),
        ("missing.json5", base.replace("base_key.pem", "no_key.pem")),
    ] {
        std::fs::write(site.path(name), changed).unwrap();
        let list = ["topic", "list", "--connect", &endpoint];
        let text = output(&mut site.command(&list, &site.path(name)));
        assert!(text.contains(&format!("no Zenoh router answers at {endpoint}")), "{name}: {text}");
        assert!(text.contains("transport/link/tls") && !text.contains(".rs:"), "{name}: {text}");
    }
    let text =
        output(&mut site.command(&["topic", "list", "--connect", &endpoint], &site.path("base.json5")));
    assert!(!text.contains("no Zenoh router"), "{text}");
}

#[test]
fn a_robot_is_seen_from_the_other_site() {
    let Some(site) = Site::new() else { return };
    let [of_base, of_site] = [free_port(), free_port()];
    let _base = site.router(&site.write("base_router.json5", of_base));
    let file = site.write("site_router.json5", of_base);
    let text = std::fs::read_to_string(&file).unwrap();
    std::fs::write(&file, text.replace(&format!("tcp/[::]:{of_base}"), &format!("tcp/127.0.0.1:{of_site}")))
        .unwrap();
    let _site = site.router(&file);
    let robot = robot_file(site.folder.path(), |text| {
        text.replacen("[robot]\n", "[robot]\nnamespace = \"/site_2/robot_7\"\n", 1)
    });
    let mut command = downbeat(&["run", robot.to_str().unwrap(), "--engine", "zenoh"]);
    command.env("ROS_DOMAIN_ID", site.domain.to_string());
    command.env("ZENOH_CONFIG_OVERRIDE", format!("connect/endpoints=[\"tcp/127.0.0.1:{of_site}\"]"));
    let running = Program::start(command);
    let base = site.write("base.json5", of_base);
    let looks = |line: &[&str]| output(&mut site.command(line, &base));
    wait_until("the base sees the robot", || {
        looks(&["topic", "list", "--engine", "zenoh"]).contains("/site_2/robot_7/imu/data_raw")
    });
    let states = looks(&["topic", "echo", "--engine", "zenoh", "--once", "/site_2/robot_7/joint_states"]);
    assert!(states.contains("head_tilt"), "{states} {}", running.output());
}

#[test]
fn a_configuration_that_is_none_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("router.json5");
    std::fs::write(&file, "{ mode: \"router\", listen: { endpoints: [").unwrap();
    let named = format!("={}: ", file.display());
    for (variable, line) in [
        ("ZENOH_ROUTER_CONFIG_URI", &["router"][..]),
        ("ZENOH_SESSION_CONFIG_URI", &["topic", "list", "--engine", "zenoh"]),
    ] {
        let text = output(downbeat(line).env(variable, &file));
        assert!(text.contains(&format!("{variable}{named}")), "{text}");
    }
}

/// Answers every connection with something that no router of this version says.
fn stranger() -> u16 {
    let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
    let port = listener.local_addr().unwrap().port();
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let mut stream = stream;
            let mut hello = [0; 64];
            // An acknowledgement with another version in the byte after the header, then nothing.
            let _ = stream.read(&mut hello);
            let _ = stream.write_all(&[6, 0, 0x21, 0x7f, 0, 0, 0, 0]);
        }
    });
    port
}

#[test]
fn a_robot_goes_on_beside_a_router_of_another_version() {
    let (port, domain, folder) = (stranger(), free_domain().to_string(), tempfile::tempdir().unwrap());
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let text = output(downbeat(&["topic", "list", "--connect", &endpoint]).env("ROS_DOMAIN_ID", &domain));
    assert!(text.contains(&format!("no Zenoh router answers at {endpoint}")), "{text}");
    let fleet = format!(
        "[networks.fleet]\nengine = \"zenoh\"\nconnect = \"{endpoint}\"\nout = [\"battery_state\"]\n"
    );
    let robot = robot_file(folder.path(), |text| format!("{text}\n{fleet}"));
    let mut command = downbeat(&["run", robot.to_str().unwrap()]);
    command.env("ROS_DOMAIN_ID", &domain);
    let running = Program::start(command);
    running.wait_for_output("no Zenoh router is there");
    let list = || output(downbeat(&["topic", "list"]).env("ROS_DOMAIN_ID", &domain));
    wait_until("the robot runs", || list().contains("/battery_state"));
}

#[test]
fn a_router_whose_log_finds_no_room_goes_on() {
    let Ok(full) = File::options().write(true).open("/dev/full") else { return };
    let (port, domain) = (free_port(), free_domain().to_string());
    let mut command = downbeat(&["router"]);
    command.env("ZENOH_CONFIG_OVERRIDE", format!("listen/endpoints=[\"tcp/127.0.0.1:{port}\"]"));
    let mut router = command.stderr(full.try_clone().unwrap()).stdout(full).spawn().unwrap();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let list = || output(downbeat(&["topic", "list", "--connect", &endpoint]).env("ROS_DOMAIN_ID", &domain));
    wait_until("the router answers", || !list().contains("no Zenoh router"));
    assert!(router.try_wait().unwrap().is_none());
    router.kill().unwrap();
    router.wait().unwrap();
}
