//! Bare UDP sockets; each received sample is copied into its own memory.

use std::io::Write;
use std::net::{Ipv4Addr, UdpSocket};
use std::time::{Duration, Instant};

use super::{End, PeerOptions, Stream, at_the_pace_of_a_camera, trips, wait_for_the_end};

/// Size of the datagrams that the engine sends on one host.
const DATAGRAM: usize = 65_000;
/// The other end is considered done after this time without a datagram.
const IDLE: Duration = Duration::from_millis(500);

pub fn run(options: &PeerOptions) -> anyhow::Result<()> {
    let socket = socket2::Socket::new(socket2::Domain::IPV4, socket2::Type::DGRAM, None)?;
    // The size that the engine requests, so that both have the same buffers.
    socket.set_recv_buffer_size(4 << 20)?;
    socket.set_send_buffer_size(4 << 20)?;
    socket.bind(&std::net::SocketAddrV4::new(Ipv4Addr::LOCALHOST, 0).into())?;
    let socket = UdpSocket::from(socket);
    println!("{}", socket.local_addr()?.port());
    std::io::stdout().flush()?;
    if options.port > 0 {
        socket.connect((Ipv4Addr::LOCALHOST, options.port))?;
    }
    match options.end {
        End::Echo => echo(&socket),
        End::Ping => ping(&socket, options),
        End::Flood => flood(&socket, options),
        End::Camera => camera(&socket, options.size),
        End::Count => count(&socket, options.size),
    }
}

fn echo(socket: &UdpSocket) -> anyhow::Result<()> {
    let answering = socket.try_clone()?;
    std::thread::spawn(move || {
        let mut buffer = [0; 2048];
        while let Ok((length, from)) = answering.recv_from(&mut buffer) {
            // Fails if the pinging end has ended, which needs no answer.
            let _ = answering.send_to(&buffer[..length], from);
        }
    });
    wait_for_the_end()
}

fn ping(socket: &UdpSocket, options: &PeerOptions) -> anyhow::Result<()> {
    socket.set_read_timeout(Some(Duration::from_secs(1)))?;
    let (mut buffer, mut times) = (vec![0; options.size], Vec::new());
    let start = Instant::now();
    while start.elapsed().as_secs_f64() < options.seconds {
        let sent = Instant::now();
        socket.send(&buffer)?;
        if socket.recv(&mut buffer).is_ok() {
            times.push(sent.elapsed());
        }
    }
    println!("{}", serde_json::to_string(&trips(times)?)?);
    Ok(())
}

fn flood(socket: &UdpSocket, options: &PeerOptions) -> anyhow::Result<()> {
    let sample = vec![0x5a; options.size];
    let (mut bytes, mut samples) = (0, 0);
    let start = Instant::now();
    while start.elapsed().as_secs_f64() < options.seconds {
        for datagram in sample.chunks(DATAGRAM) {
            bytes += socket.send(datagram)? as u64;
        }
        samples += 1;
    }
    let sent = Stream { bytes, samples, seconds: start.elapsed().as_secs_f64() };
    println!("{}", serde_json::to_string(&sent)?);
    Ok(())
}

fn camera(socket: &UdpSocket, size: usize) -> anyhow::Result<()> {
    let sample = vec![0x5a; size];
    at_the_pace_of_a_camera(|| {
        for datagram in sample.chunks(DATAGRAM) {
            socket.send(datagram)?;
        }
        Ok(())
    })?;
    println!("{}", serde_json::to_string(&Stream::of_a_camera(size))?);
    Ok(())
}

fn count(socket: &UdpSocket, size: usize) -> anyhow::Result<()> {
    let (mut buffer, mut bytes, mut samples) = (vec![0; 65_536], 0, 0);
    let mut sample = Vec::new();
    let mut first = None;
    let mut last = Instant::now();
    loop {
        // No timeout before the first datagram: it is not known when the other end begins.
        socket.set_read_timeout(first.map(|_| IDLE))?;
        let Ok(length) = socket.recv(&mut buffer) else { break };
        last = Instant::now();
        first.get_or_insert(last);
        bytes += length as u64;
        // Assembled in separate memory, as any receiver that passes samples on has to. Losses are not
        // detected.
        sample.extend_from_slice(&buffer[..length]);
        if sample.len() >= size {
            drop(std::mem::take(&mut sample));
            samples += 1;
        }
    }
    let seconds = first.map_or(0.0, |first| (last - first).as_secs_f64());
    println!("{}", serde_json::to_string(&Stream { bytes, samples, seconds })?);
    wait_for_the_end()
}
