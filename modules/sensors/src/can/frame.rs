//! CAN frames as bytes, as messages, and the errors that some of them are.
//!
//! # References
//! `linux/can.h` (`struct can_frame`), `linux/can/error.h`.

use downbeat_msgs::Message;
use downbeat_msgs::std_msgs::msg::Header;

use crate::kernel::{put, put_u32, u32_at};

/// The length of a frame.
pub const LENGTH: usize = 16;

const EXTENDED: u32 = 0x8000_0000;
const REMOTE: u32 = 0x4000_0000;
const ERROR: u32 = 0x2000_0000;
const STANDARD_MASK: u32 = 0x7ff;
const EXTENDED_MASK: u32 = 0x1fff_ffff;

/// A message of a CAN bus: `can_msgs/msg/Frame` of ROS.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "can_msgs/msg/Frame")]
pub struct Frame {
    /// When the frame came.
    pub header: Header,
    /// The identifier, without flags.
    pub id: u32,
    /// A request for a frame.
    pub is_rtr: bool,
    /// The identifier has 29 bits, not 11.
    pub is_extended: bool,
    /// An error of the controller.
    pub is_error: bool,
    /// How many bytes are data.
    pub dlc: u8,
    /// The data, and zeros.
    pub data: [u8; 8],
}

impl Frame {
    /// Reads a frame of the kernel. A length above 8 is taken as 8, as controllers do.
    #[must_use]
    pub fn parse(bytes: &[u8; LENGTH], header: Header) -> Self {
        let (id, [.., d0, d1, d2, d3, d4, d5, d6, d7]) = (u32_at(bytes, 0), *bytes);
        let is_extended = id & EXTENDED != 0;
        let is_error = id & ERROR != 0;
        let mask = if is_extended || is_error { EXTENDED_MASK } else { STANDARD_MASK };
        Self {
            header,
            id: id & mask,
            is_rtr: id & REMOTE != 0,
            is_extended,
            is_error,
            dlc: bytes[4].min(8),
            data: [d0, d1, d2, d3, d4, d5, d6, d7],
        }
    }

    /// The frame for the kernel.
    ///
    /// # Errors
    /// What is wrong with the frame.
    pub fn emit(&self) -> Result<[u8; LENGTH], String> {
        let Self { id, is_rtr, is_extended, is_error, dlc, data, .. } = self;
        let (mask, bits) = if *is_extended { (EXTENDED_MASK, 29) } else { (STANDARD_MASK, 11) };
        if *is_error {
            return Err("is_error is set: errors come from controllers and cannot be sent".to_owned());
        }
        if id & !mask != 0 {
            let remedy = if *is_extended { "" } else { "; is_extended is not set" };
            return Err(format!("id {id:#x} has more than {bits} bits{remedy}"));
        }
        if *dlc > 8 {
            return Err(format!("dlc is {dlc}, and a frame has at most 8 bytes"));
        }
        let mut bytes = [0; LENGTH];
        let flags = [(*is_extended, EXTENDED), (*is_rtr, REMOTE)];
        let flags = flags.into_iter().filter(|(is_set, _)| *is_set).fold(0, |all, (_, flag)| all | flag);
        put_u32(&mut bytes, 0, id | flags);
        bytes[4] = *dlc;
        put(&mut bytes, 8, data.get(..usize::from(*dlc)).unwrap_or(data));
        Ok(bytes)
    }
}

/// What a controller is able to do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Controller {
    /// It sends and receives.
    #[default]
    Active,
    /// Many errors.
    Warning,
    /// So many errors that it no longer disturbs others by reporting them.
    Passive,
    /// It does not take part any more.
    Off,
}

/// What an error frame says.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Trouble {
    /// What the controller is now; `None` if the frame does not say.
    pub(super) controller: Option<Controller>,
    /// In words.
    pub(super) words: Vec<&'static str>,
}

impl Trouble {
    /// Reads an error frame: the classes are in the identifier, the details in the data.
    pub(super) fn of(frame: &Frame) -> Self {
        let classes = [
            (0x001, "a frame was not sent in time"),
            (0x002, "arbitration was lost"),
            (0x008, "a frame violates the protocol; is the bit rate that of the bus?"),
            (0x010, "the transceiver reports an error; check the wiring"),
            (0x020, "nobody acknowledges frames; is another node on the bus, and is it terminated?"),
            (0x040, "the controller is off the bus"),
            (0x080, "errors on the bus"),
            (0x100, "the controller was restarted"),
        ];
        let details = [
            (0x01, "frames were lost on reception"),
            (0x02, "frames were lost on sending"),
            (0x04, "many errors on reception"),
            (0x08, "many errors on sending"),
            (0x10, "the controller is passive: too many errors on reception"),
            (0x20, "the controller is passive: too many errors on sending"),
        ];
        let has = |class: u32| frame.id & class != 0;
        let detail = if has(0x004) { frame.data[1] } else { 0 };
        let controller = if has(0x040) {
            Some(Controller::Off)
        } else if detail & 0x30 != 0 {
            Some(Controller::Passive)
        } else if detail & 0x0c != 0 {
            Some(Controller::Warning)
        } else if has(0x100) || detail & 0x40 != 0 {
            Some(Controller::Active)
        } else {
            None
        };
        let classes = classes.into_iter().filter(|(class, _)| has(*class)).map(|(_, words)| words);
        let details = details.into_iter().filter(|(bit, _)| detail & bit != 0).map(|(_, words)| words);
        Self { controller, words: classes.chain(details).collect() }
    }
}

/// A filter of the kernel: a frame passes if its identifier and `id` agree in the bits of `mask`, or,
/// inverted, if they do not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Filter {
    /// With flags.
    pub id: u32,
    /// With flags.
    pub mask: u32,
}

/// The most filters of a socket.
const MOST_FILTERS: usize = 512;
/// `CAN_INV_FILTER`: in the identifier of a filter.
const INVERTED: u32 = 0x2000_0000;

impl Filter {
    /// Reads filters as `candump` and `ros2_socketcan` write them: `id:mask` or `id~mask` in hexadecimal, of
    /// which those with eight digits are of 29 bits.
    ///
    /// # Errors
    /// Which text is none.
    pub fn parse_all(texts: &[String]) -> Result<Vec<Self>, String> {
        let parse = |text: &str| {
            let (at, inverted) =
                text.find(':').map(|at| (at, 0)).or_else(|| text.find('~').map(|at| (at, INVERTED)))?;
            let (id, mask) = (&text[..at], text.get(at + 1..)?);
            let number = |text: &str| {
                let is_number =
                    (1..=8).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_hexdigit());
                is_number.then(|| u32::from_str_radix(text, 16).ok()).flatten()
            };
            let extended = if id.len() == 8 { EXTENDED } else { 0 };
            Some(Self { id: number(id)? | extended | inverted, mask: number(mask)? & !ERROR })
        };
        let all =
            texts.iter().flat_map(|text| text.split(',')).map(str::trim).filter(|text| !text.is_empty());
        let filters = all.map(|text| {
            parse(text).ok_or_else(|| {
                format!(
                    "\"{text}\" is no filter: expected id:mask or id~mask in hexadecimal, such as \"123:7FF\""
                )
            })
        });
        let filters = filters.collect::<Result<Vec<_>, String>>()?;
        match filters.len() {
            count if count > MOST_FILTERS => {
                Err(format!("{count} filters; a socket has at most {MOST_FILTERS}"))
            }
            _ => Ok(filters),
        }
    }

    /// Whether a frame with this identifier passes, with flags.
    fn passes(self, id: u32) -> bool {
        let is_inverted = self.id & INVERTED != 0;
        (id & self.mask == self.id & !INVERTED & self.mask) != is_inverted
    }
}

/// Whether the kernel would pass a frame: errors always, others by any filter. No filter passes all.
pub(super) fn passes(filters: &[Filter], bytes: &[u8; LENGTH]) -> bool {
    let id = u32_at(bytes, 0);
    id & ERROR != 0 || filters.is_empty() || filters.iter().any(|filter| filter.passes(id))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    fn frame(id: u32, data: &[u8]) -> Frame {
        let mut frame = Frame { id, dlc: data.len() as u8, ..Frame::default() };
        put(&mut frame.data, 0, data);
        frame
    }

    /// The bytes of `cansend vcan0 123#DEADBEEF`, `12345678#R` and `7FF#`, as `struct can_frame` of
    /// `linux/can.h` lays them out.
    #[cfg(target_endian = "little")]
    #[test]
    fn frames_have_the_bytes_of_the_kernel() {
        let data = [0x23, 0x01, 0, 0, 4, 0, 0, 0, 0xde, 0xad, 0xbe, 0xef, 0, 0, 0, 0];
        let message = frame(0x123, &[0xde, 0xad, 0xbe, 0xef]);
        assert_eq!(message.emit(), Ok(data));
        assert_eq!(Frame::parse(&data, Header::default()), message);
        let request = [0x78, 0x56, 0x34, 0xd2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        let message = Frame { is_extended: true, is_rtr: true, ..frame(0x1234_5678, &[]) };
        assert_eq!(message.emit(), Ok(request));
        assert_eq!(Frame::parse(&request, Header::default()), message);
        assert_eq!(frame(0x7ff, &[]).emit().unwrap()[..4], [0xff, 0x07, 0, 0]);
    }

    #[test]
    fn what_no_bus_can_carry_is_refused() {
        assert_eq!(
            frame(0x800, &[]).emit().unwrap_err(),
            "id 0x800 has more than 11 bits; is_extended is not set"
        );
        let wide = Frame { is_extended: true, ..frame(0x2000_0000, &[]) };
        assert_eq!(wide.emit().unwrap_err(), "id 0x20000000 has more than 29 bits");
        assert!(Frame { dlc: 9, ..Frame::default() }.emit().unwrap_err().contains("at most 8 bytes"));
        assert!(Frame { is_error: true, ..Frame::default() }.emit().unwrap_err().contains("cannot be sent"));
    }

    /// Classes and details of `linux/can/error.h`.
    #[test]
    fn errors_are_told_in_words() {
        let error = |class, data: &[u8]| Trouble::of(&Frame { is_error: true, ..frame(class, data) });
        assert_eq!(error(0x40, &[]).controller, Some(Controller::Off));
        assert_eq!(error(0x204, &[0, 0x20, 0, 0, 0, 0, 128, 0]).controller, Some(Controller::Passive));
        assert_eq!(error(0x204, &[0, 0x08]).controller, Some(Controller::Warning));
        assert_eq!(error(0x100, &[]).controller, Some(Controller::Active));
        let unheard = error(0x20, &[]);
        assert_eq!((unheard.controller, unheard.words.len()), (None, 1));
        assert!(unheard.words[0].starts_with("nobody acknowledges"));
    }

    #[test]
    fn filters_are_those_of_candump() {
        let parse = |texts: &[&str]| {
            Filter::parse_all(&texts.iter().map(|&text| text.to_owned()).collect::<Vec<_>>())
        };
        let filters = parse(&["123:7FF, 400~700", "12345678:DFFFFFFF"]).unwrap();
        let pass = |frame: &Frame| passes(&filters[..1], &frame.emit().unwrap());
        assert!(pass(&frame(0x123, &[])) && !pass(&frame(0x124, &[])));
        let pass = |frame: &Frame| passes(&filters[1..2], &frame.emit().unwrap());
        assert!(pass(&frame(0x123, &[])) && !pass(&frame(0x4ff, &[])));
        let pass = |frame: &Frame| passes(&filters[2..], &frame.emit().unwrap());
        assert!(pass(&Frame { is_extended: true, ..frame(0x1234_5678, &[]) }) && !pass(&frame(0x678, &[])));
        assert_eq!(parse(&["0:0"]).unwrap(), [Filter { id: 0, mask: 0 }]);
        assert!(parse(&["", " "]).unwrap().is_empty());
        for text in ["123", "x:7FF", "123:", "123456789:0", "+1:7ff"] {
            assert!(parse(&[text]).unwrap_err().contains("is no filter"), "{text}");
        }
        assert!(Filter::parse_all(&vec!["0:0".to_owned(); 513]).is_err());
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_frame_and_sendable_ones_are_the_same_again(bytes in any::<[u8; LENGTH]>()) {
            let message = Frame::parse(&bytes, Header::default());
            prop_assert!(message.dlc <= 8);
            if let Ok(again) = message.emit() {
                let repeated = Frame::parse(&again, Header::default());
                prop_assert_eq!((repeated.id, repeated.dlc, repeated.is_rtr), (message.id, message.dlc, message.is_rtr));
            }
        }
    }
}
