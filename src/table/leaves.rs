//! What of a message has a column.

use std::fmt::Write as _;

use downbeat_msgs::dynamic::{Array, MessageRef, ValueRef};

/// How many elements of an array have a column each.
pub const MOST_ELEMENTS: usize = 1000;

/// Where a leaf is: the number of the field, of the element, of the field in that, and so on.
pub(super) type Place = Vec<usize>;

/// A leaf: a scalar, or an array that is not taken apart.
pub(super) trait Visit {
    fn leaf(&mut self, place: &[usize], path: &str, value: ValueRef<'_>);

    /// Whether the array there has one column.
    fn is_whole(&mut self, place: &[usize], array: &Array) -> bool;
}

/// Shows all leaves of a message, in the order of its fields.
pub(super) fn visit(message: MessageRef<'_>, visitor: &mut impl Visit) {
    Walk { place: Vec::new(), path: String::new(), visitor }.message(message);
}

struct Walk<'a, V> {
    place: Place,
    path: String,
    visitor: &'a mut V,
}

impl<V: Visit> Walk<'_, V> {
    fn message(&mut self, message: MessageRef<'_>) {
        let parent = self.path.len();
        for (index, (name, value)) in message.fields().enumerate() {
            if parent > 0 {
                self.path.push('.');
            }
            self.path.push_str(name);
            self.place.push(index);
            self.value(value);
            self.place.pop();
            self.path.truncate(parent);
        }
    }

    fn value(&mut self, value: ValueRef<'_>) {
        match value {
            ValueRef::Message(message) => self.message(message),
            ValueRef::Array(array) if !self.visitor.is_whole(&self.place, array) => {
                let parent = self.path.len();
                for (index, element) in array.iter().enumerate() {
                    // Writing to a string does not fail.
                    let _ = write!(self.path, "[{index}]");
                    self.place.push(index);
                    self.value(element);
                    self.place.pop();
                    self.path.truncate(parent);
                }
            }
            value => self.visitor.leaf(&self.place, &self.path, value),
        }
    }
}
