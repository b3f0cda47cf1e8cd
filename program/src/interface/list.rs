//! `downbeat interface list`

use serde::Serialize;

use super::interfaces::Interfaces;
use super::{ListArguments, Registered};
use downbeat_msgs::definitions::{Kind, TypeName};

pub(super) fn list(arguments: &ListArguments, registered: &Registered) -> anyhow::Result<()> {
    let interfaces = Interfaces::load(&arguments.source, registered)?;
    arguments.packages.iter().try_for_each(|package| interfaces.check_package(package))?;
    let mut names = interfaces.names();
    names.retain(|name| {
        let is_of_package = arguments.packages.is_empty() || arguments.packages.contains(&name.package);
        is_of_package && is_chosen(arguments, name.kind) && (arguments.all || interfaces.is_whole(name))
    });
    if arguments.json {
        let listed = names.iter().map(|name| {
            let origin = interfaces.find(name)?.origin().to_owned();
            Ok(Listed { type_name: name.to_string(), origin })
        });
        println!("{}", serde_json::to_string_pretty(&listed.collect::<anyhow::Result<Vec<_>>>()?)?);
        return Ok(());
    }
    for (heading, kind) in
        [("Messages", Kind::Message), ("Services", Kind::Service), ("Actions", Kind::Action)]
    {
        if is_chosen(arguments, kind) {
            println!("{heading}:");
            of_kind(&names, kind).for_each(|name| println!("    {name}"));
        }
    }
    Ok(())
}

#[derive(Serialize)]
struct Listed {
    type_name: String,
    origin: String,
}

fn is_chosen(arguments: &ListArguments, kind: Kind) -> bool {
    let &ListArguments { only_msgs, only_srvs, only_actions, .. } = arguments;
    match kind {
        _ if !(only_msgs || only_srvs || only_actions) => true,
        Kind::Message => only_msgs,
        Kind::Service => only_srvs,
        Kind::Action => only_actions,
    }
}

fn of_kind(names: &[TypeName], kind: Kind) -> impl Iterator<Item = &TypeName> {
    names.iter().filter(move |name| name.kind == kind)
}
