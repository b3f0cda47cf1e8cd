//! What stands on the field: goal posts and robots.

use crate::colours::Class;
use crate::labels::{Labels, boundary_at};
use crate::seen::{SeenBall, SeenPost, SeenRobot, TeamColour};
use crate::view::View;
use downbeat_football::{Field, GoalColour};
use glam::DVec2;

/// The most posts and robots in a picture.
const MOST: usize = 16;

/// Goal posts, from the left to the right: runs of their colour across the boundary of the field, followed
/// down to the floor.
pub(crate) fn posts(labels: &Labels, view: &View, boundary: &[DVec2], field: &Field) -> Vec<SeenPost> {
    let class = match field.goal.colour {
        GoalColour::Yellow => Class::Yellow,
        GoalColour::White => Class::White,
    };
    let is_post = |column: usize, row: usize| labels.class(column, row) == class;
    let mut found: Vec<SeenPost> = Vec::new();
    for above in [3.0, 8.0, 14.0] {
        let row_in = |column: usize| {
            let row = boundary_at(boundary, column as f64) - above * labels.scale();
            (row >= 0.0 && row < labels.height as f64).then_some(row as usize)
        };
        let mut column = 0;
        while column < labels.width {
            if !row_in(column).is_some_and(|row| is_post(column, row)) {
                column += 1;
                continue;
            }
            let left = column;
            while column < labels.width && row_in(column).is_some_and(|row| is_post(column, row)) {
                column += 1;
            }
            let middle = (left + column - 1) / 2;
            let Some(start) = row_in(middle) else { continue };
            let width = (column - left) as f64;
            let (top, bottom) =
                (follow(labels, middle, start, class, -1), follow(labels, middle, start, class, 1));
            if bottom + 1 >= labels.height || left == 0 || column == labels.width {
                continue;
            }
            let foot = DVec2::new((left + column - 1) as f64 / 2.0, bottom as f64);
            let Some(place) = view.on_floor(foot) else { continue };
            // The foot is the front of the post: its middle is half a diameter farther.
            let away = (place - view.ground_from_camera.translation.truncate()).normalize_or_zero();
            let place = place + away * field.goal.post_diameter / 2.0;
            let wide = view.width_at(place.extend(0.0), field.goal.post_diameter);
            let Some(high) = view.height_at(place, field.goal.height) else { continue };
            let height = (bottom - top + 1) as f64;
            let is_high = height > 0.5 * high && height < 1.5 * high || (top == 0 && height > 2.0 * width);
            if !is_high || !(0.35..=2.5).contains(&(width / wide)) || height < 2.0 * width {
                continue;
            }
            if found.iter().any(|other| (other.foot.x - foot.x).abs() < 1.5 * width.max(other.size.x)) {
                continue;
            }
            let fit = (width / wide).min(wide / width);
            found.push(SeenPost { foot, size: DVec2::new(width, height), place, confidence: fit.sqrt() });
        }
    }
    found.sort_by(|one, other| one.foot.x.total_cmp(&other.foot.x));
    found.truncate(MOST);
    found
}

/// The last row of a class in a column, up (-1) or down (1), over gaps of two pixels.
fn follow(labels: &Labels, column: usize, start: usize, class: Class, direction: isize) -> usize {
    let (mut last, mut row) = (start, start);
    while row.abs_diff(last) <= 2 {
        if labels.class(column, row) == class {
            last = row;
        }
        match row.checked_add_signed(direction).filter(|row| *row < labels.height) {
            Some(next) => row = next,
            None => break,
        }
    }
    last
}

/// Columns of one robot, side by side. Bounds are inclusive.
#[derive(Clone, Copy)]
struct Columns {
    first: usize,
    last: usize,
    /// The lowest foot and the highest top.
    foot: usize,
    top: usize,
}

/// From this share of a robot's height on it stands, and down to that one it lies.
const STANDING: f64 = 0.5;
const LYING: f64 = 0.12;
/// The width of one that lies at least, as a share of that of one that stands.
const LEAST_LYING: f64 = 0.7;
/// The width of what is seen at least of one that the picture cuts off, in m: that of a foot.
const PART: f64 = 0.04;
/// How much carpet is seen between the parts of one, as a share of the height, and at most as a share of the
/// picture.
const GAP: f64 = 0.12;
const WIDEST_GAP: f64 = 0.25;
/// How far to either side its parts are, as a share of the width.
const ASIDE: f64 = 0.7;
/// How far its middle is behind what is seen of its feet, in m.
const HALF_DEPTH: f64 = 0.05;
/// Beyond this distance a robot that lies looks like a line or a shadow and is not reported, in m.
const LYING_RANGE: f64 = 3.0;
/// Beyond this distance no robot is reported, in m.
const RANGE: f64 = 8.0;
/// The share of a robot's box that its colour covers at least, and how much more of it there has to be than
/// of the other one.
const WORN: f64 = 0.03;
const CLEARLY: usize = 4;

/// Other robots, the nearest first: columns in which something that is not carpet is about as high as a robot
/// there, side by side, with what else is above their feet; as wide as a robot. What is lower, and still
/// wide, lies; of one that the picture cuts off a part is enough. The team is what most pixels of a team's
/// colour in the box are.
pub(crate) fn robots(
    labels: &Labels,
    view: &View,
    boundary: &[DVec2],
    field: &Field,
    posts: &[SeenPost],
    balls: &[SeenBall],
) -> Vec<SeenRobot> {
    let step = (labels.width / 80).max(1);
    let mut groups: Vec<Columns> = Vec::new();
    for column in (step / 2..labels.width).step_by(step) {
        if posts.iter().any(|post| (post.foot.x - column as f64).abs() <= post.size.x) {
            continue;
        }
        let Some((top, foot)) = body_in(labels, view, boundary, field, balls, column) else { continue };
        match groups.last_mut() {
            Some(group)
                if foot.abs_diff(group.foot) as f64 <= 12.0 * labels.scale()
                    && column - group.last <= 2 * step =>
            {
                group.last = column;
                (group.foot, group.top) = (group.foot.max(foot), group.top.min(top));
            }
            _ => groups.push(Columns { first: column, last: column, foot, top }),
        }
    }
    // Arms and trunk end above the feet, and look farther away: they belong to the nearest one that they can
    // be parts of.
    groups.sort_by_key(|group| std::cmp::Reverse(group.foot));
    let mut whole: Vec<Columns> = Vec::new();
    for group in groups {
        match whole.iter_mut().find(|robot| robot.has_part(&group, view, field)) {
            Some(robot) => robot.join(&group),
            None => whole.push(group),
        }
    }
    let found = whole.into_iter().filter_map(|columns| robot(labels, view, field, columns, step));
    found.take(MOST).collect()
}

/// How many pixels high a robot is at a place; of one whose head is beside the camera, endless.
fn height_at(view: &View, place: DVec2, field: &Field) -> f64 {
    view.height_at(place, field.robot.height).unwrap_or(f64::INFINITY)
}

/// The rows of something in a column that is at least as high as a robot that lies: its top and its foot.
fn body_in(
    labels: &Labels,
    view: &View,
    boundary: &[DVec2],
    field: &Field,
    balls: &[SeenBall],
    column: usize,
) -> Option<(usize, usize)> {
    let border = boundary_at(boundary, column as f64).max(0.0);
    let is_ball = |row: usize| {
        let at = DVec2::new(column as f64, row as f64);
        balls.iter().any(|ball| ball.centre.distance(at) < 1.2 * ball.radius)
    };
    let mut row = labels.height;
    while row > 0 && row as f64 > border {
        row -= 1;
        if labels.class(column, row) == Class::Green || is_ball(row) {
            continue;
        }
        // A line in front of a robot, with carpet between them, is no part of it.
        let mut line_top = row;
        while line_top > 0 && labels.class(column, line_top) == Class::White {
            line_top -= 1;
        }
        if line_top < row && labels.class(column, line_top) == Class::Green {
            row = line_top;
            continue;
        }
        let foot = row;
        let place = view.on_floor(DVec2::new(column as f64, foot as f64))?;
        let high = height_at(view, place, field);
        if place.length() > RANGE || high < 8.0 {
            return None;
        }
        let least = foot as f64 - high;
        let gap = (GAP * high).min(WIDEST_GAP * labels.height as f64).max(2.0) as usize;
        let (mut top, mut other) = (row, 0);
        while row as f64 > least && row > 0 && top - row <= gap {
            let class = labels.class(column, row);
            if class != Class::Green && !is_ball(row) {
                top = row;
                other += usize::from(!matches!(class, Class::White | Class::Yellow));
            }
            row -= 1;
        }
        let height = (foot - top + 1) as f64;
        let reached = view.height_over(place, DVec2::new(column as f64, top as f64));
        // Lines are white all over, and goals yellow; robots are not.
        if other as f64 > 0.3 * height
            && height > 4.0 * labels.scale()
            && reached > LYING * field.robot.height
        {
            return Some((top, foot));
        }
        row = top;
    }
    None
}

impl Columns {
    fn middle(&self) -> DVec2 {
        DVec2::new((self.first + self.last) as f64 / 2.0, self.foot as f64)
    }

    /// Whether columns that end above its feet can be a part of it.
    fn has_part(&self, part: &Self, view: &View, field: &Field) -> bool {
        let Some(place) = view.on_floor(self.middle()) else { return false };
        let high = height_at(view, place, field);
        let wide = view.width_at(place.extend(0.0), field.robot.width);
        (part.middle().x - self.middle().x).abs() < ASIDE * wide && part.foot as f64 > self.foot as f64 - high
    }

    fn join(&mut self, part: &Self) {
        (self.first, self.last) = (self.first.min(part.first), self.last.max(part.last));
        self.top = self.top.min(part.top);
    }
}

fn robot(labels: &Labels, view: &View, field: &Field, columns: Columns, step: usize) -> Option<SeenRobot> {
    let Columns { first, last, foot, top } = columns;
    let mut foot_at = columns.middle();
    let on_floor = view.on_floor(foot_at)?;
    let reached = view.height_over(on_floor, DVec2::new(foot_at.x, top as f64));
    let width = (last - first + step) as f64;
    let wide = view.width_at(on_floor.extend(0.0), field.robot.width);
    let share = width / wide;
    let [is_cut_left, is_cut_right] = [first < step, last + step >= labels.width];
    let is_cut_above = top <= 2;
    let is_part = is_cut_above || (is_cut_left || is_cut_right) && share < LEAST_LYING;
    let is_fallen = reached <= STANDING * field.robot.height && !is_part;
    // One that lies is as wide as it is high, or seen from its head or its feet.
    let possible = match (is_fallen, is_part) {
        (true, _) => LEAST_LYING..=3.0,
        (false, true) => PART / field.robot.width..=3.5,
        (false, false) => 0.35..=3.5,
    };
    // The rest of it is beside the picture.
    match (is_cut_left, is_cut_right) {
        (true, false) => foot_at.x = foot_at.x.min(last as f64 - wide / 2.0),
        (false, true) => foot_at.x = foot_at.x.max(first as f64 + wide / 2.0),
        _ => {}
    }
    let place = view.on_floor(foot_at)?;
    let place =
        place + (place - view.ground_from_camera.translation.truncate()).normalize_or_zero() * HALF_DEPTH;
    // What is beside the middle may be somebody behind it.
    let aside = if is_fallen { width / 2.0 } else { (0.4 * wide).min(width / 2.0) };
    let middle = columns.middle().x;
    let within = [middle - aside, middle + aside].map(|column| column.max(0.0) as usize);
    (possible.contains(&share) && (!is_fallen || place.length() < LYING_RANGE)).then(|| SeenRobot {
        foot: columns.middle(),
        size: DVec2::new(width, (foot - top + 1) as f64),
        place,
        team: worn(labels, within, [top, foot]),
        is_fallen,
        confidence: share.min(1.0 / share).sqrt(),
    })
}

/// The colour of a team in a box, if there is enough of one and not of the other. Bounds are inclusive.
fn worn(labels: &Labels, [left, right]: [usize; 2], [top, bottom]: [usize; 2]) -> Option<TeamColour> {
    let right = right.min(labels.width - 1);
    let (mut blue, mut red) = (0, 0);
    for row in top..=bottom {
        for class in &labels.classes[row * labels.width + left..=row * labels.width + right] {
            blue += usize::from(*class == Class::Blue);
            red += usize::from(*class == Class::Red);
        }
    }
    let area = (right - left + 1) * (bottom - top + 1);
    let enough = (WORN * area as f64).max(4.0);
    if blue as f64 >= enough && blue >= CLEARLY * red {
        Some(TeamColour::Blue)
    } else if red as f64 >= enough && red >= CLEARLY * blue {
        Some(TeamColour::Red)
    } else {
        None
    }
}
