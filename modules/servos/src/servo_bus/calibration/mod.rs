//! Calibration by hand: where the stops of joints are, their zeros and signs. While it goes on, all joints of
//! the bus are limp, and are turned by hand. And by eye, with joints that are held: [`Tuner`].

mod travel;
mod tuner;

pub use tuner::{JointOffset, Tuner};

use super::description::BusPlan;
use super::joint::Joint;
use super::models::Register;
use super::protocol::{Id, Protocol};
use super::tool::{Caution, ServoError, ServoPort};
use std::f64::consts::TAU;
use std::time::Duration;
use travel::Travel;

/// A joint that was turned by less than this was not turned by hand, in rad.
const LEAST_TRAVEL_RAD: f64 = 0.1;
/// A joint that was turned by all but this much of a turn has no stops, in rad.
const ALL_ROUND_RAD: f64 = 0.1;
/// A nudge is at least this large, in rad.
const LEAST_NUDGE_RAD: f64 = 0.05;
/// After this time a servo reads its position with a new offset.
const SETTLING: Duration = Duration::from_millis(50);
/// By how much a joint may move while its servo takes an offset, in rad.
const SHAKE_RAD: f64 = 0.1;
const HOMING_OFFSET: &str = "homing_offset";
/// A Dynamixel servo with positions as goals ignores an offset that is larger.
const LARGEST_DYNAMIXEL_OFFSET: i64 = 1024;

/// The joints of a bus, limp, as they are turned by hand.
pub struct Calibrator {
    port: ServoPort,
    joints: Vec<Limb>,
}

/// A joint and what is known of it.
struct Limb {
    joint: Joint,
    travel: Travel,
    is_silent: bool,
    /// The raw position at 0 rad.
    zero: i64,
    sign: f64,
    stops: Stops,
    /// The offset that its servo has, if the description sets it.
    homing_offset: Option<i64>,
    /// Where a nudge began.
    nudged_from: i64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stops {
    /// They are where the joint was turned to.
    Found,
    /// It turns all the way round, or is a wheel.
    None,
    /// They could not be found: the joint stays as it is described.
    Unknown,
}

/// What a joint reads while it is turned.
#[derive(Clone, Debug, PartialEq)]
pub struct TurnedJoint {
    /// Its name.
    pub name: String,
    /// The address of its servo.
    pub id: Id,
    /// How far it was turned between its extremes, in rad.
    pub travel_rad: f64,
    /// Where between them it is, from 0 to 1.
    pub place: f64,
    /// Whether its servo does not answer now.
    pub is_silent: bool,
}

/// Where joints are at 0 rad.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ZeroPose {
    /// Where they are now.
    Here,
    /// In the middle between their stops.
    Middle,
}

/// What was found of a joint.
#[derive(Clone, Debug, PartialEq)]
pub struct JointCalibration {
    /// Its name.
    pub name: String,
    /// The raw position at 0 rad.
    pub zero: i64,
    /// 1, or -1 if the servo counts against the joint.
    pub sign: i64,
    /// The smallest and the largest angle, in rad; `None` if the joint turns all the way round.
    pub limits: Option<[f64; 2]>,
    /// The offset that its servo has, if the description sets it: zero and limits are those with this one.
    pub homing_offset: Option<i64>,
}

impl Calibrator {
    /// Takes over a bus, on which devices may take `slack` to answer. Its joints lose their torque: they have
    /// to be held.
    ///
    /// # Errors
    /// Returns an error if the port cannot be opened, or a servo does not answer or is of another model.
    pub fn begin(plan: &BusPlan, port: &str, slack: Duration) -> Result<Self, ServoError> {
        Self::on(opened(plan, port, slack)?, plan)
    }

    /// The same, on an open port.
    pub(crate) fn on(mut port: ServoPort, plan: &BusPlan) -> Result<Self, ServoError> {
        checked(plan, &mut port)?;
        let mut joints = Vec::new();
        for joint in &plan.joints {
            port.write(joint.id, &joint.model, &joint.registers.torque, 0, Caution::Force)?;
            let raw = port.read(joint.id, &joint.registers.position)?;
            let described = joint.further.iter().find(|(register, _)| register.name == HOMING_OFFSET);
            let homing_offset = described.map(|(register, _)| port.read(joint.id, register)).transpose()?;
            joints.push(Limb {
                joint: joint.clone(),
                travel: Travel::at(raw, turn_of(joint)),
                homing_offset,
                is_silent: false,
                zero: joint.zero,
                sign: joint.sign,
                stops: Stops::Unknown,
                nudged_from: raw,
            });
        }
        Ok(Self { port, joints })
    }

    /// Reads all joints. Has to be called often while they are turned: each may turn by less than half a turn
    /// from one call to the next.
    ///
    /// # Errors
    /// Returns an error if the port fails.
    pub fn look(&mut self) -> Result<(), ServoError> {
        for limb in &mut self.joints {
            let read = self.port.read(limb.joint.id, &limb.joint.registers.position);
            limb.is_silent = read.is_err();
            match read {
                Ok(raw) => limb.travel.see(raw),
                Err(ServoError::Port(problem)) => return Err(ServoError::Port(problem)),
                Err(_) => {}
            }
        }
        Ok(())
    }

    /// The joints, in the order of the description.
    pub fn joints(&self) -> impl Iterator<Item = TurnedJoint> {
        self.joints.iter().map(|limb| {
            let Travel { position, min, .. } = limb.travel;
            let steps = limb.travel.steps();
            TurnedJoint {
                name: limb.joint.name.clone(),
                id: limb.joint.id,
                travel_rad: limb.rad(steps),
                place: if steps > 0 { (position - min) as f64 / steps as f64 } else { 0.5 },
                is_silent: limb.is_silent,
            }
        })
    }

    /// Takes the extremes so far for the stops of the joints. Where a travel passes the end of what its servo
    /// counts, the servo gets an offset, if it has one. Returns sentences about joints that are left as they
    /// were described, and those with an offset.
    ///
    /// # Errors
    /// Returns an error if the port fails.
    pub fn take_stops(&mut self) -> Result<Vec<String>, ServoError> {
        let mut notes = Vec::new();
        for limb in &mut self.joints {
            let (name, id) = (limb.joint.name.clone(), limb.joint.id);
            let travel = limb.rad(limb.travel.steps());
            if travel < LEAST_TRAVEL_RAD {
                notes.push(format!("{name} was not turned, and stays as it is described"));
                continue;
            }
            if limb.joint.min_rad == f64::NEG_INFINITY {
                // However far the hand has turned it.
                limb.stops = Stops::None;
                notes.push(format!("{name} has no limits, as it is described, and gets none"));
                continue;
            }
            if travel > (TAU - ALL_ROUND_RAD) / limb.joint.gear {
                limb.stops = Stops::None;
                notes.push(format!("{name} turns all the way round: its limits stay as they are described"));
                continue;
            }
            let protocol = self.port.line().protocol;
            let offset = limb.joint.model.register(HOMING_OFFSET).cloned();
            let brought = match (protocol, offset) {
                (Protocol::Dynamixel2, Some(offset)) => bring_dynamixel(&mut self.port, limb, &offset)?,
                _ if limb.is_in_range() => Ok(Vec::new()),
                (Protocol::FeetechSts | Protocol::FeetechScs, Some(offset)) => {
                    bring_feetech(&mut self.port, limb, &offset)?
                }
                _ => Err(format!(
                    "it passes the end of what servo {id} counts: put its horn on half a turn further, or its servo"
                )),
            };
            match brought {
                Ok(more) => {
                    limb.stops = Stops::Found;
                    notes.extend(more);
                }
                Err(problem) => notes.push(format!("{name} stays as it is described: {problem}")),
            }
        }
        Ok(notes)
    }

    /// Takes this pose for that in which all joints are at 0 rad. Joints whose stops are unknown stay as they
    /// are described.
    pub fn take_zeros(&mut self, pose: ZeroPose) {
        for limb in self.joints.iter_mut().filter(|limb| limb.stops != Stops::Unknown) {
            limb.zero = match (pose, limb.stops) {
                (ZeroPose::Middle, Stops::Found) => limb.travel.middle(),
                // Within the turn that the servo reads when it is switched on.
                (_, Stops::None) => limb.travel.last.rem_euclid(turn_of(&limb.joint)),
                _ => limb.travel.position,
            };
        }
    }

    /// Whether the stops of a joint, or that it has none, are known.
    #[must_use]
    pub fn is_calibrated(&self, joint: usize) -> bool {
        self.joints.get(joint).is_some_and(|limb| limb.stops != Stops::Unknown)
    }

    /// Begins to watch for a nudge of a joint in its positive direction.
    pub fn begin_nudge(&mut self, joint: usize) {
        if let Some(limb) = self.joints.get_mut(joint) {
            limb.nudged_from = limb.travel.position;
        }
    }

    /// Takes the direction in which a joint was turned since then for its positive one. Returns false if it
    /// was turned too little.
    pub fn take_sign(&mut self, joint: usize) -> bool {
        let Some(limb) = self.joints.get_mut(joint) else { return false };
        let turned = limb.travel.position - limb.nudged_from;
        if limb.rad(turned.abs()) < LEAST_NUDGE_RAD {
            return false;
        }
        limb.sign = if turned < 0 { -1.0 } else { 1.0 };
        true
    }

    /// What was found. Limits are inside of the stops by the margin, in rad.
    #[must_use]
    pub fn results(&self, margin_rad: f64) -> Vec<JointCalibration> {
        let known = self.joints.iter().filter(|limb| limb.stops != Stops::Unknown);
        let result = |limb: &Limb| {
            let angle = |raw: i64| limb.sign * limb.rad(raw - limb.zero);
            let ends = [limb.travel.min, limb.travel.max].map(angle);
            // Towards the middle.
            let low = ((ends[0].min(ends[1]) + margin_rad) * 1000.0).ceil() / 1000.0;
            let high = ((ends[0].max(ends[1]) - margin_rad) * 1000.0).floor() / 1000.0;
            JointCalibration {
                name: limb.joint.name.clone(),
                zero: limb.zero,
                sign: if limb.sign < 0.0 { -1 } else { 1 },
                limits: (limb.stops == Stops::Found).then_some([low, high.max(low)]),
                homing_offset: limb.homing_offset,
            }
        };
        known.map(result).collect()
    }
}

/// Opens a bus.
fn opened(plan: &BusPlan, port: &str, slack: Duration) -> Result<ServoPort, ServoError> {
    let models = plan.joints.iter().map(|joint| joint.model.clone()).collect();
    ServoPort::open(port, slack, models)
}

/// Switches the power of the servos on, and checks that they are of the described models.
fn checked(plan: &BusPlan, port: &mut ServoPort) -> Result<(), ServoError> {
    port.speak(plan.line)?;
    for device in &plan.devices {
        if let Some(power) = &device.power {
            port.write(device.id, &device.model, &power.register, 1, Caution::Force)?;
            std::thread::sleep(power.wait);
        }
    }
    for joint in &plan.joints {
        let (_, model) = port.known(joint.id)?;
        if model.name != joint.model.name {
            return Err(ServoError::OtherModel {
                path: port.path().to_owned(),
                line: port.line(),
                id: joint.id,
                described: joint.model.name.clone(),
                found: model.name.clone(),
            });
        }
    }
    Ok(())
}

impl Limb {
    /// Of the joint.
    fn rad(&self, steps: i64) -> f64 {
        self.joint.registers.position.to_si(steps) / self.joint.gear
    }

    /// Whether the whole travel can be goals.
    fn is_in_range(&self) -> bool {
        let (goal, Travel { min, max, .. }) = (&self.joint.registers.goal, self.travel);
        goal.min <= min && max <= goal.max
    }
}

/// The steps of a turn of a servo.
fn turn_of(joint: &Joint) -> i64 {
    joint.registers.position.steps(TAU).round() as i64
}

/// Sentences about a travel that now lies within what its servo counts, or why it cannot.
type Brought = Result<Result<Vec<String>, String>, ServoError>;

/// Moves what a servo of Feetech counts so that the travel is in its middle: it reads its position minus its
/// offset, within one turn.
fn bring_feetech(port: &mut ServoPort, limb: &mut Limb, register: &Register) -> Brought {
    let Joint { id, model, registers, .. } = &limb.joint;
    let turn = turn_of(&limb.joint);
    let shift = limb.travel.middle() - (registers.goal.min + registers.goal.max + 1) / 2;
    let old = port.read(*id, register)?;
    // Within half a turn to either side.
    let new = (old + shift + turn / 2).rem_euclid(turn) - turn / 2;
    let new = new.clamp(register.min, register.max);
    port.write(*id, model, register, new, Caution::Force)?;
    let before = limb.travel;
    limb.travel.shift(new - old);
    // A multiple of a turn makes no difference to the servo.
    let turns = (limb.travel.middle() - registers.goal.min).div_euclid(turn);
    limb.travel.shift(turns * turn);
    let settled = settle(port, limb, before, register, new)?;
    Ok(settled.map(|_| vec![new_offset(&limb.joint, new)]))
}

/// Brings the travel into what a servo of Dynamixel counts with positions as goals. It reads its position
/// plus its offset, and forgets whole turns when it is switched on or gets its torque; the offset does not
/// move where a turn ends (ROBOTIS e-Manual, X series, "Homing Offset" and "Present Position").
fn bring_dynamixel(port: &mut ServoPort, limb: &mut Limb, register: &Register) -> Brought {
    let Joint { name, id, model, registers, drive, .. } = &limb.joint;
    let old = port.read(*id, register)?;
    if drive.is_none() && old.abs() > LARGEST_DYNAMIXEL_OFFSET {
        return Ok(Err(format!(
            "servo {id} has the homing_offset {old}, and ignores one beyond {LARGEST_DYNAMIXEL_OFFSET}: write 0 with \
             `downbeat servo write {} {id} homing_offset 0 --force`, and calibrate again",
            port.path()
        )));
    }
    let (turn, before) = (turn_of(&limb.joint), limb.travel);
    let turns = (before.min - old).div_euclid(turn);
    if (before.max - old).div_euclid(turn) != turns {
        return Ok(Err(format!(
            "it passes the end of a turn of servo {id}, which its homing_offset does not move: put its horn on half a turn \
             further, or its servo"
        )));
    }
    let (middle, mut notes) = ((registers.goal.min + registers.goal.max + 1) / 2, Vec::new());
    let power = format!(
        "{name}: servo {id} has counted whole turns, which it forgets without power: switch it off and on before the robot runs"
    );
    limb.travel.shift(turns * turn);
    let mut new = old;
    if !limb.is_in_range() {
        new =
            (middle + old - limb.travel.middle()).clamp(-LARGEST_DYNAMIXEL_OFFSET, LARGEST_DYNAMIXEL_OFFSET);
        port.write(*id, model, register, new, Caution::Force)?;
        limb.travel.shift(old - new);
        notes.push(new_offset(&limb.joint, new));
    }
    Ok(settle(port, limb, before, register, new)?.map(|off| {
        notes.extend((off != 0).then_some(power));
        notes
    }))
}

fn new_offset(Joint { name, id, .. }: &Joint, raw: i64) -> String {
    format!("{name} passed the end of what servo {id} counts: its homing_offset is {raw} from now on")
}

/// Checks that a servo with this offset reads what is expected, and returns by how many whole turns that is
/// off. If it does not, the travel is as before.
fn settle(
    port: &mut ServoPort,
    limb: &mut Limb,
    before: Travel,
    register: &Register,
    offset: i64,
) -> Result<Result<i64, String>, ServoError> {
    let Joint { id, registers, .. } = &limb.joint;
    std::thread::sleep(SETTLING);
    let (read, expected) = (port.read(*id, &registers.position)?, limb.travel.position);
    let turn = turn_of(&limb.joint);
    let turns = (read - expected + turn / 2).div_euclid(turn);
    if registers.position.to_si((read - expected - turns * turn).abs()) > SHAKE_RAD {
        limb.travel = before;
        return Ok(Err(format!(
            "servo {id} reads {read} with the {} {offset}, where {expected} was expected",
            register.name
        )));
    }
    if let Some(described) = &mut limb.homing_offset {
        *described = offset;
    }
    Ok(Ok(turns))
}
