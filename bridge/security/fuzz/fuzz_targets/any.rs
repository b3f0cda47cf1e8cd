#![no_main]

#[path = "../targets/mod.rs"]
mod targets;

// The first byte chooses the parser.
libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let [index, bytes @ ..] = bytes {
        (targets::ALL[usize::from(*index) % targets::ALL.len()].run)(bytes);
    }
});
