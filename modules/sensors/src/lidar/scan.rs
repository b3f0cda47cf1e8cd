//! Revolutions of a lidar as `sensor_msgs/LaserScan`.
//!
//! A scan has the same number of beams in every revolution, as mapping programs expect, at equal angles,
//! counter-clockwise from the rear (-π) to the rear (π), as REP-103 wants. A beam takes the nearest
//! measurement within its angle. Distances outside of the range are ±∞ as in REP-117; a beam between two
//! measured ones that has no measurement takes the nearer of them, and others are NaN.
//!
//! The lidars here turn clockwise and a revolution is cut at the rear, so the last beam is measured first.
//! `header.stamp` is the time of the first beam, as the definition of the message says, and `time_increment`
//! is negative. A program that corrects for the motion of the robot computes the true time of each beam from
//! both.

use std::f64::consts::{PI, TAU};
use std::time::Duration;

use downbeat_executor::Time;
use downbeat_msgs::sensor_msgs::msg::LaserScan;

use super::Sample;
use crate::diagnostics::header;

/// A revolution with a longer pause between its measurements is not whole.
const LONGEST_PAUSE: Duration = Duration::from_millis(500);

/// What scans look like.
#[derive(Clone, Debug, PartialEq)]
pub struct ScanSettings {
    /// The frame: x forward, y left, z up.
    pub frame_id: String,
    /// How many beams a scan has.
    pub beams: usize,
    /// The lidar's own direction that lies on the x axis, in degrees clockwise.
    pub forward_deg: f64,
    /// The nearest and the farthest distance, in m.
    pub range: [f64; 2],
    /// Weaker echoes are not used.
    pub min_intensity: f32,
    /// The distance of a measurement without echo: ∞ for free space, NaN for nothing known.
    pub no_echo: f32,
}

/// Collects the measurements of a revolution.
#[derive(Debug)]
pub struct ScanBuilder {
    settings: ScanSettings,
    beams: Vec<Beam>,
    /// How many beams have a measurement.
    measured: usize,
    /// The direction and time of the last measurement.
    last: Option<(f64, Time)>,
    /// Measurements since the cut, if there was one.
    measurements: Option<usize>,
    started: Time,
}

#[derive(Clone, Copy, Debug)]
struct Beam {
    /// `None` without a measurement.
    range: Option<f32>,
    intensity: f32,
}

const UNMEASURED: Beam = Beam { range: None, intensity: 0.0 };

/// A whole revolution.
#[derive(Debug)]
pub struct Revolution {
    scan: LaserScan,
    /// The number of measurements.
    pub measurements: usize,
    /// From the first measurement to the last one.
    measured_for: Duration,
}

impl Revolution {
    /// Returns the scan. `duration` is that of the revolution, `None` if the lidar does not report it.
    #[must_use]
    pub fn into_scan(self, duration: Option<Duration>) -> LaserScan {
        let mut scan = self.scan;
        let seconds = duration.unwrap_or(self.measured_for).as_secs_f64();
        scan.scan_time = seconds as f32;
        scan.time_increment = (-seconds / scan.ranges.len() as f64) as f32;
        scan
    }
}

impl ScanBuilder {
    /// A builder that has seen nothing.
    #[must_use]
    pub fn new(settings: ScanSettings) -> Self {
        let beams = vec![UNMEASURED; settings.beams.max(1)];
        Self { settings, beams, measured: 0, last: None, measurements: None, started: Time::ZERO }
    }

    /// Forgets the revolution that has begun.
    pub fn reset(&mut self) {
        *self = Self::new(self.settings.clone());
    }

    /// Adds a measurement. Returns the revolution that ended before it; the first one, which is not whole, is
    /// left out.
    pub fn push(&mut self, sample: &Sample) -> Option<Revolution> {
        if self.last.is_some_and(|(_, last)| sample.time.saturating_since(last) > LONGEST_PAUSE) {
            self.reset();
        }
        let forward = self.settings.forward_deg - sample.clockwise_deg;
        let angle = (forward.to_radians() + PI).rem_euclid(TAU);
        let is_cut =
            self.last.is_some_and(|(last, _)| angle - last > PI) && self.measured >= self.beams.len() / 4;
        let done = if is_cut { self.cut(sample.time) } else { None };
        self.last = Some((angle, sample.time));
        if let Some(count) = &mut self.measurements {
            *count += 1;
        }
        let range = self.range_of(sample);
        let position = (angle / TAU * self.beams.len() as f64) as usize;
        let index = position.min(self.beams.len() - 1);
        if let Some(beam) = self.beams.get_mut(index) {
            self.measured += usize::from(beam.range.is_none());
            if beam.range.is_none_or(|old| old.is_nan() || range < old) {
                *beam = Beam { range: Some(range), intensity: sample.intensity };
            }
        }
        done
    }

    fn range_of(&self, sample: &Sample) -> f32 {
        let [near, far] = self.settings.range;
        match sample.range {
            range if range <= 0.0 || sample.intensity < self.settings.min_intensity => self.settings.no_echo,
            range if range < near => f32::NEG_INFINITY,
            range if range > far => f32::INFINITY,
            range => range as f32,
        }
    }

    fn cut(&mut self, next: Time) -> Option<Revolution> {
        let count = self.beams.len();
        let beams = std::mem::replace(&mut self.beams, vec![UNMEASURED; count]);
        let measurements = self.measurements.replace(0);
        let started = std::mem::replace(&mut self.started, next);
        self.measured = 0;
        let (_, ended) = self.last?;
        let measurements = measurements?;
        let at = |index: usize| beams.get(index % count).copied().unwrap_or(UNMEASURED);
        let filled = |index: usize| {
            let (beam, before, after) = (at(index), at(index + count - 1), at(index + 1));
            match (beam.range, before.range, after.range) {
                (None, Some(left), Some(right)) => {
                    if left < right {
                        before
                    } else {
                        after
                    }
                }
                _ => beam,
            }
        };
        let increment = TAU / count as f64;
        let scan = LaserScan {
            header: header(ended, &self.settings.frame_id),
            angle_min: (increment / 2.0 - PI) as f32,
            angle_max: (PI - increment / 2.0) as f32,
            angle_increment: increment as f32,
            range_min: self.settings.range[0] as f32,
            range_max: self.settings.range[1] as f32,
            ranges: (0..count).map(|index| filled(index).range.unwrap_or(f32::NAN)).collect(),
            intensities: (0..count).map(|index| filled(index).intensity).collect(),
            ..LaserScan::default()
        };
        Some(Revolution { scan, measurements, measured_for: next.saturating_since(started) })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn settings() -> ScanSettings {
        ScanSettings {
            frame_id: "laser".into(),
            beams: 36,
            forward_deg: 0.0,
            range: [0.1, 12.0],
            min_intensity: 0.0,
            no_echo: f32::INFINITY,
        }
    }

    /// A measurement each 10°, 1 ms apart, from the front clockwise.
    fn sample(number: i64, range: f64) -> Sample {
        let clockwise_deg = (number as f64 * 10.0 + 1.0) % 360.0;
        Sample { clockwise_deg, range, intensity: 10.0, time: Time::from_nanos(number * 1_000_000) }
    }

    fn scans(settings: ScanSettings, samples: impl IntoIterator<Item = Sample>) -> Vec<LaserScan> {
        let mut builder = ScanBuilder::new(settings);
        let samples = samples.into_iter();
        samples.filter_map(|sample| Some(builder.push(&sample)?.into_scan(None))).collect()
    }

    #[test]
    fn a_revolution_is_cut_at_the_rear_and_its_beams_are_counter_clockwise() {
        let is_left = |number: i64| (19..36).contains(&(number % 36));
        let scans =
            scans(settings(), (0..90).map(|number| sample(number, if is_left(number) { 1.0 } else { 2.0 })));
        assert_eq!(scans.len(), 1, "the first one is not whole");
        let scan = &scans[0];
        assert_eq!(scan.ranges.len(), 36);
        assert!(scan.ranges[..18].iter().all(|range| *range == 2.0), "the right side: {:?}", scan.ranges);
        assert!(scan.ranges[19..35].iter().all(|range| *range == 1.0), "the left side: {:?}", scan.ranges);
        let degrees = [scan.angle_min, scan.angle_max, scan.angle_increment].map(f32::to_degrees);
        assert!(degrees.iter().zip([-175.0, 175.0, 10.0]).all(|(is, should)| (is - should).abs() < 1e-3));
    }

    #[test]
    fn the_stamp_is_the_time_of_the_first_beam_and_times_run_backwards() {
        let scans = scans(settings(), (0..130).map(|number| sample(number, 1.0)));
        let scan = &scans[1];
        // From 18 on, the samples are behind the cut; the second whole revolution has those from 54 to 89.
        assert_eq!(scan.header.stamp.as_nanos(), 89_000_000);
        assert!((scan.scan_time - 0.036).abs() < 1e-6 && (scan.time_increment + 0.001).abs() < 1e-6);
        let last = scan.header.stamp.as_nanos() as f64 + 35.0 * f64::from(scan.time_increment) * 1e9;
        assert!((last - 54e6).abs() < 1e3, "the last beam is the first one measured: {last}");
    }

    #[test]
    fn distances_beyond_the_range_are_infinite_and_holes_are_nothing() {
        let samples = (0..90).filter(|number| ![40, 41, 46].contains(number)).map(|number| match number {
            30 => sample(number, 0.05),
            32 => sample(number, 13.0),
            34 => sample(number, 0.0),
            45 => sample(number, 3.0),
            47 => sample(number, 4.0),
            _ => sample(number, 1.0),
        });
        let scans = scans(settings(), samples);
        let at = |number: usize| scans[0].ranges[(53 - number) % 36];
        assert_eq!([at(30), at(32), at(34)], [f32::NEG_INFINITY, f32::INFINITY, f32::INFINITY]);
        assert!(at(40).is_nan() && at(41).is_nan());
        assert_eq!(at(46), 3.0, "a single hole takes the nearer neighbour");
    }

    #[test]
    fn the_nearest_of_several_measurements_counts_and_weak_echoes_do_not() {
        let settings = ScanSettings { beams: 18, min_intensity: 5.0, no_echo: f32::NAN, ..settings() };
        let samples = (0..90).map(|number| match number {
            20 => sample(number, 0.5),
            22 => Sample { intensity: 1.0, ..sample(number, 0.2) },
            _ => sample(number, 1.0),
        });
        let scans = scans(settings, samples);
        let at = |number: usize| scans[0].ranges[(53 - number) / 2];
        assert_eq!([at(20), at(22)], [0.5, 1.0]);
    }

    #[test]
    fn a_direction_that_jumps_back_at_the_rear_makes_no_scan() {
        let wobble = |number: i64| {
            if number == 54 {
                Sample { clockwise_deg: 179.0, ..sample(54, 1.0) }
            } else {
                sample(number, 1.0)
            }
        };
        assert_eq!(scans(settings(), (0..130).map(wobble)).len(), 3);
    }

    #[test]
    fn a_revolution_with_a_pause_is_left_out() {
        let late = |number: i64| {
            let sample = sample(number, 1.0);
            if number < 60 { sample } else { Sample { time: sample.time + Duration::from_secs(1), ..sample } }
        };
        assert_eq!(scans(settings(), (0..130).map(late)).len(), 2);
    }

    #[test]
    fn the_forward_direction_turns_the_scan() {
        let near = |number: i64| sample(number, if number % 36 == 18 { 0.5 } else { 1.0 });
        let turned = scans(ScanSettings { forward_deg: 180.0, ..settings() }, (0..130).map(near));
        let nearest = turned[0].ranges.iter().position(|range| *range == 0.5).unwrap();
        let angle = turned[0].angle_min + nearest as f32 * turned[0].angle_increment;
        assert!(angle.abs() < 0.1, "what is behind the lidar is in front of the frame: {angle}");
    }
}
