//! What is odd about a robot description that can be used.

use thiserror::Error;

/// A part of a description that is not as the format demands, but whose meaning is clear. Other readers of
/// URDF accept many of them in silence.
#[derive(Clone, Debug, PartialEq)]
pub struct DescriptionWarning {
    /// The file.
    pub file: String,
    /// The line.
    pub line: u32,
    /// What was found, and what it was taken for.
    pub oddity: Oddity,
}

impl std::fmt::Display for DescriptionWarning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}:{}: {}", self.file, self.line, self.oddity)
    }
}

/// What is odd about a robot description. Messages end with what it was taken for.
#[derive(Clone, Debug, PartialEq, Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Oddity {
    /// The declaration is not at the start.
    #[error("<?xml ...?> must be the first thing in the file: what stands before it is ignored")]
    BeforeDeclaration,
    /// Zero bytes behind the end.
    #[error("the zero bytes behind </robot> are ignored")]
    ZerosBehindEnd,
    /// It is in another encoding.
    #[error("the file is not UTF-8: its other characters are replaced")]
    NotUtf8,
    /// The robot has no name.
    #[error("the robot has no name: it is called \"{taken}\", add name=\"...\" to <robot>")]
    NoName { taken: String },
    /// Numbers are separated by commas.
    #[error("{attribute}=\"{text}\" of {owner} has commas, which are read as spaces")]
    Commas { owner: String, attribute: String, text: String },
    /// There are more numbers than needed.
    #[error(
        "{attribute}=\"{text}\" of {owner} has more than {count} numbers, of which the first {count} are used"
    )]
    MoreNumbers { owner: String, attribute: String, text: String, count: usize },
    /// A colour is not one.
    #[error("rgba=\"{text}\" of {owner} is not red, green, blue and opacity: the colour is ignored")]
    BadColor { owner: String, text: String },
    /// A material is not defined.
    #[error("there is no material \"{material}\"{hint}: the shape has no colour")]
    UnknownMaterial { material: String, hint: String },
    /// A shape without extent.
    #[error("{attribute} of {owner} is 0: the shape has no extent, and collides with nothing")]
    NoExtent { owner: String, attribute: String },
    /// A shape that URDF does not have.
    #[error("{owner} has a shape <{element}>: it is ignored, known are box, cylinder, sphere and mesh")]
    UnknownShape { owner: String, element: String },
    /// An axis does not have length 1.
    #[error("the axis \"{axis}\" of joint \"{joint}\" has length {length}: it is read as \"{unit}\"")]
    AxisLength { joint: String, axis: String, length: f64, unit: String },
    /// A joint that turns about all axes.
    #[error("joint \"{joint}\" is spherical, which URDF does not have: it is read as floating")]
    Spherical { joint: String },
    /// Lower limits are above upper ones.
    #[error("joint \"{joint}\" has the limits {lower} to {upper}: they are read as {upper} to {lower}")]
    Limits { joint: String, lower: f64, upper: f64 },
    /// A joint follows one that cannot lead it, or is itself fixed.
    #[error("joint \"{joint}\" mimics \"{other}\", {reason}: <mimic> is ignored")]
    Mimic { joint: String, other: String, reason: String },
}
