//! From counts to levels: what has come since the last look decides, so that a warning ends when its cause
//! does.

use crate::expose::{EndpointReport, OfferedService};
use crate::middleware::{Direction, QosPolicyKind, SecurityState};
use downbeat_executor::{ModuleState, ModuleStatistics, Snapshot, TimeStatistics};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticStatus, KeyValue};
use std::fmt::Display;

/// The core and its modules.
pub(super) fn core(node: &str, now: &Snapshot, last: Option<&Snapshot>) -> Vec<DiagnosticStatus> {
    let since = now.uptime_ns.saturating_sub(last.map_or(0, |last| last.uptime_ns)).max(1) as f64 / 1e9;
    let rate =
        |now: u64, last: Option<u64>| format!("{:.1}", now.saturating_sub(last.unwrap_or(0)) as f64 / since);
    let mut values = vec![
        value("cycles", now.cycle),
        value("cycles per second", rate(now.cycle, last.map(|last| last.cycle))),
        value("up, s", now.uptime_ns / 1_000_000_000),
    ];
    values.extend(times("cycle", &now.cycles.total));
    values.extend(times("lateness", &now.cycles.lateness));
    let message = if now.is_paused { "paused" } else { "running" };
    let mut statuses = vec![status(DiagnosticStatus::OK, format!("{node}: core"), message.into(), values)];
    for module in &now.modules {
        let before = last.and_then(|last| last.modules.iter().find(|known| known.name == module.name));
        let (level, message) = level_of_module(module, before);
        let mut values = vec![
            value("state", module.state),
            value("runs", module.runs),
            value("runs per second", rate(module.runs, before.map(|before| before.runs))),
            value("runs past their deadline", module.overruns),
            value("panics", module.panics),
            value("restarts", module.restarts),
            value("messages received", module.received),
            value("messages published", module.published),
        ];
        if module.is_detached {
            values.push(value("messages waiting", module.inbox));
            values.push(value("messages dropped", module.dropped));
        }
        values.extend(times("run", &module.run_time));
        statuses.push(status(level, format!("{node}: module {}", module.name), message, values));
    }
    statuses
}

/// A core that did not answer in a second.
pub(super) fn silent_core(node: &str) -> DiagnosticStatus {
    let message = "the core has not finished a cycle for a second".to_owned();
    status(DiagnosticStatus::STALE, format!("{node}: core"), message, Vec::new())
}

/// One endpoint of the bridge.
pub(super) fn endpoint(node: &str, now: &EndpointReport, last: Option<&EndpointReport>) -> DiagnosticStatus {
    let peers = match now.endpoint.direction {
        Direction::Out => "subscriptions",
        Direction::In => "publishers",
    };
    let gained = |count: fn(&EndpointReport) -> u64| count(now).saturating_sub(last.map_or(0, count));
    let (failed, dropped) = (gained(|report| report.traffic.errors), gained(|report| report.traffic.dropped));
    let (level, message) = if failed > 0 {
        let reason = now.traffic.last_error.as_deref().unwrap_or("unknown");
        (DiagnosticStatus::WARN, format!("{failed} messages failed: {reason}"))
    } else if dropped > 0 {
        (DiagnosticStatus::WARN, format!("{dropped} messages dropped, the bridge is too slow"))
    } else if gained(|report| report.traffic.qos.problems()) > 0 {
        (DiagnosticStatus::WARN, qos_problems(now, last))
    } else {
        (DiagnosticStatus::OK, format!("{} {peers}", now.traffic.matched))
    };
    let values = vec![
        value("type", &now.endpoint.type_name),
        value(peers, now.traffic.matched),
        value("messages", now.traffic.messages),
        value("messages without subscription", now.traffic.skipped),
        value("messages failed", now.traffic.errors),
        value("messages dropped", now.traffic.dropped),
        value("messages lost", now.traffic.qos.lost),
        value("deadlines missed", now.traffic.qos.deadlines_missed),
        value("liveliness lost", now.traffic.qos.liveliness_lost + now.traffic.qos.silences),
        value("incompatible", now.traffic.qos.incompatible),
        value("incompatible types", now.traffic.qos.incompatible_types),
    ];
    let network = on(now.endpoint.network.as_deref());
    status(level, format!("{node}: {}{network}", now.endpoint.ros_topic), message, values)
}

/// One service that is offered to ROS 2.
pub(super) fn service(node: &str, now: &OfferedService, last: Option<&OfferedService>) -> DiagnosticStatus {
    let refused = now.refused.saturating_sub(last.map_or(0, |last| last.refused));
    let (level, message) = match &now.last_refusal {
        Some(reason) if refused > 0 => {
            (DiagnosticStatus::WARN, format!("{refused} requests refused: {reason}"))
        }
        _ => (DiagnosticStatus::OK, format!("{} requests answered", now.answered)),
    };
    let values = vec![
        value("type", now.type_name),
        value("requests answered", now.answered),
        value("requests refused", now.refused),
    ];
    let network = on(now.network.as_deref());
    status(level, format!("{node}: service {}{network}", now.service), message, values)
}

/// The protection of the participant.
pub(super) fn security(node: &str, now: &SecurityState, last: Option<&SecurityState>) -> DiagnosticStatus {
    let refused = now.refused.saturating_sub(last.map_or(0, |last| last.refused));
    let (level, message) = match (now.refusals.last(), now.warnings.first()) {
        (Some(reason), _) if refused > 0 => (DiagnosticStatus::WARN, format!("refused: {reason}")),
        (_, Some(warning)) => (DiagnosticStatus::WARN, warning.clone()),
        _ => (DiagnosticStatus::OK, format!("{} participants authenticated", now.authenticated)),
    };
    let values = vec![
        value("identity", &now.subject),
        value("participants authenticated", now.authenticated),
        value("refused", now.refused),
        value("last refusal", now.refusals.last().map_or("", String::as_str)),
    ];
    status(level, format!("{node}: security"), message, values)
}

/// What distinguishes the same name in a further network.
fn on(network: Option<&str>) -> String {
    network.map(|network| format!(" on {network}")).unwrap_or_default()
}

fn qos_problems(now: &EndpointReport, last: Option<&EndpointReport>) -> String {
    let before = last.map(|last| last.traffic.qos.clone()).unwrap_or_default();
    let counts = &now.traffic.qos;
    let policy = counts.last_incompatible.map_or("", QosPolicyKind::name);
    let problems = [
        (
            counts.incompatible.saturating_sub(before.incompatible),
            format!("endpoints do not match: {policy}"),
        ),
        (
            counts.incompatible_types.saturating_sub(before.incompatible_types),
            "endpoints have another type".to_owned(),
        ),
        (counts.deadlines_missed.saturating_sub(before.deadlines_missed), "deadlines missed".to_owned()),
        (counts.liveliness_lost.saturating_sub(before.liveliness_lost), "times liveliness lost".to_owned()),
        (counts.silences.saturating_sub(before.silences), "publishers not alive".to_owned()),
        (counts.lost.saturating_sub(before.lost), "messages lost".to_owned()),
    ];
    let problems =
        problems.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}"));
    problems.collect::<Vec<_>>().join("; ")
}

fn level_of_module(now: &ModuleStatistics, last: Option<&ModuleStatistics>) -> (u8, String) {
    let gained = |count: fn(&ModuleStatistics) -> u64| count(now).saturating_sub(last.map_or(0, count));
    let (overruns, dropped) = (gained(|module| module.overruns), gained(|module| module.dropped));
    match now.state {
        ModuleState::Failed => return (DiagnosticStatus::ERROR, "stopped by a panic".into()),
        ModuleState::Restarting => {
            return (DiagnosticStatus::ERROR, "stopped by a panic, will start again".into());
        }
        ModuleState::Unconfigured | ModuleState::Inactive | ModuleState::Paused | ModuleState::Finalized => {
            return (DiagnosticStatus::OK, now.state.to_string());
        }
        ModuleState::Active => {}
    }
    let mut problems = Vec::new();
    if gained(|module| module.panics) > 0 {
        problems.push("started again after a panic".to_owned());
    }
    if overruns > 0 {
        problems.push(format!("{overruns} runs past their deadline"));
    }
    if dropped > 0 {
        problems.push(format!("{dropped} messages dropped, it is too slow"));
    }
    if problems.is_empty() {
        (DiagnosticStatus::OK, "running".into())
    } else {
        (DiagnosticStatus::WARN, problems.join("; "))
    }
}

/// In milliseconds; nothing where nothing was measured.
fn times(what: &str, times: &TimeStatistics) -> Vec<KeyValue> {
    if times.count == 0 {
        return Vec::new();
    }
    let parts = [("p50", times.p50_ns), ("p99", times.p99_ns), ("max", times.max_ns)];
    parts.map(|(part, ns)| value(&format!("{what} {part}, ms"), ns as f64 / 1e6)).to_vec()
}

fn status(level: u8, name: String, message: String, values: Vec<KeyValue>) -> DiagnosticStatus {
    DiagnosticStatus { level, name, message, hardware_id: String::new(), values }
}

fn value(key: &str, value: impl Display) -> KeyValue {
    KeyValue { key: key.to_owned(), value: value.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn module(change: impl FnOnce(&mut ModuleStatistics)) -> Snapshot {
        let mut module = ModuleStatistics { name: "walker".into(), ..ModuleStatistics::default() };
        change(&mut module);
        Snapshot { modules: vec![module], ..Snapshot::default() }
    }

    #[test]
    fn a_warning_lasts_as_long_as_its_cause() {
        let level = |now: &Snapshot, last: &Snapshot| {
            let statuses = core("robot", now, Some(last));
            (statuses[1].level, statuses[1].message.clone())
        };
        let fine = module(|_| ());
        let late = module(|module| (module.overruns, module.dropped) = (3, 2));
        assert_eq!(level(&fine, &fine), (DiagnosticStatus::OK, "running".into()));
        let problems = "3 runs past their deadline; 2 messages dropped, it is too slow";
        assert_eq!(level(&late, &fine), (DiagnosticStatus::WARN, problems.into()));
        assert_eq!(level(&late, &late), (DiagnosticStatus::OK, "running".into()));
        let restarted = module(|module| module.panics = 1);
        assert_eq!(level(&restarted, &fine).1, "started again after a panic");
        let failed = module(|module| module.state = ModuleState::Failed);
        assert_eq!(level(&failed, &failed), (DiagnosticStatus::ERROR, "stopped by a panic".into()));
        let paused = module(|module| module.state = ModuleState::Paused);
        assert_eq!(level(&paused, &fine), (DiagnosticStatus::OK, "paused".into()));
    }

    #[test]
    fn refused_requests_of_a_service_are_a_warning_until_the_next_report() {
        let at = |answered, refused| OfferedService {
            service: "/reset".into(),
            network: None,
            type_name: "std_srvs/srv/Empty",
            answered,
            refused,
            last_refusal: (refused > 0).then(|| "it moves".into()),
        };
        let of = |now: &OfferedService, last: Option<&OfferedService>| {
            let status = service("robot", now, last);
            assert_eq!(status.name, "robot: service /reset");
            (status.level, status.message)
        };
        let refused = (DiagnosticStatus::WARN, "2 requests refused: it moves".into());
        assert_eq!(of(&at(3, 2), None), refused);
        assert_eq!(of(&at(3, 2), Some(&at(1, 0))), refused);
        assert_eq!(of(&at(4, 2), Some(&at(3, 2))), (DiagnosticStatus::OK, "4 requests answered".into()));
        let in_fleet = OfferedService { network: Some("fleet".into()), ..at(4, 2) };
        assert_eq!(service("robot", &in_fleet, None).name, "robot: service /reset on fleet");
        let values = service("robot", &at(4, 2), None).values;
        assert!(values.contains(&value("requests refused", 2)), "{values:?}");
    }

    #[test]
    fn rates_are_those_since_the_last_look() {
        let at = |seconds: u64, cycle| Snapshot {
            cycle,
            uptime_ns: seconds * 1_000_000_000,
            ..Snapshot::default()
        };
        let statuses = core("robot", &at(4, 700), Some(&at(2, 500)));
        assert_eq!(statuses[0].name, "robot: core");
        assert!(statuses[0].values.contains(&value("cycles per second", "100.0")), "{statuses:?}");
    }
}
