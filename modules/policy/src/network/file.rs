//! What an ONNX file says, as Protobuf: <https://github.com/onnx/onnx/blob/main/onnx/onnx.proto>.

use std::collections::BTreeMap;

use super::tensor::{Data, Tensor};

/// A network as its file describes it.
#[derive(Debug, Default)]
pub(super) struct Graph {
    pub(super) nodes: Vec<Node>,
    pub(super) constants: BTreeMap<String, Tensor>,
    /// With their shapes, of which symbolic dimensions are `None`.
    pub(super) inputs: Vec<(String, Vec<Option<usize>>)>,
    pub(super) outputs: Vec<String>,
    /// The version of the operations.
    pub(super) opset: i64,
}

#[derive(Debug, Default)]
pub(super) struct Node {
    pub(super) operation: String,
    /// Of those that are not ONNX's own.
    pub(super) domain: String,
    pub(super) name: String,
    /// Those that are left out have empty names.
    pub(super) inputs: Vec<String>,
    pub(super) outputs: Vec<String>,
    pub(super) attributes: BTreeMap<String, Attribute>,
}

#[derive(Clone, Debug, Default)]
pub(super) struct Attribute {
    pub(super) float: f32,
    pub(super) int: i64,
    pub(super) text: String,
    pub(super) tensor: Option<Tensor>,
    pub(super) floats: Vec<f32>,
    pub(super) ints: Vec<i64>,
    pub(super) texts: Vec<String>,
}

/// The content of a field of Protobuf.
#[derive(Clone, Copy)]
enum Content<'a> {
    Number(u64),
    Fixed32([u8; 4]),
    Fixed64([u8; 8]),
    Bytes(&'a [u8]),
}

const CUT_OFF: &str = "it is cut off or damaged";

/// The fields of a message of Protobuf, one after another.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn next(&mut self) -> Result<Option<(u64, Content<'a>)>, String> {
        if self.0.is_empty() {
            return Ok(None);
        }
        let tag = self.number()?;
        let content = match tag & 7 {
            0 => Content::Number(self.number()?),
            1 => Content::Fixed64(self.array()?),
            2 => {
                let length = usize::try_from(self.number()?).map_err(|_| CUT_OFF)?;
                let (bytes, rest) = self.0.split_at_checked(length).ok_or(CUT_OFF)?;
                self.0 = rest;
                Content::Bytes(bytes)
            }
            5 => Content::Fixed32(self.array()?),
            _ => return Err("it is no ONNX file".to_owned()),
        };
        Ok(Some((tag >> 3, content)))
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (array, rest) = self.0.split_first_chunk().ok_or(CUT_OFF)?;
        self.0 = rest;
        Ok(*array)
    }

    fn number(&mut self) -> Result<u64, String> {
        let mut number = 0;
        for shift in (0..64).step_by(7) {
            let [byte] = self.array()?;
            number |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Ok(number);
            }
        }
        Err(CUT_OFF.to_owned())
    }
}

/// Calls `take` with each field of a message.
fn each<'a>(
    bytes: &'a [u8],
    mut take: impl FnMut(u64, Content<'a>) -> Result<(), String>,
) -> Result<(), String> {
    let mut fields = Fields(bytes);
    while let Some((number, content)) = fields.next()? {
        take(number, content)?;
    }
    Ok(())
}

impl<'a> Content<'a> {
    fn bytes(self) -> Result<&'a [u8], String> {
        match self {
            Self::Bytes(bytes) => Ok(bytes),
            _ => Err(CUT_OFF.to_owned()),
        }
    }

    fn text(self) -> Result<String, String> {
        Ok(String::from_utf8_lossy(self.bytes()?).into_owned())
    }

    fn int(self) -> Result<i64, String> {
        match self {
            Self::Number(number) => Ok(number as i64),
            _ => Err(CUT_OFF.to_owned()),
        }
    }

    /// Adds the integers of a list, packed or not.
    fn add_ints(self, list: &mut Vec<i64>) -> Result<(), String> {
        let Self::Bytes(bytes) = self else {
            list.push(self.int()?);
            return Ok(());
        };
        let mut fields = Fields(bytes);
        while !fields.0.is_empty() {
            list.push(fields.number()? as i64);
        }
        Ok(())
    }

    /// Adds the floats of a list, packed or not.
    fn add_floats(self, list: &mut Vec<f32>) -> Result<(), String> {
        match self {
            Self::Bytes(bytes) => list.extend(floats(bytes)?),
            Self::Fixed32(bytes) => list.push(f32::from_le_bytes(bytes)),
            _ => return Err(CUT_OFF.to_owned()),
        }
        Ok(())
    }

    /// Adds the doubles of a list, packed or not.
    fn add_doubles(self, list: &mut Vec<f32>) -> Result<(), String> {
        match self {
            Self::Bytes(bytes) => list.extend(doubles(bytes)?),
            Self::Fixed64(bytes) => list.push(f64::from_le_bytes(bytes) as f32),
            _ => return Err(CUT_OFF.to_owned()),
        }
        Ok(())
    }
}

fn elements<const N: usize>(bytes: &[u8]) -> Result<impl Iterator<Item = [u8; N]> + '_, String> {
    let (elements, rest) = bytes.as_chunks();
    if rest.is_empty() { Ok(elements.iter().copied()) } else { Err(CUT_OFF.to_owned()) }
}

fn floats(bytes: &[u8]) -> Result<Vec<f32>, String> {
    Ok(elements(bytes)?.map(f32::from_le_bytes).collect())
}

fn doubles(bytes: &[u8]) -> Result<Vec<f32>, String> {
    Ok(elements(bytes)?.map(|bytes| f64::from_le_bytes(bytes) as f32).collect())
}

/// Reads a file of ONNX.
pub(super) fn graph(bytes: &[u8]) -> Result<Graph, String> {
    let mut graph = None;
    let mut opset = None;
    each(bytes, |number, content| {
        match number {
            7 => graph = Some(read_graph(content.bytes()?)?),
            8 => {
                let (mut domain, mut version) = (String::new(), 0);
                each(content.bytes()?, |number, content| {
                    match number {
                        1 => domain = content.text()?,
                        2 => version = content.int()?,
                        _ => {}
                    }
                    Ok(())
                })?;
                if domain.is_empty() || domain == "ai.onnx" {
                    opset = Some(version);
                }
            }
            _ => {}
        }
        Ok(())
    })?;
    let (Some(mut graph), Some(opset)) = (graph, opset) else {
        return Err("it is no ONNX file: it lacks a graph or the version of its operations".to_owned());
    };
    graph.opset = opset;
    Ok(graph)
}

fn read_graph(bytes: &[u8]) -> Result<Graph, String> {
    let mut graph = Graph::default();
    let mut inputs = Vec::new();
    each(bytes, |number, content| {
        match number {
            1 => graph.nodes.push(read_node(content.bytes()?)?),
            5 => {
                let (name, tensor) = read_tensor(content.bytes()?)?;
                graph.constants.insert(name, tensor);
            }
            11 => inputs.push(read_port(content.bytes()?)?),
            12 => graph.outputs.push(read_port(content.bytes()?)?.0),
            15 => return Err("it has sparse tensors, which are not supported".to_owned()),
            _ => {}
        }
        Ok(())
    })?;
    // Older files list their constants as inputs, too.
    inputs.retain(|(name, _)| !graph.constants.contains_key(name));
    graph.inputs = inputs;
    Ok(graph)
}

fn read_node(bytes: &[u8]) -> Result<Node, String> {
    let mut node = Node::default();
    each(bytes, |number, content| {
        match number {
            1 => node.inputs.push(content.text()?),
            2 => node.outputs.push(content.text()?),
            3 => node.name = content.text()?,
            4 => node.operation = content.text()?,
            5 => {
                let (name, attribute) = read_attribute(content.bytes()?)?;
                node.attributes.insert(name, attribute);
            }
            7 => node.domain = content.text()?,
            _ => {}
        }
        Ok(())
    })?;
    Ok(node)
}

fn read_attribute(bytes: &[u8]) -> Result<(String, Attribute), String> {
    let mut name = String::new();
    let mut attribute = Attribute::default();
    each(bytes, |number, content| {
        match (number, content) {
            (1, _) => name = content.text()?,
            (2, Content::Fixed32(bytes)) => attribute.float = f32::from_le_bytes(bytes),
            (3, _) => attribute.int = content.int()?,
            (4, _) => attribute.text = content.text()?,
            (5, _) => attribute.tensor = Some(read_tensor(content.bytes()?)?.1),
            (7, _) => content.add_floats(&mut attribute.floats)?,
            (8, _) => content.add_ints(&mut attribute.ints)?,
            (9, _) => attribute.texts.push(content.text()?),
            _ => {}
        }
        Ok(())
    })?;
    Ok((name, attribute))
}

fn read_port(bytes: &[u8]) -> Result<(String, Vec<Option<usize>>), String> {
    let mut name = String::new();
    let mut shape = Vec::new();
    each(bytes, |number, content| match number {
        1 => {
            name = content.text()?;
            Ok(())
        }
        // type, tensor_type, shape, dim
        2 => each(content.bytes()?, |number, content| match number {
            1 => each(content.bytes()?, |number, content| match number {
                2 => each(content.bytes()?, |_, content| {
                    shape.push(read_dimension(content.bytes()?)?);
                    Ok(())
                }),
                _ => Ok(()),
            }),
            _ => Ok(()),
        }),
        _ => Ok(()),
    })?;
    Ok((name, shape))
}

/// A dimension, `None` if it is symbolic.
fn read_dimension(bytes: &[u8]) -> Result<Option<usize>, String> {
    let mut dimension = None;
    each(bytes, |number, content| {
        if number == 1 {
            dimension = usize::try_from(content.int()?).ok().filter(|dimension| *dimension > 0);
        }
        Ok(())
    })?;
    Ok(dimension)
}

fn read_tensor(bytes: &[u8]) -> Result<(String, Tensor), String> {
    let mut name = String::new();
    let (mut shape, mut kind, mut raw, mut is_elsewhere) = (Vec::new(), 0, None, false);
    let (mut float_list, mut int_list) = (Vec::new(), Vec::new());
    each(bytes, |number, content| {
        match number {
            1 => content.add_ints(&mut shape)?,
            2 => kind = content.int()?,
            4 => content.add_floats(&mut float_list)?,
            5 | 7 => content.add_ints(&mut int_list)?,
            8 => name = content.text()?,
            9 => raw = Some(content.bytes()?),
            10 => content.add_doubles(&mut float_list)?,
            14 => is_elsewhere = content.int()? == 1,
            _ => {}
        }
        Ok(())
    })?;
    if is_elsewhere {
        return Err(format!("\"{name}\" is in another file; save the network with its weights in one file"));
    }
    let shape = shape.iter().map(|dimension| usize::try_from(*dimension).ok()).collect::<Option<Vec<_>>>();
    let shape = shape.ok_or(CUT_OFF)?;
    // The numbers of TensorProto.DataType.
    let data = match (kind, raw) {
        (1, Some(raw)) => Data::Floats(floats(raw)?),
        (11, Some(raw)) => Data::Floats(doubles(raw)?),
        (1 | 11, None) => Data::Floats(float_list),
        (6, Some(raw)) => {
            Data::Ints(elements(raw)?.map(|bytes| i64::from(i32::from_le_bytes(bytes))).collect())
        }
        (7, Some(raw)) => Data::Ints(elements(raw)?.map(i64::from_le_bytes).collect()),
        (9, Some(raw)) => Data::Ints(raw.iter().map(|byte| i64::from(*byte)).collect()),
        (6 | 7 | 9, None) => Data::Ints(int_list),
        _ => {
            return Err(format!(
                "\"{name}\" has elements of type {kind}; float, double, int32, int64 and bool are possible"
            ));
        }
    };
    let tensor = Tensor::new(shape, data).map_err(|problem| format!("\"{name}\": {problem}"))?;
    Ok((name, tensor))
}
