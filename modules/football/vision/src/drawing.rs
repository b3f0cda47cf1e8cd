//! Pictures for people: what was seen, and which colour belongs to what.

use crate::colours::{Class, Table};
use crate::seen::{Seen, TeamColour};
use downbeat_pictures::Picture;
use glam::DVec2;

/// A picture that is drawn into; red, green, blue, row by row.
struct Canvas {
    size: [usize; 2],
    data: Vec<u8>,
}

const BLUE: [u8; 3] = [40, 80, 255];
const RED: [u8; 3] = [255, 40, 40];
const YELLOW: [u8; 3] = [255, 230, 0];
const MAGENTA: [u8; 3] = [255, 0, 255];
const CYAN: [u8; 3] = [0, 255, 255];
const BLACK: [u8; 3] = [0, 0, 0];

/// The length of half a cross, in pixels.
const CROSS: f64 = 4.0;

/// The picture with what was seen in it: the field boundary in blue, lines in red, intersections as
/// yellow crosses, balls and the centre circle in magenta, goal posts in cyan, robots in the colour of
/// their team or else in black. Red, green, blue, row by row.
#[must_use]
pub fn annotated(picture: &Picture<'_>, seen: &Seen) -> Vec<u8> {
    let mut canvas = Canvas { size: [picture.width(), picture.height()], data: picture.to_rgb() };
    seen.boundary.windows(2).for_each(|ends| canvas.line(ends[0], ends[1], BLUE));
    seen.lines.iter().for_each(|line| canvas.line(line.pixels[0], line.pixels[1], RED));
    if let Some(circle) = &seen.circle {
        let [from, to] = circle.bounds;
        canvas.ellipse((from + to) / 2.0, (to - from) / 2.0, MAGENTA);
    }
    for post in &seen.posts {
        canvas.standing(post.foot, post.size, CYAN);
    }
    for robot in &seen.robots {
        let colour = match robot.team {
            Some(TeamColour::Blue) => BLUE,
            Some(TeamColour::Red) => RED,
            None => BLACK,
        };
        canvas.standing(robot.foot, robot.size, colour);
    }
    for intersection in &seen.intersections {
        for arm in [DVec2::X, DVec2::Y] {
            canvas.line(intersection.pixel - CROSS * arm, intersection.pixel + CROSS * arm, YELLOW);
        }
    }
    for ball in &seen.balls {
        canvas.ellipse(ball.centre, DVec2::splat(ball.radius + 1.0), MAGENTA);
    }
    canvas.data
}

/// The picture with one colour for each class: the carpet green, lines white, the ball orange, goals
/// yellow, teams blue and red, everything else black. Red, green, blue, row by row.
#[must_use]
pub fn classified(picture: &Picture<'_>, table: &Table) -> Vec<u8> {
    let mut data = Vec::with_capacity(3 * picture.width() * picture.height());
    picture.each_pixel(|_, rgb| {
        data.extend(match table.class_of(rgb) {
            Class::Other => BLACK,
            Class::Green => [0, 140, 0],
            Class::White => [255; 3],
            Class::Orange => [255, 128, 0],
            Class::Yellow => YELLOW,
            Class::Blue => BLUE,
            Class::Red => RED,
        });
    });
    data
}

impl Canvas {
    fn dot(&mut self, at: DVec2, colour: [u8; 3]) {
        let [width, height] = self.size;
        let (column, row) = (at.x.round(), at.y.round());
        if (0.0..width as f64).contains(&column) && (0.0..height as f64).contains(&row) {
            let first = 3 * (row as usize * width + column as usize);
            self.data[first..first + 3].copy_from_slice(&colour);
        }
    }

    fn line(&mut self, from: DVec2, to: DVec2, colour: [u8; 3]) {
        // What is seen may lie outside of the picture, but not by much.
        let longest = (self.size[0] + self.size[1]) as f64;
        let steps = (to - from).abs().max_element().clamp(1.0, longest).ceil();
        for step in 0..=steps as usize {
            self.dot(from.lerp(to, step as f64 / steps), colour);
        }
    }

    fn ellipse(&mut self, centre: DVec2, radii: DVec2, colour: [u8; 3]) {
        let corner =
            |part: i32| centre + radii * DVec2::from_angle(f64::from(part) * std::f64::consts::PI / 24.0);
        (0..48).for_each(|part| self.line(corner(part), corner(part + 1), colour));
    }

    /// A box around what stands on the floor.
    fn standing(&mut self, foot: DVec2, size: DVec2, colour: [u8; 3]) {
        let [left, right] = [-0.5, 0.5].map(|share| foot + DVec2::new(share * size.x, 0.0));
        let up = DVec2::new(0.0, -size.y);
        for (from, to) in [(left, right), (right, right + up), (right + up, left + up), (left + up, left)] {
            self.line(from, to, colour);
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::{Colours, Encoding, SeenBall, SeenPost};

    #[test]
    fn what_is_seen_is_drawn_where_it_is() {
        let data = [40, 130, 50].repeat(32 * 32);
        let picture = Picture::new([32, 32], 96, Encoding::Rgb8, &data).unwrap();
        let ball =
            SeenBall { centre: DVec2::new(10.0, 20.0), radius: 3.0, place: DVec2::ZERO, confidence: 1.0 };
        // Half of it is outside.
        let post = SeenPost {
            foot: DVec2::new(31.0, 16.0),
            size: DVec2::new(6.0, 40.0),
            place: DVec2::ZERO,
            confidence: 1.0,
        };
        let seen = Seen { balls: vec![ball], posts: vec![post], ..Seen::default() };
        let drawn = annotated(&picture, &seen);
        let pixel = |column: usize, row: usize| [0, 1, 2].map(|part| drawn[3 * (32 * row + column) + part]);
        assert_eq!(pixel(14, 20), MAGENTA);
        assert_eq!(pixel(10, 16), MAGENTA);
        assert_eq!(pixel(28, 5), CYAN);
        assert_eq!(pixel(10, 20), [40, 130, 50]);
        assert_eq!(annotated(&picture, &Seen::default()), data);
    }

    #[test]
    fn classes_have_a_colour_each() {
        let data = [[40, 130, 50], [235, 235, 235], [230, 90, 20], [10, 10, 10]].concat().repeat(16 * 4);
        let picture = Picture::new([16, 16], 48, Encoding::Rgb8, &data).unwrap();
        let drawn = classified(&picture, &Table::new(&Colours::default()));
        assert_eq!(drawn[..12], [[0, 140, 0], [255; 3], [255, 128, 0], BLACK].concat());
    }
}
