//! The simulated radio link of a team: messages arrive late, and some are lost. It is seeded, so that a match
//! can be repeated.

use downbeat_executor::Time;
use downbeat_football::football_interfaces::msg::TeamMessage;
use downbeat_servos::servo_emulator::Random;
use std::time::Duration;

/// Messages that are being transmitted.
pub(crate) struct TeamRadio {
    random: Random,
    /// The share of messages that are lost.
    loss: f64,
    /// Receiving robot, arrival and message, in the order of sending.
    waiting: Vec<(usize, Time, TeamMessage)>,
}

/// The range of the latency, in s.
const LATENCY: [f64; 2] = [0.05, 0.15];
/// The largest number of messages in transmission. 22 players that each send ten messages per second to their
/// whole team have fewer within the longest latency.
const MOST: usize = 512;

impl TeamRadio {
    pub(crate) fn new(seed: u64, loss: f64) -> Self {
        // A separate random stream; the noise of the robots uses others.
        Self { random: Random::new(seed, 0xA1), loss, waiting: Vec::new() }
    }

    /// Sends a message to robots; each reception may fail. Messages beyond [`MOST`] are lost.
    pub(crate) fn send(&mut self, message: &TeamMessage, to: impl Iterator<Item = usize>, now: Time) {
        for robot in to {
            let [shortest, longest] = LATENCY;
            let latency = Duration::from_secs_f64(shortest + (longest - shortest) * self.random.unit());
            let is_lost = self.random.unit() < self.loss;
            if !is_lost && self.waiting.len() < MOST {
                self.waiting.push((robot, now + latency, message.clone()));
            }
        }
    }

    /// The messages that have arrived by `now`, in the order of sending.
    pub(crate) fn arrived(&mut self, now: Time) -> impl Iterator<Item = (usize, TeamMessage)> {
        let arrived = self.waiting.extract_if(.., move |(_, at, _)| *at <= now);
        arrived.map(|(robot, _, message)| (robot, message))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arrivals(seed: u64, loss: f64) -> Vec<(u64, usize, u8)> {
        let mut radio = TeamRadio::new(seed, loss);
        let mut heard = Vec::new();
        for step in 0..300_u64 {
            let now = Time::from_nanos(10_000_000 * step as i64);
            if step < 200 && step % 20 == 0 {
                let message = TeamMessage { player: (step / 20) as u8, ..TeamMessage::default() };
                radio.send(&message, [1, 2, 3].into_iter(), now);
            }
            heard.extend(radio.arrived(now).map(|(robot, message)| (step, robot, message.player)));
        }
        heard
    }

    #[test]
    fn messages_arrive_50_to_150_ms_later_and_the_same_with_the_same_seed() {
        let heard = arrivals(1, 0.0);
        assert_eq!(heard.len(), 30);
        for (step, _, player) in &heard {
            let late = step - 20 * u64::from(*player);
            assert!((5..=15).contains(&late), "{late}");
        }
        assert_eq!(heard, arrivals(1, 0.0));
        assert_ne!(heard, arrivals(2, 0.0));
    }

    #[test]
    fn some_are_lost() {
        assert!(arrivals(1, 1.0).is_empty());
        assert!((8..28).contains(&arrivals(1, 0.4).len()));
    }

    #[test]
    fn however_many_are_sent_a_bounded_number_is_on_its_way() {
        let mut radio = TeamRadio::new(1, 0.0);
        radio.send(&TeamMessage::default(), (0..10_000).map(|_| 0), Time::ZERO);
        assert_eq!(radio.arrived(Time::from_nanos(i64::MAX)).count(), MOST);
    }
}
