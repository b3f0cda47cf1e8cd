//! Offsets of joints, found by eye: the robot holds its joints at 0 rad, and each is moved by single steps
//! until it looks right.

use super::super::description::BusPlan;
use super::super::joint::Joint;
use super::super::limp::{Limp, Reach};
use super::super::tool::{Caution, ServoError, ServoPort};
use super::{TurnedJoint, checked, opened};
use std::time::Duration;

/// How fast joints go to 0 rad, in rad/s.
const APPROACH_RAD_S: f64 = 0.3;
/// How often their goals are written on the way.
const PERIOD: Duration = Duration::from_millis(20);
/// Joints are moved at most this far from where they are described to be, in rad: more is no tolerance, but a
/// wrong zero.
const MOST_RAD: f64 = 0.35;

/// The joints of a bus, held near 0 rad.
pub struct Tuner {
    port: ServoPort,
    joints: Vec<Held>,
}

/// A joint that has its torque.
struct Held {
    joint: Joint,
    /// The raw position at 0 rad, or at the nearer limit, as it is described.
    reference: i64,
    goal: i64,
    /// Where its goals can be.
    reach: Reach,
    is_silent: bool,
}

/// By how much a joint was moved away from where it is described to be at 0 rad.
#[derive(Clone, Debug, PartialEq)]
pub struct JointOffset {
    /// Its name.
    pub name: String,
    /// Where it is described to be, in rad: at 0, or at the nearer of its limits.
    pub reference: f64,
    /// In raw steps, to be added to its `offset`.
    pub steps: i64,
    /// In rad.
    pub angle: f64,
}

impl Tuner {
    /// Takes over a bus, on which devices may take `slack` to answer. Its joints hold where they are; those
    /// that cannot, and wheels, are left alone, which the sentences say.
    ///
    /// # Errors
    /// Returns an error if the port cannot be opened, or a servo does not answer or is of another model.
    pub fn begin(plan: &BusPlan, port: &str, slack: Duration) -> Result<(Self, Vec<String>), ServoError> {
        Self::on(opened(plan, port, slack)?, plan)
    }

    /// The same, on an open port.
    pub(crate) fn on(port: ServoPort, plan: &BusPlan) -> Result<(Self, Vec<String>), ServoError> {
        let mut tuner = Self { port, joints: Vec::new() };
        checked(plan, &mut tuner.port)?;
        let notes = tuner.hold(plan);
        if notes.is_err() {
            // What was held already is let go; the first error says what is wrong.
            let _ = tuner.release();
        }
        notes.map(|notes| (tuner, notes))
    }

    /// Gives the joints their torque where they are, prepared as the driver prepares them: a servo may have
    /// been left in another operating mode, or with other gains.
    fn hold(&mut self, plan: &BusPlan) -> Result<Vec<String>, ServoError> {
        let Self { port, joints } = self;
        let mut notes = Vec::new();
        for joint in &plan.joints {
            if joint.drive.is_some() {
                notes.push(format!("{} is driven by velocities or efforts, and has no offset", joint.name));
                continue;
            }
            let reference = joint.steps(0.0_f64.clamp(joint.min_rad, joint.max_rad));
            let prepared = match port.prepare(joint) {
                Ok(prepared) => prepared,
                Err(error) => {
                    // Its torque may be on though its answer was lost; the first error says what is wrong.
                    let _ = port.write(joint.id, &joint.model, &joint.registers.torque, 0, Caution::Force);
                    return Err(error);
                }
            };
            let (goal, reach) = (prepared.position, prepared.reach);
            if let Some(limp) = Limp::of(joint, reach, goal, prepared.error) {
                notes.push(format!("{}; start again for that", limp.words(joint)));
                continue;
            }
            if !reach.contains(reference) {
                notes.push(format!(
                    "{} stays limp: servo {} cannot go to 0 rad, which is {reference} of its steps, beyond its position limits or \
                     what it counts; correct its zero with `downbeat servo calibrate`, or its position limits",
                    joint.name, joint.id
                ));
                port.write(joint.id, &joint.model, &joint.registers.torque, 0, Caution::Force)?;
                continue;
            }
            joints.push(Held { joint: joint.clone(), reference, goal, reach, is_silent: false });
        }
        Ok(notes)
    }

    /// Brings all joints slowly to where they are described to be at 0 rad, or to the nearer end of their
    /// limits. Ends early if `goes_on` returns false.
    ///
    /// # Errors
    /// Returns an error if the port fails, or a servo refuses.
    pub fn go_to_zero(&mut self, mut goes_on: impl FnMut() -> bool) -> Result<(), ServoError> {
        let (mut is_there, mut period) = (false, 0_u64);
        while !is_there && goes_on() {
            is_there = true;
            for held in &mut self.joints {
                let Joint { registers, gear, .. } = &held.joint;
                let reach = registers.goal.steps(APPROACH_RAD_S * gear * PERIOD.as_secs_f64()).abs();
                // A coarse servo takes a step in some periods only.
                let reach = ((period + 1) as f64 * reach) as i64 - (period as f64 * reach) as i64;
                let goal = held.reference.clamp(held.goal - reach, held.goal + reach);
                is_there &= held.goal == held.reference;
                if goal != held.goal {
                    held.go_to(&mut self.port, goal)?;
                }
            }
            period += 1;
            std::thread::sleep(PERIOD);
        }
        Ok(())
    }

    /// Moves a joint by raw steps of its servo, those in its positive direction positive. Returns false if it
    /// would be further from its zero than a tolerance is.
    ///
    /// # Errors
    /// Returns an error if the port fails, or the servo refuses.
    pub fn step(&mut self, joint: usize, steps: i64) -> Result<bool, ServoError> {
        let Some(held) = self.joints.get_mut(joint) else { return Ok(false) };
        let goal = held.goal + if held.joint.sign < 0.0 { -steps } else { steps };
        if !held.reach.contains(goal) || held.offset(goal).abs() > MOST_RAD {
            return Ok(false);
        }
        held.go_to(&mut self.port, goal)?;
        Ok(true)
    }

    /// Looks whether all servos answer.
    ///
    /// # Errors
    /// Returns an error if the port fails.
    pub fn look(&mut self) -> Result<(), ServoError> {
        for held in &mut self.joints {
            let read = self.port.read(held.joint.id, &held.joint.registers.position);
            held.is_silent = read.is_err();
            if let Err(ServoError::Port(problem)) = read {
                return Err(ServoError::Port(problem));
            }
        }
        Ok(())
    }

    /// The joints, with the angles by which they were moved as their travel.
    pub fn joints(&self) -> impl Iterator<Item = TurnedJoint> {
        self.offsets().zip(&self.joints).map(|(offset, held)| TurnedJoint {
            name: offset.name,
            id: held.joint.id,
            travel_rad: offset.angle,
            place: (0.5 + offset.angle / (2.0 * MOST_RAD)).clamp(0.0, 1.0),
            is_silent: held.is_silent,
        })
    }

    /// By how much each was moved.
    pub fn offsets(&self) -> impl Iterator<Item = JointOffset> {
        self.joints.iter().map(|held| JointOffset {
            name: held.joint.name.clone(),
            reference: held.joint.angle(held.reference),
            steps: held.goal - held.reference,
            angle: held.offset(held.goal),
        })
    }

    /// Takes the torque off all joints.
    ///
    /// # Errors
    /// Returns the first error, if the port fails, or a servo refuses; the others lose it all the same.
    pub fn release(&mut self) -> Result<(), ServoError> {
        let port = &mut self.port;
        let mut released = |Held { joint, .. }: &Held| {
            port.write(joint.id, &joint.model, &joint.registers.torque, 0, Caution::Force)
        };
        let results: Vec<_> = self.joints.iter().map(&mut released).collect();
        results.into_iter().collect()
    }
}

impl Held {
    /// How far a raw position is from where the joint is described to be, in rad.
    fn offset(&self, goal: i64) -> f64 {
        self.joint.angle(goal) - self.joint.angle(self.reference)
    }

    fn go_to(&mut self, port: &mut ServoPort, goal: i64) -> Result<(), ServoError> {
        let Joint { id, model, registers, .. } = &self.joint;
        port.write(*id, model, &registers.goal, goal, Caution::Force)?;
        self.goal = goal;
        Ok(())
    }
}
