//! The facts about this machine, and about the user who runs the command.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::str::FromStr;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::system;

/// What was read. What could not be read is `None`, or empty.
#[derive(Clone, Debug, Default)]
pub(super) struct Facts {
    /// Most facts come from folders that only Linux has.
    pub(super) is_linux: bool,
    pub(super) kernel: Option<String>,
    /// Such as "glibc 2.36".
    pub(super) c_library: Option<String>,
    pub(super) is_preempt_rt: bool,
    /// The highest priority of `SCHED_FIFO` that the user may take; 0 for none.
    pub(super) highest_priority: u64,
    /// How much of each second real-time threads may use; negative for all of it.
    pub(super) real_time_runtime_us: Option<i64>,
    /// Of all CPUs, each once.
    pub(super) governors: Vec<String>,
    /// The variables of the environment that concern networks.
    pub(super) variables: BTreeMap<String, String>,
    /// The variables that name a file or folder which does not exist.
    pub(super) dangling: Vec<&'static str>,
    /// The most that a program may ask for, in bytes.
    pub(super) receive_buffer: Option<u64>,
    /// As `receive_buffer`.
    pub(super) send_buffer: Option<u64>,
    /// The interfaces that run and have an IPv4 address, without loopback.
    pub(super) interfaces: Vec<Interface>,
    /// The UDP ports that are bound.
    pub(super) udp_ports: BTreeSet<u16>,
    /// The TCP ports on which a program listens.
    pub(super) tcp_ports: BTreeSet<u16>,
    /// The ports that the system gives to sockets that ask for none: first and last.
    pub(super) ephemeral_ports: Option<(u16, u16)>,
    pub(super) devices: Vec<Device>,
    pub(super) clock: Clock,
    /// The folder in which the command runs, and that of robots that start at boot if it exists, with the
    /// bytes that are free in each.
    pub(super) disks: Vec<(PathBuf, u64)>,
    pub(super) python: Option<Python>,
}

#[derive(Clone, Debug)]
pub(super) struct Interface {
    pub(super) name: String,
    pub(super) has_multicast: bool,
}

#[derive(Clone, Debug)]
pub(super) struct Device {
    pub(super) path: String,
    /// The modules that name it.
    pub(super) modules: Vec<String>,
    pub(super) access: Access,
    /// The latency timer of an FTDI adapter in milliseconds, and its file.
    pub(super) latency: Option<(u32, PathBuf)>,
}

/// Whether the user may open a device.
#[derive(Clone, Debug)]
pub(super) enum Access {
    Granted,
    /// There is no such device.
    Missing,
    /// Only members of a group may. `is_listed` if the user is one, but was none at the login.
    OfGroup {
        group: String,
        is_listed: bool,
    },
    /// No group may.
    OfOwner,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Clock {
    /// Seconds since 1970.
    pub(super) seconds: u64,
    /// How far the clock was set while the facts were read.
    pub(super) jump: Duration,
    pub(super) is_synchronised: Option<bool>,
}

#[derive(Clone, Debug)]
pub(super) struct Python {
    pub(super) version: (u32, u32),
    /// Whether it can import `downbeat`.
    pub(super) has_downbeat: bool,
}

/// Where robots that start at boot write: `StateDirectory` of packaging/systemd/downbeat@.service.
const OF_SERVICE: &str = "/var/lib/downbeat";
/// The variables whose values are files or folders.
const PATHS: [&str; 2] = ["ROS_SECURITY_KEYSTORE", "ZENOH_SESSION_CONFIG_URI"];
const PREFIXES: [&str; 6] = ["RMW_", "ROS_", "ZENOH_", "FASTRTPS_", "FASTDDS_", "CYCLONEDDS_"];
/// How long another program may take to answer.
const PATIENCE: Duration = Duration::from_secs(5);

impl Facts {
    /// Reads the facts, also those of the devices that modules name; `None` for all devices that are present.
    pub(super) fn of_this_machine(named: Option<&[(String, String)]>) -> Self {
        let (clock_before, before) = (SystemTime::now(), Instant::now());
        let is_variable = |name: &str| PREFIXES.iter().any(|prefix| name.starts_with(prefix));
        let variables: BTreeMap<_, _> = std::env::vars_os()
            .filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)))
            .filter(|(name, value)| is_variable(name) && !value.trim().is_empty())
            .collect();
        let is_dangling = |name: &&str| variables.get(*name).is_some_and(|path| !Path::new(path).exists());
        let folders = [std::env::current_dir().unwrap_or_default(), PathBuf::from(OF_SERVICE)];
        let disks = folders.into_iter().filter(|folder| folder.is_dir());
        let mut facts = Self {
            dangling: PATHS.into_iter().filter(is_dangling).collect(),
            variables,
            c_library: answer("getconf", &["GNU_LIBC_VERSION"]),
            highest_priority: system::highest_priority(),
            disks: disks.filter_map(|folder| Some((folder.clone(), system::free_bytes(&folder)?))).collect(),
            devices: devices(Path::new("/"), named),
            interfaces: interfaces(),
            python: python(),
            ..Self::of_system(Path::new("/"))
        };
        let is_synchronised = match answer("timedatectl", &["show", "--property=NTPSynchronized", "--value"])
        {
            Some(answer) => Some(answer == "yes"),
            None => Path::new("/run/systemd/timesync/synchronized").exists().then_some(true),
        };
        let (clock_after, elapsed) = (SystemTime::now(), before.elapsed());
        facts.clock = Clock {
            seconds: clock_after.duration_since(UNIX_EPOCH).unwrap_or_default().as_secs(),
            jump: match clock_after.duration_since(clock_before) {
                Ok(passed) => passed.abs_diff(elapsed),
                Err(backwards) => backwards.duration() + elapsed,
            },
            is_synchronised,
        };
        facts
    }

    /// What the kernel says, in its folders below `root`.
    fn of_system(root: &Path) -> Self {
        let limit = |name| number(&root.join("proc/sys/net/core").join(name));
        let kernel = root.join("proc/sys/kernel");
        let ports = text(&root.join("proc/sys/net/ipv4/ip_local_port_range"));
        let ports = ports.as_deref().and_then(|ports| ports.split_once(char::is_whitespace));
        Self {
            is_linux: cfg!(target_os = "linux"),
            kernel: text(&kernel.join("osrelease")),
            is_preempt_rt: number(&root.join("sys/kernel/realtime")) == Some(1),
            real_time_runtime_us: number(&kernel.join("sched_rt_runtime_us")),
            governors: governors(root),
            receive_buffer: limit("rmem_max"),
            send_buffer: limit("wmem_max"),
            udp_ports: ports_in(root, ["udp", "udp6"], |_| true),
            // The state of a socket that listens, TCP_LISTEN of Linux's tcp_states.h.
            tcp_ports: ports_in(root, ["tcp", "tcp6"], |state| state == "0A"),
            ephemeral_ports: ports
                .and_then(|(first, last)| Some((first.parse().ok()?, last.trim().parse().ok()?))),
            ..Self::default()
        }
    }
}

fn text(path: &Path) -> Option<String> {
    Some(fs::read_to_string(path).ok()?.trim().to_owned())
}

fn number<N: FromStr>(path: &Path) -> Option<N> {
    text(path)?.parse().ok()
}

fn names_in(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<_> = entries.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.sort_unstable();
    names
}

fn governors(root: &Path) -> Vec<String> {
    let folder = root.join("sys/devices/system/cpu");
    let of_cpu = |name: String| text(&folder.join(name).join("cpufreq/scaling_governor"));
    let governors: BTreeSet<_> = names_in(&folder).into_iter().filter_map(of_cpu).collect();
    governors.into_iter().collect()
}

/// The local ports of the sockets in tables of the kernel, whose state is `wanted`.
fn ports_in(root: &Path, tables: [&str; 2], wanted: impl Fn(&str) -> bool) -> BTreeSet<u16> {
    let tables = tables.map(|table| text(&root.join("proc/net").join(table)).unwrap_or_default());
    let port = |line: &str| {
        let mut columns = line.split_whitespace().skip(1);
        let (local, state) = (columns.next()?, columns.nth(1)?);
        let port = u16::from_str_radix(local.rsplit_once(':')?.1, 16).ok()?;
        wanted(state).then_some(port)
    };
    tables.iter().flat_map(|table| table.lines().skip(1).filter_map(port)).collect()
}

fn interfaces() -> Vec<Interface> {
    const MULTICAST: u32 = 0x1000; // IFF_MULTICAST of Linux's if.h
    let found = if_addrs::get_if_addrs().unwrap_or_default().into_iter();
    let found = found.filter(|found| found.ip().is_ipv4() && !found.is_loopback() && found.is_oper_up());
    let names: BTreeSet<String> = found.map(|found| found.name).collect();
    let flags = |name: &str| {
        let flags = text(&Path::new("/sys/class/net").join(name).join("flags"))?;
        u32::from_str_radix(flags.trim_start_matches("0x"), 16).ok()
    };
    // Where the flags cannot be read, the engine finds out.
    let has_multicast = |name: &str| flags(name).is_none_or(|flags| flags & MULTICAST != 0);
    names.into_iter().map(|name| Interface { has_multicast: has_multicast(&name), name }).collect()
}

/// The `named` devices with their modules, or all serial ports and cameras.
fn devices(root: &Path, named: Option<&[(String, String)]>) -> Vec<Device> {
    let mut modules: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (path, module) in named.unwrap_or_default() {
        modules.entry(path.clone()).or_default().push(module.clone());
    }
    if named.is_none() {
        let kinds = ["ttyUSB", "ttyACM", "video"];
        let present = names_in(&root.join("dev")).into_iter();
        let present = present.filter(|name| kinds.iter().any(|kind| name.starts_with(kind)));
        modules.extend(present.map(|name| (format!("/dev/{name}"), Vec::new())));
    }
    let device = |(path, modules): (String, Vec<String>)| {
        let place = root.join(path.trim_start_matches('/'));
        Device { access: access(root, &place), latency: latency(root, &place), path, modules }
    };
    modules.into_iter().map(device).collect()
}

fn access(root: &Path, device: &Path) -> Access {
    let Ok(metadata) = fs::metadata(device) else { return Access::Missing };
    // Joysticks are only read.
    let is_input = device.starts_with(root.join("dev/input"));
    let is_allowed = if is_input { system::may_read(device) } else { system::may_write(device) };
    if is_allowed {
        return Access::Granted;
    }
    let users = text(&root.join("etc/passwd")).unwrap_or_default();
    let groups = text(&root.join("etc/group")).unwrap_or_default();
    let (mode, group) = system::mode_and_group(&metadata);
    refusal(mode, group, &user_name(&users), &groups)
}

/// Why a user may not open a device of this mode and group; `groups` is the text of /etc/group.
fn refusal(mode: u32, group: u32, user: &str, groups: &str) -> Access {
    let mut entries = groups.lines().map(|line| line.split(':').collect::<Vec<_>>());
    let of_group = |entry: &Vec<&str>| entry.get(2).is_some_and(|id| *id == group.to_string());
    match entries.find(of_group) {
        Some(entry) if mode & 0o060 == 0o060 && group != 0 => Access::OfGroup {
            group: entry[0].to_owned(),
            is_listed: entry.get(3).is_some_and(|members| members.split(',').any(|member| member == user)),
        },
        _ => Access::OfOwner,
    }
}

/// The name of the user, in the text of /etc/passwd.
fn user_name(users: &str) -> String {
    let Some(id) = system::user().map(|id| id.to_string()) else { return String::new() };
    let mut users = users.lines().map(|line| line.split(':').collect::<Vec<_>>());
    let user = users.find(|user| user.get(2).is_some_and(|of_user| *of_user == id));
    user.map(|user| user[0].to_owned()).unwrap_or_default()
}

/// Names below /dev/serial are links.
fn latency(root: &Path, device: &Path) -> Option<(u32, PathBuf)> {
    let device = fs::canonicalize(device).ok()?;
    let file = Path::new("/sys/bus/usb-serial/devices").join(device.file_name()?).join("latency_timer");
    Some((number(&root.join(file.strip_prefix("/").ok()?))?, file))
}

fn python() -> Option<Python> {
    let script = "import sys, importlib.util as util\n\
                  print(sys.version_info[0], sys.version_info[1], util.find_spec('downbeat') is not None)";
    let answer = answer("python3", &["-c", script])?;
    let words: Vec<_> = answer.split_whitespace().collect();
    let [major, minor, has_downbeat] = *words else { return None };
    Some(Python { version: (major.parse().ok()?, minor.parse().ok()?), has_downbeat: has_downbeat == "True" })
}

/// What a program prints; `None` if there is none, or it fails, or does not end in time.
fn answer(program: &str, arguments: &[&str]) -> Option<String> {
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
    let mut child = command.spawn().ok()?;
    let end = Instant::now() + PATIENCE;
    let status = loop {
        match child.try_wait().ok()? {
            Some(status) => break status,
            None if Instant::now() >= end => {
                let _ = child.kill();
                let _ = child.wait();
                return None;
            }
            None => std::thread::sleep(Duration::from_millis(5)),
        }
    };
    let mut printed = String::new();
    // Some words, which fit into the pipe.
    child.stdout.take()?.take(4096).read_to_string(&mut printed).ok()?;
    status.success().then(|| printed.trim().to_owned()).filter(|printed| !printed.is_empty())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const GROUPS: &str = "root:x:0:\ndialout:x:20:ann,bob\nvideo:x:44:";

    #[test]
    fn a_device_is_refused_by_its_group_or_by_its_owner() {
        let refused = |mode, group, user| format!("{:?}", refusal(mode, group, user, GROUPS));
        assert_eq!(refused(0o660, 20, "carl"), r#"OfGroup { group: "dialout", is_listed: false }"#);
        assert_eq!(refused(0o660, 20, "bob"), r#"OfGroup { group: "dialout", is_listed: true }"#);
        assert_eq!(refused(0o600, 20, "bob"), "OfOwner");
        assert_eq!(refused(0o660, 0, "bob"), "OfOwner", "nobody should join root");
        assert_eq!(refused(0o660, 7, "bob"), "OfOwner", "a group without a name");
    }

    #[test]
    fn what_the_kernel_says_is_read_from_its_files() {
        let root = tempfile::tempdir().unwrap();
        let write = |path: &str, text: &str| {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        };
        write("proc/sys/kernel/osrelease", "6.1.0-rt\n");
        write("proc/sys/kernel/sched_rt_runtime_us", "-1\n");
        write("proc/sys/net/core/rmem_max", "212992\n");
        write("proc/sys/net/ipv4/ip_local_port_range", "32768\t60999\n");
        write("sys/kernel/realtime", "1\n");
        write("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "powersave\n");
        write("sys/devices/system/cpu/cpu1/cpufreq/scaling_governor", "powersave\n");
        let header = "  sl  local_address rem_address   st\n";
        write("proc/net/udp", &format!("{header}  1: 00000000:1CF2 00000000:0000 07\n"));
        let listens = "  0: 0100007F:1F90 00000000:0000 0A\n  1: 0100007F:2710 0100007F:1F90 01\n";
        write("proc/net/tcp", &format!("{header}{listens}"));
        write("proc/net/tcp6", &format!("{header}  0: {}:1D17 {}:0000 0A\n", "0".repeat(32), "0".repeat(32)));
        let facts = Facts::of_system(root.path());
        assert_eq!(facts.kernel.as_deref(), Some("6.1.0-rt"));
        assert!(facts.is_preempt_rt);
        assert_eq!(facts.real_time_runtime_us, Some(-1));
        assert_eq!((facts.receive_buffer, facts.send_buffer), (Some(212_992), None));
        assert_eq!(facts.ephemeral_ports, Some((32_768, 60_999)));
        assert_eq!(facts.governors, ["powersave"]);
        assert_eq!(facts.udp_ports, [7410].into());
        assert_eq!(facts.tcp_ports, [7447, 8080].into(), "not the connection");
    }

    #[test]
    fn devices_are_those_named_or_those_present_with_the_latency_behind_their_links() {
        let root = tempfile::tempdir().unwrap();
        let (dev, by_id) = (root.path().join("dev"), root.path().join("dev/serial/by-id"));
        let timer = root.path().join("sys/bus/usb-serial/devices/ttyUSB0");
        [&by_id, &timer].into_iter().for_each(|folder| fs::create_dir_all(folder).unwrap());
        fs::write(timer.join("latency_timer"), "16\n").unwrap();
        ["ttyUSB0", "video0", "null"].into_iter().for_each(|name| fs::write(dev.join(name), "").unwrap());
        std::os::unix::fs::symlink("../../ttyUSB0", by_id.join("usb-FTDI")).unwrap();

        let present = devices(root.path(), None);
        assert_eq!(
            present.iter().map(|device| &*device.path).collect::<Vec<_>>(),
            ["/dev/ttyUSB0", "/dev/video0"]
        );

        let named = |path: &str| (path.to_owned(), "hardware".to_owned());
        let named = [named("/dev/serial/by-id/usb-FTDI"), named("/dev/ttyUSB7")];
        let named = devices(root.path(), Some(&named));
        let file = Path::new("/sys/bus/usb-serial/devices/ttyUSB0/latency_timer");
        assert_eq!(named[0].latency, Some((16, file.to_owned())));
        assert_eq!(named[0].modules, ["hardware"]);
        assert!(matches!(named[0].access, Access::Granted));
        assert!(matches!(named[1].access, Access::Missing));
    }

    #[test]
    fn programs_that_are_missing_or_fail_answer_nothing() {
        assert_eq!(answer("echo", &["two words"]).as_deref(), Some("two words"));
        assert_eq!(answer("false", &[]), None);
        assert_eq!(answer("downbeat-is-no-such-program", &[]), None);
    }
}
