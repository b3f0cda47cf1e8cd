//! Lines, the centre circle, and where lines meet.
//!
//! Scan lines across and down find pairs of edges with carpet on both sides. Their middles are projected to
//! the floor, where lines are straight and the circle is round with a known radius, and fitted there by
//! RANSAC.

use crate::colours::Class;
use crate::labels::{Labels, boundary_at};
use crate::seen::{SeenCircle, SeenIntersection, SeenLine};
use crate::view::View;
use downbeat_football::{Field, IntersectionKind};
use fastrand::Rng;
use glam::{DMat2, DVec2};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Markings farther away are too thin, in m.
const FARTHEST: f64 = 6.0;
/// The least difference of brightness over two pixels at an edge.
const EDGE: i32 = 26;
/// The most points that are fitted; more are thinned out.
const MOST_POINTS: usize = 600;
/// The most lines in a picture.
const MOST_LINES: usize = 12;
/// The shortest line, in m, and the fewest points on it.
const SHORTEST: f64 = 0.25;
const FEWEST: usize = 6;

/// The middle of a marking on a scan line.
#[derive(Clone, Copy, Debug)]
struct Point {
    pixel: DVec2,
    ground: DVec2,
    /// The deviation across the line of sight is smaller; this is that along it, in m.
    deviation: f64,
}

/// What is marked on the floor.
#[derive(Clone, Debug, Default)]
pub(crate) struct Markings {
    pub(crate) lines: Vec<SeenLine>,
    pub(crate) circle: Option<SeenCircle>,
    pub(crate) intersections: Vec<SeenIntersection>,
}

pub(crate) fn markings(labels: &Labels, view: &View, boundary: &[DVec2], field: &Field) -> Markings {
    // The same picture gives the same lines.
    let mut random = Rng::with_seed(1);
    let mut points = points(labels, view, boundary, field);
    let circle = circle(&points, view, field, &mut random);
    if let Some(circle) = &circle {
        let radius = field.circle_diameter / 2.0;
        points.retain(|point| (point.ground.distance(circle.place) - radius).abs() > tolerance(point));
    }
    let mut lines = Vec::new();
    while lines.len() < MOST_LINES && points.len() >= FEWEST {
        let Some(line) = next_line(&mut points, view, labels, &mut random) else { break };
        lines.push(line);
    }
    let intersections = intersections(&lines, view, labels);
    Markings { lines, circle, intersections }
}

fn tolerance(point: &Point) -> f64 {
    0.025 + 2.0 * point.deviation
}

/// The middles of markings on all scan lines.
fn points(labels: &Labels, view: &View, boundary: &[DVec2], field: &Field) -> Vec<Point> {
    let mut found = Vec::new();
    let (width, height) = (labels.width, labels.height);
    let step = |size: usize, lines: usize| (size / lines).max(1);
    for column in (step(width, 80) / 2..width).step_by(step(width, 80)) {
        let first = boundary_at(boundary, column as f64).max(0.0) as usize;
        let at = |index: usize| DVec2::new(column as f64, index as f64);
        scan(labels, first..height, |index| index * width + column, at, view, field, &mut found);
    }
    for row in (step(height, 80) / 2..height).step_by(step(height, 80)) {
        let at = |index: usize| DVec2::new(index as f64, row as f64);
        let is_below = |point: &Point| point.pixel.y >= boundary_at(boundary, point.pixel.x);
        let before = found.len();
        scan(labels, 0..width, |index| row * width + index, at, view, field, &mut found);
        let rows: Vec<Point> = found.drain(before..).filter(is_below).collect();
        found.extend(rows);
    }
    let thinning = found.len().div_ceil(MOST_POINTS).max(1);
    found.into_iter().step_by(thinning).collect()
}

/// Finds a rise and a fall of brightness on one scan line, with carpet before and behind.
fn scan(
    labels: &Labels,
    range: std::ops::Range<usize>,
    index_of: impl Fn(usize) -> usize,
    at: impl Fn(usize) -> DVec2,
    view: &View,
    field: &Field,
    found: &mut Vec<Point>,
) {
    let luma = |position: usize| i32::from(labels.luma[index_of(position)]);
    let slope = |position: usize| luma(position + 1) - luma(position - 1);
    let is_green = |position: usize| labels.classes[index_of(position)] == Class::Green;
    let (start, end) = (range.start + 4, range.end.saturating_sub(4));
    let longest = (80.0 * labels.scale()) as usize;
    let mut position = start;
    while position < end {
        if slope(position) < EDGE {
            position += 1;
            continue;
        }
        // The steepest place of the rise.
        while position + 1 < end && slope(position + 1) > slope(position) {
            position += 1;
        }
        let rise = position;
        let last = end.min(rise + longest);
        let Some(mut fall) = (rise + 1..last).find(|index| slope(*index) <= -EDGE) else {
            position += 1;
            continue;
        };
        while fall + 1 < end && slope(fall + 1) < slope(fall) {
            fall += 1;
        }
        // A second rise before the fall begins a brighter thing.
        position = fall;
        let is_carpet = |near: usize, far: usize| is_green(near) || is_green(far);
        let has_ball = (rise..=fall)
            .any(|index| matches!(labels.classes[index_of(index)], Class::Orange | Class::Yellow));
        if has_ball || !is_carpet(rise - 2, rise - 3) || !is_carpet(fall + 2, fall + 3) {
            continue;
        }
        let (Some(one), Some(other)) = (view.on_floor(at(rise)), view.on_floor(at(fall))) else { continue };
        let ground = (one + other) / 2.0;
        let pixel_size = view.pixel_at(ground);
        let distance = ground.distance(view.ground_from_camera.translation.truncate());
        if distance > FARTHEST || one.distance(other) > 4.0 * field.line_width + 2.0 * pixel_size {
            continue;
        }
        let pixel = view.pixel_of(ground.extend(0.0)).unwrap_or((at(rise) + at(fall)) / 2.0);
        found.push(Point { pixel, ground, deviation: 0.6 * pixel_size });
    }
}

fn circle(points: &[Point], view: &View, field: &Field, random: &mut Rng) -> Option<SeenCircle> {
    let radius = field.circle_diameter / 2.0;
    if radius <= 0.0 || points.len() < 14 {
        return None;
    }
    let residual = |point: &Point, centre: DVec2| point.ground.distance(centre) - radius;
    let is_on = |point: &Point, centre: DVec2| residual(point, centre).abs() < tolerance(point);
    let mut best = (0, DVec2::ZERO);
    for _ in 0..150 {
        let (one, other) = (points[random.usize(..points.len())], points[random.usize(..points.len())]);
        let chord = other.ground - one.ground;
        let half = chord.length() / 2.0;
        if half < 0.2 * radius || half > 0.98 * radius {
            continue;
        }
        let to_centre = chord.perp().normalize() * (radius * radius - half * half).sqrt();
        for side in [1.0, -1.0] {
            let centre = (one.ground + other.ground) / 2.0 + to_centre * side;
            let count = points.iter().filter(|point| is_on(point, centre)).count();
            if count > best.0 {
                best = (count, centre);
            }
        }
    }
    let mut centre = best.1;
    // Gauss-Newton for the centre, with weights.
    for _ in 0..6 {
        let (mut matrix, mut vector) = (DMat2::ZERO, DVec2::ZERO);
        for point in points.iter().filter(|point| is_on(point, centre)) {
            let outwards = (point.ground - centre).normalize_or_zero();
            let weight = 1.0 / (point.deviation * point.deviation + 1e-4);
            matrix += DMat2::from_cols(outwards * outwards.x, outwards * outwards.y) * weight;
            vector += outwards * (residual(point, centre) * weight);
        }
        if matrix.determinant().abs() < 1e-9 {
            return None;
        }
        centre += matrix.inverse() * vector;
    }
    let on: Vec<&Point> = points.iter().filter(|point| is_on(point, centre)).collect();
    // A line is a circle nowhere for a third of its round.
    let mut sectors = [0_usize; 24];
    for point in &on {
        let angle = (point.ground - centre).to_angle() + PI;
        sectors[((angle / TAU * 24.0) as usize).min(23)] += 1;
    }
    let covered = sectors.iter().filter(|count| **count > 0).count();
    if on.len() < 14 || covered < 9 {
        return None;
    }
    // A circle that is seen has no more of the same points inside than a line through it.
    let inside = points.iter().filter(|point| residual(point, centre) < -0.15 * radius).count();
    if inside > on.len() {
        return None;
    }
    let pixel = view.pixel_of(centre.extend(0.0))?;
    let border: Vec<DVec2> = (0..24)
        .filter_map(|index| {
            let direction = DVec2::from_angle(f64::from(index) * TAU / 24.0);
            view.pixel_of((centre + direction * radius).extend(0.0))
        })
        .collect();
    let least = border.iter().fold(pixel, |least, point| least.min(*point));
    let most = border.iter().fold(pixel, |most, point| most.max(*point));
    Some(SeenCircle { pixel, bounds: [least, most], place: centre, confidence: covered as f64 / 24.0 })
}

/// The line with the most points, which are taken from them.
fn next_line(points: &mut Vec<Point>, view: &View, labels: &Labels, random: &mut Rng) -> Option<SeenLine> {
    let mut best: (usize, DVec2, DVec2) = (0, DVec2::ZERO, DVec2::X);
    for _ in 0..90 {
        let (one, other) = (points[random.usize(..points.len())], points[random.usize(..points.len())]);
        let between = other.ground - one.ground;
        if !(0.15..2.0).contains(&between.length()) {
            continue;
        }
        let along = between.normalize();
        let count = points.iter().filter(|point| is_on(point, one.ground, along)).count();
        if count > best.0 {
            best = (count, one.ground, along);
        }
    }
    if best.0 < FEWEST {
        return None;
    }
    let (mut at, mut along) = (best.1, best.2);
    for _ in 0..3 {
        (at, along) = fitted(points.iter().filter(|point| is_on(point, at, along)), along)?;
    }
    // The longest part without gaps.
    let mut on: Vec<(f64, usize)> = points
        .iter()
        .enumerate()
        .filter(|(_, point)| is_on(point, at, along))
        .map(|(index, point)| ((point.ground - at).dot(along), index))
        .collect();
    on.sort_by(|one, other| one.0.total_cmp(&other.0));
    let gap = 24.0 * labels.scale();
    let is_gap = |pair: &[(f64, usize)]| {
        let (one, other) = (&points[pair[0].1], &points[pair[1].1]);
        one.pixel.distance(other.pixel) > gap && one.ground.distance(other.ground) > 0.15
    };
    let mut part = 0..0;
    let mut start = 0;
    for end in 1..=on.len() {
        if end == on.len() || is_gap(&on[end - 1..=end]) {
            if end - start > part.len() {
                part = start..end;
            }
            start = end;
        }
    }
    let chosen = on[part].to_vec();
    let (first, last) = (chosen.first()?.0, chosen.last()?.0);
    let ends = [at + along * first, at + along * last];
    let count = chosen.len();
    let mut is_taken = vec![false; points.len()];
    chosen.iter().for_each(|(_, index)| is_taken[*index] = true);
    let mut index = 0;
    points.retain(|_| {
        index += 1;
        !is_taken[index - 1]
    });
    let pixels = [view.pixel_of(ends[0].extend(0.0))?, view.pixel_of(ends[1].extend(0.0))?];
    let is_line =
        count >= FEWEST && last - first > SHORTEST && pixels[0].distance(pixels[1]) > 14.0 * labels.scale();
    if is_line {
        let confidence = 1.0 - 1.0 / (1.0 + count as f64 / 8.0);
        return Some(SeenLine { pixels, ends, confidence });
    }
    if points.len() < FEWEST {
        return None;
    }
    next_line(points, view, labels, random)
}

fn is_on(point: &Point, at: DVec2, along: DVec2) -> bool {
    (point.ground - at).perp_dot(along).abs() < tolerance(point)
}

/// The line through points with the least weighted square distance: a point and a direction.
fn fitted<'a>(points: impl Iterator<Item = &'a Point>, along: DVec2) -> Option<(DVec2, DVec2)> {
    let (mut weights, mut mean, mut squares) = (0.0, DVec2::ZERO, [0.0; 3]);
    for point in points {
        let weight = 1.0 / (point.deviation * point.deviation + 1e-4);
        let DVec2 { x, y } = point.ground;
        weights += weight;
        mean += point.ground * weight;
        squares = [squares[0] + weight * x * x, squares[1] + weight * x * y, squares[2] + weight * y * y];
    }
    if weights <= 0.0 {
        return None;
    }
    mean /= weights;
    let [xx, xy, yy] = squares.map(|sum| sum / weights);
    let (xx, xy, yy) = (xx - mean.x * mean.x, xy - mean.x * mean.y, yy - mean.y * mean.y);
    let angle = 0.5 * libm::atan2(2.0 * xy, xx - yy);
    let direction = DVec2::from_angle(angle);
    Some((mean, if direction.dot(along) < 0.0 { -direction } else { direction }))
}

/// Where two lines that are about perpendicular meet.
fn intersections(lines: &[SeenLine], view: &View, labels: &Labels) -> Vec<SeenIntersection> {
    let mut found: Vec<SeenIntersection> = Vec::new();
    let border = 6.0 * labels.scale();
    let size = DVec2::new(labels.width as f64, labels.height as f64);
    let is_inside = |pixel: DVec2| pixel.min_element() > border && (size - pixel).min_element() > border;
    for (number, one) in lines.iter().enumerate() {
        for other in &lines[number + 1..] {
            let directions = [one, other].map(|line| (line.ends[1] - line.ends[0]).normalize());
            if directions[0].dot(directions[1]).abs() > 0.35 {
                continue;
            }
            let across = directions[0].perp_dot(directions[1]);
            let way = (other.ends[0] - one.ends[0]).perp_dot(directions[1]) / across;
            let place = one.ends[0] + directions[0] * way;
            let Some(pixel) = view.pixel_of(place.extend(0.0)).filter(|pixel| is_inside(*pixel)) else {
                continue;
            };
            let reach = 0.2 + 2.0 * view.pixel_at(place);
            // The arms of each line, away from where they meet.
            let mut arms: Vec<DVec2> = Vec::new();
            let mut touches = true;
            for (line, direction) in [one, other].into_iter().zip(directions) {
                let ways = line.ends.map(|end| (end - place).dot(direction));
                let has = [-ways[0] > reach, ways[1] > reach];
                touches &= ways[0] < reach && ways[1] > -reach && (has[0] || has[1]);
                arms.extend(has[0].then_some(-direction));
                arms.extend(has[1].then_some(direction));
            }
            if !touches {
                continue;
            }
            let sum: DVec2 = arms.iter().sum();
            let (kind, heading) = match arms.len() {
                2 => (IntersectionKind::L, sum.to_angle()),
                3 => (IntersectionKind::T, sum.to_angle()),
                4 => (IntersectionKind::X, directions[0].to_angle().rem_euclid(FRAC_PI_2)),
                _ => continue,
            };
            let confidence = (one.confidence * other.confidence).sqrt();
            if found.iter().all(|known| known.place.distance(place) > 0.2) {
                found.push(SeenIntersection { pixel, place, kind, heading, arms, confidence });
            }
        }
    }
    found
}
