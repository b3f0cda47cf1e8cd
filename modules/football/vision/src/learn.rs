//! Colour classes from marks in pictures.

use crate::colours::{Class, ClassRange, Colours, hsv};
use downbeat_pictures::Picture;
use glam::DVec2;

/// Colours of classes, from marks that a person sets in pictures.
///
/// From a mark, all pixels within a radius count. The ranges of a class contain 98 of 100 of its pixels, and
/// some more: other light is darker and paler. What hue classes have in common is divided in the middle
/// between them.
///
/// ```
/// use downbeat_vision::{Class, Colours, Encoding, Picture, Samples};
///
/// let blue_green = [20_u8, 140, 110].repeat(32 * 32);
/// let picture = Picture::new([32, 32], 32 * 3, Encoding::Rgb8, &blue_green)?;
/// let mut samples = Samples::default();
/// samples.add(&picture, Class::Green, [16.0, 16.0], 4.0);
/// let colours = samples.learn(Colours::default())?;
/// assert_eq!(colours.class_of([20, 140, 110]), Class::Green);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct Samples {
    /// Hue, saturation and value.
    orange: Vec<[f64; 3]>,
    yellow: Vec<[f64; 3]>,
    green: Vec<[f64; 3]>,
    white: Vec<[f64; 3]>,
    blue: Vec<[f64; 3]>,
    red: Vec<[f64; 3]>,
}

/// Why no colours are learned.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LearnError {
    /// A class has too few pixels.
    #[error("{class}: {found} pixels are marked, {LEAST} are needed; mark more places, or larger ones")]
    Few {
        /// The class.
        class: &'static str,
        /// Its pixels.
        found: usize,
    },
    /// Marked pixels have no hue.
    #[error("{class}: the marked pixels are grey (saturation {saturation:.2}); do the marks lie on it?")]
    Grey {
        /// The class.
        class: &'static str,
        /// Its smallest usual saturation.
        saturation: f64,
    },
    /// Marked pixels have all sorts of hues.
    #[error("{class}: the marked pixels have hues over {range:.0} degrees; do all marks lie on it?")]
    Mixed {
        /// The class.
        class: &'static str,
        /// Between its usual hues.
        range: f64,
    },
    /// Lines are as colourful as something else.
    #[error("white: the marked pixels have colour (saturation {saturation:.2}); do the marks lie on lines?")]
    Colourful {
        /// Its largest usual saturation.
        saturation: f64,
    },
    /// Two classes look the same.
    #[error("{one} and {other} have the same hue ({hue:.0} degrees); do the marks lie on what they name?")]
    Same {
        /// The class with the smaller hue.
        one: &'static str,
        /// The class with the larger hue.
        other: &'static str,
        /// Where they meet, in degrees.
        hue: f64,
    },
}

/// The fewest pixels of a class.
const LEAST: usize = 12;
/// The share of pixels at either end that do not count.
const TAIL: f64 = 0.01;
/// What is added to hues, in degrees.
const HUE_MARGIN: f64 = 9.0;
const SATURATION_MARGIN: f64 = 0.15;
const VALUE_MARGIN: f64 = 0.25;
const WHITE_SATURATION_MARGIN: f64 = 0.08;
/// The widest range of hues of a class, in degrees.
const WIDEST: f64 = 90.0;
/// The most pixels that a class keeps.
const MOST: usize = 1 << 20;

impl Samples {
    /// Adds the pixels of a disc. [`Class::Other`] has no colours, and is ignored.
    pub fn add(&mut self, picture: &Picture<'_>, class: Class, centre: impl Into<DVec2>, radius: f64) {
        let centre = centre.into();
        let pixels = match class {
            Class::Other => return,
            Class::Orange => &mut self.orange,
            Class::Yellow => &mut self.yellow,
            Class::Green => &mut self.green,
            Class::White => &mut self.white,
            Class::Blue => &mut self.blue,
            Class::Red => &mut self.red,
        };
        let width = picture.width();
        picture.each_pixel(|index, rgb| {
            let pixel = DVec2::new((index % width) as f64, (index / width) as f64);
            if pixel.distance_squared(centre) <= radius * radius && pixels.len() < MOST {
                pixels.push(hsv(rgb));
            }
        });
    }

    /// The colours of all classes; one without marks keeps its colours, as far as the others leave it hues.
    ///
    /// # Errors
    /// [`LearnError`], if the marks do not make sense.
    pub fn learn(&self, before: Colours) -> Result<Colours, LearnError> {
        let mut colours = before;
        // In the order of their hues, where red may begin below 0.
        let names = ["red", "orange", "yellow", "green", "blue"];
        let pixels = [&self.red, &self.orange, &self.yellow, &self.green, &self.blue];
        let mut ranges = [colours.red, colours.orange, colours.yellow, colours.green, colours.blue];
        if ranges[0].hue[0] > ranges[0].hue[1] {
            ranges[0].hue[0] -= 360.0;
        }
        // Of classes with marks: the usual hues.
        let mut usual = [None; 5];
        for (index, pixels) in pixels.into_iter().enumerate().filter(|(_, pixels)| !pixels.is_empty()) {
            let found = hues_of(names[index], pixels)?;
            usual[index] = Some(found);
            // A red ball is cut off at 0.
            let least = if index == 0 { -360.0 } else { 0.0 };
            ranges[index] = with_hue(found, least, pixels);
        }
        let pairs = (0..names.len()).flat_map(|one| (one + 1..names.len()).map(move |other| (one, other)));
        for (one, other) in pairs {
            let (end, start) = (ranges[one].hue[1], ranges[other].hue[0]);
            if end <= start {
                continue;
            }
            let border = match (usual[one], usual[other]) {
                (Some([_, end]), Some([start, _])) if end < start => f64::midpoint(end, start),
                (Some([_, hue]), Some(_)) => {
                    return Err(LearnError::Same { one: names[one], other: names[other], hue });
                }
                // One without marks gives way.
                (Some(_), None) => end,
                (None, Some(_)) => start,
                (None, None) => continue,
            };
            (ranges[one].hue[1], ranges[other].hue[0]) = (border, border);
            // What has no hue left, as yellow between a ball and a carpet of almost the same hue, is nothing.
            for range in [one, other] {
                ranges[range].hue[1] = ranges[range].hue[1].max(ranges[range].hue[0]);
            }
        }
        if ranges[0].hue[0] < 0.0 {
            ranges[0].hue = [ranges[0].hue[0] + 360.0, ranges[0].hue[1].rem_euclid(360.0)];
        }
        [colours.red, colours.orange, colours.yellow, colours.green, colours.blue] = ranges;
        if !self.white.is_empty() {
            let [_, saturation] = tails("white", self.white.iter().map(|pixel| pixel[1]))?;
            let [value, _] = tails("white", self.white.iter().map(|pixel| pixel[2]))?;
            if saturation > 0.6 {
                return Err(LearnError::Colourful { saturation });
            }
            colours.white = ClassRange {
                hue: [0.0, 360.0],
                saturation: [0.0, saturation + WHITE_SATURATION_MARGIN],
                value: [(value - VALUE_MARGIN).max(0.0), 1.0],
            };
        }
        Ok(colours)
    }
}

/// The usual hues of a class, from 0 to 360; a ball's may begin below 0.
fn hues_of(class: &'static str, pixels: &[[f64; 3]]) -> Result<[f64; 2], LearnError> {
    let [saturation, _] = tails(class, pixels.iter().map(|pixel| pixel[1]))?;
    let [from, to] = tails(
        class,
        // Red is 0 and 360: count from -60 to 300.
        pixels.iter().map(|pixel| if pixel[0] > 300.0 { pixel[0] - 360.0 } else { pixel[0] }),
    )?;
    if saturation < 0.1 {
        return Err(LearnError::Grey { class, saturation });
    }
    if to - from > WIDEST {
        return Err(LearnError::Mixed { class, range: to - from });
    }
    Ok([from, to])
}

fn with_hue([from, to]: [f64; 2], least_hue: f64, pixels: &[[f64; 3]]) -> ClassRange {
    let least = |part: usize| pixels.iter().map(|pixel| pixel[part]).collect::<Vec<_>>();
    let low = |mut sorted: Vec<f64>| {
        sorted.sort_by(f64::total_cmp);
        sorted.get((sorted.len() as f64 * TAIL) as usize).copied().unwrap_or_default()
    };
    ClassRange {
        hue: [(from - HUE_MARGIN).max(least_hue), (to + HUE_MARGIN).clamp(least_hue, 360.0)],
        saturation: [(low(least(1)) - SATURATION_MARGIN).max(0.1), 1.0],
        value: [(low(least(2)) - VALUE_MARGIN).max(0.08), 1.0],
    }
}

/// Where the tails begin.
fn tails(class: &'static str, numbers: impl Iterator<Item = f64>) -> Result<[f64; 2], LearnError> {
    let mut sorted: Vec<f64> = numbers.collect();
    if sorted.len() < LEAST {
        return Err(LearnError::Few { class, found: sorted.len() });
    }
    sorted.sort_by(f64::total_cmp);
    let skipped = (sorted.len() as f64 * TAIL) as usize;
    Ok([sorted[skipped], sorted[sorted.len() - 1 - skipped]])
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use downbeat_pictures::Encoding;

    /// Marks on plain pictures of these colours.
    fn learned(marks: &[(Class, [u8; 3])]) -> Result<Colours, LearnError> {
        let mut samples = Samples::default();
        for (class, rgb) in marks {
            let data = rgb.repeat(16 * 16);
            let picture = Picture::new([16, 16], 48, Encoding::Rgb8, &data).unwrap();
            samples.add(&picture, *class, DVec2::splat(8.0), 3.0);
        }
        samples.learn(Colours::default())
    }

    #[test]
    fn classes_close_in_hue_are_told_apart() {
        let marks = [
            (Class::Orange, [200, 150, 60]),
            (Class::Yellow, [150, 200, 40]),
            (Class::Green, [20, 180, 80]),
            (Class::White, [235, 215, 220]),
        ];
        let colours = learned(&marks).unwrap();
        for (class, rgb) in marks {
            assert_eq!(colours.class_of(rgb), class);
        }
        assert_eq!(Colours::parse(&colours.to_text(), "learned").unwrap().to_text(), colours.to_text());
    }

    #[test]
    fn teams_are_told_from_the_ball_and_from_each_other() {
        let marks = [
            (Class::Red, [190, 30, 40]),
            (Class::Orange, [230, 90, 20]),
            (Class::Blue, [30, 60, 200]),
            (Class::Green, [40, 130, 50]),
        ];
        let colours = learned(&marks).unwrap();
        for (class, rgb) in marks {
            assert_eq!(colours.class_of(rgb), class);
        }
        // Red has hues on both sides of 0, and so has the file.
        assert!(colours.red.hue[0] > 340.0 && colours.red.hue[1] < 15.0, "{:?}", colours.red);
        assert_eq!(colours.class_of([190, 36, 30]), Class::Red);
        assert_eq!(Colours::parse(&colours.to_text(), "learned").unwrap().to_text(), colours.to_text());
        let same = learned(&[(Class::Red, [230, 90, 20]), (Class::Orange, [230, 90, 20])]);
        assert!(same.unwrap_err().to_string().contains("red and orange"));
    }

    #[test]
    fn marks_that_make_no_sense_are_refused() {
        let refused = |marks: &[(Class, [u8; 3])]| learned(marks).unwrap_err().to_string();
        assert!(refused(&[(Class::Green, [100, 100, 100])]).contains("grey"));
        assert!(refused(&[(Class::White, [20, 180, 80])]).contains("have colour"));
        let both = [(Class::Green, [20, 180, 80]), (Class::Green, [200, 20, 20])];
        assert!(refused(&both).contains("do all marks lie on it"));
        let same = [(Class::Yellow, [20, 180, 80]), (Class::Green, [20, 180, 80])];
        assert!(refused(&same).contains("yellow and green"));
        let mut samples = Samples::default();
        let data = [20, 180, 80].repeat(16 * 16);
        let picture = Picture::new([16, 16], 48, Encoding::Rgb8, &data).unwrap();
        samples.add(&picture, Class::Green, DVec2::splat(8.0), 1.0);
        assert!(samples.learn(Colours::default()).unwrap_err().to_string().contains("5 pixels"));
    }
}
