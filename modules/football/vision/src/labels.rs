//! The class and the brightness of each pixel, and what is found directly in them: connected regions and the
//! boundary of the field.

use crate::colours::{Class, Table};
use crate::view::View;
use downbeat_pictures::Picture;
use glam::DVec2;

/// Classes and brightness, row by row.
#[derive(Clone, Debug, Default)]
pub(crate) struct Labels {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) classes: Vec<Class>,
    pub(crate) luma: Vec<u8>,
}

/// A connected region of one class. Bounds are inclusive.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Region {
    pub(crate) left: usize,
    pub(crate) right: usize,
    pub(crate) top: usize,
    pub(crate) bottom: usize,
    pub(crate) count: usize,
}

/// At most so many regions are looked at: a picture of noise has thousands.
const MOST_REGIONS: usize = 4096;

impl Labels {
    pub(crate) fn fill(&mut self, picture: &Picture<'_>, table: &Table) {
        (self.width, self.height) = (picture.width(), picture.height());
        let pixels = self.width * self.height;
        self.classes.resize(pixels, Class::Other);
        self.luma.resize(pixels, 0);
        let (classes, luma) = (&mut self.classes[..pixels], &mut self.luma[..pixels]);
        picture.each_pixel(|index, rgb| {
            classes[index] = table.class_of(rgb);
            let [r, g, b] = rgb.map(u32::from);
            luma[index] = ((77 * r + 150 * g + 29 * b) >> 8) as u8;
        });
    }

    #[inline]
    pub(crate) fn class(&self, column: usize, row: usize) -> Class {
        self.classes[row * self.width + column]
    }

    /// How many times larger than 320 x 240 the picture is.
    pub(crate) fn scale(&self) -> f64 {
        self.height as f64 / 240.0
    }

    /// The share of a class among all pixels.
    pub(crate) fn share(&self, class: Class) -> f64 {
        self.classes.iter().filter(|one| **one == class).count() as f64 / self.classes.len().max(1) as f64
    }

    /// The share of pixels in a rectangle for which a claim holds; `None` if nothing of it is in the picture.
    pub(crate) fn share_in(&self, from: DVec2, to: DVec2, claim: impl Fn(Class) -> bool) -> Option<f64> {
        let bound = |at: f64, limit: usize| at.round().clamp(0.0, limit as f64) as usize;
        let (left, right) = (bound(from.x, self.width), bound(to.x + 1.0, self.width));
        let (top, bottom) = (bound(from.y, self.height), bound(to.y + 1.0, self.height));
        let (mut all, mut held) = (0_u32, 0_u32);
        for row in top..bottom {
            for column in left..right {
                all += 1;
                held += u32::from(claim(self.class(column, row)));
            }
        }
        (all > 0).then(|| f64::from(held) / f64::from(all))
    }

    /// The connected regions of a class, from top to bottom; runs one pixel apart are connected.
    pub(crate) fn regions(&self, class: Class) -> Vec<Region> {
        let mut regions: Vec<Region> = Vec::new();
        let mut parents: Vec<usize> = Vec::new();
        let mut above: Vec<(usize, usize, usize)> = Vec::new();
        let mut runs: Vec<(usize, usize, usize)> = Vec::new();
        for (row, classes) in self.classes.chunks_exact(self.width).enumerate() {
            let mut column = 0;
            let mut next_above = 0;
            while column < self.width {
                if classes[column] != class {
                    column += 1;
                    continue;
                }
                let left = column;
                let mut right = column;
                while column < self.width && column <= right + 2 {
                    if classes[column] == class {
                        right = column;
                    }
                    column += 1;
                }
                let mut own = None;
                while let Some(&(_, end, _)) = above.get(next_above).filter(|(_, end, _)| end + 1 < left) {
                    debug_assert!(end < left);
                    next_above += 1;
                }
                for &(start, _, number) in
                    above[next_above..].iter().take_while(|(start, ..)| *start <= right + 1)
                {
                    debug_assert!(start <= right + 1);
                    let root = root_of(&mut parents, number);
                    match own {
                        None => own = Some(root),
                        Some(own) if own != root => {
                            let joined = regions[root];
                            parents[root] = own;
                            regions[own].join(&joined);
                            regions[root].count = 0;
                        }
                        Some(_) => {}
                    }
                }
                let run = Region { left, right, top: row, bottom: row, count: right - left + 1 };
                let number = match own {
                    Some(own) => {
                        regions[own].join(&run);
                        own
                    }
                    None if regions.len() < MOST_REGIONS => {
                        regions.push(run);
                        parents.push(regions.len() - 1);
                        regions.len() - 1
                    }
                    None => continue,
                };
                runs.push((left, right, number));
            }
            std::mem::swap(&mut above, &mut runs);
            runs.clear();
        }
        regions.retain(|region| region.count > 0);
        regions
    }

    /// The boundary of the field: the upper hull of green, as points from the left to the right; empty
    /// without carpet.
    pub(crate) fn boundary(&self, view: &View) -> Vec<DVec2> {
        let step = (self.width / 80).max(1);
        let window = ((8.0 * self.scale()) as usize).clamp(4, self.height / 2);
        let mut tops = Vec::new();
        for column in (step / 2..self.width).step_by(step) {
            let first = view.horizon(column as f64).clamp(0.0, self.height as f64) as usize;
            // How much of the window below a row is carpet.
            let is_green = |row: usize| usize::from(self.class(column, row) == Class::Green);
            if first + window > self.height {
                continue;
            }
            let mut count: usize = (first..first + window).map(is_green).sum();
            for row in first..self.height - window {
                if count * 4 >= window * 3 && is_green(row) == 1 {
                    tops.push(DVec2::new(column as f64, row as f64));
                    break;
                }
                count = count + is_green(row + window) - is_green(row);
            }
        }
        if tops.len() * 8 < self.width / step {
            return Vec::new();
        }
        let mut hull: Vec<DVec2> = Vec::new();
        for top in tops {
            while let [.., before, last] = hull[..] {
                // Rows grow downwards: the middle point stays if it is above the line between its neighbours.
                if (last - before).perp_dot(top - before) > 0.0 {
                    break;
                }
                hull.pop();
            }
            hull.push(top);
        }
        hull
    }
}

impl Region {
    fn join(&mut self, other: &Self) {
        self.left = self.left.min(other.left);
        self.right = self.right.max(other.right);
        self.top = self.top.min(other.top);
        self.bottom = self.bottom.max(other.bottom);
        self.count += other.count;
    }

    pub(crate) fn width(&self) -> f64 {
        (self.right - self.left + 1) as f64
    }

    pub(crate) fn height(&self) -> f64 {
        (self.bottom - self.top + 1) as f64
    }

    pub(crate) fn centre(&self) -> DVec2 {
        DVec2::new((self.left + self.right) as f64, (self.top + self.bottom) as f64) / 2.0
    }
}

fn root_of(parents: &mut [usize], of: usize) -> usize {
    let mut root = of;
    while parents[root] != root {
        parents[root] = parents[parents[root]];
        root = parents[root];
    }
    root
}

/// The row of the boundary in a column; below the picture without one.
pub(crate) fn boundary_at(boundary: &[DVec2], column: f64) -> f64 {
    let after = boundary.partition_point(|point| point.x < column);
    match (after.checked_sub(1).and_then(|before| boundary.get(before)), boundary.get(after)) {
        (Some(before), Some(after)) => {
            before.y + (after.y - before.y) * (column - before.x) / (after.x - before.x).max(1e-9)
        }
        (Some(end), None) | (None, Some(end)) => end.y,
        (None, None) => f64::INFINITY,
    }
}
