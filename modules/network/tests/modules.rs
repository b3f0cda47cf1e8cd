//! The modules on sockets of this machine, and on recordings of them.
#![allow(clippy::unwrap_used)]

mod common;

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream, UdpSocket};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use common::{Bench, free_port, options};
use downbeat_device::DeviceLink;
use downbeat_executor::Module;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_msgs::std_msgs::msg::String as Line;
use downbeat_network::tcp::Tcp;
use downbeat_network::tcp_lines::TcpLines;
use downbeat_network::udp::Udp;
use downbeat_network::udp_lines::UdpLines;

#[test]
fn lines_pass_both_ways() {
    let (port, peer) = (free_port(), UdpSocket::bind("127.0.0.1:0").unwrap());
    peer.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    let mut bench = Bench::new();
    let received = bench.collect::<Line>("lines/received");
    let settings = options([
        ("listen", format!("127.0.0.1:{port}").into()),
        ("to", peer.local_addr().unwrap().to_string().into()),
    ]);
    bench.core.add_with("lines", UdpLines::new(DeviceLink::new(Udp::default())), settings).unwrap();
    let send = bench.core.inlet::<Line>("lines/send").unwrap();
    bench.run(2);
    peer.send_to(b"one\r\ntwo\nthr\xff", ("127.0.0.1", port as u16)).unwrap();
    send.publish(Line { data: "left".to_owned() }).unwrap();
    bench.run(3);
    let lines: Vec<_> = received.lock().unwrap().iter().map(|line| line.data.clone()).collect();
    assert_eq!(lines, ["one", "two", "thr\u{fffd}"]);
    let mut buffer = [0; 64];
    let length = peer.recv(&mut buffer).unwrap();
    assert_eq!(&buffer[..length], b"left\n");
}

fn tcp_lines(side: &str, port: u16) -> (Bench, Arc<Mutex<Vec<Line>>>, downbeat_executor::Inlet<Line>) {
    let mut bench = Bench::new();
    let received = bench.collect::<Line>("lines/received");
    let settings =
        options([("side", side.to_owned().into()), ("address", format!("127.0.0.1:{port}").into())]);
    bench.core.add_with("lines", TcpLines::new(DeviceLink::new(Tcp::default())), settings).unwrap();
    let send = bench.core.inlet::<Line>("lines/send").unwrap();
    bench.run(2);
    (bench, received, send)
}

fn run_until(bench: &mut Bench, mut is_so: impl FnMut() -> bool) {
    for _ in 0..2000 {
        bench.run(1);
        if is_so() {
            return;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    panic!("waited in vain");
}

fn free_tcp_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

#[test]
fn a_tcp_server_hears_all_peers_and_tells_all_and_drops_lines_without_end() {
    let port = free_tcp_port();
    let (mut bench, received, send) = tcp_lines("server", port);
    let mut peers = [0, 1].map(|_| TcpStream::connect(("127.0.0.1", port)).unwrap());
    let [first, second] = &mut peers;
    first.write_all(b"one\r\ntw").unwrap();
    first.write_all(&vec![b'x'; 1_000_000]).unwrap();
    first.write_all(b"\nafter\n").unwrap();
    second.write_all(b"last \xff\nunfinished").unwrap();
    second.shutdown(Shutdown::Write).unwrap();
    run_until(&mut bench, || received.lock().unwrap().len() >= 3);
    let mut lines: Vec<_> = received.lock().unwrap().iter().map(|line| line.data.clone()).collect();
    lines.sort();
    assert_eq!(lines, ["after", "last \u{fffd}", "one"]);
    send.publish(Line { data: "left".to_owned() }).unwrap();
    bench.run(3);
    let mut buffer = [0; 5];
    first.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
    first.read_exact(&mut buffer).unwrap();
    assert_eq!(&buffer, b"left\n");
}

#[test]
fn a_tcp_client_connects_again_when_its_server_comes_back() {
    let port = free_tcp_port();
    let (mut bench, received, send) = tcp_lines("client", port);
    bench.run(5); // nobody is there
    for round in 1..=2 {
        let server = TcpListener::bind(("127.0.0.1", port)).unwrap();
        server.set_nonblocking(true).unwrap();
        let mut peer = None;
        run_until(&mut bench, || {
            peer = server.accept().ok();
            peer.is_some()
        });
        let (mut peer, _) = peer.unwrap();
        peer.write_all(b"hello\n").unwrap();
        run_until(&mut bench, || received.lock().unwrap().len() == round);
        send.publish(Line { data: "back".to_owned() }).unwrap();
        bench.run(3);
        peer.set_nonblocking(false).unwrap();
        peer.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        let mut buffer = [0; 5];
        peer.read_exact(&mut buffer).unwrap();
        assert_eq!(&buffer, b"back\n");
    }
}

/// The first failure that a module records on a topic.
fn failure<M: Module>(module: M, topic: &str, settings: &[(&str, &str)]) -> String {
    let mut bench = Bench::new();
    let exchanges = bench.collect::<BusExchange>(topic);
    let settings =
        settings.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned().into())).collect();
    let options = downbeat_executor::ModuleOptions { settings, ..Default::default() };
    bench.core.add_with("lines", module, options).unwrap();
    let mut error = String::new();
    run_until(&mut bench, || {
        let exchanges = exchanges.lock().unwrap();
        let failed = exchanges.iter().find(|exchange| exchange.outcome == BusExchange::FAILED);
        failed.inspect(|exchange| error = exchange.error.to_string()).is_some()
    });
    error
}

#[test]
fn an_address_on_which_nothing_can_listen_is_named_with_what_to_do() {
    let tcp = |address: &str| {
        let module = TcpLines::new(DeviceLink::new(Tcp::default()));
        failure(module, "lines/exchanges", &[("side", "server"), ("address", address)])
    };
    let udp = |address: &str| {
        failure(UdpLines::new(DeviceLink::new(Udp::default())), "datagrams", &[("listen", address)])
    };
    let (stream, datagram) =
        (TcpListener::bind("127.0.0.1:0").unwrap(), UdpSocket::bind("127.0.0.1:0").unwrap());
    for (failure, protocol, address, option) in [
        (tcp as fn(&str) -> String, "TCP", stream.local_addr().unwrap(), "-ltnp"),
        (udp, "UDP", datagram.local_addr().unwrap(), "-lunp"),
    ] {
        let error = failure(&address.to_string());
        let start = format!("cannot listen on {protocol} {address}: ");
        let end = format!(
            "; choose another port, or end the program that `ss {option} 'sport = :{}'` shows",
            address.port()
        );
        assert!(error.starts_with(&start) && error.ends_with(&end), "{error}");
        // RFC 5737: for documentation, of no machine.
        let error = failure("192.0.2.1:4010");
        let start = format!("cannot listen on {protocol} 192.0.2.1:4010: ");
        assert!(error.starts_with(&start) && error.contains("; `ip -brief address` lists "), "{error}");
    }
}

#[test]
fn a_program_that_does_not_listen_is_named_with_what_to_do() {
    let address = format!("127.0.0.1:{}", free_tcp_port());
    let module = TcpLines::new(DeviceLink::new(Tcp::default()));
    let error = failure(module, "lines/exchanges", &[("side", "client"), ("address", &address)]);
    assert!(error.starts_with(&format!("cannot connect to TCP {address}: ")), "{error}");
    assert!(
        error.ends_with("; start the program that listens there, or correct the address in the robot file")
    );
}
