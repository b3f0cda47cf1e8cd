//! What is around a robot: floor, field, ball and boxes.

use glam::DVec2;
use serde::Deserialize;

/// What is around a robot. Lengths in m, masses in kg.
#[derive(Clone, Debug, PartialEq)]
pub struct WorldFile {
    /// The name.
    pub name: String,
    /// The floor: the plane z = 0.
    pub floor: Floor,
    /// The lines and goals of a football field around the origin.
    pub field: Option<Field>,
    /// The ball.
    pub ball: Option<Ball>,
    /// Boxes and walls, in the order of the file.
    pub boxes: Vec<Block>,
}

/// The floor.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Floor {
    /// The coefficient of Coulomb friction of everything.
    pub friction: f64,
    /// How much of the speed of an impact remains, 0 to 1.
    pub restitution: f64,
    /// Red, green, blue, 0 to 255.
    pub colour: [u8; 3],
}

/// The lines and goals of a football field, symmetric about the origin; goals at both ends of x.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Field {
    /// Along x, between the outer edges of the lines.
    pub length: f64,
    /// Along y.
    pub width: f64,
    /// Of all lines.
    pub line_width: f64,
    /// From the goal line to the penalty mark.
    pub penalty_mark: f64,
    /// Of the circle at the centre.
    pub circle_diameter: f64,
    /// Of the goal area: from the goal line into the field, and across.
    pub goal_area: [f64; 2],
    /// Between the inner sides of the posts.
    pub goal_width: f64,
    /// Of the posts.
    pub goal_height: f64,
    /// Of the posts.
    pub post_diameter: f64,
    /// Of the posts: red, green, blue, 0 to 255.
    pub post_colour: [u8; 3],
}

/// A ball.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Ball {
    /// Where it lies on the floor.
    pub position: [f64; 2],
    /// Half its diameter.
    pub radius: f64,
    /// Its mass.
    pub mass: f64,
    /// How much of the speed of an impact remains, 0 to 1.
    pub restitution: f64,
    /// The coefficient of rolling friction: what slows it down on the floor, as a share of its weight.
    pub rolling_friction: f64,
    /// Red, green, blue, 0 to 255.
    pub colour: [u8; 3],
}

/// A box.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// Its name, unique in the world.
    pub name: String,
    /// Its centre.
    pub position: [f64; 3],
    /// Its edges.
    pub size: [f64; 3],
    /// Its rotation about z, in rad.
    pub yaw: f64,
    /// Its mass; `None` if it cannot be moved.
    pub mass: Option<f64>,
    /// Red, green, blue, 0 to 255.
    pub colour: [u8; 3],
}

/// The most boxes and walls of a world.
pub(crate) const MOST_BOXES: usize = 1000;
/// The largest distance and size, in m: beyond it single precision is coarser than a millimetre.
const LARGEST: f64 = 1000.0;

impl Default for Floor {
    fn default() -> Self {
        Self { friction: 0.8, restitution: 0.0, colour: [40, 130, 50] }
    }
}

/// The field of the humanoid kid size league of 2014.
impl Default for Field {
    fn default() -> Self {
        Self {
            length: 9.0,
            width: 6.0,
            line_width: 0.05,
            penalty_mark: 1.8,
            circle_diameter: 1.5,
            goal_area: [0.6, 3.45],
            goal_width: 2.25,
            goal_height: 1.1,
            post_diameter: 0.1,
            post_colour: [230, 210, 30],
        }
    }
}

impl Default for Ball {
    fn default() -> Self {
        Self {
            position: [0.5, 0.0],
            radius: 0.05,
            mass: 0.05,
            restitution: 0.4,
            rolling_friction: 0.05,
            colour: [230, 90, 20],
        }
    }
}

impl Default for WorldFile {
    /// A floor.
    fn default() -> Self {
        Self { name: "floor".to_owned(), floor: Floor::default(), field: None, ball: None, boxes: Vec::new() }
    }
}

impl WorldFile {
    /// The posts of the goals: their centres on the floor.
    pub(crate) fn posts(&self) -> impl Iterator<Item = (&'static str, DVec2)> {
        let names = ["goal_post_1", "goal_post_2", "goal_post_3", "goal_post_4"];
        let field = self.field;
        names.into_iter().enumerate().filter_map(move |(index, name)| {
            let field = field?;
            let x = field.length / 2.0 - field.line_width / 2.0;
            let y = (field.goal_width + field.post_diameter) / 2.0;
            let sign = |bit: usize| if index & bit == 0 { 1.0 } else { -1.0 };
            Some((name, DVec2::new(x * sign(2), y * sign(1))))
        })
    }
}

/// What a number may be: see [`is_allowed`].
pub(crate) const POSITIVE: &str = "more than 0 and at most 1000";
pub(crate) const FINITE: &str = "a number between -1000 and 1000";
pub(crate) const SHARE: &str = "from 0 to 1";
pub(crate) const NOT_NEGATIVE: &str = "from 0 to 1000";

/// Whether a number is what one of the constants above says.
pub(crate) fn is_allowed(found: f64, allowed: &str) -> bool {
    match allowed {
        POSITIVE => found > 0.0 && found <= LARGEST,
        NOT_NEGATIVE => (0.0..=LARGEST).contains(&found),
        SHARE => (0.0..=1.0).contains(&found),
        _ => found.abs() <= LARGEST,
    }
}
