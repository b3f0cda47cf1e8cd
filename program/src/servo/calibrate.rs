//! `downbeat servo calibrate`

use std::path::Path;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use downbeat_msgs::user_file;
use downbeat_servos::servo_bus::{Calibrator, Description, TurnedJoint, ZeroPose};

use super::description_edit::with_calibration;
use crate::input;
use crate::screen::Screen;
use crate::stop::Stop;

/// How often the table on the screen changes.
const REFRESH: Duration = Duration::from_millis(100);

/// The characters between the stops of a joint on the screen.
const BAR: usize = 30;

pub(super) struct Options<'a> {
    pub(super) description: &'a Path,
    pub(super) bus: &'a str,
    /// In place of that of the description.
    pub(super) port: Option<&'a str>,
    pub(super) timeout: Duration,
    pub(super) margin_rad: f64,
}

/// Leads through the calibration of a bus, and writes what was found into its description.
pub(super) fn calibrate(options: &Options) -> anyhow::Result<()> {
    let path = options.description;
    let text = user_file::read_text(path).with_context(|| format!("cannot read {}", path.display()))?;
    let description = Description::load(&path.to_string_lossy())?;
    if path.extension().is_some_and(|extension| extension == "urdf") {
        bail!(
            "{} is a URDF, and calibration is written into a description in TOML; `downbeat servo setup` writes one",
            path.display()
        );
    }
    let plan = description.bus(options.bus)?;
    let mut dialogue = Dialogue { stop: Stop::new()?, lines: input::lines()?, screen: Screen::of_process() };
    println!("All joints of \"{}\" lose their torque now. Hold the robot, and press Enter.", plan.name);
    dialogue.answer(|| Ok(Vec::new()))?;
    let mut bus = Calibrator::begin(plan, options.port.unwrap_or(&plan.port), options.timeout)?;

    println!("Turn each joint by hand from one stop to the other. When all are done, press Enter.");
    dialogue.answer_while_turning(&mut bus)?;
    for note in bus.take_stops()? {
        println!("{note}");
    }
    println!(
        "Bring all joints to where they are to be at 0 rad, and press Enter; or type \"middle\" for the middle between \
         their stops."
    );
    let pose = match &*dialogue.answer_while_turning(&mut bus)? {
        "middle" => ZeroPose::Middle,
        _ => ZeroPose::Here,
    };
    bus.take_zeros(pose);
    let names: Vec<String> = bus.joints().map(|joint| joint.name).collect();
    for (index, name) in names.iter().enumerate() {
        if !bus.is_calibrated(index) {
            continue;
        }
        bus.begin_nudge(index);
        loop {
            println!(
                "{name}: turn it a little in its positive direction, and press Enter; or type \"keep\" for the sign of the \
                 description."
            );
            if dialogue.answer_while_turning(&mut bus)? == "keep" || bus.take_sign(index) {
                break;
            }
            println!("{name} was turned by less than 3 degrees.");
        }
    }

    let found = bus.results(options.margin_rad);
    if found.is_empty() {
        bail!("no joint was turned; {} stays as it is", path.display());
    }
    let mut calibrated = text;
    let mut written = Vec::new();
    for joint in found {
        let with_it = with_calibration(&calibrated, &joint).with_context(|| path.display().to_string())?;
        // What cannot be read again is not written: limits that were kept may not fit to a new zero.
        match Description::parse(&path.to_string_lossy(), &with_it) {
            Ok(_) => {
                calibrated = with_it;
                written.push(joint);
            }
            Err(problem) => println!("{} stays as it is described: {problem}", joint.name),
        }
    }
    if written.is_empty() {
        bail!("nothing was written");
    }
    user_file::replace(path, &calibrated).with_context(|| format!("cannot write {}", path.display()))?;
    for joint in &written {
        let limits = joint
            .limits
            .map_or("as described".to_owned(), |[low, high]| format!("{low:.3} to {high:.3} rad"));
        println!("{:<20} zero {:>6}  sign {:>2}  limits {limits}", joint.name, joint.zero, joint.sign);
    }
    println!("wrote {}; the joints are still limp", path.display());
    Ok(())
}

/// Questions and answers on the terminal.
struct Dialogue<'a> {
    stop: Stop,
    lines: Receiver<String>,
    screen: &'a Screen,
}

impl Dialogue<'_> {
    /// Waits for a line, and shows the joints meanwhile.
    fn answer_while_turning(&mut self, bus: &mut Calibrator) -> anyhow::Result<String> {
        self.answer(|| {
            bus.look()?;
            Ok(bus.joints().map(|joint| row(&joint)).collect())
        })
    }

    /// Waits for a line; `look` is called all the time, and returns what is shown.
    fn answer(&mut self, mut look: impl FnMut() -> anyhow::Result<Vec<String>>) -> anyhow::Result<String> {
        let mut next = Instant::now();
        let answer = loop {
            if self.stop.is_due() {
                bail!("stopped; nothing was written");
            }
            let rows = look()?;
            match self.lines.try_recv() {
                Ok(line) => {
                    // What is there now counts.
                    look()?;
                    break line;
                }
                Err(TryRecvError::Disconnected) => bail!("standard input has ended; nothing was written"),
                Err(TryRecvError::Empty) => {}
            }
            if Instant::now() >= next {
                self.screen.show(rows);
                next = Instant::now() + REFRESH;
            }
            self.stop.sleep(Duration::from_millis(1));
        };
        self.screen.show(Vec::new());
        self.screen.flush();
        Ok(answer.trim().to_owned())
    }
}

fn row(joint: &TurnedJoint) -> String {
    let TurnedJoint { name, id, travel_rad, place, is_silent } = joint;
    let at = (place * (BAR - 1) as f64).round() as usize;
    let bar: String = (0..BAR).map(|place| if place == at { '|' } else { '-' }).collect();
    let silent = if *is_silent { "  does not answer" } else { "" };
    format!("{name:<20} id {id:>3}  [{bar}] {:>5.1} degrees{silent}", travel_rad.to_degrees())
}
