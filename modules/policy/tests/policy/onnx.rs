//! Small networks in ONNX files, written by hand.

fn varint(mut number: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    while number >= 0x80 {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
    bytes
}

/// A field of Protobuf.
fn field(number: u8, content: &[u8]) -> Vec<u8> {
    [&[number << 3 | 2], &varint(content.len())[..], content].concat()
}

/// An input or output with these sizes.
fn port(name: &str, shape: &[usize]) -> Vec<u8> {
    let sizes: Vec<u8> =
        shape.iter().flat_map(|size| field(1, &[&[8], &varint(*size)[..]].concat())).collect();
    let tensor = [&[8, 1][..], &field(2, &sizes)].concat();
    [field(1, name.as_bytes()), field(2, &field(1, &tensor))].concat()
}

fn file(graph: &[Vec<u8>]) -> Vec<u8> {
    [field(7, &graph.concat()), field(8, &[0x10, 18])].concat()
}

fn node(operation: &str, inputs: &[&str], output: &str) -> Vec<u8> {
    let inputs = inputs.iter().map(|input| (1, *input));
    let texts = inputs.chain([(2, output), (3, "second"), (4, operation)]);
    field(1, &texts.flat_map(|(number, text)| field(number, text.as_bytes())).collect::<Vec<_>>())
}

fn constant(name: &str, shape: &[usize], numbers: impl Iterator<Item = f32>) -> Vec<u8> {
    let raw: Vec<u8> = numbers.flat_map(f32::to_le_bytes).collect();
    let shape: Vec<u8> = shape.iter().flat_map(|size| varint(*size)).collect();
    field(5, &[field(1, &shape), vec![0x10, 1], field(8, name.as_bytes()), field(9, &raw)].concat())
}

/// A network of one node that takes one number.
pub fn of_one(operation: &str) -> Vec<u8> {
    file(&[node(operation, &["x"], "y"), field(11, &port("x", &[1])), field(12, &port("y", &[1]))])
}

/// The product of `obs` with a matrix, whose lines are those of the inputs: `action`.
pub fn linear<const N: usize>(matrix: &[[f32; N]]) -> Vec<u8> {
    file(&[
        node("MatMul", &["obs", "w"], "action"),
        constant("w", &[matrix.len(), N], matrix.iter().flatten().copied()),
        field(11, &port("obs", &[1, matrix.len()])),
        field(12, &port("action", &[1, N])),
    ])
}

/// A perceptron with an activation behind each layer but the last; `number` gives weights and biases.
pub fn perceptron(sizes: &[usize], activation: &str, mut number: impl FnMut() -> f32) -> Vec<u8> {
    let mut graph = Vec::new();
    let (mut last, layers) = ("obs".to_owned(), sizes.len() - 1);
    for (layer, pair) in sizes.windows(2).enumerate() {
        let names = ["w", "b", "z", "a"].map(|letter| format!("{letter}{layer}"));
        let [w, b, z, a] = names.each_ref().map(String::as_str);
        let target = if layer + 1 == layers { "action" } else { z };
        graph.push(constant(w, pair, std::iter::repeat_with(&mut number).take(pair[0] * pair[1])));
        graph.push(constant(b, &pair[1..], std::iter::repeat_with(&mut number).take(pair[1])));
        graph.push(node("Gemm", &[&last, w, b], target));
        graph.push(node(activation, &[target], a));
        last = a.to_owned();
    }
    graph.push(field(11, &port("obs", &[1, sizes[0]])));
    graph.push(field(12, &port("action", &[1, sizes[layers]])));
    file(&graph)
}
