//! What a robot file asks of its machine.

use std::net::SocketAddrV4;

use downbeat_bridge::middleware::Engine;
use downbeat_executor::{Core, SettingValue};
use downbeat_robot::{RobotFile, RobotFileError};
use downbeat_servos::servo_bus::Description;

/// What a robot asks of its machine; by default nothing in particular.
#[derive(Debug, Default)]
pub(super) struct Wanted {
    /// Whether there is a robot file that could be read.
    pub(super) is_robot: bool,
    /// The devices that its modules open: path and module.
    pub(super) devices: Vec<(String, String)>,
    /// The highest priority of a thread.
    pub(super) priority: Option<u8>,
    /// Why this machine refuses CPUs or priorities of threads, with what to do.
    pub(super) thread_problems: Vec<String>,
    /// Engine and domain of each further network; `None` for those of the environment.
    pub(super) networks: Vec<(Option<Engine>, Option<u16>)>,
    /// The TCP ports on which viewers must find it, with the keys that say so.
    pub(super) view_ports: Vec<(&'static str, u16)>,
    /// The ports on which its modules receive lines of text.
    pub(super) module_ports: Vec<ModulePort>,
}

/// A port on which a module receives.
#[derive(Debug)]
pub(super) struct ModulePort {
    pub(super) module: String,
    pub(super) protocol: Protocol,
    pub(super) port: u16,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Protocol {
    Tcp,
    Udp,
}

impl Wanted {
    /// What the robot of a file wants.
    ///
    /// # Errors
    /// If the robot cannot be built.
    pub(super) fn of(file: RobotFile) -> Result<Self, RobotFileError> {
        let threads = file.modules.iter().map(|module| module.options().thread.fifo_priority);
        let mut wanted = Self {
            is_robot: true,
            priority: threads.chain([file.launcher.threads.fifo_priority]).max().flatten(),
            thread_problems: file.thread_problems().iter().map(ToString::to_string).collect(),
            networks: file.networks.iter().map(|network| (network.engine, network.domain)).collect(),
            ..Self::default()
        };
        let page = file.view.page.flatten().map(|port| ("page", port));
        wanted.view_ports.extend(page);
        wanted.view_ports.extend(file.view.foxglove.map(|port| ("foxglove", port)));
        wanted.view_ports.retain(|(_, port)| *port != 0);

        let robot = file.on_any_machine().build(Core::new())?;
        for module in &robot.file.modules {
            let settings = robot.core.settings(&module.name).unwrap_or_default();
            let texts = settings.iter().filter_map(|setting| match &setting.value {
                SettingValue::Text(text) => Some((&*setting.name, &**text)),
                _ => None,
            });
            let texts: Vec<_> = texts.collect();
            let port = port_of_lines(module.kind.name(), &texts);
            wanted.module_ports.extend(port.map(|(protocol, port)| ModulePort {
                module: module.name.clone(),
                protocol,
                port,
            }));
            let named = texts.iter().map(|(_, text)| (*text).to_owned());
            let devices = named.chain(port_of_description(&texts)).filter(|text| text.starts_with("/dev/"));
            wanted.devices.extend(devices.map(|path| (path, module.name.clone())));
        }
        Ok(wanted)
    }
}

/// The port on which a module of this kind receives; `None` for one that the system chooses.
fn port_of_lines(kind: &str, settings: &[(&str, &str)]) -> Option<(Protocol, u16)> {
    let value = |name| settings.iter().find(|(setting, _)| *setting == name).map(|(_, value)| *value);
    let (protocol, address) = match kind {
        "tcp_lines" if value("side") == Some("server") => (Protocol::Tcp, value("address")?),
        "udp_lines" => (Protocol::Udp, value("listen")?),
        _ => return None,
    };
    let address: SocketAddrV4 = address.parse().ok()?;
    (address.port() != 0).then_some((protocol, address.port()))
}

/// The port of a servo bus that its settings leave to the description of the servos.
fn port_of_description(settings: &[(&str, &str)]) -> Option<String> {
    let value = |name| settings.iter().find(|(setting, _)| *setting == name).map(|(_, value)| *value);
    let (description, bus, "") = (value("description")?, value("bus")?, value("port")?) else { return None };
    let description = Description::load(description).ok()?;
    Some(description.bus(bus).ok()?.port.clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modules_with_lines_receive_on_the_port_of_their_settings() {
        let server = [("side", "server"), ("address", "0.0.0.0:4012")];
        assert_eq!(port_of_lines("tcp_lines", &server), Some((Protocol::Tcp, 4012)));
        let client = [("side", "client"), ("address", "10.0.0.7:4012")];
        assert_eq!(port_of_lines("tcp_lines", &client), None, "it connects");
        let lines = [("listen", "127.0.0.1:4010"), ("to", "127.0.0.1:4011")];
        assert_eq!(port_of_lines("udp_lines", &lines), Some((Protocol::Udp, 4010)));
        assert_eq!(port_of_lines("udp_lines", &[("listen", "127.0.0.1:0")]), None, "the system chooses it");
        assert_eq!(port_of_lines("servo_bus", &server), None);
    }
}
