//! `downbeat interface decode`

use std::io::{IsTerminal, Read};
use std::path::Path;

use anyhow::{Context, bail};

use super::interfaces::{Definition, Interfaces};
use super::{DecodeArguments, Registered};
use downbeat_msgs::definitions::TypeName;
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType, YamlStyle};
use downbeat_msgs::user_file;

/// More than DDS and bags permit for one message.
const MOST_BYTES: u64 = 1 << 30;

pub(super) fn decode(arguments: &DecodeArguments, registered: &Registered) -> anyhow::Result<()> {
    let interfaces = Interfaces::load(&arguments.source, registered)?;
    let name = interfaces.named(&arguments.name)?;
    check_is_message(&interfaces, &name)?;
    let of = DynamicType::new(&interfaces.catalog, &name)?;
    let (bytes, origin) = match arguments.file.as_deref() {
        Some(path) => (read_file(path)?, path.display().to_string()),
        None => (read_standard_input()?, "standard input".to_owned()),
    };
    let message =
        DynamicMessage::from_cdr(&of, &bytes).with_context(|| format!("{origin} is not a {name} in CDR"))?;
    if arguments.json {
        println!("{}", message.to_json());
    } else {
        print!("{}", message.to_yaml(&YamlStyle::default()));
    }
    Ok(())
}

/// Services and actions cannot be serialised, only their parts can.
fn check_is_message(interfaces: &Interfaces, name: &TypeName) -> anyhow::Result<()> {
    let (what, parts): (_, &[&str]) = match interfaces.find(name)? {
        Definition::Message(_) => return Ok(()),
        Definition::Service(_) => ("a service", &["_Request", "_Response", "_Event"]),
        Definition::Action(_) => ("an action", &["_Goal", "_Result", "_Feedback", "_FeedbackMessage"]),
    };
    let parts: Vec<String> = parts.iter().map(|suffix| name.with_suffix(suffix).to_string()).collect();
    bail!("{name} is {what}, of which only the messages can be decoded: use one of {}", parts.join(", "))
}

fn read_file(path: &Path) -> anyhow::Result<Vec<u8>> {
    let context = || format!("cannot read {}", path.display());
    read(user_file::open(path).with_context(context)?).with_context(context)
}

fn read_standard_input() -> anyhow::Result<Vec<u8>> {
    let input = std::io::stdin();
    if input.is_terminal() {
        bail!("provide the bytes of the message through a pipe or --file: standard input is a terminal");
    }
    read(input.lock()).context("cannot read standard input")
}

fn read(from: impl Read) -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    from.take(MOST_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > MOST_BYTES {
        bail!("the input exceeds {MOST_BYTES} bytes, the maximum size of a message");
    }
    Ok(bytes)
}
