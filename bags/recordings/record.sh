#!/bin/sh
# Makes darwin_op_emulated/ again: 12 s of an emulated Darwin OP with faults, recorded inside the process from
# the hardware module's first run to its last, so that it can be replayed byte for byte (tests/replay.rs).
set -eu
cd "$(dirname "$0")/../.."
rm -rf bags/recordings/darwin_op_emulated
cargo run --release -- bag record --robot bags/recordings/darwin_op_emulated.toml \
    --duration 12s --output bags/recordings/darwin_op_emulated
cargo run --release -- bag info bags/recordings/darwin_op_emulated
