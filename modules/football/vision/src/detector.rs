//! The engine: from a picture to what is seen.

use crate::colours::{Class, Colours, Table};
use crate::labels::Labels;
use crate::picture::Picture;
use crate::view::View;
use crate::{markings, round, upright};
use downbeat_football::{Field, IntersectionKind};
use glam::DVec2;

/// What is seen in one picture. Places are on the floor, in `base_footprint`.
#[derive(Clone, Debug, Default)]
pub struct Seen {
    /// The boundary of the field in pixels, from the left to the right; empty without carpet.
    pub boundary: Vec<DVec2>,
    /// Lines.
    pub lines: Vec<SeenLine>,
    /// The centre circle.
    pub circle: Option<SeenCircle>,
    /// Where lines meet.
    pub intersections: Vec<SeenIntersection>,
    /// Balls, the most certain one first.
    pub balls: Vec<SeenBall>,
    /// Goal posts.
    pub posts: Vec<SeenPost>,
    /// Other robots.
    pub robots: Vec<SeenRobot>,
    /// Whether the picture was of use at all.
    pub exposure: Exposure,
}

/// How bright a picture is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Exposure {
    /// As it should be.
    #[default]
    Good,
    /// Black all over.
    Black,
    /// White all over.
    White,
    /// Good, but without carpet.
    NoCarpet,
}

/// A line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenLine {
    /// Its ends in the picture.
    pub pixels: [DVec2; 2],
    /// Its ends on the floor.
    pub ends: [DVec2; 2],
    /// From 0 to 1.
    pub confidence: f64,
}

/// The centre circle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenCircle {
    /// Its middle in the picture.
    pub pixel: DVec2,
    /// The upper left and the lower right corner around it in the picture.
    pub bounds: [DVec2; 2],
    /// Its middle on the floor.
    pub place: DVec2,
    /// The share of its round that is seen.
    pub confidence: f64,
}

/// Where lines meet.
#[derive(Clone, Debug, PartialEq)]
pub struct SeenIntersection {
    /// In the picture.
    pub pixel: DVec2,
    /// On the floor.
    pub place: DVec2,
    /// How they meet.
    pub kind: IntersectionKind,
    /// As [`downbeat_football::Intersection::heading`], in `base_footprint`.
    pub heading: f64,
    /// The directions of the arms.
    pub arms: Vec<DVec2>,
    /// From 0 to 1.
    pub confidence: f64,
}

/// A ball.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenBall {
    /// Its middle in the picture.
    pub centre: DVec2,
    /// In pixels.
    pub radius: f64,
    /// Where it lies on the floor.
    pub place: DVec2,
    /// From 0 to 1.
    pub confidence: f64,
}

/// A goal post.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenPost {
    /// Its foot in the picture.
    pub foot: DVec2,
    /// Its width, and its height as far as it is seen, in pixels.
    pub size: DVec2,
    /// Its middle on the floor.
    pub place: DVec2,
    /// From 0 to 1.
    pub confidence: f64,
}

/// Another robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenRobot {
    /// Its feet in the picture.
    pub foot: DVec2,
    /// Width and height in pixels.
    pub size: DVec2,
    /// Its feet on the floor.
    pub place: DVec2,
    /// What it wears, if that is seen.
    pub team: Option<TeamColour>,
    /// Whether it lies on the floor.
    pub is_fallen: bool,
    /// From 0 to 1.
    pub confidence: f64,
}

/// What the robots of a team wear.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TeamColour {
    /// [`Class::Blue`].
    Blue,
    /// [`Class::Red`].
    Red,
}

/// Finds what is on a field. The same picture gives the same result.
#[derive(Clone, Debug)]
pub struct Detector {
    field: Field,
    table: Table,
    labels: Labels,
}

impl Detector {
    /// A detector for this field and these colours.
    #[must_use]
    pub fn new(field: Field, colours: &Colours) -> Self {
        Self { field, table: Table::new(colours), labels: Labels::default() }
    }

    /// The field.
    #[must_use]
    pub fn field(&self) -> &Field {
        &self.field
    }

    /// Looks at a picture.
    pub fn see(&mut self, picture: &Picture<'_>, view: &View) -> Seen {
        self.labels.fill(picture, &self.table);
        let (labels, field) = (&self.labels, &self.field);
        let brightness =
            labels.luma.iter().map(|luma| u64::from(*luma)).sum::<u64>() / labels.luma.len() as u64;
        let has_carpet = labels.share(Class::Green) > 0.01;
        let exposure = match brightness {
            _ if has_carpet => Exposure::Good,
            0..16 => Exposure::Black,
            240.. => Exposure::White,
            _ => Exposure::NoCarpet,
        };
        let boundary = labels.boundary(view);
        if boundary.is_empty() {
            let exposure = if exposure == Exposure::Good { Exposure::NoCarpet } else { exposure };
            return Seen { exposure, ..Seen::default() };
        }
        let markings = markings::markings(labels, view, &boundary, field);
        let balls = round::balls(labels, view, &boundary, &field.ball);
        let posts = upright::posts(labels, view, &boundary, field);
        let robots = upright::robots(labels, view, &boundary, field, &posts, &balls);
        let markings::Markings { lines, circle, intersections } = markings;
        Seen { boundary, lines, circle, intersections, balls, posts, robots, exposure }
    }
}
