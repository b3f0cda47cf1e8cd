//! The control table of the CM-730, the sub controller with the power switch, the buttons and the IMU.
//!
//! # References
//! ROBOTIS e-Manual, DARwIn-OP "Control table of the CM-730"; the second generation's CM-740 has the same.

use super::{Field, checked};

/// The size of the table in bytes.
pub const LENGTH: u8 = 81;
/// The value of [`MODEL_NUMBER`].
pub const MODEL: u16 = 0x7300;

/// The model of the device.
pub const MODEL_NUMBER: Field = Field::read("model number", 0, 2, MODEL).means("which device this is");
/// Its firmware.
pub const FIRMWARE_VERSION: Field =
    Field::read("firmware version", 2, 1, 0x13).means("0x13 is the last published");
/// Its address on the bus.
pub const ID: Field = Field::eeprom("id", 3, 1, 200, 253).means("address on the bus");
/// The speed of the bus.
pub const BAUD_RATE: Field = Field::eeprom("baud rate", 4, 1, 1, 254).means("2 000 000 / (value + 1) bit/s");
/// The delay before it answers.
pub const RETURN_DELAY: Field =
    Field::eeprom("return delay time", 5, 1, 0, 254).means("wait before an answer, 2 us");
/// Which instructions it answers.
pub const STATUS_RETURN_LEVEL: Field =
    Field::eeprom("status return level", 16, 1, 2, 2).means("0 answers pings, 1 also reads, 2 all");
/// The switch of the servos' power.
pub const DXL_POWER: Field = Field::ram("dynamixel power", 24, 1, 0, 1).means("1 switches the servo bus on");
/// The lights on the back.
pub const LED_PANEL: Field = Field::ram("led panel", 25, 1, 0, 7).means("bit 0 red, bit 1 blue, bit 2 green");
/// The light on the head.
pub const LED_HEAD: Field =
    Field::ram("led head", 26, 2, 0, 0x7FFF).means("red bits 0-4, green 5-9, blue 10-14");
/// The light of the eyes.
pub const LED_EYE: Field =
    Field::ram("led eye", 28, 2, 0, 0x7FFF).means("red bits 0-4, green 5-9, blue 10-14");
/// The buttons on the back.
pub const BUTTON: Field = Field::read("button", 30, 1, 0).means("bit 0 mode, bit 1 start");
/// Angular rate about the upward axis.
pub const GYRO_Z: Field = Field::read("gyro z", 38, 2, 512).means("10 bit, centre 512");
/// Angular rate, positive when the robot tips backwards.
pub const GYRO_Y: Field = Field::read("gyro y", 40, 2, 512).means("10 bit, centre 512");
/// Angular rate, positive when the robot tips to its left.
pub const GYRO_X: Field = Field::read("gyro x", 42, 2, 512).means("10 bit, centre 512");
/// Specific force to the right.
pub const ACC_X: Field = Field::read("acceleration x", 44, 2, 512).means("10 bit, centre 512, right");
/// Specific force to the front.
pub const ACC_Y: Field = Field::read("acceleration y", 46, 2, 512).means("10 bit, centre 512, forward");
/// Specific force upwards.
pub const ACC_Z: Field =
    Field::read("acceleration z", 48, 2, 640).means("10 bit, centre 512, up; +1 g is 640");
/// The voltage of the battery.
pub const VOLTAGE: Field = Field::read("voltage", 50, 1, 120).means("0.1 V");
/// The left microphone, first of the analogue inputs.
pub const MIC_LEFT: Field = Field::read("left microphone", 51, 2, 512).means("10 bit");
/// The right microphone, ninth of the analogue inputs.
pub const MIC_RIGHT: Field = Field::read("right microphone", 67, 2, 512).means("10 bit");

const fn adc(name: &'static str, address: u8) -> Field {
    Field::read(name, address, 2, 0).means("10 bit, external port J8")
}

/// All entries, in the order of their addresses.
pub const TABLE: [Field; 33] = checked(
    [
        MODEL_NUMBER,
        FIRMWARE_VERSION,
        ID,
        BAUD_RATE,
        RETURN_DELAY,
        STATUS_RETURN_LEVEL,
        DXL_POWER,
        LED_PANEL,
        LED_HEAD,
        LED_EYE,
        BUTTON,
        GYRO_Z,
        GYRO_Y,
        GYRO_X,
        ACC_X,
        ACC_Y,
        ACC_Z,
        VOLTAGE,
        MIC_LEFT,
        adc("adc 2", 53),
        adc("adc 3", 55),
        adc("adc 4", 57),
        adc("adc 5", 59),
        adc("adc 6", 61),
        adc("adc 7", 63),
        adc("adc 8", 65),
        MIC_RIGHT,
        adc("adc 10", 69),
        adc("adc 11", 71),
        adc("adc 12", 73),
        adc("adc 13", 75),
        adc("adc 14", 77),
        adc("adc 15", 79),
    ],
    LENGTH,
);
