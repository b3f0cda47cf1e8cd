//! World files: what is around a robot, as TOML.
//!
//! `docs/physics.md` describes the format. A file that names something impossible is refused with its line
//! and a remedy.

use crate::scenery::{
    Ball, Block, FINITE, Field, Floor, MOST_BOXES, NOT_NEGATIVE, POSITIVE, SHARE, WorldFile, is_allowed,
};
use downbeat_files::toml::{Source, Spanned};
use glam::DVec2;
use serde::Deserialize;
use std::path::Path;

/// Why a world file is refused.
#[derive(Debug, thiserror::Error)]
pub enum WorldFileError {
    /// The file cannot be read, is no TOML, or has unknown keys or values of another type.
    #[error(transparent)]
    File(#[from] downbeat_files::toml::Error),
    /// A number is not possible.
    #[error("{file}:{line}: {what} is {found}; it has to be {allowed}")]
    Number {
        /// The file.
        file: String,
        /// The line.
        line: usize,
        /// What the number says.
        what: String,
        /// The number.
        found: f64,
        /// What is possible.
        allowed: &'static str,
    },
    /// Two things have the same name.
    #[error("{file}:{line}: the world already contains something named \"{name}\"; give it another name")]
    Name {
        /// The file.
        file: String,
        /// The line.
        line: usize,
        /// The name.
        name: String,
    },
    /// Two things, at least one of which can move, are in the same place.
    #[error(
        "{file}:{line}: {what} overlaps {other}, and would be thrown out of it; move it by at least {depth:.3} m"
    )]
    Overlap {
        /// The file.
        file: String,
        /// The line of the first one.
        line: usize,
        /// One of them.
        what: String,
        /// The other.
        other: String,
        /// How far they are inside each other, in m.
        depth: f64,
    },
    /// There is too much in it.
    #[error("{file}: {found} boxes and walls; at most {} are possible", MOST_BOXES)]
    TooMany {
        /// The file.
        file: String,
        /// Their number.
        found: usize,
    },
}

/// The longest world file, in bytes.
const LONGEST: u64 = 1 << 20;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    name: Option<String>,
    #[serde(default)]
    floor: Option<Spanned<Floor>>,
    field: Option<Spanned<Field>>,
    ball: Option<Spanned<Ball>>,
    #[serde(default, rename = "box")]
    boxes: Vec<Spanned<RawBox>>,
    #[serde(default, rename = "wall")]
    walls: Vec<Spanned<RawWall>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawBox {
    name: Option<String>,
    position: [f64; 3],
    size: [f64; 3],
    #[serde(default)]
    yaw_deg: f64,
    mass: Option<f64>,
    #[serde(default = "grey")]
    colour: [u8; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawWall {
    name: Option<String>,
    from: [f64; 2],
    to: [f64; 2],
    #[serde(default = "wall_height")]
    height: f64,
    #[serde(default = "wall_thickness")]
    thickness: f64,
    #[serde(default = "grey")]
    colour: [u8; 3],
}

fn grey() -> [u8; 3] {
    [128, 128, 128]
}

fn wall_height() -> f64 {
    0.5
}

fn wall_thickness() -> f64 {
    0.05
}

impl WorldFile {
    /// Reads a world file.
    ///
    /// # Errors
    /// [`WorldFileError`], with path and line.
    pub fn read(path: &Path) -> Result<Self, WorldFileError> {
        Self::checked(&Source::read(path, "the world file", LONGEST)?)
    }

    /// Reads a world from text; `file` names it in errors.
    ///
    /// # Errors
    /// [`WorldFileError`], with this name and the line.
    pub fn parse(text: &str, file: &str) -> Result<Self, WorldFileError> {
        Self::checked(&Source::new(file, text))
    }

    fn checked(source: &Source<'_>) -> Result<Self, WorldFileError> {
        let file = &*source.path().display().to_string();
        let raw: Raw = source.parse()?;
        if raw.boxes.len() + raw.walls.len() > MOST_BOXES {
            let found = raw.boxes.len() + raw.walls.len();
            return Err(WorldFileError::TooMany { file: file.to_owned(), found });
        }
        Reader { file, at: &|offset| source.line_of(offset), lines: Vec::new() }.world(raw)
    }
}

/// Checks what a file says.
struct Reader<'a> {
    file: &'a str,
    at: &'a dyn Fn(usize) -> usize,
    /// The lines of the boxes.
    lines: Vec<usize>,
}

impl Reader<'_> {
    fn world(mut self, raw: Raw) -> Result<WorldFile, WorldFileError> {
        let floor = self.floor(raw.floor)?;
        let field = raw.field.map(|field| self.field(&field)).transpose()?;
        let ball_line = raw.ball.as_ref().map_or(1, |ball| (self.at)(ball.span().start));
        let ball = raw.ball.map(|ball| self.ball(&ball)).transpose()?;
        let mut boxes = Vec::new();
        for (index, raw) in raw.boxes.into_iter().enumerate() {
            let line = (self.at)(raw.span().start);
            boxes.push(self.block(raw.into_inner(), line, index)?);
            self.lines.push(line);
        }
        for (index, raw) in raw.walls.into_iter().enumerate() {
            let line = (self.at)(raw.span().start);
            boxes.push(self.wall(raw.into_inner(), line, index)?);
            self.lines.push(line);
        }
        let world =
            WorldFile { name: raw.name.unwrap_or_else(|| "world".to_owned()), floor, field, ball, boxes };
        self.check_names(&world)?;
        self.check_overlaps(&world, ball_line)?;
        Ok(world)
    }

    fn number(
        &self,
        line: usize,
        what: &str,
        found: f64,
        allowed: &'static str,
    ) -> Result<(), WorldFileError> {
        if is_allowed(found, allowed) {
            return Ok(());
        }
        let (file, what) = (self.file.to_owned(), what.to_owned());
        Err(WorldFileError::Number { file, line, what, found, allowed })
    }

    fn floor(&self, raw: Option<Spanned<Floor>>) -> Result<Floor, WorldFileError> {
        let Some(raw) = raw else { return Ok(Floor::default()) };
        let (line, floor) = ((self.at)(raw.span().start), raw.into_inner());
        self.number(line, "the friction of the floor", floor.friction, NOT_NEGATIVE)?;
        self.number(line, "the restitution of the floor", floor.restitution, SHARE)?;
        Ok(floor)
    }

    fn field(&self, raw: &Spanned<Field>) -> Result<Field, WorldFileError> {
        let (line, field) = ((self.at)(raw.span().start), *raw.get_ref());
        for (what, found) in [
            ("length", field.length),
            ("width", field.width),
            ("line_width", field.line_width),
            ("penalty_mark", field.penalty_mark),
            ("circle_diameter", field.circle_diameter),
            ("goal_area", field.goal_area[0]),
            ("goal_area", field.goal_area[1]),
            ("goal_width", field.goal_width),
            ("goal_height", field.goal_height),
            ("post_diameter", field.post_diameter),
        ] {
            self.number(line, &format!("{what} of the field"), found, POSITIVE)?;
        }
        Ok(field)
    }

    fn ball(&self, raw: &Spanned<Ball>) -> Result<Ball, WorldFileError> {
        let (line, ball) = ((self.at)(raw.span().start), *raw.get_ref());
        ball.position
            .iter()
            .try_for_each(|found| self.number(line, "a coordinate of the ball", *found, FINITE))?;
        self.number(line, "the radius of the ball", ball.radius, POSITIVE)?;
        self.number(line, "the mass of the ball", ball.mass, POSITIVE)?;
        self.number(line, "the restitution of the ball", ball.restitution, SHARE)?;
        self.number(line, "the rolling friction of the ball", ball.rolling_friction, NOT_NEGATIVE)?;
        Ok(ball)
    }

    fn block(&self, raw: RawBox, line: usize, index: usize) -> Result<Block, WorldFileError> {
        let name = raw.name.unwrap_or_else(|| format!("box_{}", index + 1));
        let what = |part: &str| format!("{part} of \"{name}\"");
        for found in raw.position {
            self.number(line, &what("a coordinate"), found, FINITE)?;
        }
        for found in raw.size {
            self.number(line, &what("an edge"), found, POSITIVE)?;
        }
        self.number(line, &what("yaw_deg"), raw.yaw_deg, FINITE)?;
        if let Some(mass) = raw.mass {
            self.number(line, &what("the mass"), mass, POSITIVE)?;
        }
        let RawBox { position, size, yaw_deg, mass, colour, .. } = raw;
        Ok(Block { name, position, size, yaw: yaw_deg.to_radians(), mass, colour })
    }

    fn wall(&self, raw: RawWall, line: usize, index: usize) -> Result<Block, WorldFileError> {
        let name = raw.name.unwrap_or_else(|| format!("wall_{}", index + 1));
        let what = |part: &str| format!("{part} of \"{name}\"");
        for found in raw.from.into_iter().chain(raw.to) {
            self.number(line, &what("a coordinate"), found, FINITE)?;
        }
        let (from, to) = (DVec2::from(raw.from), DVec2::from(raw.to));
        self.number(line, &what("the length"), (to - from).length(), POSITIVE)?;
        self.number(line, &what("the height"), raw.height, POSITIVE)?;
        self.number(line, &what("the thickness"), raw.thickness, POSITIVE)?;
        let (centre, along) = ((from + to) / 2.0, to - from);
        Ok(Block {
            name,
            position: [centre.x, centre.y, raw.height / 2.0],
            size: [along.length(), raw.thickness, raw.height],
            yaw: libm::atan2(along.y, along.x),
            mass: None,
            colour: raw.colour,
        })
    }

    fn check_names(&self, world: &WorldFile) -> Result<(), WorldFileError> {
        let mut names: Vec<&str> = vec!["floor", "ball"];
        names.extend(world.posts().map(|(name, _)| name));
        for (block, &line) in world.boxes.iter().zip(&self.lines) {
            if names.contains(&block.name.as_str()) {
                let (file, name) = (self.file.to_owned(), block.name.clone());
                return Err(WorldFileError::Name { file, line, name });
            }
            names.push(&block.name);
        }
        Ok(())
    }

    fn check_overlaps(&self, world: &WorldFile, ball_line: usize) -> Result<(), WorldFileError> {
        let Some(overlap) = crate::world::overlap(world) else { return Ok(()) };
        let line = match overlap.block {
            Some(index) => self.lines.get(index).copied().unwrap_or(1),
            None => ball_line,
        };
        let (file, depth) = (self.file.to_owned(), overlap.depth);
        Err(WorldFileError::Overlap { file, line, what: overlap.what, other: overlap.other, depth })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn error(text: &str) -> String {
        WorldFile::parse(text, "world.toml").unwrap_err().to_string()
    }

    #[test]
    fn an_empty_file_is_a_floor() {
        let world = WorldFile::parse("", "world.toml").unwrap();
        assert_eq!(world, WorldFile { name: "world".into(), ..WorldFile::default() });
    }

    #[test]
    fn impossible_numbers_are_refused_with_line_and_remedy() {
        let found = error("[floor]\nfriction = 0.5\n\n[ball]\nradius = -0.05\n");
        assert_eq!(
            found,
            "world.toml:4: the radius of the ball is -0.05; it has to be more than 0 and at most 1000"
        );
        assert!(error("[ball]\nmass = nan").contains("the mass of the ball is NaN"));
        assert!(
            error("[[box]]\nposition = [0, 0, 1]\nsize = [1, 0, 1]")
                .contains("world.toml:1: an edge of \"box_1\" is 0")
        );
        assert!(
            error("[[box]]\nposition = [inf, 0, 1]\nsize = [1, 1, 1]")
                .contains("a coordinate of \"box_1\" is inf")
        );
        assert!(error("[[wall]]\nfrom = [1, 1]\nto = [1, 1]").contains("the length of \"wall_1\" is 0"));
        assert!(error("[floor]\nfriction = -1").contains("the friction of the floor is -1"));
    }

    #[test]
    fn unknown_keys_and_other_types_are_refused_with_the_line() {
        assert!(error("[floor]\nfricton = 0.5").starts_with("world.toml:2: unknown field `fricton`"));
        assert!(error("\n[ball]\nradius = \"big\"").starts_with("world.toml:3: invalid type"));
        assert!(error("[ball\n").starts_with("world.toml:1: "));
    }

    #[test]
    fn what_can_move_overlaps_nothing() {
        let boxes = "[[box]]\nname = \"table\"\nposition = [0.5, 0, 0.1]\nsize = [0.2, 0.2, 0.2]\n";
        let found = error(&format!("[ball]\nposition = [0.5, 0.05]\n\n{boxes}"));
        assert!(found.starts_with("world.toml:1: the ball overlaps \"table\""), "{found}");
        let heavy =
            "[[box]]\nname = \"parcel\"\nposition = [0.5, 0, 0.19]\nsize = [0.2, 0.2, 0.2]\nmass = 1\n";
        let found = error(&format!("{boxes}{heavy}"));
        assert!(found.starts_with("world.toml:5: \"parcel\" overlaps \"table\""), "{found}");
        let sunk = heavy.replace("0.19", "0.05");
        assert!(error(&sunk).contains("\"parcel\" overlaps the floor"), "{}", error(&sunk));
        let wall = "[[wall]]\nfrom = [0, 1]\nto = [1, 1]\n";
        WorldFile::parse(&format!("{wall}{}", wall.replace("to = [1, 1]", "to = [0, 2]")), "world.toml")
            .unwrap();
    }

    #[test]
    fn names_are_unique() {
        let one = "[[box]]\nname = \"ball\"\nposition = [1, 1, 1]\nsize = [1, 1, 1]\n";
        assert!(error(one).contains("already contains something named \"ball\""));
    }

    #[test]
    fn a_field_has_four_posts() {
        let world = WorldFile::parse("[field]", "world.toml").unwrap();
        let posts: Vec<_> = world.posts().map(|(_, at)| at).collect();
        assert_eq!(posts.len(), 4);
        assert!((posts[0] - DVec2::new(4.475, 1.175)).length() < 1e-12 && posts[3] == -posts[0]);
    }
}
