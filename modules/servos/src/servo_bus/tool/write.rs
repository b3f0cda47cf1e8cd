//! Writes to registers, and which of them can do harm.

use super::scan::Presence;
use super::{ATTEMPTS, ServoError, ServoPort};
use crate::servo_bus::models::{Access, Model, Register};
use crate::servo_bus::protocol::{Id, Protocol};

/// A goal this far from the position is a jump when the torque is enabled, in rad.
const JUMP_RAD: f64 = 0.1;
/// Whether a write that can do harm is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Caution {
    /// It is refused.
    Refuse,
    /// It is done.
    Force,
}

impl ServoPort {
    /// Writes a register.
    ///
    /// # Errors
    /// Returns an error if the value is out of range, the write can do harm, or the device does not answer or
    /// refuses.
    pub fn write(
        &mut self,
        id: Id,
        model: &Model,
        register: &Register,
        value: i64,
        caution: Caution,
    ) -> Result<(), ServoError> {
        if !(register.min..=register.max).contains(&value) {
            let (model, name) = (model.name.clone(), register.name.clone());
            return Err(ServoError::Range {
                model,
                register: name,
                min: register.min,
                max: register.max,
                value,
            });
        }
        if caution == Caution::Refuse {
            self.check_harmless(id, model, register, value)?;
        }
        let lock = model
            .register("lock")
            .filter(|_| register.access == Access::Eeprom && self.line.protocol != Protocol::Dynamixel1);
        for (register, value) in lock.map(|lock| (lock, 0)).into_iter().chain([(register, value)]) {
            self.write_raw(id, register, value)?;
        }
        // A device with another id or speed is not there any more.
        if let Some(lock) = lock.filter(|_| !["id", "baud_rate"].contains(&&*register.name)) {
            self.write_raw(id, lock, 1)?;
        }
        Ok(())
    }

    /// Gives a device another id.
    ///
    /// # Errors
    /// Returns an error if another device has it, or the device does not answer or refuses.
    pub fn set_id(&mut self, id: Id, new: Id, caution: Caution) -> Result<(), ServoError> {
        let (_, model) = self.known(id)?;
        let register = Self::register(&model, "id")?;
        if caution == Caution::Refuse && self.presence(new, ATTEMPTS)? != Presence::Absent {
            return Err(ServoError::Dangerous(format!(
                "id {new} is taken: two devices of one id answer at the same time, and neither is understood"
            )));
        }
        self.write(id, &model, &register, i64::from(new.raw()), Caution::Force)?;
        if let Some(lock) = model.register("lock").filter(|_| self.line.protocol != Protocol::Dynamixel1) {
            self.write_raw(new, lock, 1)?;
        }
        match self.presence(new, ATTEMPTS)? {
            Presence::Present => Ok(()),
            Presence::Garbled => Err(self.garbled(new)),
            Presence::Absent => Err(self.silent(new)),
        }
    }

    fn check_harmless(
        &mut self,
        id: Id,
        model: &Model,
        register: &Register,
        value: i64,
    ) -> Result<(), ServoError> {
        let danger = match &*register.name {
            "id" => Some("a new id: use `downbeat servo set-id`, which checks that it is free".to_owned()),
            "baud_rate" => {
                Some("at another speed than the others of its bus the device cannot be reached".to_owned())
            }
            name if register.access == Access::Eeprom => {
                Some(format!("\"{name}\" outlives the power, and wears out with each write"))
            }
            "torque_enable" if value != 0 && self.turns_at_once(id, model)? => Some(
                "it is in an operating mode whose goal is a velocity or a current, and that goal is not 0: it would turn; write 0 to \
                 goal_velocity and goal_current first, or set operating_mode"
                    .to_owned(),
            ),
            "torque_enable" if value != 0 => {
                let (goal, position) =
                    (Self::register(model, "goal_position")?, Self::register(model, "present_position")?);
                let far = goal.to_si(self.read(id, &goal)? - self.read(id, &position)?);
                (far.abs() > JUMP_RAD).then(|| {
                    format!(
                        "the goal is {far:.2} rad from the position: it would jump; write goal_position first"
                    )
                })
            }
            "goal_position" => {
                let (torque, position) =
                    (Self::register(model, "torque_enable")?, Self::register(model, "present_position")?);
                let far = register.to_si(value - self.read(id, &position)?);
                (far.abs() > JUMP_RAD && self.read(id, &torque)? != 0).then(|| {
                    format!("the goal is {far:.2} rad from the position and the torque is on: it would jump")
                })
            }
            _ => None,
        };
        danger.map_or(Ok(()), |danger| Err(ServoError::Dangerous(danger)))
    }

    /// Whether a servo has a goal that is a velocity or a current, and not 0.
    fn turns_at_once(&mut self, id: Id, model: &Model) -> Result<bool, ServoError> {
        let Some(mode) = model.register("operating_mode") else { return Ok(false) };
        let mode = Some(self.read(id, mode)?);
        let goal = match mode {
            mode if mode == model.modes.velocity => "goal_velocity",
            mode if mode == model.modes.effort => "goal_current",
            _ => return Ok(false),
        };
        Ok(self.read(id, &Self::register(model, goal)?)? != 0)
    }
}
