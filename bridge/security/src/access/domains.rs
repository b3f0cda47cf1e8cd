//! Sets of domains, which governance and permissions write alike.

use std::ops::RangeInclusive;

use crate::document::{DocumentError, Element, Problem};

/// The domains to which a rule applies.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Domains(Vec<RangeInclusive<u32>>);

impl Domains {
    /// Whether the domain is one of them.
    pub fn contains(&self, domain_id: u32) -> bool {
        self.0.iter().any(|range| range.contains(&domain_id))
    }

    pub(super) fn read(element: Element) -> Result<Self, DocumentError> {
        let children = element.children(&["id", "id_range"])?;
        children.some("id")?.iter().map(|child| range(*child)).collect::<Result<_, _>>().map(Self)
    }
}

/// An open end of a range has no limit.
fn range(element: Element) -> Result<RangeInclusive<u32>, DocumentError> {
    if element.name() == "id" {
        return number(element).map(|id| id..=id);
    }
    let limits = element.children(&["min", "max"])?;
    limits.some("min")?;
    let min = limits.optional("min")?.map_or(Ok(0), number)?;
    let max = limits.optional("max")?.map_or(Ok(u32::MAX), number)?;
    if max < min {
        return Err(element.error(Problem::EmptyRange(min, max)));
    }
    Ok(min..=max)
}

fn number(element: Element) -> Result<u32, DocumentError> {
    element.value("a domain id, for example 0", |text| text.parse().ok())
}
