//! Networks with memory: GRU and LSTM, forwards.

use super::super::tensor::{Tensor, text};
use super::elementwise::sigmoid;
use super::products::{add_product, rows};
use super::{Described, Inputs, Operation};

pub(super) fn operation(of: &Described<'_>) -> Result<Option<Operation>, String> {
    let gates = match of.node.operation.as_str() {
        "GRU" => 3,
        "LSTM" => 4,
        _ => return Ok(None),
    };
    if !matches!(of.text("direction"), "" | "forward") {
        return Err(format!("runs {}; only forward is supported", of.text("direction")));
    }
    of.only("layout", 0)?;
    if let Some(name) = ["activations", "clip"].iter().find(|name| of.attribute(name).is_some()) {
        return Err(format!("has {name} of its own, which is not supported"));
    }
    if gates == 3 && of.int("linear_before_reset", 0) == 0 {
        return Err("has linear_before_reset = 0, and only 1, that of PyTorch, is supported".to_owned());
    }
    let [weights, recurrence] = [1, 2].map(|place| {
        let constant = of.constant(place).ok_or("has weights that are no constants")?;
        Weights::new(constant, gates)
    });
    let (weights, recurrence) = (weights?, recurrence?);
    if recurrence.inputs * gates != weights.outputs || weights.outputs != recurrence.outputs {
        return Err("has weights of sizes that do not fit".to_owned());
    }
    Ok(Some(Box::new(move |inputs| run(inputs, &weights, &recurrence, gates))))
}

/// A matrix that takes a row of inputs to all gates.
struct Weights {
    inputs: usize,
    outputs: usize,
    /// A line for each input.
    matrix: Vec<f32>,
}

impl Weights {
    /// Of the shape 1 x outputs x inputs.
    fn new(weights: &Tensor, gates: usize) -> Result<Self, String> {
        let &[1, outputs, inputs] = &weights.shape[..] else {
            return Err(format!("has weights of {}", text(&weights.shape)));
        };
        if outputs == 0 || outputs % gates != 0 || inputs == 0 {
            return Err(format!("has weights of {}", text(&weights.shape)));
        }
        let turned = super::layout::transposed(&weights.with_shape(vec![outputs, inputs])?, None)?;
        Ok(Self { inputs, outputs, matrix: turned.floats()?.to_vec() })
    }
}

/// Steps × batch × width, in which the batch is 1; and the state, 1 × 1 × size.
fn run(
    inputs: &Inputs<'_>,
    weights: &Weights,
    recurrence: &Weights,
    gates: usize,
) -> Result<Vec<Tensor>, String> {
    let size = recurrence.inputs;
    if let Some(&[_, batch, _]) = inputs.optional(0).map(|input| &input.shape[..])
        && batch != 1
    {
        return Err(format!("runs {batch} at once; only 1 is supported"));
    }
    let sequence = rows(inputs, 0, weights.inputs)?;
    let start = |place: usize| match inputs.optional(place) {
        Some(state) if state.len() == size => Ok(state.floats()?.to_vec()),
        Some(state) => Err(format!("has a state of {} where {size} numbers are", text(&state.shape))),
        None => Ok(vec![0.0; size]),
    };
    let (mut state, mut cell) = (start(5)?, if gates == 4 { start(6)? } else { Vec::new() });
    let zeros = vec![0.0; 2 * gates * size];
    let biases = match inputs.optional(3) {
        Some(biases) if biases.len() == zeros.len() => biases.floats()?,
        Some(biases) => return Err(format!("has biases of {}", text(&biases.shape))),
        None => &zeros,
    };
    let (of_input, of_state) = biases.split_at(gates * size);
    let mut all = Vec::with_capacity(sequence.len() / weights.inputs * size);
    for row in sequence.chunks(weights.inputs) {
        let (mut from_input, mut from_state) = (of_input.to_vec(), of_state.to_vec());
        add_product(row, &weights.matrix, &mut from_input);
        add_product(&state, &recurrence.matrix, &mut from_state);
        for place in 0..size {
            let gate = |number: usize| (from_input[number * size + place], from_state[number * size + place]);
            let sum = |number: usize| {
                let (input, state) = gate(number);
                input + state
            };
            if gates == 4 {
                // Input, output, forget, cell.
                let [input, output, forget] = [0, 1, 2].map(|number| sigmoid(sum(number)));
                cell[place] = forget * cell[place] + input * libm::tanhf(sum(3));
                state[place] = output * libm::tanhf(cell[place]);
            } else {
                // Update, reset, hidden.
                let [update, reset] = [0, 1].map(|number| sigmoid(sum(number)));
                let (input, hidden) = gate(2);
                let new = libm::tanhf(input + reset * hidden);
                state[place] = (1.0 - update) * new + update * state[place];
            }
        }
        all.extend_from_slice(&state);
    }
    let steps = all.len() / size;
    let mut found =
        vec![Tensor::floats_of(vec![steps, 1, 1, size], all)?, Tensor::floats_of(vec![1, 1, size], state)?];
    if gates == 4 {
        found.push(Tensor::floats_of(vec![1, 1, size], cell)?);
    }
    Ok(found)
}
