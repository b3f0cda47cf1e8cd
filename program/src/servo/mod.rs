//! `downbeat servo`

mod calibrate;
mod description_edit;
mod dialogue;
mod setup;
mod tune;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, bail};
use calibrate::calibrate;
use clap::{Args, Subcommand};
use downbeat_servos::servo_bus::bus::LineSettings;
use downbeat_servos::servo_bus::models::{self, Model, Register};
use downbeat_servos::servo_bus::protocol::{Id, Protocol};
use downbeat_servos::servo_bus::{Caution, Found, ServoError, ServoPort};
use setup::{scan, search, set_up};
use tune::tune;

#[derive(Subcommand)]
pub(crate) enum ServoCommand {
    /// List the devices on a port, in all protocols and at all speeds, or in those that are given.
    Scan {
        #[command(flatten)]
        port: PortArguments,
        /// The last id to ask: those from 0 are asked.
        #[arg(long, value_name = "ID", default_value_t = 253)]
        last_id: u8,
    },
    /// Write a first description of the servos on a port, once all of them answer well.
    Setup {
        /// The serial port, such as /dev/ttyUSB0. Default: the one with servos among all that are there. Each
        /// is asked, so unplug what must not get bytes that it does not understand.
        #[arg(value_name = "PORT")]
        path: Option<String>,
        #[command(flatten)]
        asking: Asking,
        /// The last id to ask: those from 0 are asked.
        #[arg(long, value_name = "ID", default_value_t = 253)]
        last_id: u8,
        /// The name of the robot and its bus.
        #[arg(long, value_name = "NAME", default_value = "arm")]
        name: String,
        /// The file to write. Default: NAME.toml.
        #[arg(short, long, value_name = "FILE")]
        output: Option<PathBuf>,
        /// Write it in any case, and in place of a file that is there.
        #[arg(long)]
        force: bool,
        /// The folder of devices, for emulated ports.
        #[arg(long, value_name = "FOLDER", default_value = "/dev", hide = true)]
        devices: PathBuf,
    },
    /// Find the stops, zeros and signs of joints that are turned by hand, and write them down.
    ///
    /// All joints of the bus lose their torque: hold the robot.
    Calibrate {
        #[command(flatten)]
        of: OfDescription,
        /// How far limits are inside of the stops, in rad.
        #[arg(long, value_name = "RAD", default_value_t = 0.035, value_parser = margin)]
        margin: f64,
    },
    /// Find the offsets of joints by eye, and write them down.
    ///
    /// All joints of the bus get their torque, and go slowly to 0 rad; each is then moved by single steps
    /// until it looks right.
    Tune {
        #[command(flatten)]
        of: OfDescription,
    },
    /// Print what a device is.
    Ping {
        #[command(flatten)]
        port: PortArguments,
        /// The device.
        id: u8,
    },
    /// Print registers of a device, by name; without a name, all.
    Read {
        #[command(flatten)]
        port: PortArguments,
        /// The device.
        id: u8,
        /// Names of registers, such as present_position.
        registers: Vec<String>,
    },
    /// Write a register of a device. What outlives the power, and what makes a joint jump, needs --force.
    Write {
        #[command(flatten)]
        port: PortArguments,
        /// The device.
        id: u8,
        /// The name of the register, such as goal_position.
        register: String,
        /// The raw value, as in the control table.
        #[arg(allow_negative_numbers = true)]
        value: i64,
        /// Write it in any case.
        #[arg(long)]
        force: bool,
    },
    /// Give a device another id.
    SetId {
        #[command(flatten)]
        port: PortArguments,
        /// Its present id.
        id: u8,
        /// Its new id.
        new: u8,
        /// Write it even if another device has that id.
        #[arg(long)]
        force: bool,
    },
}

/// A bus of a description, and who is asked about it.
#[derive(Args)]
pub(crate) struct OfDescription {
    /// The description, as for the kind servo_bus.
    #[arg(value_name = "SERVOS.toml")]
    description: PathBuf,
    /// Which bus, if the description has several.
    #[arg(long, value_name = "NAME", default_value = "")]
    bus: String,
    /// The port in place of that of the description.
    #[arg(long, value_name = "PORT")]
    port: Option<String>,
    /// How long a device may take to answer.
    #[arg(long, value_name = "MS", default_value_t = 10)]
    timeout_ms: u64,
    /// Ask in a browser, in a page at this port; 0 takes a free one.
    #[arg(long, value_name = "PORT")]
    page: Option<u16>,
}

#[derive(Args)]
pub(crate) struct PortArguments {
    /// The serial port, such as /dev/ttyUSB0.
    #[arg(value_name = "PORT")]
    path: String,
    #[command(flatten)]
    asking: Asking,
}

/// How the devices on a port are asked.
#[derive(Args)]
pub(crate) struct Asking {
    /// The speed, in bit/s; may be given more than once. Default: all usual ones.
    #[arg(long, value_name = "BPS")]
    baud: Vec<u32>,
    /// The protocol: dynamixel1, dynamixel2, feetech_sts, feetech_scs; may be given more than once. Default:
    /// all.
    #[arg(long, value_name = "PROTOCOL")]
    protocol: Vec<Protocol>,
    /// How long a device may take to answer.
    #[arg(long, value_name = "MS", default_value_t = 10)]
    timeout_ms: u64,
    /// A file with the registers of a model that is not built in; may be given more than once.
    #[arg(long, value_name = "FILE")]
    model_file: Vec<PathBuf>,
}

/// The speeds of a scan, the most usual first.
const BAUDS: [u32; 9] = [1_000_000, 57_600, 2_000_000, 115_200, 3_000_000, 4_000_000, 500_000, 9_600, 19_200];

pub(crate) fn run(command: ServoCommand) -> anyhow::Result<()> {
    match command {
        ServoCommand::Scan { port, last_id } => scan(&port.path, &port.asking, last_id).map(drop),
        ServoCommand::Setup { path, asking, last_id, name, output, force, devices } => {
            let output = output.unwrap_or_else(|| PathBuf::from(format!("{name}.toml")));
            if output.exists() && !force {
                bail!(
                    "{} exists; name another file with --output, or replace it with --force",
                    output.display()
                );
            }
            let found = match path {
                Some(path) => scan(&path, &asking, last_id)?,
                None => search(&devices, &asking, last_id)?,
            };
            set_up(found, &asking, &name, &output, force)
        }
        ServoCommand::Calibrate { of, margin } => calibrate(&of, margin),
        ServoCommand::Tune { of } => tune(&of),
        ServoCommand::Ping { port, id } => {
            let (_, found) = port.find(id)?;
            println!("{}", described(&found));
            Ok(())
        }
        ServoCommand::Read { port, id, registers } => read(&port, id, &registers),
        ServoCommand::Write { port, id, register, value, force } => {
            let (mut port, found) = port.find(id)?;
            let (_, model) = port.known(found.id)?;
            let register = ServoPort::register(&model, &register)?;
            port.write(found.id, &model, &register, value, caution(force))?;
            println!("{}", shown(&register, value));
            Ok(())
        }
        ServoCommand::SetId { port, id, new, force } => {
            let (mut port, found) = port.find(id)?;
            let new = device(new)?;
            port.set_id(found.id, new, caution(force))?;
            println!("id {id} is now id {new}");
            Ok(())
        }
    }
}

/// The text of a description that is to be changed.
fn text_of(description: &Path) -> anyhow::Result<String> {
    let text = downbeat_msgs::user_file::read_text(description)
        .with_context(|| format!("cannot read {}", description.display()))?;
    if description.extension().is_some_and(|extension| extension == "urdf") {
        bail!(
            "{} is a URDF, and what is found is written into a description in TOML; `downbeat servo setup` writes one",
            description.display()
        );
    }
    Ok(text)
}

fn read(arguments: &PortArguments, id: u8, names: &[String]) -> anyhow::Result<()> {
    let (mut port, found) = arguments.find(id)?;
    let (_, model) = port.known(found.id)?;
    let registers: Vec<Register> = if names.is_empty() {
        model.registers.clone()
    } else {
        names.iter().map(|name| ServoPort::register(&model, name)).collect::<Result<_, _>>()?
    };
    for register in registers {
        let value = port.read(found.id, &register)?;
        println!("{}", shown(&register, value));
    }
    Ok(())
}

impl Asking {
    fn open(&self, path: &str) -> anyhow::Result<ServoPort> {
        let model = |path: &PathBuf| -> anyhow::Result<Arc<Model>> { own_model(path) };
        let own_models = self.model_file.iter().map(model).collect::<anyhow::Result<Vec<_>>>()?;
        Ok(ServoPort::open(path, Duration::from_millis(self.timeout_ms), own_models)?)
    }

    fn protocols(&self) -> &[Protocol] {
        if self.protocol.is_empty() { &Protocol::ALL } else { &self.protocol }
    }

    fn bauds(&self) -> &[u32] {
        if self.baud.is_empty() { &BAUDS } else { &self.baud }
    }

    fn lines(&self) -> Vec<LineSettings> {
        let lines = self.bauds().iter().flat_map(|baud| {
            self.protocols().iter().map(|protocol| LineSettings { baud: *baud, protocol: *protocol })
        });
        lines.collect()
    }
}

impl PortArguments {
    /// Opens the port and finds a device on it.
    fn find(&self, id: u8) -> anyhow::Result<(ServoPort, Found)> {
        let id = device(id)?;
        let mut port = self.asking.open(&self.path)?;
        let (mut unknown, mut garbled) = (None, None);
        for line in self.asking.lines() {
            if let Err(error) = port.speak(line) {
                tracing::debug!("skipped {} bit/s: {error}", line.baud);
                continue;
            }
            match port.identify(id) {
                Ok(Some(found)) if found.model.is_some() => return Ok((port, found)),
                Ok(Some(found)) if unknown.is_none() => unknown = Some(found),
                Ok(_) => {}
                // It may be understood at another speed.
                Err(error @ ServoError::Garbled { .. }) => garbled = garbled.or(Some(error)),
                Err(error) => return Err(error.into()),
            }
        }
        match (unknown, garbled) {
            (Some(found), _) => {
                port.speak(found.line)?;
                Ok((port, found))
            }
            (None, Some(error)) => Err(error.into()),
            (None, None) => bail!(
                "{}: no answer from id {id}; is it powered? `downbeat servo scan {}` lists the devices",
                self.path,
                self.path
            ),
        }
    }
}

fn own_model(path: &Path) -> anyhow::Result<Arc<Model>> {
    let text = downbeat_msgs::user_file::read_text(path)
        .with_context(|| format!("cannot read the model {}", path.display()))?;
    Model::parse(&text).map(Arc::new).with_context(|| path.display().to_string())
}

fn device(raw: u8) -> anyhow::Result<Id> {
    Id::new(raw)
        .filter(|id| id.raw() <= 253)
        .with_context(|| format!("{raw} is no id of a device; ids are 0 to 253"))
}

fn margin(text: &str) -> Result<f64, String> {
    let margin = text.parse().ok().filter(|margin| (0.0..=1.0).contains(margin));
    margin.ok_or_else(|| "a margin is from 0 to 1, in rad".to_owned())
}

fn caution(force: bool) -> Caution {
    if force { Caution::Force } else { Caution::Refuse }
}

fn described(found: &Found) -> String {
    if found.is_garbled {
        return format!(
            "id {}: what comes at {} bit/s is not understood: two servos may have this id. Connect one at a time, and give each its own \
             with `downbeat servo set-id`",
            found.id, found.line.baud
        );
    }
    let model = match (&found.model, found.number) {
        (Some(model), _) => model.name.clone(),
        (None, Some(number)) => format!("unknown model {number}"),
        (None, None) => "unknown model".to_owned(),
    };
    let firmware = found.firmware.map_or_else(String::new, |firmware| format!(", firmware {firmware}"));
    format!("id {}: {model}{firmware}, {} at {} bit/s", found.id, found.line.protocol.key(), found.line.baud)
}

fn shown(register: &Register, value: i64) -> String {
    let access = match register.access {
        models::Access::Read => "read",
        models::Access::Ram => "ram",
        models::Access::Eeprom => "eeprom",
    };
    let si = if register.unit.is_empty() || register.unit == "1" && value == 0 {
        String::new()
    } else {
        format!("  {:.4} {}", register.to_si(value), register.unit)
    };
    format!("{:<28} {value:>8}  {access:<6}{si}", register.name)
}
