//! Random values of each type, compared with other implementations.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use downbeat_msgs::cdr;
use downbeat_msgs_definitions::TypeName;
use serde_json::Value;

use crate::SEED;
use crate::every_type::{Type, catalog, every_type};
use crate::exact::first_difference;
use crate::peer::hex;
use crate::random::random_message;

/// A random value of a type and its bytes.
pub struct Sample {
    pub name: &'static str,
    pub number: usize,
    pub value: Value,
    pub bytes: Vec<u8>,
    read: fn(&[u8]) -> cdr::Result<Vec<u8>>,
}

impl Sample {
    /// Identifies the sample in failures.
    pub fn label(&self) -> String {
        label(self.name, self.number)
    }

    /// Checks the value that another implementation reads from its bytes.
    pub fn check_value(&self, json: &str, by: &str) {
        if let Some(difference) = first_difference(&self.value, &parse(json)) {
            panic!("{} read by {by}: at {difference}", self.label());
        }
    }

    /// Checks the bytes that another implementation writes for its value.
    pub fn check_bytes(&self, theirs: &[u8]) {
        let same = self.bytes.iter().zip(theirs).take_while(|(a, b)| a == b).count();
        if same < self.bytes.len().max(theirs.len()) {
            let (ours, theirs) = (hex(&self.bytes), hex(theirs));
            panic!("{}: differ from byte {same} on: we write {ours}, they {theirs}", self.label());
        }
    }

    /// Checks that we read the same value from bytes in another form.
    pub fn check_read(&self, theirs: &[u8]) {
        let again =
            (self.read)(theirs).unwrap_or_else(|error| panic!("{}: {error}: {}", self.label(), hex(theirs)));
        self.check_bytes(&again);
    }

    /// Checks that we read the same value from big-endian bytes.
    pub fn check_swapped(&self, theirs: &[u8]) {
        assert!(theirs.starts_with(&[0; 4]), "{}: {}", self.label(), hex(theirs));
        self.check_read(theirs);
    }
}

pub fn label(name: &str, number: usize) -> String {
    format!("{name}, value {number} of seed {SEED:#x}")
}

pub fn parse(json: &str) -> Value {
    serde_json::from_str(json).unwrap_or_else(|error| panic!("{json}: {error}"))
}

/// `of_each` random values of each of the types.
pub fn samples(types: &[&Type], of_each: usize) -> Vec<Sample> {
    let catalog = catalog();
    let mut samples = Vec::new();
    for of in types {
        let name: TypeName = of.type_name();
        for number in 0..of_each {
            let value = random_message(&catalog, &name, SEED, number);
            samples.push(Sample { name: of.name, number, bytes: (of.write)(&value), value, read: of.read });
        }
    }
    samples
}

/// Lines of name and bytes.
pub fn lines(samples: &[Sample]) -> String {
    samples.iter().fold(String::new(), |mut lines, sample| {
        writeln!(lines, "{}\t{}", sample.name, hex(&sample.bytes)).unwrap();
        lines
    })
}

/// Lines of `define`, name and definition.
pub fn definitions(types: &[&Type]) -> String {
    types.iter().fold(String::new(), |mut lines, of| {
        writeln!(lines, "define\t{}\t{}", of.name, hex(of.definition.as_bytes())).unwrap();
        lines
    })
}

pub fn by_name() -> BTreeMap<&'static str, Type> {
    every_type().into_iter().map(|of| (of.name, of)).collect()
}

#[test]
fn random_values_of_every_type_round_trip() {
    let types = every_type();
    for of in &types {
        for sample in samples(&[of], 50) {
            sample.check_read(&sample.bytes);
        }
    }
}

#[test]
fn random_values_reach_bounds_and_edges() {
    let catalog = catalog();
    let name: TypeName = "test_msgs/msg/BoundedSequences".parse().unwrap();
    let values: Vec<Value> = (0..200).map(|number| random_message(&catalog, &name, SEED, number)).collect();
    let has = |check: &dyn Fn(&Value) -> bool| values.iter().any(check);
    for length in [0, 1, 3] {
        assert!(has(&|value| value["float64_values"].as_array().unwrap().len() == length), "{length} values");
    }
    for bits in ["7ff0000000000000", "fff0000000000000", "7ff8000000000000", "8000000000000000"] {
        let has_bits = |value: &Value| value["float64_values"].as_array().unwrap().contains(&bits.into());
        assert!(has(&has_bits), "{bits}");
    }
    assert!(has(&|value| value["int64_values"].as_array().unwrap().contains(&i64::MIN.into())));
    let texts = |value: &Value| value["string_values"].as_array().unwrap().clone();
    assert!(has(&|value| texts(value).contains(&"".into())));
    assert!(has(&|value| !value["string_values"].to_string().is_ascii()));
    assert_eq!(values[7], random_message(&catalog, &name, SEED, 7));
}
