//! The engine: from a picture to what is seen.

use crate::colours::{Class, Colours, Table};
use crate::labels::Labels;
use crate::seen::{Exposure, Seen};
use crate::view::View;
use crate::{balls, markings, posts_and_robots};
use downbeat_football::Field;
use downbeat_pictures::Picture;

/// Finds what is on a field. The same picture gives the same result.
#[derive(Clone, Debug)]
pub struct Detector {
    field: Field,
    table: Table,
    labels: Labels,
}

impl Detector {
    /// A detector for this field and these colours.
    #[must_use]
    pub fn new(field: Field, colours: &Colours) -> Self {
        Self { field, table: Table::new(colours), labels: Labels::default() }
    }

    /// The field.
    #[must_use]
    pub fn field(&self) -> &Field {
        &self.field
    }

    /// Looks at a picture.
    pub fn see(&mut self, picture: &Picture<'_>, view: &View) -> Seen {
        self.labels.fill(picture, &self.table);
        let (labels, field) = (&self.labels, &self.field);
        let brightness =
            labels.luma.iter().map(|luma| u64::from(*luma)).sum::<u64>() / labels.luma.len() as u64;
        let has_carpet = labels.share(Class::Green) > 0.01;
        let exposure = match brightness {
            _ if has_carpet => Exposure::Good,
            0..16 => Exposure::Black,
            240.. => Exposure::White,
            _ => Exposure::NoCarpet,
        };
        let boundary = labels.boundary(view);
        if boundary.is_empty() {
            let exposure = if exposure == Exposure::Good { Exposure::NoCarpet } else { exposure };
            return Seen { exposure, ..Seen::default() };
        }
        let markings = markings::markings(labels, view, &boundary, field);
        let balls = balls::balls(labels, view, &boundary, &field.ball);
        let posts = posts_and_robots::posts(labels, view, &boundary, field);
        let robots = posts_and_robots::robots(labels, view, &boundary, field, &posts, &balls);
        let markings::Markings { lines, circle, intersections } = markings;
        Seen { boundary, lines, circle, intersections, balls, posts, robots, exposure }
    }
}
