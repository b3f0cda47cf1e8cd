//! What a network computes, compared with onnxruntime; what is refused; and damaged files.

use base64::{Engine, engine::general_purpose::STANDARD};
use downbeat_policy::Network;
use fuzzing::Random;
use python_peer::{Python, printed};
use serde::Deserialize;
use std::collections::BTreeMap;

use crate::onnx::{of_one, perceptron};

/// A network of `networks.py`, and what onnxruntime computes with it.
#[derive(Deserialize)]
struct Case {
    name: String,
    file: String,
    inputs: BTreeMap<String, Vec<f32>>,
    outputs: Vec<Output>,
}

#[derive(Deserialize)]
struct Output {
    shape: Vec<usize>,
    /// `None` for what is not a number.
    data: Vec<Option<f32>>,
}

impl Case {
    fn network(&self) -> Network {
        Network::parse(&self.bytes(), &self.name).unwrap_or_else(|error| panic!("{error}"))
    }

    fn bytes(&self) -> Vec<u8> {
        STANDARD.decode(&self.file).unwrap()
    }
}

/// Those of `networks.py`; `None` without Python.
fn cases() -> Option<Vec<Case>> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/policy/networks.py");
    Some(serde_json::from_str(&printed(&mut Python::find()?.command(script))).unwrap())
}

#[test]
fn every_network_computes_what_onnxruntime_does() {
    let Some(cases) = cases() else { return };
    assert!(cases.len() > 60);
    for case in &cases {
        let mut network = case.network();
        let inputs = network.inputs().iter().map(|port| case.inputs[&port.name].clone()).collect::<Vec<_>>();
        let given: Vec<&[f32]> = inputs.iter().map(Vec::as_slice).collect();
        let said = network.run(&given).unwrap_or_else(|problem| panic!("{}: {problem}", case.name));
        assert_eq!(said.len(), case.outputs.len(), "{}", case.name);
        for ((output, port), numbers) in case.outputs.iter().zip(network.outputs()).zip(&said) {
            assert_eq!(port.shape, output.shape, "{}: {port}", case.name);
            assert_eq!(numbers.len(), output.data.len(), "{}", case.name);
            for (ours, theirs) in numbers.iter().zip(&output.data) {
                let fits = theirs
                    .map_or(ours.is_nan(), |theirs| (ours - theirs).abs() <= 2e-5 * (1.0 + theirs.abs()));
                assert!(fits, "{}: {ours} {theirs:?}", case.name);
            }
        }
        assert_eq!(bits(&network.run(&given).unwrap()), bits(&said), "{}: it says the same again", case.name);
    }
}

fn bits(said: &[Vec<f32>]) -> Vec<u32> {
    said.iter().flatten().map(|number| number.to_bits()).collect()
}

/// The numbers hold for every machine: `cargo xtask aarch64` runs this test, too.
#[test]
fn the_bits_are_the_same_on_every_machine() {
    let mut random = Random::new(3);
    let mut number = || random.below(20_001) as f32 / 5_000.0 - 2.0;
    let mut network =
        Network::parse(&perceptron(&[30, 24, 17, 5], "Tanh", &mut number), "perceptron").unwrap();
    let row: Vec<f32> = (0..30).map(|_| number()).collect();
    let mut all = bits(&network.run(&[&row]).unwrap());
    for operation in "Elu Exp Gelu LogSoftmax Mish Selu Sigmoid Softplus Sqrt Tanh".split(' ') {
        let mut network = Network::parse(&of_one(operation), operation).unwrap();
        all.extend((0..200).flat_map(|_| bits(&network.run(&[&[number().abs()]]).unwrap())));
    }
    let hash = all.iter().fold(0xcbf2_9ce4_8422_2325_u64, |hash, bits| {
        (hash ^ u64::from(*bits)).wrapping_mul(0x0100_0000_01b3)
    });
    assert_eq!(format!("{hash:016x}"), "724a6d571bb6ba92");
}

#[test]
fn damaged_files_are_refused_or_run() {
    let Some(cases) = cases() else { return };
    for case in cases.iter().filter(|case| case.file.len() < 20_000) {
        let bytes = case.bytes();
        for length in (0..bytes.len()).step_by(7) {
            run_if_possible(&bytes[..length]);
        }
        let mut random = Random::new(1);
        for _ in 0..200 {
            let mut damaged = bytes.clone();
            for _ in 0..=random.below(3) {
                let place = random.below(damaged.len());
                damaged[place] = random.bits() as u8;
            }
            run_if_possible(&damaged);
        }
    }
}

fn run_if_possible(bytes: &[u8]) {
    let Ok(mut network) = Network::parse(bytes, "damaged") else { return };
    let inputs: Vec<Vec<f32>> = network.inputs().iter().map(|port| vec![0.5; port.count()]).collect();
    drop(network.run(&inputs.iter().map(Vec::as_slice).collect::<Vec<_>>()));
}

#[test]
fn what_cannot_be_used_is_named() {
    let refused = |bytes: &[u8]| Network::parse(bytes, "legs.onnx").unwrap_err().to_string();
    assert_eq!(Network::parse(&of_one("Relu"), "").unwrap().run(&[&[-1.0]]).unwrap(), [[0.0]]);
    let unknown = refused(&of_one("NonMaxSuppression"));
    assert!(
        unknown.starts_with("legs.onnx: NonMaxSuppression \"second\" is an operation that is not supported"),
        "{unknown}"
    );
    assert!(refused(b"[robot]\nname = \"no network\"\n").contains("no ONNX file"));
    assert!(refused(b"").contains("no ONNX file"));
    assert_eq!(refused(&of_one("Add")), "legs.onnx: Add \"second\" lacks its input 1");
    let mut network = Network::parse(&of_one("Relu"), "").unwrap();
    assert_eq!(network.run(&[&[1.0, 2.0]]).unwrap_err(), "its input x (1) takes 1 numbers, and is given 2");
    let missing = Network::read("no/such.onnx".as_ref()).unwrap_err().to_string();
    assert!(missing.starts_with("no/such.onnx: "), "{missing}");
}
