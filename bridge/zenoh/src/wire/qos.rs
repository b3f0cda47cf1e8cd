//! Quality of service as text in tokens: `reliability:durability:history,depth:deadline:lifespan:liveliness`,
//! with the numbers of `rmw/types.h`. A field with its default value is empty.

use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// The policies of an endpoint, as the numbers of `rmw`, since peers announce *system default* and *best
/// available* too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// [`Qos::RELIABLE`] or [`Qos::BEST_EFFORT`], among others.
    pub reliability: u64,
    /// [`Qos::TRANSIENT_LOCAL`] or [`Qos::VOLATILE`], among others.
    pub durability: u64,
    /// [`Qos::KEEP_LAST`] or [`Qos::KEEP_ALL`], among others.
    pub history: u64,
    /// The number of samples, of *keep last*.
    pub depth: u64,
    /// The longest time between two samples.
    pub deadline: Period,
    /// How long a sample is worth delivering.
    pub lifespan: Period,
    /// [`Qos::AUTOMATIC`] or [`Qos::MANUAL_BY_TOPIC`], among others.
    pub liveliness: u64,
    /// The lease of the liveliness.
    pub lease: Period,
}

/// A time of `rmw`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Period {
    /// Whole seconds.
    pub seconds: u64,
    /// The nanoseconds besides.
    pub nanoseconds: u64,
}

impl Period {
    /// `RMW_DURATION_INFINITE`.
    pub const INFINITE: Self = Self { seconds: 9_223_372_036, nanoseconds: 854_775_807 };
}

impl Qos {
    /// Samples that are lost are sent again.
    pub const RELIABLE: u64 = 1;
    /// They are not.
    pub const BEST_EFFORT: u64 = 2;
    /// Late subscriptions receive the history of the publisher.
    pub const TRANSIENT_LOCAL: u64 = 1;
    /// They do not.
    pub const VOLATILE: u64 = 2;
    /// `depth` samples are kept.
    pub const KEEP_LAST: u64 = 1;
    /// All samples are kept.
    pub const KEEP_ALL: u64 = 2;
    /// An endpoint is alive while its process is.
    pub const AUTOMATIC: u64 = 1;
    /// A publisher asserts that it is alive.
    pub const MANUAL_BY_TOPIC: u64 = 3;

    /// What empty fields mean.
    pub const DEFAULT: Self = Self {
        reliability: Self::RELIABLE,
        durability: Self::VOLATILE,
        history: Self::KEEP_LAST,
        depth: 42,
        deadline: Period::INFINITE,
        lifespan: Period::INFINITE,
        liveliness: Self::AUTOMATIC,
        lease: Period::INFINITE,
    };
}

/// The text is no quality of service.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum QosError {
    /// A part is missing, or there is one too many.
    #[error("quality of service in a token has another number of fields than six")]
    Fields,
    /// A field is no number.
    #[error("a field of the quality of service in a token is no number")]
    Number,
}

/// Writes nothing for the default value.
struct Field(u64, u64);

impl fmt::Display for Field {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0 == self.1 { Ok(()) } else { write!(f, "{}", self.0) }
    }
}

impl fmt::Display for Period {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let infinite = Self::INFINITE;
        let (seconds, nanoseconds) =
            (Field(self.seconds, infinite.seconds), Field(self.nanoseconds, infinite.nanoseconds));
        write!(f, "{seconds},{nanoseconds}")
    }
}

impl fmt::Display for Qos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let default = Self::DEFAULT;
        write!(
            f,
            "{}:{}:{},{}:{}:{}:{},{}",
            Field(self.reliability, default.reliability),
            Field(self.durability, default.durability),
            Field(self.history, default.history),
            Field(self.depth, default.depth),
            self.deadline,
            self.lifespan,
            Field(self.liveliness, default.liveliness),
            self.lease,
        )
    }
}

impl FromStr for Qos {
    type Err = QosError;

    fn from_str(text: &str) -> Result<Self, QosError> {
        let fields = parts::<6>(text, ':')?;
        let default = Self::DEFAULT;
        let [history, depth] = parts(fields[2], ',')?;
        let [liveliness, seconds, nanoseconds] = parts(fields[5], ',')?;
        Ok(Self {
            reliability: number(fields[0], default.reliability)?,
            durability: number(fields[1], default.durability)?,
            history: number(history, default.history)?,
            depth: number(depth, default.depth)?,
            deadline: period(fields[3])?,
            lifespan: period(fields[4])?,
            liveliness: number(liveliness, default.liveliness)?,
            lease: period_of([seconds, nanoseconds])?,
        })
    }
}

fn parts<const COUNT: usize>(text: &str, separator: char) -> Result<[&str; COUNT], QosError> {
    let mut parts = [""; COUNT];
    let mut found = text.split(separator);
    for part in &mut parts {
        *part = found.next().ok_or(QosError::Fields)?;
    }
    found.next().map_or(Ok(parts), |_| Err(QosError::Fields))
}

fn number(text: &str, default: u64) -> Result<u64, QosError> {
    if text.is_empty() { Ok(default) } else { text.parse().map_err(|_| QosError::Number) }
}

fn period(text: &str) -> Result<Period, QosError> {
    period_of(parts(text, ',')?)
}

fn period_of([seconds, nanoseconds]: [&str; 2]) -> Result<Period, QosError> {
    let infinite = Period::INFINITE;
    Ok(Period {
        seconds: number(seconds, infinite.seconds)?,
        nanoseconds: number(nanoseconds, infinite.nanoseconds)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_with_their_default_are_empty() {
        let seconds = |seconds, nanoseconds| Period { seconds, nanoseconds };
        for (qos, text) in [
            (Qos::DEFAULT, "::,:,:,:,,"),
            (Qos { depth: 10, ..Qos::DEFAULT }, "::,10:,:,:,,"),
            (
                Qos { durability: 1, depth: 1000, lifespan: seconds(10, 0), ..Qos::DEFAULT },
                ":1:,1000:,:10,0:,,",
            ),
            (
                Qos {
                    history: 2,
                    depth: 10,
                    deadline: seconds(0, 250_000_000),
                    lifespan: seconds(3, 5),
                    liveliness: 3,
                    lease: seconds(2, 0),
                    ..Qos::DEFAULT
                },
                "::2,10:0,250000000:3,5:3,2,0",
            ),
        ] {
            assert_eq!(qos.to_string(), text);
            assert_eq!(text.parse(), Ok(qos));
        }
    }

    #[test]
    fn other_texts_are_refused() {
        for (text, error) in [
            ("", QosError::Fields),
            ("::,10:,:,:,", QosError::Fields),
            ("::,10:,:,:,,:", QosError::Fields),
            ("::10:,:,:,,", QosError::Fields),
            ("a::,10:,:,:,,", QosError::Number),
            ("::,-1:,:,:,,", QosError::Number),
            ("::,99999999999999999999:,:,:,,", QosError::Number),
        ] {
            assert_eq!(text.parse::<Qos>(), Err(error), "{text:?}");
        }
    }
}
