//! The messages of team mates: the latest valid message of each.

use downbeat_executor::Time;
use downbeat_football::football_interfaces::msg::TeamMessage;
use downbeat_msgs::geometry_msgs::msg::Point;
use std::collections::BTreeMap;
use std::time::Duration;

/// The latest message of each team mate, by its number.
#[derive(Clone, Debug, Default)]
pub(crate) struct Mates {
    latest: BTreeMap<u8, TeamMessage>,
    /// The number of refused messages by reason.
    refused: BTreeMap<Refusal, u64>,
}

/// The reason why a message is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Refusal {
    /// It comes from another team or from this player, or its player number is invalid.
    Foreign,
    /// Sent too long ago, before the latest message of this mate, or in the future.
    Old,
    /// A number is not finite.
    NotFinite,
    /// A position is off the field, or a variance or a time is negative.
    Absurd,
    /// There are more senders than a team has players.
    TooMany,
}

/// The largest number of mates.
const MOST: usize = 10;
/// The largest valid player number.
const HIGHEST: u8 = 20;
/// The largest distance of any object from the centre, in m.
const FARTHEST: f64 = 20.0;
/// The largest valid speed of a ball, in m/s.
const FASTEST: f64 = 20.0;
/// The largest valid variance, in m².
const VAGUEST: f64 = 100.0;
/// The largest valid clock difference.
const AHEAD: Duration = Duration::from_millis(200);

impl Refusal {
    /// The key in diagnostics.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Foreign => "foreign",
            Self::Old => "old",
            Self::NotFinite => "not_finite",
            Self::Absurd => "absurd",
            Self::TooMany => "too_many",
        }
    }
}

impl Mates {
    /// Takes a message for the player `player` of `team`; both are 0 if unknown.
    pub(crate) fn take(
        &mut self,
        message: &TeamMessage,
        [team, player]: [u8; 2],
        now: Time,
        timeout: Duration,
    ) {
        let refusal = self.refusal(message, [team, player], now, timeout);
        match refusal {
            Some(refusal) => *self.refused.entry(refusal).or_default() += 1,
            None => {
                self.latest.insert(message.player, message.clone());
            }
        }
    }

    fn refusal(
        &self,
        message: &TeamMessage,
        [team, player]: [u8; 2],
        now: Time,
        timeout: Duration,
    ) -> Option<Refusal> {
        let is_foreign = team != 0 && message.team != team
            || message.player == player
            || !(1..=HIGHEST).contains(&message.player);
        if is_foreign {
            return Some(Refusal::Foreign);
        }
        let at = sent_at(message);
        let is_before = self.latest.get(&message.player).is_some_and(|last| at < sent_at(last));
        if is_before || now.saturating_since(at) > timeout || at > now + AHEAD {
            return Some(Refusal::Old);
        }
        problem_of(message).or_else(|| {
            let is_new = !self.latest.contains_key(&message.player);
            (is_new && self.latest.len() >= MOST).then_some(Refusal::TooMany)
        })
    }

    /// Removes outdated messages, and with them silent players.
    pub(crate) fn forget_after(&mut self, now: Time, timeout: Duration) {
        self.latest.retain(|_, message| now.saturating_since(sent_at(message)) <= timeout);
    }

    /// The messages, by the numbers of the players.
    pub(crate) fn messages(&self) -> impl ExactSizeIterator<Item = &TeamMessage> {
        self.latest.values()
    }

    /// The number of refused messages by reason.
    pub(crate) fn refused(&self) -> &BTreeMap<Refusal, u64> {
        &self.refused
    }
}

/// The time at which a message was sent.
pub(crate) fn sent_at(message: &TeamMessage) -> Time {
    Time::from_nanos(message.header.stamp.as_nanos())
}

/// The first invalid value of a message, if any.
fn problem_of(message: &TeamMessage) -> Option<Refusal> {
    let pose = &message.pose.pose;
    let q = &pose.orientation;
    let mut numbers = vec![pose.position.x, pose.position.y, q.x, q.y, q.z, q.w];
    numbers.extend(message.pose.covariance);
    if message.sees_ball {
        let (ball, velocity) = (&message.ball, &message.ball_velocity);
        let of_ball = [message.ball_variance, message.ball_age].map(f64::from);
        numbers.extend([ball.x, ball.y, ball.z, velocity.x, velocity.y, velocity.z]);
        numbers.extend(of_ball);
    }
    numbers.extend(message.others.iter().flat_map(|other| [other.x, other.y, other.variance].map(f64::from)));
    // An infinite time is valid: it means that the player cannot kick.
    if message.time_to_ball.is_nan() || numbers.iter().any(|number| !number.is_finite()) {
        return Some(Refusal::NotFinite);
    }
    let is_place = |at: &Point| libm::hypot(at.x, at.y) <= FARTHEST;
    let is_variance = |variance: f64| (0.0..=VAGUEST).contains(&variance);
    let velocity = &message.ball_velocity;
    let is_ball = !message.sees_ball
        || is_place(&message.ball)
            && libm::hypot(velocity.x, velocity.y) <= FASTEST
            && is_variance(message.ball_variance.into())
            && message.ball_age >= 0.0;
    let are_others = message.others.iter().all(|other| {
        libm::hypot(f64::from(other.x), other.y.into()) <= FARTHEST && is_variance(other.variance.into())
    });
    let turn = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w;
    let is_pose = is_place(&pose.position)
        && (0.5..=2.0).contains(&turn)
        && [0, 7].iter().all(|index| is_variance(message.pose.covariance[*index]));
    let is_possible = is_pose && is_ball && are_others && message.time_to_ball >= 0.0;
    (!is_possible).then_some(Refusal::Absurd)
}

#[cfg(test)]
mod tests {
    use super::*;
    use downbeat_football::football_interfaces::msg::SeenRobot;
    use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;

    const NOW: Time = Time::from_nanos(10_000_000_000);
    const TIMEOUT: Duration = Duration::from_secs(2);

    fn message(player: u8, age_ms: i64) -> TeamMessage {
        let mut message = TeamMessage { team: 1, player, ..TeamMessage::default() };
        message.header.stamp = Stamp::from_nanos(NOW.as_nanos() - age_ms * 1_000_000);
        message.pose.pose.orientation.w = 1.0;
        message
    }

    fn refusal(of: &TeamMessage) -> Option<Refusal> {
        let mut mates = Mates::default();
        mates.take(of, [1, 2], NOW, TIMEOUT);
        let refused = mates.refused().keys().next().copied();
        assert_eq!(refused.is_none(), mates.messages().len() == 1);
        refused
    }

    #[test]
    fn what_is_foreign_old_no_number_or_absurd_is_refused() {
        let with = |change: &dyn Fn(&mut TeamMessage)| {
            let mut message = message(3, 100);
            change(&mut message);
            refusal(&message)
        };
        assert_eq!(with(&|_| {}), None);
        assert_eq!(with(&|message| message.time_to_ball = f32::INFINITY), None);
        assert_eq!(with(&|message| message.team = 2), Some(Refusal::Foreign));
        assert_eq!(with(&|message| message.player = 2), Some(Refusal::Foreign), "its own");
        assert_eq!(with(&|message| message.player = 0), Some(Refusal::Foreign));
        assert_eq!(refusal(&message(3, 2100)), Some(Refusal::Old));
        assert_eq!(refusal(&message(3, -500)), Some(Refusal::Old), "from the future");
        assert_eq!(with(&|message| message.pose.pose.position.x = f64::NAN), Some(Refusal::NotFinite));
        assert_eq!(with(&|message| message.time_to_ball = f32::NAN), Some(Refusal::NotFinite));
        assert_eq!(with(&|message| message.pose.pose.position.x = 50.0), Some(Refusal::Absurd));
        assert_eq!(with(&|message| message.time_to_ball = -1.0), Some(Refusal::Absurd));
        assert_eq!(with(&|message| message.pose.pose.orientation.w = 0.0), Some(Refusal::Absurd));
        // If the ball is not seen, its fields are ignored.
        assert_eq!(with(&|message| message.ball.x = 1e9), None);
        let ball = |message: &mut TeamMessage| (message.sees_ball, message.ball.x) = (true, 1e9);
        assert_eq!(with(&ball), Some(Refusal::Absurd));
        let other = |message: &mut TeamMessage| {
            message.others.push(SeenRobot { x: f32::INFINITY, ..SeenRobot::default() });
        };
        assert_eq!(with(&other), Some(Refusal::NotFinite));
    }

    #[test]
    fn the_latest_of_each_counts_until_it_is_old() {
        let mut mates = Mates::default();
        let take = |mates: &mut Mates, player, age_ms, x| {
            let mut message = message(player, age_ms);
            message.pose.pose.position.x = x;
            mates.take(&message, [1, 2], NOW, TIMEOUT);
        };
        take(&mut mates, 3, 500, 1.0);
        take(&mut mates, 3, 800, 2.0);
        take(&mut mates, 4, 1500, 3.0);
        let places = |mates: &Mates| mates.messages().map(|of| of.pose.pose.position.x).collect::<Vec<_>>();
        assert_eq!(places(&mates), [1.0, 3.0], "an overtaken message does not count");
        assert_eq!(mates.refused().get(&Refusal::Old), Some(&1));
        mates.forget_after(NOW + Duration::from_secs(1), TIMEOUT);
        assert_eq!(places(&mates), [1.0]);
    }

    #[test]
    fn no_more_speak_than_a_team_has() {
        let mut mates = Mates::default();
        (3..=20).for_each(|player| mates.take(&message(player, 0), [1, 2], NOW, TIMEOUT));
        assert_eq!((mates.messages().len(), mates.refused()[&Refusal::TooMany]), (MOST, 8));
    }
}
