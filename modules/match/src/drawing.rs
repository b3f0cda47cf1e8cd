//! A field in text.

use crate::referee::{Seat, Team};
use downbeat_football::Field;
use downbeat_physics::ArenaSnapshot;
use glam::DVec2;

/// Columns and rows of a drawing, without its border.
const SIZE: [usize; 2] = [60, 20];

/// The field from above, +x to the right, with `o` as the ball, and each player as its number: in lower case letters from `a` for
/// blue, in upper case ones for red. Lines end with `\n`.
#[must_use]
pub fn draw(field: &Field, seats: &[Seat], snapshot: &ArenaSnapshot) -> String {
    let half = DVec2::new(field.length, field.width) / 2.0 + field.margin;
    let cell = |at: DVec2| {
        let share = (at / half).clamp(DVec2::NEG_ONE, DVec2::ONE) * 0.5 + 0.5;
        let last = SIZE.map(|size| (size - 1) as f64);
        [(share.x * last[0]).round() as usize, ((1.0 - share.y) * last[1]).round() as usize]
    };
    let mut rows = vec![vec![' '; SIZE[0]]; SIZE[1]];
    for line in field.lines() {
        let ([from_x, from_y], [to_x, to_y]) = (cell(line.from), cell(line.to));
        for row in &mut rows[from_y.min(to_y)..=from_y.max(to_y)] {
            row[from_x.min(to_x)..=from_x.max(to_x)].fill('.');
        }
    }
    for post in field.posts() {
        let [x, y] = cell(post);
        rows[y][x] = '#';
    }
    for (seat, robot) in seats.iter().zip(&snapshot.robots) {
        let [x, y] = cell(robot.root.world_from_body.translation.truncate());
        let first = match seat.team {
            Team::Blue => b'a',
            Team::Red => b'A',
        };
        rows[y][x] = char::from(first + seat.number.saturating_sub(1).min(25));
    }
    if let Some(ball) = &snapshot.ball {
        let [x, y] = cell(ball.world_from_body.translation.truncate());
        rows[y][x] = 'o';
    }
    let border = format!("+{}+\n", "-".repeat(SIZE[0]));
    let rows: String =
        rows.into_iter().map(|row| format!("|{}|\n", row.into_iter().collect::<String>())).collect();
    format!("{border}{rows}{border}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use downbeat_physics::{Motion, RobotTruth};
    use downbeat_transforms::Isometry;
    use glam::DVec3;
    use std::time::Duration;

    #[test]
    fn players_and_ball_are_where_they_are_seen_from_above() {
        let motion = |x, y| Motion {
            world_from_body: Isometry::from_translation(x, y, 0.0),
            linear: DVec3::ZERO,
            angular: DVec3::ZERO,
        };
        let robot = |x, y| RobotTruth { root: motion(x, y), camera: None };
        let snapshot = ArenaSnapshot {
            elapsed: Duration::ZERO,
            robots: vec![robot(-5.2, 3.7), robot(2.0, -3.7)],
            ball: Some(motion(100.0, 0.0)),
            last_touch: None,
        };
        let seats = [(Team::Blue, 1), (Team::Red, 2)].map(|(team, number)| Seat { team, number });
        let drawing = draw(&Field::default(), &seats, &snapshot);
        let rows: Vec<&str> = drawing.lines().collect();
        assert_eq!((rows.len(), rows[0].len()), (22, 62));
        assert!(rows[1].starts_with("|a") && rows[20].contains('B'), "{drawing}");
        assert!(drawing.contains("o|"), "what is beyond the carpet is at its edge\n{drawing}");
    }
}
