//! The operations of ONNX that networks of policies consist of:
//! <https://github.com/onnx/onnx/blob/main/docs/Operators.md>.
//!
//! They use additions, multiplications, divisions, square roots and `libm` only, in an order that the network
//! alone decides, so they compute the same bits on every machine.

mod elementwise;
mod layout;
mod products;
mod recurrent;
mod reductions;

use super::file::{Attribute, Node};
use super::tensor::Tensor;

/// Computes the outputs of a node from its inputs.
pub(super) type Operation = Box<dyn Fn(&Inputs<'_>) -> Result<Vec<Tensor>, String> + Send>;

/// The inputs of a node; those that are left out are `None`.
pub(super) struct Inputs<'a>(pub(super) Vec<Option<&'a Tensor>>);

impl<'a> Inputs<'a> {
    pub(super) fn optional(&self, place: usize) -> Option<&'a Tensor> {
        self.0.get(place).copied().flatten()
    }

    fn get(&self, place: usize) -> Result<&'a Tensor, String> {
        self.optional(place).ok_or_else(|| format!("lacks its input {place}"))
    }

    fn all(&self) -> impl Iterator<Item = &'a Tensor> {
        self.0.iter().flatten().copied()
    }
}

/// A node with the version of its operation and what is known of its inputs before it runs.
pub(super) struct Described<'a> {
    pub(super) node: &'a Node,
    pub(super) opset: i64,
    pub(super) constants: Vec<Option<&'a Tensor>>,
}

impl Described<'_> {
    fn attribute(&self, name: &str) -> Option<&Attribute> {
        self.node.attributes.get(name)
    }

    fn int(&self, name: &str, default: i64) -> i64 {
        self.attribute(name).map_or(default, |attribute| attribute.int)
    }

    fn float(&self, name: &str, default: f32) -> f32 {
        self.attribute(name).map_or(default, |attribute| attribute.float)
    }

    fn ints(&self, name: &str) -> Option<Vec<i64>> {
        self.attribute(name).map(|attribute| attribute.ints.clone())
    }

    fn text(&self, name: &str) -> &str {
        self.attribute(name).map_or("", |attribute| &attribute.text)
    }

    fn constant(&self, place: usize) -> Option<&Tensor> {
        self.constants.get(place).copied().flatten()
    }

    /// Refuses an attribute whose value is another one than this.
    fn only(&self, name: &str, value: i64) -> Result<(), String> {
        match self.int(name, value) {
            found if found == value => Ok(()),
            found => Err(format!("has {name} = {found}, and only {value} is supported")),
        }
    }
}

/// What computes a node. `None` for an operation that is not known.
pub(super) fn operation(of: &Described<'_>) -> Result<Option<Operation>, String> {
    if !matches!(of.node.domain.as_str(), "" | "ai.onnx") {
        return Ok(None);
    }
    for family in [
        elementwise::operation,
        layout::operation,
        products::operation,
        recurrent::operation,
        reductions::operation,
    ] {
        if let Some(operation) = family(of)? {
            return Ok(Some(operation));
        }
    }
    Ok(None)
}

/// The operation that makes one tensor of one.
fn map(compute: impl Fn(&Tensor) -> Result<Tensor, String> + Send + 'static) -> Operation {
    Box::new(move |inputs| Ok(vec![compute(inputs.get(0)?)?]))
}
