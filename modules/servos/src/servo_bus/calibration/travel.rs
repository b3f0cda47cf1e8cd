//! How far a joint was turned by hand.

/// The raw positions of a servo as it is turned, counted on where they jump at the end of a turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Travel {
    /// The steps of a full turn.
    turn: i64,
    /// The last reading.
    pub(super) last: i64,
    /// The position, counted on.
    pub(super) position: i64,
    pub(super) min: i64,
    pub(super) max: i64,
}

impl Travel {
    pub(super) fn at(raw: i64, turn: i64) -> Self {
        Self { turn: turn.max(2), last: raw, position: raw, min: raw, max: raw }
    }

    /// Takes the next reading. Between two of them the servo must have turned by less than half a turn.
    pub(super) fn see(&mut self, raw: i64) {
        let step = (raw - self.last).rem_euclid(self.turn);
        let step = if step > self.turn / 2 { step - self.turn } else { step };
        self.last = raw;
        self.position += step;
        self.min = self.min.min(self.position);
        self.max = self.max.max(self.position);
    }

    pub(super) fn steps(&self) -> i64 {
        self.max - self.min
    }

    pub(super) fn middle(&self) -> i64 {
        self.min + self.steps() / 2
    }

    /// Counts from another zero: what was `shift` becomes 0.
    pub(super) fn shift(&mut self, shift: i64) {
        for position in [&mut self.position, &mut self.min, &mut self.max] {
            *position -= shift;
        }
        // The reading is that of a servo which counts within one turn.
        self.last = (self.last - shift).rem_euclid(self.turn);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(first: i64, readings: &[i64]) -> Travel {
        let mut travel = Travel::at(first, 4096);
        readings.iter().for_each(|raw| travel.see(*raw));
        travel
    }

    #[test]
    fn a_travel_goes_on_over_the_end_of_a_turn() {
        let up = seen(3900, &[4090, 20, 300, 4000, 3700]);
        assert_eq!((up.min, up.max, up.position), (3700, 4396, 3700));
        let down = seen(100, &[4000, 3500, 200, 300]);
        assert_eq!((down.min, down.max, down.position), (-596, 300, 300));
        assert_eq!(seen(2000, &[2100, 1500, 2048]).steps(), 600);
    }

    #[test]
    fn a_shifted_travel_is_around_the_middle() {
        let mut travel = seen(3900, &[100, 1000, 3900]);
        assert_eq!((travel.min, travel.max), (3900, 5096));
        travel.shift(travel.middle() - 2048);
        assert_eq!((travel.min, travel.max, travel.position), (1450, 2646, 1450));
        // As the servo reads from then on.
        travel.see(1460);
        assert_eq!(travel.position, 1460);
    }
}
