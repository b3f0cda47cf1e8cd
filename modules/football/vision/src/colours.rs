//! Classes of colours, in a file that people can read, and as a table.

use downbeat_files::toml::Source;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What a colour can belong to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Class {
    /// Everything else.
    #[default]
    Other,
    /// The carpet.
    Green,
    /// Lines, posts, parts of balls.
    White,
    /// The ball.
    Orange,
    /// The goals.
    Yellow,
    /// What the blue team wears.
    Blue,
    /// What the red team wears.
    Red,
}

/// The colours of a class.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClassRange {
    /// In degrees, 0 to 360: red 0, green 120, blue 240. If the first is larger, the range contains 0.
    pub hue: [f64; 2],
    /// From 0 for grey to 1.
    pub saturation: [f64; 2],
    /// The largest of red, green and blue, from 0 to 1.
    pub value: [f64; 2],
}

/// The colours of all classes. A colour of two classes belongs to the first of orange, yellow, green, white,
/// blue, red.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Colours {
    /// The ball.
    pub orange: ClassRange,
    /// The goals.
    pub yellow: ClassRange,
    /// The carpet.
    pub green: ClassRange,
    /// Lines.
    pub white: ClassRange,
    /// What the blue team wears.
    pub blue: ClassRange,
    /// What the red team wears.
    pub red: ClassRange,
}

/// Why a file of colours is refused.
#[derive(Debug, thiserror::Error)]
pub enum ColoursError {
    /// The file cannot be read, is no TOML, or has unknown keys or values of another type.
    #[error(transparent)]
    File(#[from] downbeat_files::toml::Error),
    /// A range is not possible.
    #[error("{file}: {key} of {class} is {found:?}; it has to be {allowed}")]
    Range {
        /// The file.
        file: String,
        /// The class.
        class: &'static str,
        /// The key.
        key: &'static str,
        /// The range.
        found: [f64; 2],
        /// What is possible.
        allowed: &'static str,
    },
}

/// The longest file, in bytes.
const LONGEST: u64 = 1 << 16;

impl Default for Colours {
    /// Wide ranges that fit the simulator and bright halls.
    fn default() -> Self {
        let range = |hue, saturation, value| ClassRange { hue, saturation, value };
        Self {
            orange: range([8.0, 39.0], [0.5, 1.0], [0.2, 1.0]),
            yellow: range([40.0, 79.0], [0.5, 1.0], [0.25, 1.0]),
            green: range([80.0, 175.0], [0.25, 1.0], [0.08, 1.0]),
            white: range([0.0, 360.0], [0.0, 0.3], [0.4, 1.0]),
            blue: range([205.0, 255.0], [0.5, 1.0], [0.15, 1.0]),
            red: range([335.0, 12.0], [0.5, 1.0], [0.15, 1.0]),
        }
    }
}

impl Colours {
    /// Reads a file.
    ///
    /// # Errors
    /// [`ColoursError`].
    pub fn read(path: &Path) -> Result<Self, ColoursError> {
        Self::checked(&Source::read(path, "the colour file", LONGEST)?)
    }

    /// Reads colours from text; `file` names it in errors.
    ///
    /// # Errors
    /// [`ColoursError`].
    pub fn parse(text: &str, file: &str) -> Result<Self, ColoursError> {
        Self::checked(&Source::new(file, text))
    }

    fn checked(source: &Source<'_>) -> Result<Self, ColoursError> {
        let colours: Self = source.parse()?;
        for (class, range) in colours.classes() {
            let refuse = |key, found, allowed| {
                Err(ColoursError::Range {
                    file: source.path().display().to_string(),
                    class,
                    key,
                    found,
                    allowed,
                })
            };
            if !range.hue.iter().all(|hue| (0.0..=360.0).contains(hue)) {
                return refuse("hue", range.hue, "two numbers from 0 to 360");
            }
            for (key, found) in [("saturation", range.saturation), ("value", range.value)] {
                if !(0.0 <= found[0] && found[0] <= found[1] && found[1] <= 1.0) {
                    return refuse(key, found, "two numbers from 0 to 1, the smaller one first");
                }
            }
        }
        Ok(colours)
    }

    /// The text of a file with these colours.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text =
            "# Colour classes: hue in degrees, saturation and value from 0 to 1 (docs/vision.md).\n"
                .to_owned();
        for (class, ClassRange { hue, saturation, value }) in self.classes() {
            let pair = |[from, to]: [f64; 2], digits: usize| format!("[{from:.digits$}, {to:.digits$}]");
            text += &format!(
                "\n[{class}]\nhue = {}\nsaturation = {}\nvalue = {}\n",
                pair(hue, 1),
                pair(saturation, 3),
                pair(value, 3)
            );
        }
        text
    }

    /// The class of a colour.
    #[must_use]
    pub fn class_of(&self, rgb: [u8; 3]) -> Class {
        let hsv = hsv(rgb);
        let classes = [
            (Class::Orange, &self.orange),
            (Class::Yellow, &self.yellow),
            (Class::Green, &self.green),
            (Class::White, &self.white),
            (Class::Blue, &self.blue),
            (Class::Red, &self.red),
        ];
        classes.into_iter().find(|(_, range)| range.contains(hsv)).map_or(Class::Other, |(class, _)| class)
    }

    /// In order of precedence.
    fn classes(&self) -> [(&'static str, ClassRange); 6] {
        [
            ("orange", self.orange),
            ("yellow", self.yellow),
            ("green", self.green),
            ("white", self.white),
            ("blue", self.blue),
            ("red", self.red),
        ]
    }
}

impl ClassRange {
    fn contains(&self, [hue, saturation, value]: [f64; 3]) -> bool {
        let [from, to] = self.hue;
        let is_hue = if from <= to { (from..=to).contains(&hue) } else { hue >= from || hue <= to };
        is_hue
            && (self.saturation[0]..=self.saturation[1]).contains(&saturation)
            && (self.value[0]..=self.value[1]).contains(&value)
    }
}

/// Hue in degrees, saturation, value.
pub(crate) fn hsv(rgb: [u8; 3]) -> [f64; 3] {
    let [r, g, b] = rgb.map(|part| f64::from(part) / 255.0);
    let (most, least) = (r.max(g).max(b), r.min(g).min(b));
    let range = most - least;
    if range <= 0.0 {
        return [0.0, 0.0, most];
    }
    let sixth = if most == r {
        ((g - b) / range).rem_euclid(6.0)
    } else if most == g {
        (b - r) / range + 2.0
    } else {
        (r - g) / range + 4.0
    };
    [sixth * 60.0, range / most, most]
}

/// The class of each colour, with 6 bits of red, green and blue.
#[derive(Clone, Debug)]
pub struct Table {
    classes: Box<[Class]>,
}

impl Table {
    /// Looks all colours up once.
    #[must_use]
    pub fn new(colours: &Colours) -> Self {
        let part = |index: usize, shift: usize| (((index >> shift) & 63) * 4 + 2) as u8;
        let class = |index| colours.class_of([part(index, 12), part(index, 6), part(index, 0)]);
        Self { classes: (0..1 << 18).map(class).collect() }
    }

    /// The class of a colour.
    #[inline]
    #[must_use]
    pub fn class_of(&self, [r, g, b]: [u8; 3]) -> Class {
        self.classes[(usize::from(r >> 2) << 12) | (usize::from(g >> 2) << 6) | usize::from(b >> 2)]
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_written_file_is_read_again() {
        let colours = Colours::default();
        assert_eq!(Colours::parse(&colours.to_text(), "colours.toml").unwrap(), colours);
    }

    #[test]
    fn the_table_knows_the_colours_of_a_field() {
        let table = Table::new(&Colours::default());
        let classes =
            [[40, 130, 50], [235, 235, 235], [230, 90, 20], [230, 210, 30], [150, 175, 200], [20, 20, 20]];
        let expected = [Class::Green, Class::White, Class::Orange, Class::Yellow, Class::White, Class::Other];
        assert_eq!(classes.map(|rgb| table.class_of(rgb)), expected);
        let teams = [[30, 60, 200], [20, 40, 80], [190, 30, 40], [90, 12, 14]];
        let expected = [Class::Blue, Class::Blue, Class::Red, Class::Red];
        assert_eq!(teams.map(|rgb| table.class_of(rgb)), expected);
    }

    #[test]
    fn impossible_ranges_are_refused() {
        let error = |text: &str| Colours::parse(text, "c.toml").unwrap_err().to_string();
        let range = |hue: &str| format!("[green]\nhue = {hue}\nsaturation = [0, 1]\nvalue = [0.5, 0.2]\n");
        assert!(error(&range("[0, 400]")).contains("hue of green is [0.0, 400.0]"));
        assert!(error(&range("[0, 40]")).contains("value of green is [0.5, 0.2]"));
        assert!(error("[green]\nhu = 3").starts_with("c.toml:2: "));
    }

    #[test]
    fn hues_around_red_are_one_range() {
        let red = ClassRange { hue: [350.0, 10.0], saturation: [0.0, 1.0], value: [0.0, 1.0] };
        assert!(
            red.contains(hsv([200, 0, 5]))
                && red.contains(hsv([200, 5, 0]))
                && !red.contains(hsv([0, 200, 0]))
        );
    }
}
