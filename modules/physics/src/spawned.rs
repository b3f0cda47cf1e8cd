//! What can be put into a world while it is simulated: balls, boxes and posts.

use crate::scenery::{Ball, Floor, MOST_BOXES, NOT_NEGATIVE, POSITIVE, SHARE, is_allowed};
use downbeat_transforms::Isometry;
use serde::Deserialize;

/// Something that is put into a world while it is simulated.
#[derive(Clone, Debug, PartialEq)]
pub struct Spawned {
    /// Its name, unique in the world.
    pub name: String,
    /// The pose of its centre.
    pub world_from_body: Isometry,
    /// Its shape.
    pub shape: SpawnedShape,
    /// In kg; `None` if it cannot be moved.
    pub mass: Option<f64>,
    /// How much of the speed of an impact remains, 0 to 1.
    pub restitution: f64,
    /// Red, green, blue, 0 to 255.
    pub colour: [u8; 3],
}

/// The shape of something. Lengths in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SpawnedShape {
    /// A ball.
    Ball {
        /// Half its diameter.
        radius: f64,
        /// What slows it down on the floor, as a share of its weight.
        rolling_friction: f64,
    },
    /// A box.
    Box {
        /// Its edges.
        size: [f64; 3],
    },
    /// A cylinder along z.
    Post {
        /// Of the circle.
        diameter: f64,
        /// Along z.
        height: f64,
    },
}

/// The largest number of things that are spawned and not deleted.
pub(crate) const MOST_SPAWNED: usize = MOST_BOXES;

/// What is known by these names, each with a description.
pub(crate) const SPAWNABLES: [(&str, &str); 3] = [
    (
        "ball",
        "a ball: radius 0.05 m, 0.05 kg; as text: kind, radius, mass, restitution, rolling_friction, colour",
    ),
    ("box", "a box: edges of 0.1 m, 0.5 kg; as text: kind, size, mass (0: it cannot be moved), colour"),
    (
        "post",
        "a post: diameter 0.1 m, height 1.1 m, it cannot be moved; as text: kind, diameter, height, mass, colour",
    ),
];

/// The longest description, in bytes.
const LONGEST: usize = 10_000;

#[derive(Deserialize)]
#[serde(deny_unknown_fields, tag = "kind", rename_all = "snake_case")]
enum Description {
    Ball(Ball),
    Box(BoxDescription),
    Post(PostDescription),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct BoxDescription {
    size: [f64; 3],
    mass: f64,
    colour: [u8; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct PostDescription {
    diameter: f64,
    height: f64,
    mass: f64,
    colour: [u8; 3],
}

impl Default for BoxDescription {
    fn default() -> Self {
        Self { size: [0.1; 3], mass: 0.5, colour: [128; 3] }
    }
}

/// A post of a goal of the humanoid kid size league of 2014.
impl Default for PostDescription {
    fn default() -> Self {
        Self { diameter: 0.1, height: 1.1, mass: 0.0, colour: [230, 210, 30] }
    }
}

impl Spawned {
    /// Something at the origin and without a name, from a description in TOML, as `kind = "ball"`, or the
    /// name of a spawnable in it.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        if text.len() > LONGEST {
            return Err(format!("{} bytes; a description has at most {LONGEST}", text.len()));
        }
        let found: Description = downbeat_files::toml::parse(text).map_err(|error| error.problem)?;
        let number = |what: &str, found: f64, allowed: &'static str| {
            let problem = || format!("{what} is {found}; it has to be {allowed}");
            if is_allowed(found, allowed) { Ok(()) } else { Err(problem()) }
        };
        let mass_of = |mass: f64| {
            number("mass", mass, NOT_NEGATIVE)?;
            Ok::<_, String>((mass > 0.0).then_some(mass))
        };
        let (shape, mass, restitution, colour) = match found {
            Description::Ball(ball) => {
                let Ball { position, radius, mass, restitution, rolling_friction, colour } = ball;
                if position != Ball::default().position {
                    return Err("the position is that of the request, initial_pose".to_owned());
                }
                number("radius", radius, POSITIVE)?;
                number("mass", mass, POSITIVE)?;
                number("restitution", restitution, SHARE)?;
                number("rolling_friction", rolling_friction, NOT_NEGATIVE)?;
                (SpawnedShape::Ball { radius, rolling_friction }, Some(mass), restitution, colour)
            }
            Description::Box(BoxDescription { size, mass, colour }) => {
                size.iter().try_for_each(|&edge| number("an edge", edge, POSITIVE))?;
                (SpawnedShape::Box { size }, mass_of(mass)?, Floor::default().restitution, colour)
            }
            Description::Post(PostDescription { diameter, height, mass, colour }) => {
                number("diameter", diameter, POSITIVE)?;
                number("height", height, POSITIVE)?;
                let shape = SpawnedShape::Post { diameter, height };
                (shape, mass_of(mass)?, Floor::default().restitution, colour)
            }
        };
        let world_from_body = Isometry::IDENTITY;
        Ok(Self { name: String::new(), world_from_body, shape, mass, restitution, colour })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn error(text: &str) -> String {
        Spawned::parse(text).unwrap_err()
    }

    #[test]
    fn every_spawnable_has_a_description_without_numbers() {
        for (name, _) in SPAWNABLES {
            Spawned::parse(&format!("kind = \"{name}\"")).unwrap();
        }
    }

    #[test]
    fn a_description_gives_size_and_mass() {
        let parcel = Spawned::parse("kind = \"box\"\nsize = [0.1, 0.2, 0.3]\nmass = 0").unwrap();
        assert_eq!((parcel.shape, parcel.mass), (SpawnedShape::Box { size: [0.1, 0.2, 0.3] }, None));
        let ball = Spawned::parse("kind = \"ball\"\nradius = 0.07").unwrap();
        assert_eq!(ball.shape, SpawnedShape::Ball { radius: 0.07, rolling_friction: 0.05 });
    }

    #[test]
    fn impossible_descriptions_are_refused_with_the_remedy() {
        assert_eq!(
            error("kind = \"ball\"\nradius = nan"),
            "radius is NaN; it has to be more than 0 and at most 1000"
        );
        assert_eq!(error("kind = \"box\"\nmass = -1"), "mass is -1; it has to be from 0 to 1000");
        assert!(error("kind = \"cone\"").contains("unknown variant `cone`"), "{}", error("kind = \"cone\""));
        assert!(error("kind = \"post\"\nradius = 1").contains("unknown field `radius`"));
        assert!(error("kind = \"ball\"\nposition = [1, 1]").contains("initial_pose"));
        assert!(error(&" ".repeat(20_000)).contains("at most 10000"));
    }
}
