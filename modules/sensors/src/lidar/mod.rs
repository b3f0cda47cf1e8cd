//! Laser scanners on a serial port.
//!
//! - [`ldrobot`]: packets of the LDROBOT LD06 and LD19;
//! - [`rplidar`]: requests and responses of the Slamtec RPLIDAR A1;
//! - [`scan`]: revolutions from single measurements;
//! - [`Lidar`] is the module, [`LidarEmulator`] emulates the devices.
//!
//! The protocols are plain state machines without I/O: bytes and times in, measurements out.

mod emulator;
pub mod ldrobot;
mod module;
pub mod rplidar;
pub mod scan;

pub use emulator::{LidarEmulator, emulated};
pub use module::{Lidar, LidarPort};

use std::time::Duration;

use downbeat_executor::Time;

/// The models.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Model {
    /// LDROBOT LD06.
    Ld06,
    /// LDROBOT LD19, which speaks as the LD06.
    #[default]
    Ld19,
    /// Slamtec RPLIDAR A1.
    RplidarA1,
}

impl Model {
    /// The names in robot files.
    pub const NAMES: [&str; 3] = ["ld06", "ld19", "rplidar_a1"];

    /// The model of this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        let position = Self::NAMES.iter().position(|known| *known == name)?;
        [Self::Ld06, Self::Ld19, Self::RplidarA1].get(position).copied()
    }

    /// What its manual says.
    #[must_use]
    pub fn data(self) -> ModelData {
        match self {
            Self::Ld06 => ModelData { title: "LD06", ..LD19 },
            Self::Ld19 => LD19,
            Self::RplidarA1 => ModelData {
                title: "RPLIDAR A1",
                baud: rplidar::BAUD,
                // 2000 measurements per second, 5.5 revolutions.
                beams: 360,
                range: [0.15, 12.0],
                // The adapter's motor switch is inverted: it turns while DTR is off.
                data_terminal_ready: Some(false),
            },
        }
    }

    fn protocol(self) -> Box<dyn Protocol> {
        match self {
            Self::Ld06 | Self::Ld19 => Box::<ldrobot::Receiver>::default(),
            Self::RplidarA1 => Box::<rplidar::Driver>::default(),
        }
    }
}

const LD19: ModelData = ModelData {
    title: "LD19",
    baud: ldrobot::BAUD,
    // 4500 measurements per second, 10 revolutions.
    beams: 450,
    range: [0.02, 12.0],
    data_terminal_ready: None,
};

/// The data of a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelData {
    /// The name for people.
    pub title: &'static str,
    /// The speed of the serial port, in bit/s.
    pub baud: u32,
    /// How many beams a scan has by default: about the measurements of a revolution.
    pub beams: usize,
    /// The nearest and the farthest distance, in m.
    pub range: [f64; 2],
    /// See [`PortSettings`](crate::serial::PortSettings).
    pub data_terminal_ready: Option<bool>,
}

/// A measurement of a lidar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// The direction in the lidar's own frame: clockwise from its front, seen from above, in degrees from 0
    /// to 360.
    pub clockwise_deg: f64,
    /// In m; 0 if there was no echo.
    pub range: f64,
    /// The strength of the echo, in units of the lidar.
    pub intensity: f32,
    /// When it was measured.
    pub time: Time,
}

/// What a protocol has received.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Valid packets.
    pub packets: u64,
    /// Packets whose checksum or check bits are wrong.
    pub corrupt: u64,
    /// Bytes that belong to no valid packet.
    pub skipped: u64,
}

/// A lidar's side of the conversation, without I/O.
pub(crate) trait Protocol: Send {
    /// The port was opened at this time.
    fn opened(&mut self, now: Time);

    /// What to send now.
    fn request(&mut self, now: Time) -> Option<Vec<u8>> {
        let _ = now;
        None
    }

    /// Takes bytes, the last of which arrived at this time, and appends the measurements in them.
    fn take(&mut self, bytes: &[u8], arrived: Time, samples: &mut Vec<Sample>);

    /// How long a revolution of this many measurements took, if the protocol tells.
    fn revolution(&self, measurements: usize) -> Option<Duration>;

    /// What the lidar reports as its fault.
    fn fault(&self) -> Option<&str> {
        None
    }

    /// What is sent before the port is closed.
    fn farewell(&self) -> Option<Vec<u8>> {
        None
    }

    fn counts(&self) -> Counts;
}
