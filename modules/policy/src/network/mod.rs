//! Neural networks in ONNX files.

mod file;
mod operations;
mod tensor;

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;

use file::{Graph, Node};
use operations::{Described, Inputs, Operation};
use tensor::Tensor;

/// Why a network is not used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {problem}")]
pub struct NetworkError {
    /// The file.
    pub file: String,
    /// What is wrong, and what to do.
    pub problem: String,
}

/// The largest file, in bytes.
const LARGEST: u64 = 1 << 28;

/// An input or an output of a [`Network`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// The name in the file.
    pub name: String,
    /// The size of each dimension. One that the file leaves open is 1.
    pub shape: Vec<usize>,
}

impl Port {
    /// How many numbers it takes or gives.
    #[must_use]
    pub fn count(&self) -> usize {
        self.shape.iter().product()
    }
}

/// Its name and shape: `obs (1 x 12)`.
impl fmt::Display for Port {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.name, tensor::text(&self.shape))
    }
}

/// A neural network of an ONNX file. It computes the same bits on every machine.
///
/// The operations that it may have are those of perceptrons, convolutions, GRU and LSTM as PyTorch, JAX and
/// Stable-Baselines3 export them, in 32 bits (docs/policies.md lists them).
pub struct Network {
    inputs: Vec<Port>,
    outputs: Vec<Port>,
    /// Where each output is.
    places: Vec<usize>,
    steps: Vec<Step>,
    /// Constants, then inputs, then what steps compute.
    values: Vec<Option<Tensor>>,
    /// The place of the first input.
    first_input: usize,
}

struct Step {
    name: String,
    operation: Operation,
    inputs: Vec<Option<usize>>,
    outputs: Vec<Option<usize>>,
}

impl Network {
    /// Reads a file.
    ///
    /// # Errors
    /// [`NetworkError`] if it cannot be read, is damaged, or has operations or types that are not known.
    pub fn read(path: &Path) -> Result<Self, NetworkError> {
        let refused = |problem: String| NetworkError { file: path.display().to_string(), problem };
        let size = std::fs::metadata(path).map_err(|error| refused(error.to_string()))?.len();
        if size > LARGEST {
            return Err(refused(format!("it has {} MB; at most {} are possible", size >> 20, LARGEST >> 20)));
        }
        let bytes = std::fs::read(path).map_err(|error| refused(error.to_string()))?;
        Self::parse(&bytes, &path.display().to_string())
    }

    /// Takes a network from the bytes of a file; `file` names it in errors.
    ///
    /// # Errors
    /// As of [`read`](Self::read).
    pub fn parse(bytes: &[u8], file: &str) -> Result<Self, NetworkError> {
        let refused = |problem| NetworkError { file: file.to_owned(), problem };
        Self::of(file::graph(bytes).map_err(refused)?).map_err(refused)
    }

    fn of(graph: Graph) -> Result<Self, String> {
        let Graph { nodes, constants, inputs, outputs: names, opset } = graph;
        let inputs: Vec<Port> = inputs
            .into_iter()
            .map(|(name, shape)| Port { name, shape: shape.iter().map(|size| size.unwrap_or(1)).collect() })
            .collect();
        let mut values = Vec::new();
        let mut places: BTreeMap<String, usize> = BTreeMap::new();
        for (name, tensor) in constants {
            places.insert(name, values.len());
            values.push(Some(tensor));
        }
        let first_input = values.len();
        for port in &inputs {
            tensor::count(&port.shape)?;
            places.insert(port.name.clone(), values.len());
            values.push(None);
        }
        let mut steps = Vec::new();
        for node in &nodes {
            let step = add(node, opset, &mut places, &mut values)?;
            steps.extend(step);
        }
        let place = |name: &String| {
            places.get(name).copied().ok_or_else(|| format!("nothing computes its output \"{name}\""))
        };
        let places = names.iter().map(place).collect::<Result<Vec<_>, _>>()?;
        let mut network = Self { inputs, outputs: Vec::new(), places, steps, values, first_input };
        // Shapes are found by running it once.
        let zeros: Vec<Vec<f32>> = network.inputs.iter().map(|port| vec![0.0; port.count()]).collect();
        network.compute(&zeros.iter().map(Vec::as_slice).collect::<Vec<_>>())?;
        let outputs = names.into_iter().zip(&network.places).map(|(name, place)| {
            let shape = network.values[*place].as_ref().map_or_else(Vec::new, |tensor| tensor.shape.clone());
            Port { name, shape }
        });
        network.outputs = outputs.collect();
        Ok(network)
    }

    /// What it takes, in the order of the file.
    #[must_use]
    pub fn inputs(&self) -> &[Port] {
        &self.inputs
    }

    /// What it gives, in the order of the file.
    #[must_use]
    pub fn outputs(&self) -> &[Port] {
        &self.outputs
    }

    /// Computes the outputs of these inputs, each in the order in which the last index changes first.
    ///
    /// # Errors
    /// If the numbers of inputs do not fit the network, or a shape that depends on them is impossible.
    pub fn run(&mut self, inputs: &[&[f32]]) -> Result<Vec<Vec<f32>>, String> {
        if inputs.len() != self.inputs.len() {
            return Err(format!("it takes {} inputs, and is given {}", self.inputs.len(), inputs.len()));
        }
        if let Some((port, given)) =
            self.inputs.iter().zip(inputs).find(|(port, given)| port.count() != given.len())
        {
            return Err(format!(
                "its input {port} takes {} numbers, and is given {}",
                port.count(),
                given.len()
            ));
        }
        self.compute(inputs)?;
        let output = |place: &usize| match self.values[*place].as_ref().map(|tensor| &tensor.data) {
            Some(tensor::Data::Floats(floats)) => floats.clone(),
            Some(tensor::Data::Ints(ints)) => ints.iter().map(|int| *int as f32).collect(),
            None => Vec::new(),
        };
        Ok(self.places.iter().map(output).collect())
    }

    fn compute(&mut self, inputs: &[&[f32]]) -> Result<(), String> {
        for (place, (port, given)) in self.inputs.iter().zip(inputs).enumerate() {
            let tensor = Tensor::floats_of(port.shape.clone(), given.to_vec())?;
            self.values[self.first_input + place] = Some(tensor);
        }
        for step in &self.steps {
            let given = step.inputs.iter().map(|place| place.and_then(|place| self.values[place].as_ref()));
            let found = (step.operation)(&Inputs(given.collect()));
            let found = found.map_err(|problem| format!("{} {problem}", step.name))?;
            for (place, tensor) in step.outputs.iter().zip(found) {
                if let Some(place) = place {
                    self.values[*place] = Some(tensor);
                }
            }
        }
        Ok(())
    }
}

/// Its inputs and outputs.
impl fmt::Debug for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Network")
            .field("inputs", &self.inputs)
            .field("outputs", &self.outputs)
            .finish_non_exhaustive()
    }
}

/// The step of a node, unless it depends on constants only, and is one itself.
fn add(
    node: &Node,
    opset: i64,
    places: &mut BTreeMap<String, usize>,
    values: &mut Vec<Option<Tensor>>,
) -> Result<Option<Step>, String> {
    let name = match node.name.as_str() {
        "" => node.operation.clone(),
        name => format!("{} \"{name}\"", node.operation),
    };
    let place = |input: &String| match places.get(input) {
        _ if input.is_empty() => Ok(None),
        Some(place) => Ok(Some(*place)),
        None => Err(format!("{name} takes \"{input}\", which nothing before it computes")),
    };
    let inputs = node.inputs.iter().map(place).collect::<Result<Vec<_>, _>>()?;
    let known: Vec<_> = inputs.iter().map(|place| place.and_then(|place| values[place].as_ref())).collect();
    let described = Described { node, opset, constants: known.clone() };
    let operation = operations::operation(&described).map_err(|problem| format!("{name} {problem}"))?;
    let operation = operation.ok_or_else(|| {
        format!("{name} is an operation that is not supported; docs/policies.md lists those that are")
    })?;
    // A constant if all is known that it takes.
    let is_constant = inputs.iter().zip(&known).all(|(place, known)| place.is_none() || known.is_some());
    let found = is_constant.then(|| operation(&Inputs(known))).transpose();
    let found = found.map_err(|problem| format!("{name} {problem}"))?;
    let mut outputs = Vec::new();
    for output in &node.outputs {
        outputs.push((!output.is_empty()).then_some(values.len()));
        if !output.is_empty() {
            places.insert(output.clone(), values.len());
            values.push(None);
        }
    }
    let Some(found) = found else { return Ok(Some(Step { name, operation, inputs, outputs })) };
    for (place, tensor) in outputs.into_iter().zip(found) {
        if let Some(place) = place {
            values[place] = Some(tensor);
        }
    }
    Ok(None)
}
