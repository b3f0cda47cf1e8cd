//! Balls: candidates of the ball's colour, verified by the size that the ball has on the floor at their
//! place.

use crate::colours::Class;
use crate::labels::{Labels, boundary_at};
use crate::seen::SeenBall;
use crate::view::View;
use downbeat_football::{Ball, BallColour};
use glam::DVec2;
use std::f64::consts::PI;

/// How much larger or smaller than expected a ball may look.
const SIZES: std::ops::RangeInclusive<f64> = 0.5..=1.7;
/// The smallest radius of a ball, in pixels: less is noise.
const SMALLEST: f64 = 1.5;
/// The most balls in a picture.
const MOST: usize = 8;

/// The balls, the most certain one first.
pub(crate) fn balls(labels: &Labels, view: &View, boundary: &[DVec2], ball: &Ball) -> Vec<SeenBall> {
    let mut found = match ball.colour {
        BallColour::Orange => orange(labels, view, boundary, ball.diameter / 2.0),
        BallColour::HalfWhite => half_white(labels, view, boundary, ball.diameter / 2.0),
    };
    found.sort_by(|one, other| other.confidence.total_cmp(&one.confidence));
    found.truncate(MOST);
    found
}

/// The ball whose middle is at a pixel: its place, and its radius in pixels.
fn expected(view: &View, centre: DVec2, radius: f64) -> Option<(DVec2, f64)> {
    let place = view.at_height(centre, radius)?;
    Some((place, view.width_at(place.extend(radius), radius)))
}

fn orange(labels: &Labels, view: &View, boundary: &[DVec2], radius: f64) -> Vec<SeenBall> {
    let candidates = labels.regions(Class::Orange).into_iter().filter(|region| region.count >= 6);
    let verified = candidates.filter_map(|region| {
        let (width, height) = (region.width(), region.height());
        let mut centre = region.centre();
        if (region.bottom as f64) < boundary_at(boundary, centre.x) {
            return None;
        }
        let (_, size) = expected(view, centre, radius)?;
        // What is cut off at the edge of the picture is as large as it should be.
        let (right, bottom) = (labels.width - 1, labels.height - 1);
        let is_cut_aside = region.left == 0 || region.right >= right;
        let is_cut_below = region.bottom >= bottom || region.top == 0;
        if is_cut_aside && width < 2.0 * size {
            centre.x = if region.left == 0 { region.right as f64 - size } else { region.left as f64 + size };
        }
        if is_cut_below && height < 2.0 * size {
            centre.y = if region.top == 0 { region.bottom as f64 - size } else { region.top as f64 + size };
        }
        let (place, size) = expected(view, centre, radius)?;
        let [across, down] = [width, height].map(|extent| extent / (2.0 * size));
        let is_size = |share: f64, is_cut: bool| share <= *SIZES.end() && (is_cut || share >= *SIZES.start());
        if size < SMALLEST || !is_size(across, is_cut_aside) || !is_size(down, is_cut_below) {
            return None;
        }
        let fill = region.count as f64 / (PI / 4.0 * width * height);
        // Carpet around it, except where the picture ends.
        let reach = DVec2::new(1.6 * size, 1.6 * size);
        let green = labels.share_in(centre - reach, centre + reach, |class| class == Class::Green)?;
        if fill < 0.55 || (green < 0.2 && !is_cut_aside && !is_cut_below) {
            return None;
        }
        let fit = (across.min(1.0 / across) * down.min(1.0 / down)).clamp(0.0, 1.0).sqrt();
        let seen = if is_cut_aside || is_cut_below { size } else { (width + height) / 4.0 };
        Some(SeenBall { centre, radius: seen, place, confidence: (fill.min(1.0) * fit).sqrt() })
    });
    verified.collect()
}

/// A white ball with dark patches: something round that is not carpet, of the right size, with carpet around.
fn half_white(labels: &Labels, view: &View, boundary: &[DVec2], radius: f64) -> Vec<SeenBall> {
    let sums = Sums::of(labels);
    let mut found: Vec<SeenBall> = Vec::new();
    let mut row = 0.0;
    while row < labels.height as f64 {
        let middle = DVec2::new(labels.width as f64 / 2.0, row);
        let Some((_, size)) = expected(view, middle, radius).filter(|(_, size)| *size >= 2.0) else {
            row += 2.0;
            continue;
        };
        let step = (size / 2.0).max(1.0);
        let mut column = size / 2.0;
        while column < labels.width as f64 {
            let at = DVec2::new(column, row);
            if row + size > boundary_at(boundary, column)
                && sums.share_of_carpet(at, 0.6 * size) < 0.2
                && sums.share_of_carpet(at, 1.6 * size) > 0.3
                && let Some(ball) = refined(labels, view, at, radius)
            {
                let is_full = found.len() >= 64;
                match found.iter_mut().find(|other| other.centre.distance(ball.centre) < other.radius * 1.5) {
                    Some(other) if other.confidence < ball.confidence => *other = ball,
                    Some(_) => {}
                    None if is_full => {}
                    None => found.push(ball),
                }
            }
            column += step;
        }
        row += step;
    }
    found
}

/// Moves a candidate to the middle of what is not carpet, and verifies disc and ring.
fn refined(labels: &Labels, view: &View, at: DVec2, radius: f64) -> Option<SeenBall> {
    let mut centre = at;
    for _ in 0..3 {
        let (_, size) = expected(view, centre, radius)?;
        let (mut sum, mut count) = (DVec2::ZERO, 0.0);
        each_within(labels, centre, 1.35 * size, |pixel, class| {
            if class != Class::Green {
                sum += pixel;
                count += 1.0;
            }
        });
        if count < 4.0 {
            return None;
        }
        centre = sum / count;
    }
    let (place, size) = expected(view, centre, radius)?;
    // Disc, ring around it: pixels, carpet, white.
    let mut disc = [0.0_f64; 3];
    let mut ring = [0.0_f64; 2];
    each_within(labels, centre, 1.6 * size, |pixel, class| {
        let distance = pixel.distance(centre) / size;
        let (is_green, is_white) = (f64::from(class == Class::Green), f64::from(class == Class::White));
        if distance < 0.9 {
            disc = [disc[0] + 1.0, disc[1] + is_green, disc[2] + is_white];
        } else if distance > 1.25 {
            ring = [ring[0] + 1.0, ring[1] + is_green];
        }
    });
    let (body, white) = (1.0 - disc[1] / disc[0].max(1.0), disc[2] / disc[0].max(1.0));
    let around = ring[1] / ring[0].max(1.0);
    let is_ball = disc[0] >= 6.0 && body > 0.85 && (0.25..0.97).contains(&white) && around > 0.65;
    is_ball.then(|| SeenBall { centre, radius: size, place, confidence: (body * around).sqrt() })
}

fn each_within(labels: &Labels, centre: DVec2, reach: f64, mut take: impl FnMut(DVec2, Class)) {
    let bound = |at: f64, limit: usize| at.clamp(0.0, limit as f64) as usize;
    for row in bound(centre.y - reach, labels.height)..bound(centre.y + reach + 1.0, labels.height) {
        for column in bound(centre.x - reach, labels.width)..bound(centre.x + reach + 1.0, labels.width) {
            let pixel = DVec2::new(column as f64, row as f64);
            if pixel.distance_squared(centre) <= reach * reach {
                take(pixel, labels.class(column, row));
            }
        }
    }
}

/// Sums of carpet over rectangles from the top left.
struct Sums {
    width: usize,
    height: usize,
    sums: Vec<u32>,
}

impl Sums {
    fn of(labels: &Labels) -> Self {
        let (width, height) = (labels.width, labels.height);
        let mut sums = vec![0_u32; (width + 1) * (height + 1)];
        for row in 0..height {
            let mut line = 0;
            for column in 0..width {
                line += u32::from(labels.class(column, row) == Class::Green);
                sums[(row + 1) * (width + 1) + column + 1] = sums[row * (width + 1) + column + 1] + line;
            }
        }
        Self { width, height, sums }
    }

    /// In the square around a point with this half edge.
    fn share_of_carpet(&self, centre: DVec2, half: f64) -> f64 {
        let bound = |at: f64, limit: usize| at.round().clamp(0.0, limit as f64) as usize;
        let (left, right) = (bound(centre.x - half, self.width), bound(centre.x + half + 1.0, self.width));
        let (top, bottom) = (bound(centre.y - half, self.height), bound(centre.y + half + 1.0, self.height));
        let at = |column: usize, row: usize| self.sums[row * (self.width + 1) + column];
        let pixels = (right - left) * (bottom - top);
        let sum = at(right, bottom) + at(left, top) - at(left, bottom) - at(right, top);
        f64::from(sum) / pixels.max(1) as f64
    }
}
