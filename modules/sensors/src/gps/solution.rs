//! Positions, velocities and times from sentences.
//!
//! Topics and rules are those of nmea_navsat_driver, except where it says otherwise here:
//!
//! - a covariance from GST is the square of its deviations, of type `DIAGONAL_KNOWN` (the driver multiplies
//!   them with HDOP);
//! - the vertical deviation from dilution is that of VDOP, if GSA gives it, else twice that of HDOP;
//! - quality 9 (WAAS) is `SBAS_FIX`, quality 3 (PPS) is `FIX`;
//! - `vel` comes from RMC, and from VTG only where no RMC comes; without a course it is 0 below 0.5 m/s and
//!   else left out;
//! - `time_reference` comes with fixes only, and its date from RMC.

use std::time::Duration;

use downbeat_executor::Time;
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::geometry_msgs::msg::TwistStamped;
use downbeat_msgs::sensor_msgs::msg::{NavSatFix, NavSatStatus, TimeReference};

use super::sentence::{Content, Gga, Rmc, Sentence, TimeOfDay};
use crate::diagnostics::header;

/// How long deviations, dilutions, systems and dates are used.
const FRESH: Duration = Duration::from_millis(2500);
/// Below this speed a receiver without a course stands still, in m/s.
const STANDING: f64 = 0.5;
/// A day, in ns.
const DAY: i64 = 86_400_000_000_000;

/// What does not come from the receiver.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SolutionSettings {
    /// Of all messages.
    pub frame_id: String,
    /// The name of the time source.
    pub time_source: String,
    /// Whether positions come from RMC instead of GGA.
    pub uses_rmc: bool,
    /// The deviation of a position at HDOP 1 by quality, in m.
    pub deviations: Deviations,
}

/// The deviation of a position at HDOP 1, in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviations {
    /// Of qualities 1 and 3.
    pub fix: f64,
    /// Of quality 2.
    pub differential: f64,
    /// Of quality 4.
    pub rtk: f64,
    /// Of quality 5.
    pub rtk_float: f64,
    /// Of quality 9.
    pub satellite_based: f64,
}

impl Default for Deviations {
    /// Those of nmea_navsat_driver.
    fn default() -> Self {
        Self { fix: 4.0, differential: 0.1, rtk: 0.02, rtk_float: 4.0, satellite_based: 3.0 }
    }
}

/// A message that follows from a sentence.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// On `fix`.
    Fix(NavSatFix),
    /// On `vel`.
    Velocity(TwistStamped),
    /// On `time_reference`.
    Time(TimeReference),
}

/// What is known from the sentences so far.
#[derive(Debug, Default)]
pub struct Solution {
    settings: SolutionSettings,
    /// East, north and up, in m, and when they came.
    deviations: Option<([f64; 3], Time)>,
    vdop: Option<(f64, Time)>,
    /// Days since the Unix epoch and the time in them, of RMC.
    date: Option<(i64, TimeOfDay, Time)>,
    last_rmc: Option<Time>,
    services: Services,
    has_fix: bool,
    /// The last number of satellites.
    satellites: u32,
}

/// The systems whose satellites are used, each with the time at which it was named last.
#[derive(Debug, Default)]
struct Services([Option<Time>; 4]);

const SERVICES: [u16; 4] = [
    NavSatStatus::SERVICE_GPS,
    NavSatStatus::SERVICE_GLONASS,
    NavSatStatus::SERVICE_GALILEO,
    NavSatStatus::SERVICE_COMPASS,
];

impl Services {
    fn see(&mut self, index: usize, now: Time) {
        if let Some(seen) = self.0.get_mut(index) {
            *seen = Some(now);
        }
    }

    fn flags(&self, now: Time) -> u16 {
        let is_seen = |seen: &Option<Time>| seen.is_some_and(|at| now.saturating_since(at) <= FRESH);
        let flags = self.0.iter().zip(SERVICES).filter(|(seen, _)| is_seen(seen)).map(|(_, flag)| flag);
        match flags.fold(0, |all, flag| all | flag) {
            // As the driver says.
            0 => NavSatStatus::SERVICE_GPS,
            flags => flags,
        }
    }
}

impl Solution {
    /// Nothing is known.
    #[must_use]
    pub fn new(settings: SolutionSettings) -> Self {
        Self { settings, ..Self::default() }
    }

    /// Forgets everything, because the receiver was away.
    pub fn reset(&mut self) {
        *self = Self::new(std::mem::take(&mut self.settings));
    }

    /// Returns whether the last position was valid.
    #[must_use]
    pub fn has_fix(&self) -> bool {
        self.has_fix
    }

    /// The number of satellites of the last position.
    #[must_use]
    pub fn satellites(&self) -> u32 {
        self.satellites
    }

    /// Takes a sentence that arrived at this time.
    pub fn take(&mut self, sentence: &Sentence, arrived: Time, mut output: impl FnMut(Output)) {
        match &sentence.content {
            Content::Gga(gga) => {
                self.see_talker(sentence.talker, arrived);
                self.satellites = gga.satellites.unwrap_or_default();
                if !self.settings.uses_rmc {
                    let fix = self.fix(gga, arrived);
                    self.has_fix = fix.status.status >= NavSatStatus::STATUS_FIX;
                    output(Output::Fix(fix));
                    self.time(gga.time, arrived).into_iter().for_each(output);
                }
            }
            Content::Rmc(rmc) => {
                self.last_rmc = Some(arrived);
                if let (Some(date), Some(time), true) = (rmc.date, rmc.time, rmc.is_valid) {
                    self.date = Some((date, time, arrived));
                }
                if rmc.is_valid {
                    self.velocity(rmc.speed, rmc.course, arrived).into_iter().for_each(&mut output);
                }
                if self.settings.uses_rmc {
                    self.see_talker(sentence.talker, arrived);
                    self.has_fix = rmc.is_valid && rmc.position.is_some();
                    output(Output::Fix(self.fix_of_rmc(rmc, arrived)));
                    self.time(rmc.time, arrived).into_iter().for_each(output);
                }
            }
            Content::Gsa(gsa) => {
                self.vdop = gsa.vdop.map(|vdop| (vdop, arrived));
                if gsa.satellites > 0 {
                    match gsa.system {
                        Some(system) => {
                            let index = system.checked_sub(1).and_then(|index| usize::try_from(index).ok());
                            index.into_iter().for_each(|index| self.services.see(index, arrived));
                        }
                        None => self.see_talker(sentence.talker, arrived),
                    }
                }
            }
            Content::Gst(gst) => {
                let deviations = gst.east.zip(gst.north).zip(gst.up);
                self.deviations = deviations.map(|((east, north), up)| ([east, north, up], arrived));
            }
            Content::Vtg(vtg) => {
                let comes_rmc = self.last_rmc.is_some_and(|at| arrived.saturating_since(at) <= FRESH);
                if self.has_fix && !comes_rmc {
                    self.velocity(vtg.speed, vtg.course, arrived).into_iter().for_each(output);
                }
            }
            Content::Other => {}
        }
    }

    fn see_talker(&mut self, talker: [u8; 2], now: Time) {
        match &talker {
            b"GP" => self.services.see(0, now),
            b"GL" => self.services.see(1, now),
            b"GA" => self.services.see(2, now),
            b"GB" | b"BD" => self.services.see(3, now),
            _ => {}
        }
    }

    fn fix(&self, gga: &Gga, arrived: Time) -> NavSatFix {
        let deviations = self.settings.deviations;
        let (status, deviation) = match gga.quality {
            _ if gga.position.is_none() => (NavSatStatus::STATUS_NO_FIX, None),
            1 | 3 => (NavSatStatus::STATUS_FIX, Some(deviations.fix)),
            2 => (NavSatStatus::STATUS_SBAS_FIX, Some(deviations.differential)),
            4 => (NavSatStatus::STATUS_GBAS_FIX, Some(deviations.rtk)),
            5 => (NavSatStatus::STATUS_GBAS_FIX, Some(deviations.rtk_float)),
            9 => (NavSatStatus::STATUS_SBAS_FIX, Some(deviations.satellite_based)),
            _ => (NavSatStatus::STATUS_NO_FIX, None),
        };
        let fresh = |at: Time| arrived.saturating_since(at) <= FRESH;
        let measured = self.deviations.filter(|(_, at)| deviation.is_some() && fresh(*at));
        let vdop = self.vdop.filter(|(_, at)| fresh(*at)).map(|(vdop, _)| vdop);
        let (diagonal, kind) = match (measured, deviation, gga.hdop) {
            (Some((measured, _)), ..) => (measured, NavSatFix::COVARIANCE_TYPE_DIAGONAL_KNOWN),
            (None, Some(deviation), Some(hdop)) => {
                let up = vdop.unwrap_or(2.0 * hdop) * deviation;
                ([hdop * deviation, hdop * deviation, up], NavSatFix::COVARIANCE_TYPE_APPROXIMATED)
            }
            _ => ([0.0; 3], NavSatFix::COVARIANCE_TYPE_UNKNOWN),
        };
        let [east, north, up] = diagonal.map(|deviation| deviation * deviation);
        let [latitude, longitude] = gga.position.unwrap_or([f64::NAN; 2]);
        let altitude = gga.position.and(gga.altitude).zip(gga.geoid_separation);
        NavSatFix {
            latitude,
            longitude,
            altitude: altitude.map_or(f64::NAN, |(above_sea, separation)| above_sea + separation),
            position_covariance: [east, 0.0, 0.0, 0.0, north, 0.0, 0.0, 0.0, up],
            position_covariance_type: kind,
            ..self.empty_fix(status, arrived)
        }
    }

    fn fix_of_rmc(&self, rmc: &Rmc, arrived: Time) -> NavSatFix {
        let status = if self.has_fix { NavSatStatus::STATUS_FIX } else { NavSatStatus::STATUS_NO_FIX };
        let [latitude, longitude] = rmc.position.unwrap_or([f64::NAN; 2]);
        NavSatFix { latitude, longitude, altitude: f64::NAN, ..self.empty_fix(status, arrived) }
    }

    fn empty_fix(&self, status: i8, arrived: Time) -> NavSatFix {
        NavSatFix {
            header: header(arrived, &self.settings.frame_id),
            status: NavSatStatus { status, service: self.services.flags(arrived) },
            position_covariance_type: NavSatFix::COVARIANCE_TYPE_UNKNOWN,
            ..NavSatFix::default()
        }
    }

    /// In the frame of the receiver as the driver has it: x east, y north.
    fn velocity(&self, speed: Option<f64>, course_deg: Option<f64>, arrived: Time) -> Option<Output> {
        let speed = speed?;
        let mut velocity =
            TwistStamped { header: header(arrived, &self.settings.frame_id), ..TwistStamped::default() };
        match course_deg {
            Some(course) => {
                let (east, north) = libm::sincos(course.to_radians());
                velocity.twist.linear.x = speed * east;
                velocity.twist.linear.y = speed * north;
            }
            None if speed < STANDING => {}
            None => return None,
        }
        Some(Output::Velocity(velocity))
    }

    /// The time of the receiver: on the day of RMC, or else on that day which brings it nearest to the time
    /// of the robot.
    fn time(&self, time: Option<TimeOfDay>, arrived: Time) -> Option<Output> {
        let time = i64::try_from(time.filter(|_| self.has_fix)?).ok()?;
        let known = self.date.filter(|(_, _, at)| arrived.saturating_since(*at) <= FRESH);
        let near = known.map_or(arrived.as_nanos(), |(day, time, _)| {
            day.saturating_mul(DAY).saturating_add(i64::try_from(time).unwrap_or_default())
        });
        let day = near.saturating_sub(time).saturating_add(DAY / 2).div_euclid(DAY);
        let nanoseconds = day.checked_mul(DAY)?.checked_add(time).filter(|nanoseconds| *nanoseconds >= 0)?;
        Some(Output::Time(TimeReference {
            header: header(arrived, &self.settings.frame_id),
            time_ref: Stamp::from_nanos(nanoseconds),
            source: self.settings.time_source.clone(),
        }))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::sentence::line;
    use super::*;

    fn solution() -> Solution {
        Solution::new(SolutionSettings {
            frame_id: "gps".into(),
            time_source: "gps".into(),
            ..SolutionSettings::default()
        })
    }

    fn take(solution: &mut Solution, bodies: &[&str]) -> Vec<Output> {
        let mut outputs = Vec::new();
        for body in bodies {
            let sentence = Sentence::parse(line(body).trim_ascii_end()).unwrap();
            solution.take(&sentence, Time::from_nanos(1_000_000_000_000), |output| outputs.push(output));
        }
        outputs
    }

    fn fix(solution: &mut Solution, bodies: &[&str]) -> NavSatFix {
        let outputs = take(solution, bodies);
        let mut fixes = outputs.into_iter().filter_map(|output| match output {
            Output::Fix(fix) => Some(fix),
            _ => None,
        });
        fixes.next_back().unwrap()
    }

    const GGA: &str = "GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,";

    #[test]
    fn a_fix_has_its_position_on_the_ellipsoid_and_a_covariance_from_dilution() {
        let fix = fix(&mut solution(), &[GGA]);
        assert!((fix.latitude - 48.1173).abs() < 1e-9 && (fix.longitude - 11.516_666_667).abs() < 1e-9);
        assert!((fix.altitude - 592.3).abs() < 1e-9);
        assert_eq!(
            (fix.status.status, fix.status.service),
            (NavSatStatus::STATUS_FIX, NavSatStatus::SERVICE_GPS)
        );
        assert_eq!(fix.position_covariance_type, NavSatFix::COVARIANCE_TYPE_APPROXIMATED);
        let diagonal = [0, 4, 8].map(|index| fix.position_covariance[index]);
        for (is, should) in diagonal.into_iter().zip([12.96, 12.96, 51.84]) {
            assert!((is - should).abs() < 1e-9, "{diagonal:?}");
        }
        assert_eq!((fix.header.frame_id.as_str(), fix.header.stamp.sec), ("gps", 1000));
    }

    #[test]
    fn deviations_of_the_receiver_have_precedence_and_vdop_is_used() {
        let mut solution = solution();
        let known = fix(&mut solution, &["GPGST,082356.00,1.8,,,,1.7,1.3,2.2", GGA]);
        assert_eq!(known.position_covariance_type, NavSatFix::COVARIANCE_TYPE_DIAGONAL_KNOWN);
        let [east, north, up] = [0, 4, 8].map(|index| known.position_covariance[index]);
        assert!((east - 1.69).abs() < 1e-9 && (north - 2.89).abs() < 1e-9 && (up - 4.84).abs() < 1e-9);
        let approximated = fix(
            &mut solution,
            &["GPGST,082356.00,,,,,,,", "GPGSA,A,3,04,05,,09,12,,,24,,,,,2.5,1.3,2.1", GGA],
        );
        assert_eq!(approximated.position_covariance_type, NavSatFix::COVARIANCE_TYPE_APPROXIMATED);
        assert!((approximated.position_covariance[8] - (2.1_f64 * 4.0).powi(2)).abs() < 1e-9);
    }

    #[test]
    fn without_a_fix_there_is_no_position() {
        let mut solution = solution();
        let outputs = take(
            &mut solution,
            &["GNGGA,,,,,,0,00,99.99,,,,,,", "GPRMC,,V,,,,,,,,,,N", "GPVTG,,T,,M,0.1,N,0.2,K,N"],
        );
        let [Output::Fix(fix)] = &outputs[..] else { panic!("{outputs:?}") };
        assert_eq!(fix.status.status, NavSatStatus::STATUS_NO_FIX);
        assert!(fix.latitude.is_nan() && fix.longitude.is_nan() && fix.altitude.is_nan());
        assert_eq!(fix.position_covariance_type, NavSatFix::COVARIANCE_TYPE_UNKNOWN);
        assert!(!solution.has_fix());
    }

    #[test]
    fn qualities_are_statuses() {
        let status = |quality: u8| {
            let fix = fix(&mut solution(), &[&GGA.replace(",E,1,", &format!(",E,{quality},"))]);
            (fix.status.status, fix.position_covariance_type)
        };
        let approximated = NavSatFix::COVARIANCE_TYPE_APPROXIMATED;
        assert_eq!(status(2), (NavSatStatus::STATUS_SBAS_FIX, approximated));
        assert_eq!(status(4), (NavSatStatus::STATUS_GBAS_FIX, approximated));
        assert_eq!(status(5), (NavSatStatus::STATUS_GBAS_FIX, approximated));
        assert_eq!(status(9), (NavSatStatus::STATUS_SBAS_FIX, approximated));
        for quality in [0, 6, 7, 8] {
            assert_eq!(status(quality), (NavSatStatus::STATUS_NO_FIX, NavSatFix::COVARIANCE_TYPE_UNKNOWN));
        }
    }

    #[test]
    fn systems_are_those_whose_satellites_are_used() {
        let all = [
            "GNGSA,A,3,04,,,,,,,,,,,,2.5,1.3,2.1,1",
            "GNGSA,A,3,70,,,,,,,,,,,,2.5,1.3,2.1,2",
            "GNGSA,A,3,,,,,,,,,,,,,2.5,1.3,2.1,3",
        ];
        let gga = GGA.replace("GPGGA", "GNGGA");
        let bodies = [&all[..], &[gga.as_str()]].concat();
        let service = fix(&mut solution(), &bodies).status.service;
        assert_eq!(service, NavSatStatus::SERVICE_GPS | NavSatStatus::SERVICE_GLONASS);
        let galileo = fix(&mut solution(), &[&GGA.replace("GPGGA", "GAGGA")]);
        assert_eq!(galileo.status.service, NavSatStatus::SERVICE_GALILEO);
        let odd = fix(
            &mut solution(),
            &["GNGSA,A,3,04,,,,,,,,,,,,2.5,1.3,2.1,0", "GNGSA,A,3,04,,,,,,,,,,,,2.5,1.3,2.1,77", &gga],
        );
        assert_eq!(odd.status.service, NavSatStatus::SERVICE_GPS);
    }

    #[test]
    fn the_velocity_is_east_and_north() {
        let outputs =
            take(&mut solution(), &["GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W"]);
        let [Output::Velocity(velocity)] = &outputs[..] else { panic!("{outputs:?}") };
        let speed = 22.4 * 1852.0 / 3600.0;
        let (east, north) = libm::sincos(84.4_f64.to_radians());
        assert!((velocity.twist.linear.x - speed * east).abs() < 1e-9);
        assert!((velocity.twist.linear.y - speed * north).abs() < 1e-9);
    }

    #[test]
    fn a_velocity_without_course_is_zero_while_standing_and_is_else_left_out() {
        let velocity = |speed: &str| {
            take(&mut solution(), &[&format!("GPRMC,123519,A,4807.038,N,01131.000,E,{speed},,230394,,")])
        };
        let standing = velocity("0.02");
        let [Output::Velocity(velocity_of_standing)] = &standing[..] else { panic!("{standing:?}") };
        assert_eq!(velocity_of_standing.twist, TwistStamped::default().twist);
        assert_eq!(velocity("3.0"), []);
    }

    #[test]
    fn a_velocity_comes_from_vtg_where_no_rmc_comes() {
        let vtg = "GPVTG,054.7,T,034.4,M,005.5,N,010.2,K";
        let is_velocity = |output: &Output| matches!(output, Output::Velocity(_));
        let count = |bodies: &[&str]| {
            take(&mut solution(), bodies).iter().filter(|output| is_velocity(output)).count()
        };
        assert_eq!(count(&[vtg]), 0, "without a fix");
        assert_eq!(count(&[GGA, vtg]), 1);
        assert_eq!(count(&["GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W", GGA, vtg]), 1);
    }

    #[test]
    fn the_time_of_the_receiver_has_the_date_of_rmc_also_at_midnight() {
        let time = |rmc: &str, gga: &str| {
            let outputs = take(&mut solution(), &[rmc, gga]);
            let mut times = outputs.into_iter().filter_map(|output| match output {
                Output::Time(reference) => Some(reference),
                _ => None,
            });
            times.next_back().unwrap()
        };
        let rmc = "GPRMC,235959.00,A,4717.11437,N,00833.91522,E,0.004,77.52,091202,,,A";
        let at = |time: &str| GGA.replace("123519", time);
        let midnight = 12_031_i64 * 86_400;
        let before = time(rmc, &at("235959.50"));
        assert_eq!((i64::from(before.time_ref.sec), before.time_ref.nanosec), (midnight - 1, 500_000_000));
        assert_eq!(i64::from(time(rmc, &at("000000.00")).time_ref.sec), midnight);
        assert_eq!(before.source, "gps");
        let outputs = take(&mut solution(), &[&at("001640.00")]);
        let Some(Output::Time(of_robot)) = outputs.last() else { panic!("{outputs:?}") };
        assert_eq!(of_robot.time_ref.sec, 1000, "on the robot's day, which is that of the epoch here");
    }

    #[test]
    fn positions_come_from_rmc_on_request() {
        let mut solution = Solution::new(SolutionSettings { uses_rmc: true, ..SolutionSettings::default() });
        let fix =
            fix(&mut solution, &[GGA, "GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W"]);
        assert!(fix.altitude.is_nan() && fix.status.status == NavSatStatus::STATUS_FIX);
        assert_eq!(fix.position_covariance_type, NavSatFix::COVARIANCE_TYPE_UNKNOWN);
    }
}
