//! The README does what it says.

use std::net::UdpSocket;

#[test]
fn the_commands_of_the_readme_print_what_it_says() {
    // The port is free now, and nothing else requests it by number.
    let free =
        UdpSocket::bind("127.0.0.1:0").and_then(|socket| socket.local_addr()).expect("there is a port");
    readme_runner::Readme::of(env!("CARGO_MANIFEST_DIR"), env!("CARGO_BIN_EXE_own_device"))
        .replacing("robot.toml", "47300", &free.port().to_string())
        .check();
}
