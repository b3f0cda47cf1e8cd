#![no_main]

#[path = "../targets/mod.rs"]
mod targets;

libfuzzer_sys::fuzz_target!(|conversation: &[u8]| targets::participant::run(conversation));
