//! The control table of the MX-28 servo, protocol 1.0, firmware 27 or later.
//!
//! Earlier firmware has another layout (1024 steps over 300 degrees, compliance instead of gains).
//!
//! # References
//! ROBOTIS e-Manual, "MX-28T/R/AT/AR".

use super::{Field, checked};

/// The size of the table in bytes.
pub const LENGTH: u8 = 74;
/// The value of [`MODEL_NUMBER`].
pub const MODEL: u16 = 29;
/// The oldest firmware with this layout.
pub const OLDEST_FIRMWARE: u16 = 27;

/// The model of the device.
pub const MODEL_NUMBER: Field = Field::read("model number", 0, 2, MODEL).means("which device this is");
/// Its firmware.
pub const FIRMWARE_VERSION: Field = Field::read("firmware version", 2, 1, 36).means("27 or later");
/// Its address on the bus.
pub const ID: Field = Field::eeprom("id", 3, 1, 1, 252).means("address on the bus");
/// The speed of the bus.
pub const BAUD_RATE: Field = Field::eeprom("baud rate", 4, 1, 34, 254)
    .means("2 000 000 / (value + 1) bit/s; 250, 251, 252: 2.25, 2.5, 3 Mbit/s");
/// The delay before it answers.
pub const RETURN_DELAY: Field =
    Field::eeprom("return delay time", 5, 1, 250, 254).means("wait before an answer, 2 us");
/// Smallest goal.
pub const CW_ANGLE_LIMIT: Field =
    Field::eeprom("clockwise angle limit", 6, 2, 0, 4095).means("smallest goal, ticks");
/// Largest goal.
pub const CCW_ANGLE_LIMIT: Field =
    Field::eeprom("counter-clockwise angle limit", 8, 2, 4095, 4095).means("largest goal, ticks");
/// Drive mode.
pub const DRIVE_MODE: Field =
    Field::eeprom("drive mode", 10, 1, 0, 3).means("for pairs of servos on one joint");
/// Highest temperature.
pub const TEMPERATURE_LIMIT: Field =
    Field::eeprom("highest temperature limit", 11, 1, 80, 99).means("degrees Celsius");
/// Lowest voltage.
pub const MIN_VOLTAGE: Field =
    Field::eeprom("lowest voltage limit", 12, 1, 60, 250).at_least(50).means("0.1 V");
/// Highest voltage.
pub const MAX_VOLTAGE: Field =
    Field::eeprom("highest voltage limit", 13, 1, 160, 250).at_least(50).means("0.1 V");
/// Torque after switching on.
pub const MAX_TORQUE: Field =
    Field::eeprom("max torque", 14, 2, 1023, 1023).means("1/1023 of what it can do");
/// Which instructions it answers.
pub const STATUS_RETURN_LEVEL: Field =
    Field::eeprom("status return level", 16, 1, 2, 2).means("0 answers pings, 1 also reads, 2 all");
/// Errors that make its LED blink.
pub const ALARM_LED: Field = Field::eeprom("alarm led", 17, 1, 36, 127).means("error bits");
/// Errors that disable its torque.
pub const SHUTDOWN: Field = Field::eeprom("alarm shutdown", 18, 1, 36, 127).means("error bits");
/// Shift of the position.
pub const MULTI_TURN_OFFSET: Field =
    Field::eeprom("multi turn offset", 20, 2, 0, 0xFFFF).means("ticks, two's complement");
/// Divider of the position.
pub const RESOLUTION_DIVIDER: Field =
    Field::eeprom("resolution divider", 22, 1, 1, 4).at_least(1).means("multi turn only");
/// Whether its torque is enabled.
pub const TORQUE_ENABLE: Field = Field::ram("torque enable", 24, 1, 0, 1).means("1 holds the goal");
/// Its light.
pub const LED: Field = Field::ram("led", 25, 1, 0, 1).means("1 is on");
/// The derivative gain.
pub const D_GAIN: Field = Field::ram("d gain", 26, 1, 0, 254).means("Kd = 4/1000 of it");
/// The integral gain.
pub const I_GAIN: Field = Field::ram("i gain", 27, 1, 0, 254).means("Ki = 1000/2048 of it");
/// The proportional gain.
pub const P_GAIN: Field = Field::ram("p gain", 28, 1, 32, 254).means("Kp = 1/8 of it");
/// The goal position.
pub const GOAL_POSITION: Field = Field::ram("goal position", 30, 2, 2048, 4095).means("ticks, centre 2048");
/// The maximum speed.
pub const MOVING_SPEED: Field =
    Field::ram("moving speed", 32, 2, 0, 1023).means("0.114 rpm; 0 is as fast as it can");
/// The current torque limit.
pub const TORQUE_LIMIT: Field =
    Field::ram("torque limit", 34, 2, 1023, 1023).means("1/1023 of what it can do");
/// The present position.
pub const PRESENT_POSITION: Field = Field::read("present position", 36, 2, 2048).means("ticks, centre 2048");
/// The present speed.
pub const PRESENT_SPEED: Field =
    Field::read("present speed", 38, 2, 0).means("0.11 rpm in bits 0-9, bit 10 clockwise");
/// The present load.
pub const PRESENT_LOAD: Field =
    Field::read("present load", 40, 2, 0).means("0.1 % of the drive in bits 0-9, bit 10 clockwise");
/// The supply voltage.
pub const PRESENT_VOLTAGE: Field = Field::read("present voltage", 42, 1, 120).means("0.1 V");
/// The temperature.
pub const PRESENT_TEMPERATURE: Field = Field::read("present temperature", 43, 1, 25).means("degrees Celsius");
/// Whether a registered write is pending.
pub const REGISTERED: Field = Field::read("registered instruction", 44, 1, 0).means("1 waits for ACTION");
/// Whether it is moving.
pub const MOVING: Field = Field::read("moving", 46, 1, 0).means("1 is on its way to the goal");
/// Whether the persistent entries are locked.
pub const LOCK: Field = Field::ram("lock", 47, 1, 0, 1).means("1 locks what outlives the power");
/// Smallest drive.
pub const PUNCH: Field = Field::ram("punch", 48, 2, 0, 1023).means("smallest drive, 1/1023");
/// Its clock.
pub const REALTIME_TICK: Field = Field::read("realtime tick", 50, 2, 0).means("ms, firmware 40 or later");
/// The acceleration.
pub const GOAL_ACCELERATION: Field =
    Field::ram("goal acceleration", 73, 1, 0, 254).means("8.583 degrees/s^2; 0 is no limit");

/// All entries, in the order of their addresses.
pub const TABLE: [Field; 36] = checked(
    [
        MODEL_NUMBER,
        FIRMWARE_VERSION,
        ID,
        BAUD_RATE,
        RETURN_DELAY,
        CW_ANGLE_LIMIT,
        CCW_ANGLE_LIMIT,
        DRIVE_MODE,
        TEMPERATURE_LIMIT,
        MIN_VOLTAGE,
        MAX_VOLTAGE,
        MAX_TORQUE,
        STATUS_RETURN_LEVEL,
        ALARM_LED,
        SHUTDOWN,
        MULTI_TURN_OFFSET,
        RESOLUTION_DIVIDER,
        TORQUE_ENABLE,
        LED,
        D_GAIN,
        I_GAIN,
        P_GAIN,
        GOAL_POSITION,
        MOVING_SPEED,
        TORQUE_LIMIT,
        PRESENT_POSITION,
        PRESENT_SPEED,
        PRESENT_LOAD,
        PRESENT_VOLTAGE,
        PRESENT_TEMPERATURE,
        REGISTERED,
        MOVING,
        LOCK,
        PUNCH,
        REALTIME_TICK,
        // 52 to 67 are known by name only (potentiometer, drive, parts of the control error) and left out.
        GOAL_ACCELERATION,
    ],
    LENGTH,
);
