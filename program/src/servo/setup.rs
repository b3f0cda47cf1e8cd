//! `downbeat servo scan` and `setup`

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use downbeat_servos::servo_bus::protocol::Id;
use downbeat_servos::servo_bus::{Found, ServoError, ServoPort, first_description};

use super::{Asking, BAUDS, described};

/// Lists the devices on a port.
pub(super) fn scan(path: &str, asking: &Asking, last_id: u8) -> anyhow::Result<(ServoPort, Vec<Found>)> {
    let ids: Vec<Id> = (0..=last_id.min(253)).filter_map(Id::new).collect();
    let mut port = asking.open(path)?;
    let mut all = Vec::new();
    for baud in asking.bauds() {
        let found = match port.scan(*baud, asking.protocols(), &ids) {
            Ok(found) => found,
            // Not every port has every speed.
            Err(ServoError::Port(reason)) if asking.baud.is_empty() && *baud != BAUDS[0] => {
                tracing::debug!("skipped {baud} bit/s: {reason}");
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        for found in &found {
            println!("{}", described(found));
        }
        for board in &found {
            if port.withholds_power(board)? {
                println!("{}", without_power(board, path));
            }
        }
        all.extend(found);
    }
    if all.is_empty() {
        bail!(
            "{path}: no device answered; is the power on, is the port the right one, and does nothing else use it?"
        );
    }
    Ok((port, all))
}

/// The only port with servos among those that are there, and the devices on it.
pub(super) fn search(
    devices: &Path,
    asking: &Asking,
    last_id: u8,
) -> anyhow::Result<(ServoPort, Vec<Found>)> {
    let paths = serial_ports(devices);
    if paths.is_empty() {
        bail!(
            "{} has no serial port of an adapter (ttyUSB*, ttyACM*, cu.usb*); plug it in, or name its port: `downbeat servo setup PORT`",
            devices.display()
        );
    }
    let mut with_servos = Vec::new();
    for path in &paths {
        println!("{path}:");
        match scan(path, asking, last_id) {
            // Other devices speak unasked, which no servo does.
            Ok(found) if found.1.iter().any(|found| !found.is_garbled) => with_servos.push(found),
            Ok(_) => {}
            Err(error) => println!("{error:#}"),
        }
    }
    let found: Vec<String> = with_servos.iter().map(|(port, _)| port.path().to_owned()).collect();
    match (with_servos.pop(), &found[..]) {
        (Some(only), [path]) => {
            println!("the servos are on {path}");
            Ok(only)
        }
        (None, _) => bail!(
            "no servo was understood on {}; is the power on, and may the port be opened?",
            paths.join(", ")
        ),
        (Some(_), _) => bail!(
            "servos were found on {}; name the port that is meant, such as `downbeat servo setup {}`",
            found.join(", "),
            found[0]
        ),
    }
}

/// The serial ports of adapters, each once: by the name that it keeps when it is plugged in elsewhere, if it
/// has one.
fn serial_ports(devices: &Path) -> Vec<String> {
    // The last ones are those of macOS, where a port is there twice and tty.* waits for a modem.
    let prefixes = ["ttyUSB", "ttyACM", "cu.usb", "cu.wchusb", "cu.SLAB"];
    let by_id = devices.join("serial/by-id");
    let (mut paths, mut seen) = (Vec::new(), BTreeSet::new());
    for (folder, prefixes) in [(&*by_id, &[""][..]), (devices, &prefixes[..])] {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let mut present: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
        present.sort_unstable();
        for path in present {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            let device = path.canonicalize().unwrap_or_else(|_| path.clone());
            if prefixes.iter().any(|prefix| name.starts_with(prefix)) && seen.insert(device) {
                paths.push(path.display().to_string());
            }
        }
    }
    paths
}

/// Writes a first description of the servos on a port.
pub(super) fn set_up(
    (mut port, found): (ServoPort, Vec<Found>),
    asking: &Asking,
    name: &str,
    output: &Path,
    force: bool,
) -> anyhow::Result<()> {
    let mut problems = 0;
    for found in &found {
        for problem in port.examine(found)? {
            println!("{problem}");
            problems += 1;
        }
    }
    if problems > 0 && !force {
        bail!("{} is not written before that is solved; --force writes it all the same", output.display());
    }
    // A description names them relative to itself.
    let model = |path: &PathBuf| path.canonicalize().map(|path| path.display().to_string());
    let models = asking.model_file.iter().map(model).collect::<Result<Vec<_>, _>>()?;
    // With --force, those that are not understood are left out.
    let found: Vec<Found> = found.into_iter().filter(|found| !found.is_garbled).collect();
    let text = first_description(name, port.path(), &models, &found).map_err(anyhow::Error::msg)?;
    std::fs::write(output, text).with_context(|| format!("cannot write {}", output.display()))?;
    println!(
        "wrote {}. Set the names, zeros, signs and limits of its joints before anything moves: docs/servos.md, \"Zero, sign and limits\"",
        output.display()
    );
    Ok(())
}

/// What to do about servos that cannot answer, since the board before them has switched them off.
fn without_power(board: &Found, path: &str) -> String {
    let Found { id, line, model, .. } = board;
    let remedy = match model {
        Some(_) => format!(
            "`downbeat servo write {path} {id} dynamixel_power 1 --baud {} --protocol {}` switches it on; then scan again",
            line.baud,
            line.protocol.key()
        ),
        // Registers are written by name.
        None => "a robot switches it on with `power` of [[device]] (docs/servos.md)".to_owned(),
    };
    let seems = if model.is_some() { "has" } else { "seems to have" };
    format!("id {id} {seems} switched off the power of the servos behind it, which cannot answer: {remedy}")
}
