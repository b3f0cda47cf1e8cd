//! `downbeat interface`

mod arguments;
mod decode;
mod description;
mod interfaces;
mod list;
mod nearest;
mod packages;
mod show;
mod source_text;
mod structure;

pub(crate) use arguments::InterfaceCommand;

pub(crate) fn interface(command: &InterfaceCommand) -> anyhow::Result<()> {
    match command {
        InterfaceCommand::List(arguments) => list::list(arguments),
        InterfaceCommand::Show(arguments) => show::show(arguments),
        InterfaceCommand::Hash(arguments) => description::hash(arguments),
        InterfaceCommand::Description(arguments) => description::description(arguments),
        InterfaceCommand::Decode(arguments) => decode::decode(arguments),
    }
}
