//! Benchmarks of downbeat. They are in `benches/`; `README.md` says what is compared with what.
