//! Draws the summary of a match as SVG.

use downbeat_football::Field;
use downbeat_football::football_interfaces::msg::Kick;
use glam::DVec2;
use std::fmt::{Arguments, Write};

/// A picture: the score, the field, who had the ball, and the rows of a table, from top to bottom.
pub(crate) struct Svg {
    text: String,
    /// Pixels per m.
    scale: f64,
    /// The centre of the field.
    centre: DVec2,
    /// The lower edge of the carpet.
    below_field: f64,
    next_row: f64,
}

const WIDTH: f64 = 900.0;
const MARGIN: f64 = 20.0;
/// The height of the score, of what is between field and table, and of a row of the table.
const SCORE: f64 = 60.0;
const BETWEEN: f64 = 75.0;
const ROW: f64 = 22.0;
/// The right ends of the columns.
const FIRST_COLUMN: f64 = 170.0;
const COLUMN: f64 = 78.0;

const BLUE: &str = "#2f6fe0";
const RED: &str = "#d23b3b";
const CARPET: &str = "#2e7d43";
const LINES: &str = "#e8f2ea";
const POSTS: &str = "#ffe14d";

impl Svg {
    pub(crate) fn new(field: &Field, rows: usize) -> Self {
        let scale = (WIDTH - 2.0 * MARGIN) / (field.length + 2.0 * field.margin);
        let height = (field.width + 2.0 * field.margin) * scale;
        let below_field = SCORE + height;
        let centre = DVec2::new(WIDTH / 2.0, SCORE + height / 2.0);
        let next_row = below_field + BETWEEN;
        let mut svg = Self { text: String::new(), scale, centre, below_field, next_row };
        let bottom = next_row + ROW * rows as f64 + MARGIN;
        svg.add(format_args!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {bottom:.0}\" font-family=\"system-ui, sans-serif\" font-size=\"15\">"
        ));
        svg.add(format_args!("<rect width=\"100%\" height=\"100%\" fill=\"white\"/>"));
        svg
    }

    pub(crate) fn end(mut self) -> String {
        self.text.push_str("</svg>\n");
        self.text
    }

    pub(crate) fn score(&mut self, [blue, red]: [u8; 2]) {
        self.add(format_args!(
            "<text x=\"{}\" y=\"40\" font-size=\"24\" font-weight=\"600\" text-anchor=\"middle\"><tspan fill=\"{BLUE}\">blue {blue}</tspan> : <tspan fill=\"{RED}\">{red} red</tspan></text>",
            WIDTH / 2.0
        ));
    }

    pub(crate) fn field(&mut self, field: &Field) {
        let [corner, size] = [DVec2::new(MARGIN, SCORE), 2.0 * (self.centre - DVec2::new(MARGIN, SCORE))];
        self.add(format_args!(
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"{CARPET}\"/>",
            corner.x, corner.y, size.x, size.y
        ));
        let width = field.line_width * self.scale;
        for line in field.lines() {
            self.line(line.from, line.to, &format!("stroke=\"{LINES}\" stroke-width=\"{width:.1}\""));
        }
        if field.circle_diameter > 0.0 {
            let style = format!("fill=\"none\" stroke=\"{LINES}\" stroke-width=\"{width:.1}\"");
            self.circle(DVec2::ZERO, field.circle_diameter / 2.0, &style);
        }
        for mark in field.marks() {
            self.circle(mark, field.line_width, &format!("fill=\"{LINES}\""));
        }
        let back = |post: DVec2| DVec2::new(post.x + field.goal.depth.copysign(post.x), post.y);
        let posts = field.posts();
        for post in posts {
            let style = format!("stroke=\"{POSTS}\" stroke-width=\"2\"");
            self.line(post, back(post), &style);
            for other in posts.into_iter().filter(|other| other.x == post.x && other.y > post.y) {
                self.line(back(post), back(other), &style);
            }
            self.circle(post, field.goal.post_diameter / 2.0, &format!("fill=\"{POSTS}\""));
        }
    }

    /// Where a robot walked. A single place is not shown.
    pub(crate) fn track(&mut self, robot: &str, track: &[DVec2]) {
        if track.len() < 2 {
            return;
        }
        let points: Vec<String> = track
            .iter()
            .map(|place| {
                let DVec2 { x, y } = self.at(*place);
                format!("{x:.1},{y:.1}")
            })
            .collect();
        self.add(format_args!(
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"1.5\" stroke-linejoin=\"round\" opacity=\"0.6\"/>",
            points.join(" "),
            colour_of(robot)
        ));
    }

    /// A line to where the ball went, with a dot at its end in the colour of the team.
    pub(crate) fn kick(&mut self, kick: &Kick) {
        let [from, to] = [&kick.from, &kick.to].map(|point| DVec2::new(point.x, point.y));
        let style = match kick.outcome {
            Kick::GOAL => "stroke=\"#ffd400\" stroke-width=\"4\"",
            Kick::SHOT | Kick::SHOT_ON_GOAL => "stroke=\"white\" stroke-width=\"3\"",
            Kick::PASS => "stroke=\"white\" stroke-width=\"2\" stroke-dasharray=\"6 4\"",
            _ => "stroke=\"white\" stroke-width=\"1\"",
        };
        self.line(from, to, style);
        let style = format!("fill=\"{}\" stroke=\"white\"", colour_of(&kick.robot));
        self.circle(to, 4.0 / self.scale, &style);
    }

    /// The shares of the teams in the time in which somebody had the ball.
    pub(crate) fn possession<'a>(&mut self, teams: impl Iterator<Item = (&'a str, f64)>) {
        let y = self.below_field;
        self.add(format_args!(
            "<text x=\"{MARGIN}\" y=\"{:.1}\" font-size=\"13\" fill=\"#555\">Ways of the robots. Kicks: yellow goals, wide shots, dashed passes. Below: who had the ball.</text>",
            y + 18.0
        ));
        let mut left = MARGIN;
        for (team, share) in teams {
            let (top, width) = (y + 28.0, share * (WIDTH - 2.0 * MARGIN));
            self.add(format_args!(
                "<rect x=\"{left:.1}\" y=\"{top:.1}\" width=\"{width:.1}\" height=\"10\" fill=\"{}\"/>",
                colour_of(team)
            ));
            left += width;
        }
    }

    /// The next row of the table; those of teams are bold.
    pub(crate) fn row(&mut self, name: &str, cells: &[String]) {
        let y = self.next_row;
        self.next_row += ROW;
        let weight = if name.is_empty() || name.contains('_') { "400" } else { "700" };
        let colour = if name.is_empty() { "#555" } else { colour_of(name) };
        self.add(format_args!(
            "<text x=\"{MARGIN}\" y=\"{y:.1}\" font-weight=\"{weight}\" fill=\"{colour}\">{name}</text>"
        ));
        for (column, cell) in cells.iter().enumerate() {
            let x = FIRST_COLUMN + COLUMN * column as f64;
            self.add(format_args!(
                "<text x=\"{x:.1}\" y=\"{y:.1}\" font-weight=\"{weight}\" fill=\"#333\" text-anchor=\"end\">{cell}</text>"
            ));
        }
    }

    fn line(&mut self, from: DVec2, to: DVec2, style: &str) {
        let [from, to] = [from, to].map(|place| self.at(place));
        self.add(format_args!(
            "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" {style}/>",
            from.x, from.y, to.x, to.y
        ));
    }

    /// A circle whose radius is in m.
    fn circle(&mut self, centre: DVec2, radius: f64, style: &str) {
        let (DVec2 { x, y }, radius) = (self.at(centre), radius * self.scale);
        self.add(format_args!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius:.1}\" {style}/>"));
    }

    /// The pixel of a place on the field.
    fn at(&self, place: DVec2) -> DVec2 {
        self.centre + DVec2::new(place.x, -place.y) * self.scale
    }

    fn add(&mut self, element: Arguments<'_>) {
        // Never fails on a string.
        let _ = writeln!(self.text, "{element}");
    }
}

/// The colour of a team, or of the team of a robot.
fn colour_of(name: &str) -> &'static str {
    if name.starts_with("red") { RED } else { BLUE }
}
