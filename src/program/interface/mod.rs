//! `downbeat interface`

mod arguments;
mod decode;
mod description;
mod interfaces;
mod list;
mod packages;
mod show;
mod source_text;
mod structure;

pub(crate) use arguments::InterfaceCommand;
pub(super) use arguments::SourceArguments;
pub(super) use interfaces::Interfaces;

use crate::bridge::edge::Interfaces as Registered;
use crate::robot::Catalog;

pub(crate) fn interface(command: &InterfaceCommand, catalog: &Catalog) -> anyhow::Result<()> {
    let registered = &catalog.interfaces;
    match command {
        InterfaceCommand::List(arguments) => list::list(arguments, registered),
        InterfaceCommand::Show(arguments) => show::show(arguments, registered),
        InterfaceCommand::Hash(arguments) => description::hash(arguments, registered),
        InterfaceCommand::Description(arguments) => description::description(arguments, registered),
        InterfaceCommand::Decode(arguments) => decode::decode(arguments, registered),
    }
}
