//! Draws a field as text.

use downbeat_football::Field;
use downbeat_football::football_interfaces::msg::MatchState;
use glam::DVec2;

/// The columns and rows of a drawing, without its border.
const SIZE: [usize; 2] = [60, 20];

/// Draws the field from above, with +x to the right. The ball is `o`; each player is a letter for its number,
/// lower case from `a` for blue, upper case for red. Lines end with `\n`.
#[must_use]
pub fn draw(field: &Field, state: &MatchState) -> String {
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
    for (name, pose) in state.robots.iter().zip(&state.poses) {
        let [x, y] = cell(DVec2::new(pose.position.x, pose.position.y));
        let (team, number) = name.rsplit_once('_').unwrap_or((name, "1"));
        let letter = b'a' + number.parse::<u8>().unwrap_or(1).clamp(1, 26) - 1;
        let letter = char::from(letter);
        rows[y][x] = if team == "red" { letter.to_ascii_uppercase() } else { letter };
    }
    let [x, y] = cell(DVec2::new(state.ball.x, state.ball.y));
    rows[y][x] = 'o';
    let border = format!("+{}+\n", "-".repeat(SIZE[0]));
    let rows: String =
        rows.into_iter().map(|row| format!("|{}|\n", row.into_iter().collect::<String>())).collect();
    format!("{border}{rows}{border}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use downbeat_msgs::geometry_msgs::msg::{Point, Pose};

    #[test]
    fn players_and_ball_are_where_they_are_seen_from_above() {
        let pose = |x, y| Pose { position: Point { x, y, z: 0.0 }, ..Pose::default() };
        let state = MatchState {
            robots: ["blue_1", "red_2"].map(str::to_owned).to_vec(),
            poses: vec![pose(-5.2, 3.7), pose(2.0, -3.7)],
            ball: Point { x: 100.0, y: 0.0, z: 0.0 },
            ..MatchState::default()
        };
        let drawing = draw(&Field::default(), &state);
        let rows: Vec<&str> = drawing.lines().collect();
        assert_eq!((rows.len(), rows[0].len()), (22, 62));
        assert!(rows[1].starts_with("|a") && rows[20].contains('B'), "{drawing}");
        assert!(drawing.contains("o|"), "objects beyond the carpet are drawn at its edge\n{drawing}");
    }
}
