//! Files of fields: the measures of a football field, of its ball and of its robots, as TOML.
//!
//! The origin is the centre of the field, x points to the goal on the right, y to the left when one faces it,
//! z up: the frame `map`. All lengths are in m. Distances between lines are between their outer edges, as the
//! humanoid league measures; the lines that [`Field::lines`] returns are their middles.

use downbeat_files::toml::{Source, Spanned};
use glam::DVec2;
use serde::Deserialize;
use std::f64::consts::{FRAC_PI_2, PI};
use std::path::Path;

/// A football field, symmetric about its centre.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// The name.
    pub name: String,
    /// Along x, between the outer edges of the goal lines.
    pub length: f64,
    /// Along y, between the outer edges of the touch lines.
    pub width: f64,
    /// The width of the carpet around the field.
    pub margin: f64,
    /// The width of all lines.
    pub line_width: f64,
    /// Of the middle of the circle's line; 0 if there is no circle.
    pub circle_diameter: f64,
    /// From the outer edge of the goal line to the middle of the penalty mark.
    pub penalty_mark: f64,
    /// The area in front of a goal.
    pub goal_area: Area,
    /// The larger area around it; not all leagues have one.
    pub penalty_area: Option<Area>,
    /// Both goals.
    pub goal: Goal,
    /// The ball.
    pub ball: Ball,
    /// The size of a robot that stands.
    pub robot: RobotSize,
}

/// A rectangle at the goal line, between outer edges of lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Area {
    /// Along x.
    pub depth: f64,
    /// Along y.
    pub width: f64,
}

/// A goal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Between the inner sides of the posts.
    pub width: f64,
    /// Of the posts.
    pub height: f64,
    /// Behind the goal line.
    pub depth: f64,
    /// Of the posts.
    pub post_diameter: f64,
    /// Of the posts.
    pub colour: GoalColour,
}

/// The colour of goal posts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GoalColour {
    /// As until 2014.
    Yellow,
    /// As today.
    White,
}

/// A ball.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    /// Its diameter.
    pub diameter: f64,
    /// How it looks.
    pub colour: BallColour,
}

/// How a ball looks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BallColour {
    /// Orange all over.
    Orange,
    /// At least half of it white, with dark patches.
    HalfWhite,
}

/// The size of a robot that stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotSize {
    /// Its height.
    pub height: f64,
    /// From shoulder to shoulder.
    pub width: f64,
}

/// The middle of a straight line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// One end.
    pub from: DVec2,
    /// The other end.
    pub to: DVec2,
}

/// How lines meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum IntersectionKind {
    /// Two arms: a corner.
    L,
    /// Three arms.
    T,
    /// Four arms.
    X,
}

/// Where lines meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intersection {
    /// Where their middles meet.
    pub position: DVec2,
    /// How they meet.
    pub kind: IntersectionKind,
    /// In rad, from the x axis to the left: of an L the direction between its two arms, of a T that of the
    /// arm without an opposite one, of an X that of one of its arms, from 0 to π/2.
    pub heading: f64,
}

/// Why the file of a field is refused.
#[derive(Debug, thiserror::Error)]
pub enum FieldError {
    /// The file cannot be read, is no TOML, lacks a key, or has unknown keys or values of another type.
    #[error(transparent)]
    File(#[from] downbeat_files::toml::Error),
    /// A length is not possible.
    #[error("{file}:{line}: {key} is {found} m; it has to be {allowed}")]
    Length {
        /// The file.
        file: String,
        /// The line.
        line: usize,
        /// The key.
        key: &'static str,
        /// The length.
        found: f64,
        /// What is possible.
        allowed: String,
    },
}

/// The longest file, in bytes.
const LONGEST: u64 = 1 << 16;

/// The largest length, in m: that of a field for people.
const LARGEST: f64 = 120.0;

impl Field {
    /// The fields that the program knows by name, with their files.
    pub const BUILT_IN: [(&'static str, &'static str); 6] = [
        ("darwin_op_2014", include_str!("../fields/darwin_op_2014.toml")),
        ("kid_size_2013", include_str!("../fields/kid_size_2013.toml")),
        ("spl_2020", include_str!("../fields/spl_2020.toml")),
        ("hsl_small_2026", include_str!("../fields/hsl_small_2026.toml")),
        ("hsl_middle_2026", include_str!("../fields/hsl_middle_2026.toml")),
        ("teen", include_str!("../fields/teen.toml")),
    ];

    /// The field of a setting: the default for an empty text, a built-in one by its name, otherwise that in
    /// the file of this path.
    ///
    /// # Errors
    /// [`FieldError`], with path and line.
    pub fn named(text: &str) -> Result<Self, FieldError> {
        if text.is_empty() {
            return Ok(Self::default());
        }
        match Self::BUILT_IN.iter().find(|(name, _)| *name == text) {
            Some((name, file)) => Self::parse(file, name),
            None => Self::read(Path::new(text)),
        }
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`FieldError`], with path and line.
    pub fn read(path: &Path) -> Result<Self, FieldError> {
        Self::checked(&Source::read(path, "the field file", LONGEST)?)
    }

    /// Reads a field from text; `file` names it in errors.
    ///
    /// # Errors
    /// [`FieldError`], with this name and the line.
    pub fn parse(text: &str, file: &str) -> Result<Self, FieldError> {
        Self::checked(&Source::new(file, text))
    }

    fn checked(source: &Source<'_>) -> Result<Self, FieldError> {
        Checks { source }.field(source.parse()?)
    }

    /// The middles of all straight lines: first the border, then the halfway line, then the areas.
    #[must_use]
    pub fn lines(&self) -> Vec<Line> {
        let corner = self.corner();
        let line = |from: [f64; 2], to: [f64; 2]| Line { from: from.into(), to: to.into() };
        let DVec2 { x, y } = corner;
        let mut lines = vec![
            line([-x, y], [x, y]),
            line([x, y], [x, -y]),
            line([x, -y], [-x, -y]),
            line([-x, -y], [-x, y]),
            line([0.0, y], [0.0, -y]),
        ];
        for area in self.areas() {
            let inner = self.inner_corner(area);
            for side in [1.0, -1.0] {
                lines.push(line([side * x, inner.y], [side * inner.x, inner.y]));
                lines.push(line([side * inner.x, inner.y], [side * inner.x, -inner.y]));
                lines.push(line([side * inner.x, -inner.y], [side * x, -inner.y]));
            }
        }
        lines
    }

    /// Where lines meet; the circle meets the halfway line as an X.
    #[must_use]
    pub fn intersections(&self) -> Vec<Intersection> {
        use IntersectionKind::{L, T, X};
        let corner = self.corner();
        let mut found = Vec::new();
        let mut add = |x: f64, y: f64, kind, heading: f64| {
            found.push(Intersection { position: DVec2::new(x, y), kind, heading: normalised(heading) });
        };
        // Towards the inside of the field, seen from each corner.
        let inwards = |side_x: f64, side_y: f64| libm::atan2(-side_y, -side_x);
        for side_y in [1.0, -1.0] {
            add(0.0, side_y * corner.y, T, -side_y * FRAC_PI_2);
            if self.circle_diameter > 0.0 {
                add(0.0, side_y * self.circle_diameter / 2.0, X, 0.0);
            }
            for side_x in [1.0, -1.0] {
                add(side_x * corner.x, side_y * corner.y, L, inwards(side_x, side_y));
                for area in self.areas() {
                    let inner = self.inner_corner(area);
                    // The arms lead to the goal line and to the middle of the area.
                    add(side_x * inner.x, side_y * inner.y, L, inwards(-side_x, side_y));
                    add(side_x * corner.x, side_y * inner.y, T, if side_x > 0.0 { PI } else { 0.0 });
                }
            }
        }
        found
    }

    /// The middles of the goal posts on the floor: right goal left and right post, then left goal the same in
    /// y.
    #[must_use]
    pub fn posts(&self) -> [DVec2; 4] {
        let x = self.corner().x;
        let y = (self.goal.width + self.goal.post_diameter) / 2.0;
        [DVec2::new(x, y), DVec2::new(x, -y), DVec2::new(-x, y), DVec2::new(-x, -y)]
    }

    /// The middles of the marks: the centre, the penalty mark on the right, that on the left.
    #[must_use]
    pub fn marks(&self) -> [DVec2; 3] {
        let x = self.length / 2.0 - self.penalty_mark;
        [DVec2::ZERO, DVec2::new(x, 0.0), DVec2::new(-x, 0.0)]
    }

    /// Whether a point is on the field or its lines.
    #[must_use]
    pub fn contains(&self, point: DVec2) -> bool {
        point.x.abs() <= self.length / 2.0 && point.y.abs() <= self.width / 2.0
    }

    /// The corner between the middles of the touch line and the goal line.
    fn corner(&self) -> DVec2 {
        DVec2::new(self.length, self.width) / 2.0 - self.line_width / 2.0
    }

    /// The corner of an area on the right, in the field, where y is positive.
    fn inner_corner(&self, area: Area) -> DVec2 {
        DVec2::new(
            self.length / 2.0 - area.depth + self.line_width / 2.0,
            area.width / 2.0 - self.line_width / 2.0,
        )
    }

    fn areas(&self) -> impl Iterator<Item = Area> + use<> {
        [Some(self.goal_area), self.penalty_area].into_iter().flatten()
    }
}

/// The field of the humanoid kid size league of 2014.
impl Default for Field {
    fn default() -> Self {
        Self {
            name: "darwin_op_2014".to_owned(),
            length: 9.0,
            width: 6.0,
            margin: 0.7,
            line_width: 0.05,
            circle_diameter: 1.5,
            penalty_mark: 1.8,
            goal_area: Area { depth: 0.6, width: 3.45 },
            penalty_area: None,
            goal: Goal {
                width: 2.25,
                height: 1.1,
                depth: 0.5,
                post_diameter: 0.1,
                colour: GoalColour::Yellow,
            },
            ball: Ball { diameter: 0.1, colour: BallColour::Orange },
            robot: RobotSize { height: 0.45, width: 0.25 },
        }
    }
}

/// From -π (not included) to π.
fn normalised(angle: f64) -> f64 {
    let turned = angle.rem_euclid(2.0 * PI);
    if turned > PI { turned - 2.0 * PI } else { turned }
}

type Number = Spanned<f64>;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    name: String,
    length: Number,
    width: Number,
    margin: Number,
    line_width: Number,
    circle_diameter: Number,
    penalty_mark: Number,
    goal_area: RawArea,
    penalty_area: Option<RawArea>,
    goal: RawGoal,
    ball: RawBall,
    robot: RawRobot,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawArea {
    depth: Number,
    width: Number,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawGoal {
    width: Number,
    height: Number,
    depth: Number,
    post_diameter: Number,
    colour: GoalColour,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawBall {
    diameter: Number,
    colour: BallColour,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawRobot {
    height: Number,
    width: Number,
}

/// Checks what a file says.
struct Checks<'a> {
    source: &'a Source<'a>,
}

impl Checks<'_> {
    fn field(&self, raw: Raw) -> Result<Field, FieldError> {
        let length = self.up_to("length", &raw.length, LARGEST, "120 m")?;
        let width = self.up_to("width", &raw.width, length, "length")?;
        let line_width = self.up_to("line_width", &raw.line_width, width / 10.0, "a tenth of width")?;
        let goal_area = self.area(["goal_area.depth", "goal_area.width"], &raw.goal_area, length, width)?;
        let penalty_area = match &raw.penalty_area {
            Some(raw) => {
                let keys = ["penalty_area.depth", "penalty_area.width"];
                let area = self.area(keys, raw, length, width)?;
                self.more_than(keys[0], &raw.depth, goal_area.depth, "goal_area.depth")?;
                self.more_than(keys[1], &raw.width, goal_area.width, "goal_area.width")?;
                Some(area)
            }
            None => None,
        };
        let post_diameter = self.up_to("goal.post_diameter", &raw.goal.post_diameter, 1.0, "1 m")?;
        let goal = Goal {
            width: self.up_to(
                "goal.width",
                &raw.goal.width,
                width - 2.0 * post_diameter,
                "width without the posts",
            )?,
            height: self.up_to("goal.height", &raw.goal.height, 10.0, "10 m")?,
            depth: self.up_to("goal.depth", &raw.goal.depth, 10.0, "10 m")?,
            post_diameter,
            colour: raw.goal.colour,
        };
        Ok(Field {
            length,
            width,
            margin: self.zero_to("margin", &raw.margin, 20.0, "20 m")?,
            line_width,
            circle_diameter: self.zero_to("circle_diameter", &raw.circle_diameter, width, "width")?,
            penalty_mark: self.up_to("penalty_mark", &raw.penalty_mark, length / 2.0, "half of length")?,
            goal_area,
            penalty_area,
            goal,
            ball: Ball {
                diameter: self.up_to("ball.diameter", &raw.ball.diameter, 1.0, "1 m")?,
                colour: raw.ball.colour,
            },
            robot: RobotSize {
                height: self.up_to("robot.height", &raw.robot.height, 3.0, "3 m")?,
                width: self.up_to("robot.width", &raw.robot.width, 3.0, "3 m")?,
            },
            name: raw.name,
        })
    }

    fn area(
        &self,
        keys: [&'static str; 2],
        raw: &RawArea,
        length: f64,
        width: f64,
    ) -> Result<Area, FieldError> {
        Ok(Area {
            depth: self.up_to(keys[0], &raw.depth, length / 2.0, "half of length")?,
            width: self.up_to(keys[1], &raw.width, width, "width")?,
        })
    }

    fn up_to(&self, key: &'static str, number: &Number, most: f64, named: &str) -> Result<f64, FieldError> {
        let is_possible = *number.get_ref() > 0.0 && *number.get_ref() <= most;
        self.possible(key, number, is_possible, || match named.ends_with(" m") {
            true => format!("more than 0 and at most {named}"),
            false => format!("more than 0 and at most {named}, {most} m"),
        })
    }

    fn zero_to(&self, key: &'static str, number: &Number, most: f64, named: &str) -> Result<f64, FieldError> {
        let is_possible = (0.0..=most).contains(number.get_ref());
        self.possible(key, number, is_possible, || format!("from 0 to {named}"))
    }

    fn more_than(
        &self,
        key: &'static str,
        number: &Number,
        least: f64,
        named: &str,
    ) -> Result<f64, FieldError> {
        self.possible(key, number, *number.get_ref() > least, || format!("more than {named}, {least} m"))
    }

    fn possible(
        &self,
        key: &'static str,
        number: &Number,
        is_possible: bool,
        allowed: impl Fn() -> String,
    ) -> Result<f64, FieldError> {
        let found = *number.get_ref();
        if is_possible {
            return Ok(found);
        }
        let file = self.source.path().display().to_string();
        let line = self.source.line_of(number.span().start);
        Err(FieldError::Length { file, line, key, found, allowed: allowed() })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn default_file() -> &'static str {
        Field::BUILT_IN[0].1
    }

    fn error(from: &str, to: &str) -> String {
        assert!(default_file().contains(from), "{from}");
        Field::parse(&default_file().replace(from, to), "field.toml").unwrap_err().to_string()
    }

    #[test]
    fn every_built_in_field_is_possible_and_has_its_name() {
        for (name, _) in Field::BUILT_IN {
            assert_eq!(Field::named(name).unwrap().name, name);
        }
        assert_eq!(Field::named("darwin_op_2014").unwrap(), Field::default());
        assert_eq!(Field::named("").unwrap(), Field::default());
        let missing = Field::named("no_such_field.toml").unwrap_err().to_string();
        assert!(missing.starts_with("cannot read the field file no_such_field.toml: "), "{missing}");
    }

    #[test]
    fn impossible_lengths_are_refused_with_line_and_remedy() {
        assert_eq!(
            error("width = 2.25 ", "width = 6.5 "),
            "field.toml:13: goal.width is 6.5 m; it has to be more than 0 and at most width without the posts, 5.8 m"
        );
        assert_eq!(
            error("length = 9.0", "length = nan"),
            "field.toml:4: length is NaN m; it has to be more than 0 and at most 120 m"
        );
        assert!(error("width = 6.0", "width = 9.5").starts_with("field.toml:5: width is 9.5 m"));
        assert!(error("depth = 0.6", "depth = 5").contains("goal_area.depth is 5 m"));
        assert!(error("margin = 0.7", "margin = -1").contains("from 0 to 20 m"));
        let small = "penalty_mark = 1.8\npenalty_area = { depth = 0.5, width = 4 }";
        assert!(error("penalty_mark = 1.8", small).contains("it has to be more than goal_area.depth, 0.6 m"));
    }

    #[test]
    fn unknown_missing_and_misspelled_keys_are_refused_with_the_line() {
        assert!(error("margin = 0.7", "margn = 0.7").starts_with("field.toml:6: unknown field `margn`"));
        assert!(error("margin = 0.7", "").contains("missing field `margin`"));
        assert!(error("\"orange\"", "\"blue\"").contains("unknown variant `blue`"));
        assert!(error("[ball]", "[ball").starts_with("field.toml:"));
    }

    #[test]
    fn lines_meet_where_intersections_are() {
        for (name, _) in Field::BUILT_IN {
            let field = Field::named(name).unwrap();
            let lines = field.lines();
            for found in field.intersections() {
                // The arms, counted on the lines themselves a little away from the intersection.
                let arms = (0..4).filter(|quarter| {
                    let direction = DVec2::from_angle(f64::from(*quarter) * FRAC_PI_2);
                    let at = found.position + 0.01 * direction;
                    let is_on = |line: &Line| {
                        let along = (line.to - line.from).normalize();
                        let way = (at - line.from).dot(along);
                        (at - line.from).perp_dot(along).abs() < 1e-9
                            && (-1e-9..=line.from.distance(line.to) + 1e-9).contains(&way)
                    };
                    let is_on_circle = found.kind == IntersectionKind::X && direction.x.abs() > 0.5;
                    is_on_circle || lines.iter().any(is_on)
                });
                let arms: Vec<_> = arms.collect();
                let expected = match found.kind {
                    IntersectionKind::L => 2,
                    IntersectionKind::T => 3,
                    IntersectionKind::X => 4,
                };
                assert_eq!(arms.len(), expected, "{name}: {found:?}");
                let sum: DVec2 =
                    arms.iter().map(|quarter| DVec2::from_angle(f64::from(*quarter) * FRAC_PI_2)).sum();
                if found.kind != IntersectionKind::X {
                    let heading = DVec2::from_angle(found.heading);
                    assert!(sum.normalize().distance(heading) < 1e-9, "{name}: {found:?}");
                }
            }
        }
    }

    #[test]
    fn a_field_is_symmetric_about_its_centre() {
        let field = Field::named("spl_2020").unwrap();
        let found = field.intersections();
        assert_eq!(found.len(), 24);
        assert!(found.iter().all(|one| {
            found
                .iter()
                .any(|other| other.kind == one.kind && (other.position + one.position).length() < 1e-12)
        }));
        let posts = field.posts();
        assert!((posts[0] - DVec2::new(4.475, 0.8)).length() < 1e-12);
        assert_eq!(posts[0], -posts[3]);
        assert!(field.contains(DVec2::new(4.49, -2.9)) && !field.contains(DVec2::new(0.0, 3.1)));
    }
}
