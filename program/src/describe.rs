//! `downbeat describe`

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Context;
use serde_json::json;

use super::cli::DescribeArguments;
use downbeat_executor::SettingValue;
use downbeat_msgs::definitions::suggestion;
use downbeat_robot::features::{built_without, missing_kind, missing_kinds};
use downbeat_robot::parameters::setting_value;
use downbeat_robot::{
    Catalog, KindProfile, ModuleSource, PROFILE_SCHEMA, PortKind, PortRole, RobotFile, RosArgs, Runs,
    SettingProfile,
};

pub(crate) fn describe(
    arguments: &DescribeArguments,
    catalog: &Catalog,
    ros: &RosArgs,
) -> anyhow::Result<()> {
    let profiles = match &arguments.robot {
        Some(robot) => of_robot(robot, &arguments.kinds, catalog, ros)?,
        None => of_kinds(arguments, catalog)?,
    };
    if arguments.json {
        let kinds: Vec<_> = profiles.iter().map(|(_, profile)| profile).collect();
        let missing: Vec<_> = missing_kinds(catalog)
            .into_iter()
            .map(|(kind, feature)| json!({ "kind": kind, "feature": feature, "reason": built_without(feature) }))
            .collect();
        let mut json = json!({ "schema": PROFILE_SCHEMA, "kinds": kinds, "missing": missing });
        if arguments.robot.is_some() {
            let modules = profiles.iter().map(|(name, profile)| json!({ "name": name, "profile": profile }));
            json = json!({ "schema": PROFILE_SCHEMA, "modules": modules.collect::<Vec<_>>() });
        }
        println!("{json:#}");
        return Ok(());
    }
    for (position, (name, profile)) in profiles.iter().enumerate() {
        if position > 0 {
            println!();
        }
        print(name, profile);
    }
    if arguments.robot.is_none() && arguments.kinds.is_empty() {
        print_missing_kinds(catalog);
    }
    Ok(())
}

/// Prints the kinds that programs with more features have.
pub(super) fn print_missing_kinds(catalog: &Catalog) {
    let missing = missing_kinds(catalog);
    if !missing.is_empty() {
        println!("\nnot in this program");
    }
    for (kind, feature) in missing {
        println!("  {kind:<24} {}", built_without(feature));
    }
}

fn of_kinds(arguments: &DescribeArguments, catalog: &Catalog) -> anyhow::Result<Vec<(String, KindProfile)>> {
    let names: Vec<String> = match arguments.kinds.as_slice() {
        [] => catalog.kinds().map(|kind| kind.name().to_owned()).collect(),
        names => names.to_vec(),
    };
    anyhow::ensure!(
        arguments.set.is_empty() || names.len() == 1,
        "-p is for one kind: name the kind that it is for"
    );
    names
        .into_iter()
        .map(|name| {
            let kind = catalog.kind(&name).with_context(|| {
                let hint = match missing_kind(&name) {
                    Some(reason) => format!(": {reason}"),
                    None => suggestion(&name, catalog.kinds().map(|kind| kind.name())),
                };
                format!("there is no kind \"{name}\"{hint}")
            })?;
            let given =
                arguments.set.iter().map(|text| given(text)).collect::<anyhow::Result<BTreeMap<_, _>>>()?;
            let keys = kind.keys().concat();
            let (keys, settings): (BTreeMap<_, _>, BTreeMap<_, _>) =
                given.into_iter().partition(|(name, _)| keys.contains(&name.as_str()));
            let mut source = ModuleSource::new(name.clone(), "");
            source.keys = keys;
            let profile = catalog.profile(&name, &settings, &source);
            profile
                .map(|profile| (name.clone(), profile))
                .with_context(|| format!("there is no kind \"{name}\""))
        })
        .collect()
}

/// The modules of a robot file, with their settings; those that are named, if some are.
fn of_robot(
    path: &Path,
    names: &[String],
    catalog: &Catalog,
    ros: &RosArgs,
) -> anyhow::Result<Vec<(String, KindProfile)>> {
    let file = RobotFile::read_with(path, catalog, ros)?;
    let is_meant =
        |name: &str, kind: &str| names.is_empty() || names.iter().any(|meant| meant == name || meant == kind);
    for name in names {
        anyhow::ensure!(
            file.modules.iter().any(|module| module.name == *name || module.kind.name() == name),
            "{} has no module \"{name}\", and none of that kind",
            path.display()
        );
    }
    let modules = file.modules.iter().filter(|module| is_meant(&module.name, module.kind.name()));
    let profile = |module: &downbeat_robot::ModuleEntry| {
        let settings = module.options().settings;
        let profile = catalog.profile(module.kind.name(), &settings, &module.source);
        profile.map(|profile| (module.name.clone(), profile))
    };
    Ok(modules.filter_map(profile).collect())
}

/// Reads NAME:=VALUE, the value in YAML as with `downbeat run`.
fn given(text: &str) -> anyhow::Result<(String, SettingValue)> {
    let (name, value) =
        text.split_once(":=").with_context(|| format!("-p {text}: write NAME:=VALUE, the value in YAML"))?;
    let value = serde_norway::from_str(value).with_context(|| format!("-p {text}: this is no YAML"))?;
    let value = setting_value(&value).map_err(|problem| anyhow::anyhow!("-p {text}: {problem}"))?;
    Ok((name.trim().to_owned(), value))
}

fn print(name: &str, profile: &KindProfile) {
    let KindProfile {
        kind,
        about,
        is_emulated,
        uses_device,
        runs,
        periods_s,
        keys,
        settings,
        ports,
        panel,
        needs,
    } = profile;
    let of_kind = if name == kind { String::new() } else { format!(" ({kind})") };
    println!("{name}{of_kind}: {about}");
    let runs = match runs {
        Runs::WhenDue => "runs in cycles in which it has work",
        Runs::EveryCycle => "runs in every cycle",
        Runs::Detached => "runs detached, on its own thread",
    };
    let mut facts = vec![runs.to_owned()];
    facts.extend(periods_s.iter().map(|period| format!("has a timer of {period} s")));
    facts.extend(uses_device.then(|| "drives a device".to_owned()));
    facts.extend(is_emulated.then(|| "its data is emulated".to_owned()));
    println!("  {}", facts.join("; "));
    for key in keys {
        println!("  key      {}{}", key.name, if key.is_required { " (required)" } else { "" });
    }
    for SettingProfile {
        name,
        description,
        value_type,
        default,
        range,
        choices,
        is_required,
        is_read_only,
        ..
    } in settings
    {
        let default = match default {
            _ if *is_required => " (required)".to_owned(),
            Some(value) => format!(" = {value}"),
            None => String::new(),
        };
        let mut notes = vec![(*value_type).to_owned()];
        notes.extend(range.map(|[least, most]| format!("{least} to {most}")));
        notes.extend((!choices.is_empty()).then(|| choices.join(" | ")));
        notes.extend(is_read_only.then(|| "read-only".to_owned()));
        println!("  setting  {name}{default}   [{}] {description}", notes.join(", "));
    }
    for port in ports {
        let role = match (port.role, port.what) {
            (PortRole::Publishes, _) => "publishes",
            (PortRole::Subscribes, _) => "subscribes",
            (PortRole::Serves, PortKind::Action) => "serves action",
            (PortRole::Calls, PortKind::Action) => "calls action",
            (PortRole::Serves, _) => "serves",
            (PortRole::Calls, _) => "calls",
        };
        println!("  {role:<13} {:<32} {}", port.name, port.type_name);
    }
    if let Some(panel) = panel {
        println!("  panel    {}: {}", panel.title, panel.topics.join(", "));
    }
    if let Some(needs) = needs {
        println!("  its ports are not known: {needs}");
    }
}
