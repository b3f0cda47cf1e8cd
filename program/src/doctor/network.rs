//! What the environment says about networks, and whether this machine is ready for them.

use std::collections::{BTreeMap, BTreeSet};

use downbeat_bridge::middleware::{
    DiscoveryRange, Engine, OptionsError, ParticipantOptions, SOCKET_BUFFER, SecurityOptions,
};

use super::facts::{Facts, Interface};
use super::finding::Finding;
use super::wanted::{ModulePort, Protocol, Wanted};

const AREA: &str = "network";
const KIB: u64 = 1 << 10;
/// Of rmw_zenohd, and of `downbeat router`.
const ROUTER_PORT: u16 = 7447;
/// Variables of other programs, which downbeat does not read: the variable, and what it does to peers.
const OF_OTHERS: [(&str, &str); 5] = [
    ("ROS_DISCOVERY_SERVER", "nodes that use a discovery server are not found by those that do not"),
    ("FASTRTPS_DEFAULT_PROFILES_FILE", "nodes of Fast DDS may use other interfaces or no multicast"),
    ("FASTDDS_DEFAULT_PROFILES_FILE", "nodes of Fast DDS may use other interfaces or no multicast"),
    ("CYCLONEDDS_URI", "nodes of Cyclone DDS may use other interfaces or no multicast"),
    ("RMW_FASTRTPS_USE_QOS_FROM_XML", "nodes of Fast DDS may have another quality of service"),
];

pub(super) fn examine(facts: &Facts, wanted: &Wanted) -> Vec<Finding> {
    let options = ParticipantOptions::from_variables(|name| facts.variables.get(name).cloned());
    let mut findings = match options {
        Ok(options) => joined(&options, facts, wanted),
        Err(error) => vec![refused(&error)],
    };
    findings.extend(OF_OTHERS.iter().filter(|(variable, _)| facts.variables.contains_key(*variable)).map(
        |(variable, effect)| {
            let found = format!("{variable} is set, which downbeat does not read: {effect}");
            Finding::warn(
                AREA,
                found,
                format!("`unset {variable}` where those nodes start, if they are not found"),
            )
        },
    ));
    findings.extend(view_ports(facts, wanted));
    findings.extend(wanted.module_ports.iter().map(|port| module_port(port, facts)));
    findings
}

fn refused(error: &OptionsError) -> Finding {
    Finding::problem(AREA, error.to_string(), "correct the variable, or unset it")
}

/// What the options lead to.
fn joined(options: &ParticipantOptions, facts: &Facts, wanted: &Wanted) -> Vec<Finding> {
    let own = (options.engine, options.domain_id);
    let further = wanted.networks.iter();
    let further = further.map(|(engine, domain)| (engine.unwrap_or(own.0), domain.unwrap_or(own.1)));
    let (zenoh, dds): (BTreeSet<_>, BTreeSet<_>) = [own]
        .into_iter()
        .chain(further)
        .map(|(engine, domain)| (is_zenoh(engine), domain))
        .partition(|(is_zenoh, _)| *is_zenoh);

    let not_honoured = options.not_honoured().into_iter();
    let mut findings: Vec<_> = not_honoured
        .map(|sentence| Finding::warn(AREA, sentence, "correct the variable, or unset it"))
        .collect();
    for (_, domain) in &dds {
        findings.extend(dds_domain(*domain, options.discovery_range, facts));
    }
    if !dds.is_empty() && options.discovery_range != DiscoveryRange::Off {
        findings.extend(interfaces(options.discovery_range, facts));
        findings.extend(buffers(facts));
    }
    if zenoh.is_empty() {
        let unused = facts.variables.keys().filter(|name| name.starts_with("ZENOH_"));
        findings.extend(unused.map(|variable| {
            let found = format!("{variable} has no effect: the robot is in no network of Zenoh");
            Finding::warn(AREA, found, "`export RMW_IMPLEMENTATION=rmw_zenoh_cpp`, or unset it")
        }));
    } else {
        findings.push(zenoh_router(facts));
    }
    findings.extend(options.security.as_ref().map(|security| protection(security, facts)));
    findings
}

/// The variant exists only with the feature.
fn is_zenoh(engine: Engine) -> bool {
    engine.to_string() == "zenoh"
}

fn dds_domain(domain: u16, range: DiscoveryRange, facts: &Facts) -> Vec<Finding> {
    let reach = match range {
        DiscoveryRange::Off => {
            return vec![Finding::ok(AREA, "no DDS: ROS_AUTOMATIC_DISCOVERY_RANGE=OFF")];
        }
        DiscoveryRange::Localhost => "with nodes of this machine only",
        DiscoveryRange::Subnet => "with all nodes of the subnet",
    };
    // RTPS 2.5, 9.6.2.3. Beyond the domains that `ParticipantOptions` accepts there are no ports.
    let base = 7400_u16.saturating_add(domain.saturating_mul(250));
    let ports = (0..120).filter_map(|participant: u16| base.checked_add(10 + 2 * participant));
    let (used, free): (Vec<u16>, Vec<u16>) = ports.partition(|port| facts.udp_ports.contains(port));
    let joins = format!("DDS domain {domain}, {reach}");
    let Some(first_free) = free.first() else {
        let found = format!("{joins}: all ports of its participants are in use");
        let remedy = format!(
            "another domain (`export ROS_DOMAIN_ID=N`), or end the programs that `ss -lunp 'sport >= :{base}'` shows"
        );
        return vec![Finding::problem(AREA, found, remedy)];
    };
    let found = format!(
        "{joins}; UDP ports from {base}, the next one {first_free}, {} in use: a firewall must let them through",
        used.len()
    );
    let mut findings = vec![Finding::ok(AREA, found)];
    if let Some((first, last)) = facts.ephemeral_ports
        && (first..=last).contains(&base)
    {
        let found = format!(
            "the ports of domain {domain} are among those that the system gives to any program ({first} to {last}), which may \
             take them before the robot does"
        );
        findings.push(Finding::warn(AREA, found, "a domain from 0 to 100: `export ROS_DOMAIN_ID=N`"));
    }
    findings
}

fn interfaces(range: DiscoveryRange, facts: &Facts) -> Vec<Finding> {
    if range != DiscoveryRange::Subnet {
        return Vec::new();
    }
    if facts.interfaces.is_empty() {
        let found = "no network interface is up with an IPv4 address: only nodes of this machine are found";
        return vec![Finding::warn(AREA, found, "connect the cable or the Wi-Fi (`ip -brief address`)")];
    }
    let interface = |Interface { name, has_multicast }: &Interface| {
        if *has_multicast {
            return Finding::ok(AREA, format!("{name} is up and has multicast"));
        }
        let found = format!("{name} has no multicast: nodes behind it are not found");
        let remedy = format!(
            "`sudo ip link set dev {name} multicast on`; where the network has none, name the hosts in ROS_STATIC_PEERS"
        );
        Finding::warn(AREA, found, remedy)
    };
    facts.interfaces.iter().map(interface).collect()
}

fn buffers(facts: &Facts) -> Vec<Finding> {
    let wanted = SOCKET_BUFFER as u64;
    let limits = [("net.core.rmem_max", facts.receive_buffer), ("net.core.wmem_max", facts.send_buffer)];
    let limits = limits.into_iter().filter_map(|(name, limit)| Some((name, limit?)));
    let finding = |(name, limit): (&str, u64)| {
        let found = format!("{name} allows socket buffers of {} KiB", limit / KIB);
        if limit >= wanted {
            return Finding::ok(AREA, found);
        }
        let found = format!(
            "{found}, and the DDS engine asks for {}: bursts of large messages are sent again, or lost if best effort",
            wanted / KIB
        );
        let remedy = format!(
            "`echo {name}={wanted} | sudo tee -a /etc/sysctl.d/60-downbeat.conf && sudo sysctl --system`"
        );
        Finding::warn(AREA, found, remedy)
    };
    limits.map(finding).collect()
}

fn zenoh_router(facts: &Facts) -> Finding {
    const CONFIG: &str = "ZENOH_SESSION_CONFIG_URI";
    if facts.dangling.contains(&CONFIG) {
        let file = &facts.variables[CONFIG];
        return Finding::problem(
            AREA,
            format!("{CONFIG}={file} names no file"),
            "correct the path, or unset it",
        );
    }
    if let Some(variable) =
        [CONFIG, "ZENOH_CONFIG_OVERRIDE"].into_iter().find(|variable| facts.variables.contains_key(*variable))
    {
        return Finding::ok(AREA, format!("Zenoh, as {variable} says"));
    }
    if !facts.is_linux || facts.tcp_ports.contains(&ROUTER_PORT) {
        return Finding::ok(AREA, format!("Zenoh, by the router on port {ROUTER_PORT} of this machine"));
    }
    Finding::warn(
        AREA,
        format!(
            "Zenoh, but no router listens on port {ROUTER_PORT} of this machine: no other nodes are found"
        ),
        "`downbeat router` in another terminal, or `ros2 run rmw_zenoh_cpp rmw_zenohd`",
    )
}

fn protection(security: &SecurityOptions, facts: &Facts) -> Finding {
    const KEYSTORE: &str = "ROS_SECURITY_KEYSTORE";
    let refusal = if !cfg!(feature = "security") {
        Some("this program is built without \"security\"".to_owned())
    } else if facts.dangling.contains(&KEYSTORE) {
        Some(format!("{KEYSTORE}={} names no folder", facts.variables[KEYSTORE]))
    } else {
        security.folder().err().map(|error| error.to_string())
    };
    let remedy = "`downbeat security create-keystore` and `create-enclave` make what is needed, docs/security.md says how; or \
                  `unset ROS_SECURITY_ENABLE`";
    match refusal {
        None => Finding::ok(
            AREA,
            format!(
                "protected by the enclave {}; `downbeat check ROBOT.toml` says what it denies",
                security.enclave()
            ),
        ),
        Some(refusal) if security.is_enforced => Finding::problem(
            AREA,
            format!("{refusal}, and ROS_SECURITY_STRATEGY=Enforce lets no robot start"),
            remedy,
        ),
        Some(refusal) => {
            Finding::warn(AREA, format!("{refusal}: the robot joins without protection"), remedy)
        }
    }
}

fn view_ports<'a>(facts: &'a Facts, wanted: &'a Wanted) -> impl Iterator<Item = Finding> + 'a {
    let ports: BTreeMap<u16, &str> = wanted.view_ports.iter().map(|(key, port)| (*port, *key)).collect();
    ports.into_iter().map(move |(port, key)| {
        if !facts.tcp_ports.contains(&port) {
            return Finding::ok(AREA, format!("TCP port {port} of `{key}` in [view] is free"));
        }
        let found = format!("TCP port {port} of `{key}` in [view] is in use");
        let remedy = format!("another port, or end the program that `ss -ltnp 'sport = :{port}'` shows");
        Finding::problem(AREA, found, remedy)
    })
}

fn module_port(ModulePort { module, protocol, port }: &ModulePort, facts: &Facts) -> Finding {
    let (name, option, used) = match protocol {
        Protocol::Tcp => ("TCP", "-ltnp", &facts.tcp_ports),
        Protocol::Udp => ("UDP", "-lunp", &facts.udp_ports),
    };
    if !used.contains(port) {
        return Finding::ok(AREA, format!("{name} port {port} of {module} is free"));
    }
    let remedy = format!(
        "another port in its settings, or end the program that `ss {option} 'sport = :{port}'` shows"
    );
    match protocol {
        Protocol::Tcp => Finding::problem(AREA, format!("{name} port {port} of {module} is in use"), remedy),
        // Sockets with SO_REUSEPORT, such as those of other robots, share it.
        Protocol::Udp => {
            let found = format!(
                "{name} port {port} of {module} is in use: if the other program shares it, each datagram reaches one of \
                 them, else the module cannot listen"
            );
            Finding::warn(AREA, found, remedy)
        }
    }
}
