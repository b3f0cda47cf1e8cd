//! Points in time as XML Schema's `dateTime` writes them.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

const SECONDS_PER_DAY: i64 = 86_400;

/// Reads `2030-05-01T12:00:00`, with fractions of a second and a zone (`Z`, `+02:00`) or without; without a
/// zone, it is UTC. `None` if it is no such text or lies outside of the years 1 to 9999.
pub(crate) fn parse(text: &str) -> Option<SystemTime> {
    let (date, rest) = text.split_once('T')?;
    let (clock, offset) = split_zone(rest)?;
    let mut fields = date.split('-');
    let (year, month, day) =
        (number(fields.next()?, 4)?, number(fields.next()?, 2)?, number(fields.next()?, 2)?);
    let (clock, fraction) = clock.split_once('.').map_or((clock, None), |(clock, part)| (clock, Some(part)));
    let mut times = clock.split(':');
    let (hour, minute, second) =
        (number(times.next()?, 2)?, number(times.next()?, 2)?, number(times.next()?, 2)?);
    let is_whole = fields.next().is_none()
        && times.next().is_none()
        && fraction
            .is_none_or(|digits| !digits.is_empty() && digits.bytes().all(|digit| digit.is_ascii_digit()));
    let is_date = year >= 1 && (1..=12).contains(&month) && (1..=days_of(year, month)).contains(&day);
    if !is_whole || !is_date || hour > 23 || minute > 59 || second > 59 {
        return None;
    }
    let seconds = days_since_1970(year, month, day) * SECONDS_PER_DAY + hour * 3600 + minute * 60 + second;
    let nanoseconds: u32 = format!("{:0<9.9}", fraction.unwrap_or_default()).parse().ok()?;
    let since = Duration::new((seconds - offset).unsigned_abs(), 0);
    let whole = if seconds >= offset { UNIX_EPOCH.checked_add(since) } else { UNIX_EPOCH.checked_sub(since) };
    whole?.checked_add(Duration::from_nanos(nanoseconds.into()))
}

/// Writes a time as `2030-05-01T12:00:00`, in UTC, without a zone, as sros2 does. Fractions are cut off.
pub(crate) fn format(time: SystemTime) -> String {
    let seconds = match time.duration_since(UNIX_EPOCH) {
        Ok(since) => i64::try_from(since.as_secs()).unwrap_or(i64::MAX),
        Err(before) => -i64::try_from(before.duration().as_secs()).unwrap_or(i64::MAX),
    };
    let (year, month, day) = date_of(seconds.div_euclid(SECONDS_PER_DAY));
    let of_day = seconds.rem_euclid(SECONDS_PER_DAY);
    let (hour, minute, second) = (of_day / 3600, of_day / 60 % 60, of_day % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}")
}

/// The clock's text, and by how many seconds its zone is ahead of UTC.
fn split_zone(text: &str) -> Option<(&str, i64)> {
    if let Some(clock) = text.strip_suffix('Z') {
        return Some((clock, 0));
    }
    let Some(at) = text.find(['+', '-']) else { return Some((text, 0)) };
    let (clock, zone) = text.split_at_checked(at)?;
    let (hours, minutes) = zone.get(1..)?.split_once(':')?;
    let (hours, minutes) = (number(hours, 2)?, number(minutes, 2)?);
    let offset = hours * 3600 + minutes * 60;
    let is_offset = minutes < 60 && offset <= 14 * 3600;
    is_offset.then_some((clock, if zone.starts_with('-') { -offset } else { offset }))
}

/// A number of exactly so many digits.
fn number(text: &str, digits: usize) -> Option<i64> {
    let is_number = text.len() == digits && text.bytes().all(|digit| digit.is_ascii_digit());
    is_number.then(|| text.parse().ok())?
}

fn days_of(year: i64, month: i64) -> i64 {
    match month {
        2 if year % 4 == 0 && (year % 100 != 0 || year % 400 == 0) => 29,
        2 => 28,
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    }
}

// A year that begins in March has its leap day at its end; 400 years have 146 097 days.
const DAYS_OF_400_YEARS: i64 = 146_097;
/// Days from March 1 of the year 0 to January 1 1970.
const DAYS_TO_1970: i64 = 719_468;

fn days_since_1970(year: i64, month: i64, day: i64) -> i64 {
    let year = if month <= 2 { year - 1 } else { year };
    let (era, of_era) = (year.div_euclid(400), year.rem_euclid(400));
    let of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    era * DAYS_OF_400_YEARS + of_era * 365 + of_era / 4 - of_era / 100 + of_year - DAYS_TO_1970
}

fn date_of(days: i64) -> (i64, i64, i64) {
    let days = days.saturating_add(DAYS_TO_1970);
    let (era, of_era) = (days.div_euclid(DAYS_OF_400_YEARS), days.rem_euclid(DAYS_OF_400_YEARS));
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let from_march = (5 * of_year + 2) / 153;
    let day = of_year - (153 * from_march + 2) / 5 + 1;
    let month = (from_march + 2) % 12 + 1;
    (era * 400 + year + i64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_is_read_in_its_zone_and_without_one_in_utc() {
        // Seconds from `date -u -d … +%s`.
        let cases = [
            ("1970-01-01T00:00:00", 0),
            ("2030-05-01T00:00:00", 1_903_824_000),
            ("2030-05-01T00:00:00Z", 1_903_824_000),
            ("2030-05-01T02:00:00+02:00", 1_903_824_000),
            ("2030-04-30T18:30:00-05:30", 1_903_824_000),
            ("2024-02-29T23:59:59", 1_709_251_199),
            ("2115-09-15T01:00:00", 4_597_952_400),
        ];
        for (text, seconds) in cases {
            assert_eq!(parse(text), Some(UNIX_EPOCH + Duration::from_secs(seconds)), "{text}");
        }
        assert_eq!(parse("1970-01-01T00:00:00.25"), Some(UNIX_EPOCH + Duration::from_millis(250)));
        assert_eq!(parse("1969-12-31T23:59:59"), Some(UNIX_EPOCH - Duration::from_secs(1)));
    }

    #[test]
    fn every_day_of_four_centuries_is_written_as_it_is_read() {
        for day in 0..DAYS_OF_400_YEARS.unsigned_abs() {
            let time = UNIX_EPOCH + Duration::from_secs(day * SECONDS_PER_DAY.unsigned_abs() + 86_399);
            assert_eq!(parse(&format(time)), Some(time), "{}", format(time));
        }
        assert_eq!(format(UNIX_EPOCH - Duration::from_secs(1)), "1969-12-31T23:59:59");
    }

    #[test]
    fn a_text_that_is_no_time_is_refused() {
        let texts = [
            "",
            "2030-05-01",
            "2030-05-01 00:00:00",
            "2030-13-01T00:00:00",
            "2030-02-29T00:00:00",
            "2030-05-00T00:00:00",
            "2030-05-01T24:00:00",
            "2030-05-01T00:60:00",
            "2030-05-01T00:00:60",
            "2030-05-01T00:00",
            "2030-05-01T00:00:00.",
            "2030-05-01T00:00:00+2",
            "2030-05-01T00:00:00+15:00",
            "+030-05-01T00:00:00",
            "99999-05-01T00:00:00",
            "2030-05-01-01T00:00:00",
            "0000-05-01T00:00:00",
        ];
        for text in texts {
            assert_eq!(parse(text), None, "{text}");
        }
    }
}
