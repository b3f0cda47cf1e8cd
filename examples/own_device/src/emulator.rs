//! An emulated range finder: its distances are computed, and it leaves one request of ten unanswered.

use std::net::UdpSocket;
use std::thread::JoinHandle;

use downbeat::executor::{Context, Module, Setup, SetupError, TransitionError};

/// Answers on its own thread while the module is active.
#[derive(Default)]
pub(crate) struct Emulator {
    address: String,
    running: Option<Running>,
}

struct Running {
    socket: UdpSocket,
    thread: JoinHandle<()>,
}

/// The datagram that ends the thread.
const OFF: &[u8] = b"off";

impl Module for Emulator {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let address = setup.read_only_setting(
            "address",
            "127.0.0.1:4001".to_owned(),
            "where it answers, host and port",
        )?;
        self.address = setup.value(address).cloned().unwrap_or_default();
        Ok(())
    }

    fn activate(&mut self, _: &mut Context<'_>) -> Result<(), TransitionError> {
        let socket = UdpSocket::bind(&self.address).map_err(|error| {
            TransitionError::new(format!("cannot emulate a range finder at {}: {error}", self.address))
        })?;
        let of_thread = socket.try_clone()?;
        let thread =
            std::thread::Builder::new().name("range finder".into()).spawn(move || answer(&of_thread))?;
        self.running = Some(Running { socket, thread });
        Ok(())
    }

    fn deactivate(&mut self, ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        self.shutdown(ctx);
        Ok(())
    }

    fn shutdown(&mut self, _: &mut Context<'_>) {
        let Some(Running { socket, thread }) = self.running.take() else { return };
        let is_sent = socket.local_addr().and_then(|address| socket.send_to(OFF, address));
        if is_sent.is_ok() {
            // The thread returns nothing.
            let _ = thread.join();
        }
    }
}

fn answer(socket: &UdpSocket) {
    let mut buffer = [0; 64];
    while let Ok((length, from)) = socket.recv_from(&mut buffer) {
        if &buffer[..length] == OFF {
            return;
        }
        let request = String::from_utf8_lossy(&buffer[..length]);
        let number = request.split(' ').next().and_then(|number| number.parse::<u32>().ok());
        if let Some(number) = number.filter(|number| number % 10 != 0) {
            #[allow(clippy::disallowed_methods)] // this is the device, whose answers are recorded
            let metres = 1.0 + 0.5 * (f64::from(number) / 10.0).sin();
            // The client may have closed its socket.
            let _ = socket.send_to(format!("{number} {metres:.3}").as_bytes(), from);
        }
    }
}
