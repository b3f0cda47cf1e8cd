//! What is seen in one picture.

#[cfg(doc)]
use crate::colours::Class;
use downbeat_football::IntersectionKind;
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
