//! The simulated world of a football field.

use downbeat_football::{BallColour, Field, GoalColour};
use downbeat_physics::{Ball, Block, WorldFile};

/// The thickness of nets and crossbars as obstacles, in m.
const THICKNESS: f64 = 0.05;
/// The height of the nets, in m: enough to stop a rolling ball, low enough for cameras to look over.
const NET_HEIGHT: f64 = 0.3;
/// The mass of a ball divided by its diameter cubed, in kg/m^3: 50 g for 10 cm.
const BALL_DENSITY: f64 = 50.0;

/// The world of a field, with lines, goals with nets, and a ball in the centre. Pictures show a centre circle
/// only if the field has one.
#[must_use]
pub fn world_of(field: &Field) -> WorldFile {
    let diameter = field.ball.diameter;
    let ball = Ball {
        position: [0.0, 0.0],
        radius: diameter / 2.0,
        mass: BALL_DENSITY * diameter.powi(3),
        colour: match field.ball.colour {
            BallColour::Orange => Ball::default().colour,
            BallColour::HalfWhite => [225, 225, 225],
        },
        ..Ball::default()
    };
    let lines = downbeat_physics::Field {
        length: field.length,
        width: field.width,
        line_width: field.line_width,
        penalty_mark: field.penalty_mark,
        circle_diameter: field.circle_diameter,
        goal_area: [field.goal_area.depth, field.goal_area.width],
        goal_width: field.goal.width,
        goal_height: field.goal.height,
        post_diameter: field.goal.post_diameter,
        post_colour: match field.goal.colour {
            GoalColour::Yellow => downbeat_physics::Field::default().post_colour,
            GoalColour::White => [235, 235, 235],
        },
    };
    WorldFile {
        name: field.name.clone(),
        field: Some(lines),
        ball: Some(ball),
        boxes: nets(field),
        ..WorldFile::default()
    }
}

/// The back, sides and crossbar of both goals.
fn nets(field: &Field) -> Vec<Block> {
    let goal = &field.goal;
    let (line, outside) = (field.length / 2.0, goal.width / 2.0 + goal.post_diameter);
    let block = |name: &str, end: &str, position: [f64; 3], size: [f64; 3]| Block {
        name: format!("{name} of the {end} goal"),
        position,
        size,
        yaw: 0.0,
        mass: None,
        colour: [200, 200, 200],
    };
    let of_end = |(end, sign): (&str, f64)| {
        let side = |name: &str, y: f64| {
            // The posts are on the goal line.
            let depth = goal.depth - goal.post_diameter;
            let x = sign * (line + goal.post_diameter + depth / 2.0);
            block(name, end, [x, y, NET_HEIGHT / 2.0], [depth, THICKNESS, NET_HEIGHT])
        };
        let bar = [sign * line, 0.0, goal.height + THICKNESS / 2.0];
        [
            block(
                "back",
                end,
                [sign * (line + goal.depth), 0.0, NET_HEIGHT / 2.0],
                [THICKNESS, 2.0 * outside, NET_HEIGHT],
            ),
            side("left side", outside - THICKNESS / 2.0),
            side("right side", THICKNESS / 2.0 - outside),
            block("crossbar", end, bar, [THICKNESS, 2.0 * outside, THICKNESS]),
        ]
    };
    [("left", -1.0), ("right", 1.0)].into_iter().flat_map(of_end).collect()
}
