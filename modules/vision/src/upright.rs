//! What stands on the field: goal posts and robots.

use crate::colours::Class;
use crate::detector::{SeenBall, SeenPost, SeenRobot};
use crate::labels::{Labels, boundary_at};
use crate::view::View;
use downbeat_football::{Field, GoalColour};
use glam::DVec2;

/// The most posts and robots in a picture.
const MOST: usize = 16;

/// Goal posts, from the left to the right: runs of their colour across the boundary of the field, followed down to the floor.
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

/// Other robots, from the left to the right: columns in which something that is not carpet is as high as a robot there, side by side as
/// wide as one.
pub(crate) fn robots(
    labels: &Labels,
    view: &View,
    boundary: &[DVec2],
    field: &Field,
    posts: &[SeenPost],
    balls: &[SeenBall],
) -> Vec<SeenRobot> {
    let step = (labels.width / 80).max(1);
    let mut found: Vec<SeenRobot> = Vec::new();
    // The columns of one robot so far: first and last column, lowest foot, highest top.
    let mut group: Option<[usize; 4]> = None;
    for column in (step / 2..labels.width).step_by(step) {
        let is_post = posts.iter().any(|post| (post.foot.x - column as f64).abs() <= post.size.x);
        let body = if is_post { None } else { body_in(labels, view, boundary, field, column) };
        let is_ball = |foot: usize| {
            let near = |ball: &SeenBall| {
                ball.centre.distance(DVec2::new(column as f64, foot as f64)) < 1.5 * ball.radius
            };
            balls.iter().any(near)
        };
        match (body.filter(|(_, foot)| !is_ball(*foot)), &mut group) {
            (Some((top, foot)), Some([_, last, lowest, highest]))
                if foot.abs_diff(*lowest) as f64 <= 12.0 * labels.scale() && column - *last <= 2 * step =>
            {
                (*last, *lowest, *highest) = (column, (*lowest).max(foot), (*highest).min(top));
            }
            (Some((top, foot)), _) => {
                found.extend(group.take().and_then(|group| robot(view, field, group, step)));
                group = Some([column, column, foot, top]);
            }
            (None, Some([_, last, ..])) if column - *last > 2 * step => {
                found.extend(group.take().and_then(|group| robot(view, field, group, step)));
            }
            (None, _) => {}
        }
    }
    found.extend(group.and_then(|group| robot(view, field, group, step)));
    found.truncate(MOST);
    found
}

/// The rows of something as high as a robot in a column: its top and its foot.
fn body_in(
    labels: &Labels,
    view: &View,
    boundary: &[DVec2],
    field: &Field,
    column: usize,
) -> Option<(usize, usize)> {
    let border = boundary_at(boundary, column as f64).max(0.0);
    let mut row = labels.height;
    while row > 0 && row as f64 > border {
        row -= 1;
        if labels.class(column, row) == Class::Green {
            continue;
        }
        let foot = row;
        let place = view.on_floor(DVec2::new(column as f64, foot as f64))?;
        let high = view.height_at(place, field.robot.height)?;
        if place.length() > 8.0 || high < 8.0 {
            return None;
        }
        let least = foot as f64 - high;
        let (mut top, mut other) = (row, 0);
        while row as f64 > least && row > 0 && top - row <= 2 {
            let class = labels.class(column, row);
            if class != Class::Green {
                top = row;
                other += usize::from(class != Class::White);
            }
            row -= 1;
        }
        let height = (foot - top + 1) as f64;
        // Lines are white all over; robots are not.
        if height > 0.5 * high && other as f64 > 0.3 * height {
            return Some((top, foot));
        }
        row = top;
    }
    None
}

fn robot(view: &View, field: &Field, group: [usize; 4], step: usize) -> Option<SeenRobot> {
    let [first, last, foot, top] = group;
    let foot_at = DVec2::new((first + last) as f64 / 2.0, foot as f64);
    let place = view.on_floor(foot_at)?;
    let width = (last - first + step) as f64;
    let expected = view.width_at(place.extend(0.0), field.robot.width);
    let share = width / expected;
    (0.35..=3.5).contains(&share).then(|| SeenRobot {
        foot: foot_at,
        size: DVec2::new(width, (foot - top + 1) as f64),
        place,
        confidence: share.min(1.0 / share).sqrt(),
    })
}
