//! What the page asks of the core.

use super::{Ask, ModuleProfile, PageOptions, Panel};
use crate::options::ViewTime;
use crate::parameters::{settings, typed};
use crate::shared::Shared;
use downbeat_executor::{CoreHandle, CycleTrace, Receipt, Transition};
use serde::Serialize;
use serde_json::{Value, json};
use std::time::Duration;

/// How long the core may take to reach the end of a cycle.
const PATIENCE: Duration = Duration::from_secs(5);

/// How long the cycles of a trace may take.
const PATIENCE_WITH_TRACE: Duration = Duration::from_secs(2);

/// The most cycles of one trace.
const MOST_CYCLES: u64 = 1000;

const NO_ANSWER: &str = "the core does not answer: it has stopped, or a module does not return";

/// Answers a question.
///
/// # Errors
/// In words for the user.
pub(crate) fn answer(shared: &Shared, page: &PageOptions, ask: Ask<'_>) -> Result<Value, String> {
    if let Some(answered) = page.host.as_ref().and_then(|host| host.answer(ask)) {
        return answered;
    }
    if ask.name == "robot" {
        return Ok(robot(shared, page, ask.may_change));
    }
    let core = &shared.source.core()?.handle;
    match ask.name {
        "snapshot" => plain(&core.snapshot().wait(PATIENCE).ok_or(NO_ANSWER)?),
        "graph" => plain(&core.graph().wait(PATIENCE).ok_or(NO_ANSWER)?),
        // Chains are declared in a robot file, whose host answers.
        "latencies" => Ok(Value::Array(Vec::new())),
        "trace" => {
            let cycles =
                ask.arguments.get("cycles").and_then(Value::as_u64).unwrap_or(100).clamp(1, MOST_CYCLES);
            finish(core, &core.trace(u32::try_from(cycles).unwrap_or(1)))
        }
        "settings" => Ok(all_settings(core)?.into()),
        "set" => {
            ask.check_access()?;
            set(core, ask)
        }
        "pause" | "resume" => {
            ask.check_access()?;
            if ask.name == "pause" {
                core.pause()
            } else {
                core.resume()
            }
            Ok(Value::Null)
        }
        "step" => {
            ask.check_access()?;
            // The trace begins before the cycle does.
            let trace = ask.arguments["trace"].as_bool().unwrap_or(false).then(|| core.trace(1));
            core.step();
            trace.map_or(Ok(Value::Null), |trace| finish(core, &trace))
        }
        "lifecycle" => {
            let snapshot = core.snapshot().wait(PATIENCE).ok_or(NO_ANSWER)?;
            let state = |module: &downbeat_executor::ModuleStatistics| json!({ "module": module.name, "state": module.state });
            Ok(snapshot.modules.iter().map(state).collect())
        }
        "transition" => {
            ask.check_access()?;
            let (module, name) = (ask.require_text("module")?, ask.require_text("transition")?);
            let transition = transition(name)?;
            let made = core.transition(module, transition).wait(PATIENCE).ok_or(NO_ANSWER)?;
            made.map(|_| Value::Null).map_err(|error| error.to_string())
        }
        other => Err(format!("nothing here answers the question \"{other}\"")),
    }
}

fn plain(answer: &impl Serialize) -> Result<Value, String> {
    serde_json::to_value(answer).map_err(|error| error.to_string())
}

fn robot(shared: &Shared, page: &PageOptions, may_change: bool) -> Value {
    let module = |(name, profile): (&String, &ModuleProfile)| {
        let ModuleProfile { kind, source, description } = profile;
        (name.clone(), json!({ "kind": kind, "source": source, "description": description }))
    };
    let panel = |panel: &Panel| {
        let Panel { name, title, module, topics, .. } = panel;
        // As the page names them.
        let topics: Vec<String> =
            topics.iter().map(|topic| format!("/{}", topic.trim_start_matches('/'))).collect();
        json!({ "name": name, "title": title, "module": module, "topics": topics, "script": format!("/panels/{name}/panel.js") })
    };
    json!({
        "name": shared.options.name,
        "version": env!("CARGO_PKG_VERSION"),
        "mayChange": may_change,
        "isSimulated": shared.options.time == ViewTime::Core,
        "isBag": shared.source.bag().is_some(),
        "canPause": shared.source.core().is_ok(),
        "modules": page.modules.iter().map(module).collect::<serde_json::Map<_, _>>(),
        "panels": page.panels.iter().map(panel).collect::<Vec<_>>(),
    })
}

/// The trace when its cycles are over, or what it has after a while.
fn finish(core: &CoreHandle, receipt: &Receipt<CycleTrace>) -> Result<Value, String> {
    let cut = || {
        core.finish_trace();
        receipt.wait(PATIENCE)
    };
    let trace: CycleTrace = receipt.wait(PATIENCE_WITH_TRACE).or_else(cut).ok_or(NO_ANSWER)?;
    let events: Vec<_> = trace.events().iter().collect();
    Ok(json!({ "threads": trace.threads().collect::<Vec<_>>(), "events": events }))
}

fn all_settings(core: &CoreHandle) -> Result<Vec<Value>, String> {
    let settings = settings(core, PATIENCE).ok_or(NO_ANSWER)?;
    let described = settings.values().map(|(module, info)| {
        let (kind, value) = typed(&info.value);
        json!({
            "module": module,
            "name": info.name,
            "description": info.description,
            "type": kind,
            "value": value,
            "range": info.range.as_ref().map(|range| [*range.start(), *range.end()]),
            "read_only": info.is_read_only,
        })
    });
    Ok(described.collect())
}

fn set(core: &CoreHandle, ask: Ask<'_>) -> Result<Value, String> {
    let (module, name) = (ask.require_text("module")?, ask.require_text("name")?);
    let settings = settings(core, PATIENCE).ok_or(NO_ANSWER)?;
    let present = settings.get(&format!("{module}.{name}")).ok_or("no module has this setting")?;
    let given = crate::protocol::Parameter {
        name: name.to_owned(),
        value: ask.arguments.get("value").cloned().unwrap_or_default(),
    };
    let value = crate::parameters::wanted(&given, &present.1.value)?;
    let set = core.set(module, name, value).wait(PATIENCE).ok_or(NO_ANSWER)?;
    set.map(|_| Value::Null).map_err(|refused| refused.to_string())
}

fn transition(name: &str) -> Result<Transition, String> {
    Ok(match name {
        "configure" => Transition::Configure,
        "activate" => Transition::Activate,
        "deactivate" => Transition::Deactivate,
        "cleanup" => Transition::Cleanup,
        "shutdown" => Transition::Shutdown,
        _ => {
            return Err(format!(
                "\"{name}\" is no transition; there are configure, activate, deactivate, cleanup, shutdown"
            ));
        }
    })
}
