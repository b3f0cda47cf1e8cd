//! A match in retrospect, as text and as a picture.

use crate::game::Team;
use crate::module::seats;
use crate::svg::Svg;
use downbeat_football::Field;
use downbeat_football::football_interfaces::msg::{Kick, MatchState, MatchStatistics, PlayerStatistics};
use glam::DVec2;

/// What was seen of a match: its messages, in the order in which they were published.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    state: Option<MatchState>,
    statistics: MatchStatistics,
    kicks: Vec<Kick>,
    /// Of each robot, the ways that it walked between places where it was put.
    tracks: Vec<Vec<Vec<DVec2>>>,
}

/// A row of the table: a team, or a player.
#[derive(Clone, Copy, Debug, Default)]
struct Row {
    goals: u32,
    kicks: u32,
    shots: u32,
    shots_on_goal: u32,
    passes: u32,
    falls: u32,
    get_ups: u32,
    penalties: u32,
    distance: f64,
    possession: f64,
}

/// The titles of the columns; `ball` is the share of the time in which the player had it.
const COLUMNS: [&str; 10] =
    ["goals", "kicks", "shots", "on goal", "passes", "ball", "walked", "falls", "up again", "penalties"];
/// Points of a track that are nearer to each other are one, in m.
const POINT: f64 = 0.1;
/// Points of a track that are farther from each other are not joined, in m.
const JUMP: f64 = 0.5;

impl Summary {
    /// Takes a state of the match.
    pub fn see(&mut self, state: &MatchState) {
        self.tracks.resize_with(state.poses.len(), Vec::new);
        for (track, pose) in self.tracks.iter_mut().zip(&state.poses) {
            let place = DVec2::new(pose.position.x, pose.position.y);
            let last = track.last().and_then(|part| part.last());
            match (last.map(|last| last.distance(place)), track.last_mut()) {
                (Some(way), _) if way < POINT => {}
                (Some(way), Some(part)) if way < JUMP => part.push(place),
                _ => track.push(vec![place]),
            }
        }
        self.state = Some(state.clone());
    }

    /// Takes what the players did so far.
    pub fn count(&mut self, statistics: &MatchStatistics) {
        self.statistics = statistics.clone();
    }

    /// Takes a kick.
    pub fn add(&mut self, kick: &Kick) {
        self.kicks.push(kick.clone());
    }

    /// The rows of the table with their names: each team, followed by its players.
    fn rows(&self) -> Vec<(String, Row)> {
        let players: Vec<_> =
            self.statistics.players.iter().map(|player| (player, Row::of(player))).collect();
        let mut rows = Vec::new();
        for team in [Team::Blue, Team::Red] {
            let is_of_team = |player: &PlayerStatistics| {
                seats(std::slice::from_ref(&player.robot)).is_ok_and(|seats| seats[0].team == team)
            };
            let members = || players.iter().filter(|(player, _)| is_of_team(player));
            if members().next().is_none() {
                continue;
            }
            let mut all = members().fold(Row::default(), |all, (_, row)| all.plus(row));
            all.goals = self.state.as_ref().map_or(0, |state| match team {
                Team::Blue => state.blue_score.into(),
                Team::Red => state.red_score.into(),
            });
            rows.push((team.to_string(), all));
            rows.extend(members().map(|(player, row)| (player.robot.clone(), *row)));
        }
        rows
    }

    /// The time in which somebody had the ball, in s.
    fn possession(&self) -> f64 {
        self.statistics.players.iter().map(|player| f64::from(player.possession)).sum()
    }

    /// A table of what teams and players did; empty before the match has begun. Lines end with `\n`.
    #[must_use]
    pub fn text(&self) -> String {
        let rows = self.rows();
        if rows.is_empty() {
            return String::new();
        }
        let line = |name: &str, cells: [String; COLUMNS.len()]| {
            let cells = cells.iter().zip(COLUMNS).map(|(cell, title)| format!("{cell:>0$}", title.len() + 2));
            format!("{name:<10}{}\n", cells.collect::<String>())
        };
        let mut text = line("", COLUMNS.map(str::to_owned));
        for (name, row) in &rows {
            let indent = if is_team(name) { "" } else { "  " };
            text.push_str(&line(&format!("{indent}{name}"), row.cells(self.possession())));
        }
        text
    }

    /// A line for spectators while the match is played: what both teams did, blue first.
    #[must_use]
    pub fn line(&self) -> String {
        let whole = self.possession();
        let rows = self.rows();
        let teams: Vec<_> =
            rows.iter().filter(|(name, _)| is_team(name)).map(|(_, row)| row.cells(whole)).collect();
        let of_column = |(column, title): (usize, &str)| {
            let cells: Vec<&str> = teams.iter().map(|cells| cells[column].as_str()).collect();
            format!("{title} {}", cells.join(" : "))
        };
        let shown = |(_, title): &(usize, &str)| ["shots", "passes", "ball", "falls"].contains(title);
        COLUMNS.into_iter().enumerate().filter(shown).map(of_column).collect::<Vec<_>>().join("   ")
    }

    /// A picture of the field with the ways of the robots and the kicks, and the table below it, as SVG.
    #[must_use]
    pub fn svg(&self, field: &Field) -> String {
        let rows = self.rows();
        let mut svg = Svg::new(field, rows.len());
        if let Some(state) = &self.state {
            svg.score([state.blue_score, state.red_score]);
        }
        svg.field(field);
        for (player, track) in self.statistics.players.iter().zip(&self.tracks) {
            track.iter().for_each(|part| svg.track(&player.robot, part));
        }
        self.kicks.iter().for_each(|kick| svg.kick(kick));
        let whole = self.possession();
        let of_teams = rows.iter().filter(|(name, _)| is_team(name));
        svg.possession(of_teams.map(|(team, row)| (team.as_str(), row.possession / whole.max(f64::EPSILON))));
        svg.row("", &COLUMNS.map(str::to_owned));
        rows.iter().for_each(|(name, row)| svg.row(name, &row.cells(whole)));
        svg.end()
    }
}

/// True for the name of a team, not of a player.
fn is_team(name: &str) -> bool {
    !name.contains('_')
}

impl Row {
    fn of(player: &PlayerStatistics) -> Self {
        Self {
            goals: player.goals,
            kicks: player.kicks,
            shots: player.shots,
            shots_on_goal: player.shots_on_goal,
            passes: player.passes,
            falls: player.falls,
            get_ups: player.get_ups,
            penalties: player.penalties,
            distance: player.distance.into(),
            possession: player.possession.into(),
        }
    }

    fn plus(self, other: &Self) -> Self {
        Self {
            goals: self.goals + other.goals,
            kicks: self.kicks + other.kicks,
            shots: self.shots + other.shots,
            shots_on_goal: self.shots_on_goal + other.shots_on_goal,
            passes: self.passes + other.passes,
            falls: self.falls + other.falls,
            get_ups: self.get_ups + other.get_ups,
            penalties: self.penalties + other.penalties,
            distance: self.distance + other.distance,
            possession: self.possession + other.possession,
        }
    }

    /// The cells below [`COLUMNS`]; `whole` is the time in which anybody had the ball, in s.
    fn cells(&self, whole: f64) -> [String; COLUMNS.len()] {
        let share =
            if whole > 0.0 { format!("{:.0} %", 100.0 * self.possession / whole) } else { "–".to_owned() };
        [
            self.goals.to_string(),
            self.kicks.to_string(),
            self.shots.to_string(),
            self.shots_on_goal.to_string(),
            self.passes.to_string(),
            share,
            format!("{:.1} m", self.distance),
            self.falls.to_string(),
            self.get_ups.to_string(),
            self.penalties.to_string(),
        ]
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use downbeat_msgs::geometry_msgs::msg::{Point, Pose};

    fn state(x: f64) -> MatchState {
        let pose = |x| Pose { position: Point { x, y: 0.5, z: 0.3 }, ..Pose::default() };
        MatchState { poses: vec![pose(x), pose(2.0)], blue_score: 2, red_score: 1, ..MatchState::default() }
    }

    fn summary() -> Summary {
        let mut summary = Summary::default();
        for step in 0..20 {
            summary.see(&state(-2.0 + 0.05 * f64::from(step)));
        }
        // Put back to its place.
        summary.see(&state(-4.0));
        let player = |robot: &str, possession, distance| PlayerStatistics {
            robot: robot.to_owned(),
            possession,
            distance,
            shots: 3,
            kicks: 5,
            goals: 1,
            ..PlayerStatistics::default()
        };
        let players = vec![player("blue_2", 30.0, 12.34), player("red_1", 10.0, 0.0)];
        summary.count(&MatchStatistics { players, ..MatchStatistics::default() });
        let to = Point { x: 4.6, y: 0.2, z: 0.0 };
        summary.add(&Kick { robot: "blue_2".to_owned(), to, outcome: Kick::GOAL, ..Kick::default() });
        summary
    }

    #[test]
    fn teams_come_before_their_players_and_have_the_score_of_the_referee() {
        let text = summary().text();
        let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split_whitespace().collect()).collect();
        assert_eq!(rows[1][..4], ["blue", "2", "5", "3"], "{text}");
        assert_eq!(rows[2][..4], ["blue_2", "1", "5", "3"], "{text}");
        assert!(rows[2].ends_with(&["75", "%", "12.3", "m", "0", "0", "0"]), "{text}");
        assert_eq!((rows[3][0], rows[4][0], rows.len()), ("red", "red_1", 5));
        let ends: Vec<usize> = text.lines().map(|line| line.chars().count()).collect();
        assert!(ends.iter().all(|end| *end == ends[0]), "columns are below their titles\n{text}");
    }

    #[test]
    fn spectators_compare_the_teams() {
        assert_eq!(summary().line(), "shots 3 : 3   passes 0 : 0   ball 75 % : 25 %   falls 0 : 0");
    }

    #[test]
    fn before_the_match_there_is_nothing_to_tell() {
        assert_eq!(Summary::default().text(), "");
        assert!(Summary::default().svg(&Field::default()).ends_with("</svg>\n"));
    }

    #[test]
    fn the_picture_shows_ways_without_jumps_and_kicks_where_they_were() {
        let svg = summary().svg(&Field::default());
        // 9 m and twice 0.7 m of carpet are 860 pixels wide.
        let scale = 860.0 / 10.4;
        let x = |x: f64| format!("{:.1}", 450.0 + x * scale);
        assert_eq!(svg.matches("<polyline").count(), 1, "{svg}");
        assert!(svg.contains(&format!("points=\"{},", x(-2.0))), "{svg}");
        assert!(svg.contains(&format!("x2=\"{}\"", x(4.6))), "{svg}");
        assert!(svg.contains("blue 2") && svg.contains("75 %"), "{svg}");
        let opened = svg.matches("<text").count();
        assert_eq!(opened, svg.matches("</text>").count());
    }
}
