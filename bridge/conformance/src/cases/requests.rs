//! Requests and replies.
#![allow(clippy::unwrap_used)]

use super::Ran;
use crate::engine::Domain;
use crate::support::{WATCHDOG, cdr, next, subscribe, wait_until};
use bytes::Bytes;
use downbeat_bridge::middleware::rpc::{
    CallError, IncomingRequest, MAX_IN_FLIGHT, RequestClient, RequestServer, Responder, ServiceEndpoint,
};
use downbeat_bridge::middleware::{Endpoint, Middleware, SampleIdentity, Writer};
use downbeat_bridge::worker::Worker;
use downbeat_msgs::qos::QosProfile;
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

/// Why cases about the two topics of a service are not for engines with services.
const ONE_WAY: &str = "its requests carry the way back";

fn reset() -> ServiceEndpoint {
    ServiceEndpoint {
        type_hashes: [None, None],
        type_name: "std_srvs::srv::dds_::SetBool_".into(),
        type_hash: None,
        node: None,
        name: "/reset".into(),
        request_topic: "rq/resetRequest".into(),
        request_type: "std_srvs::srv::dds_::SetBool_Request_".into(),
        reply_topic: "rr/resetReply".into(),
        reply_type: "std_srvs::srv::dds_::SetBool_Response_".into(),
        qos: QosProfile::SERVICES,
    }
}

/// A participant with the thread for its handlers.
struct Peer {
    worker: Worker,
    middleware: Box<dyn Middleware>,
}

impl Peer {
    fn join(domain: &Domain<'_>) -> Self {
        Self { worker: Worker::start().unwrap(), middleware: domain.join() }
    }

    fn serve(&self, on_request: impl FnMut(IncomingRequest) + Send + 'static) -> RequestServer {
        RequestServer::new(&*self.middleware, &self.worker, &reset(), Box::new(on_request)).unwrap()
    }

    /// A server whose requests go into a channel.
    fn listen(&self) -> (RequestServer, Receiver<IncomingRequest>) {
        let (sender, requests) = channel();
        let server = self.serve(move |request| {
            // The test may have stopped listening.
            let _ = sender.send(request);
        });
        (server, requests)
    }

    fn client(&self) -> RequestClient {
        RequestClient::new(&*self.middleware, &self.worker, &reset()).unwrap()
    }
}

/// Answers with the request.
fn echo(request: IncomingRequest) {
    request.responder.reply(request.cdr).unwrap();
}

type Answer = Result<Bytes, CallError>;

fn call(client: &RequestClient, body: &[u8], timeout: Duration) -> Receiver<Answer> {
    let (sender, answer) = channel();
    client.call(cdr(body), timeout, move |result| {
        // The test may have stopped listening.
        let _ = sender.send(result.map(|answer| answer.cdr));
    });
    answer
}

fn answer(of: &Receiver<Answer>) -> Answer {
    of.recv_timeout(WATCHDOG).expect("an end of the call within the watchdog time")
}

/// What was sent, which the engine may have padded.
fn is_echo(answer: &Receiver<Answer>, body: &[u8]) {
    let expected = cdr(body);
    assert_eq!(self::answer(answer).unwrap()[..expected.len()], expected[..]);
}

pub(super) fn a_request_is_answered_to_the_client_that_asked(domain: &Domain<'_>) {
    let (alice, bob, carol) = (Peer::join(domain), Peer::join(domain), Peer::join(domain));
    let server = alice.serve(echo);
    let clients = [bob.client(), bob.client(), carol.client()];
    for client in &clients {
        assert!(client.wait_for_server(WATCHDOG));
    }
    let asked: Vec<_> = (0..30_u8)
        .flat_map(|round| (0..3_u8).map(move |index| [round, index, 0, 0]))
        .map(|body| (body, call(&clients[usize::from(body[1])], &body, WATCHDOG)))
        .collect();
    for (body, answer) in &asked {
        is_echo(answer, body);
    }
    assert_eq!(server.matched_clients(), 3);
    assert_eq!((server.refused_requests(), server.unreachable_clients()), (0, 0));
}

pub(super) fn many_requests_in_flight_are_each_answered_in_whatever_order(domain: &Domain<'_>) {
    const COUNT: u32 = 500;
    let (alice, bob) = (Peer::join(domain), Peer::join(domain));
    let (_server, requests) = alice.listen();
    let client = bob.client();
    assert!(client.wait_for_server(WATCHDOG));
    let answers: Vec<_> = (0..COUNT).map(|number| call(&client, &number.to_le_bytes(), WATCHDOG)).collect();
    let mut open: Vec<_> = (0..COUNT).map(|_| requests.recv_timeout(WATCHDOG).unwrap()).collect();
    open.reverse();
    open.into_iter().for_each(echo);
    for (number, answer) in (0..COUNT).zip(&answers) {
        is_echo(answer, &number.to_le_bytes());
    }
}

pub(super) fn a_call_without_a_server_ends_at_once(domain: &Domain<'_>) {
    let bob = Peer::join(domain);
    let client = bob.client();
    assert!(!client.wait_for_server(Duration::from_millis(1)));
    let error = answer(&call(&client, &[0; 4], Duration::MAX / 4)).unwrap_err();
    assert_eq!(error, CallError::NoServer { service: "/reset".into() });
}

pub(super) fn a_call_that_is_not_answered_ends_when_its_time_is_up(domain: &Domain<'_>) {
    let (alice, bob) = (Peer::join(domain), Peer::join(domain));
    let (_server, requests) = alice.listen();
    let client = bob.client();
    assert!(client.wait_for_server(WATCHDOG));
    let (long, short) = (call(&client, &[1; 4], WATCHDOG), call(&client, &[2; 4], Duration::from_millis(20)));
    let timeout = Duration::from_millis(20);
    let error = answer(&short).unwrap_err();
    assert_eq!(error, CallError::TimedOut { service: "/reset".into(), timeout });
    for _ in 0..2 {
        echo(requests.recv_timeout(WATCHDOG).unwrap());
    }
    is_echo(&long, &[1; 4]);
    assert!(short.recv().is_err(), "the answer that came too late is not given as a second one");
}

/// Asks as one half of a client, and echoes. Returns the number of the request.
fn ask_until_heard(writer: &dyn Writer, requests: &Receiver<IncomingRequest>) -> i64 {
    wait_until("the server hears the client", || writer.matched() == 1);
    loop {
        // Matched on this side may be before the other.
        let number = writer.write_with(cdr([7; 4]), Default::default()).unwrap();
        if let Ok(request) = requests.recv_timeout(Duration::from_millis(200)) {
            echo(request);
            return number;
        }
    }
}

pub(super) fn a_reply_waits_until_the_client_that_asked_is_matched(domain: &Domain<'_>) -> Ran {
    let (alice, bob) = (Peer::join(domain), Peer::join(domain));
    if alice.middleware.services().is_some() {
        return Ran::NotApplicable(ONE_WAY);
    }
    let (_server, requests) = alice.listen();
    let ServiceEndpoint { request_topic, request_type, reply_topic, reply_type, qos, .. } = reset();
    let writer = bob.middleware.create_writer(&Endpoint::new(request_topic, request_type, qos)).unwrap();
    let number = ask_until_heard(&*writer, &requests);
    let (_reader, replies) = subscribe(&*bob.middleware, &Endpoint::new(reply_topic, reply_type, qos));
    let reply = next(&replies);
    assert_eq!(reply.cdr, cdr([7; 4]));
    assert_eq!(reply.related, Some(SampleIdentity { endpoint: writer.gid(), number }));
    Ran::Done(None)
}

pub(super) fn a_reply_to_a_client_that_never_comes_is_dropped(domain: &Domain<'_>) -> Ran {
    let (alice, bob) = (Peer::join(domain), Peer::join(domain));
    if alice.middleware.services().is_some() {
        return Ran::NotApplicable(ONE_WAY);
    }
    let server = alice.serve(echo);
    let ServiceEndpoint { request_topic, request_type, qos, .. } = reset();
    let writer = bob.middleware.create_writer(&Endpoint::new(request_topic, request_type, qos)).unwrap();
    wait_until("the server hears the client", || writer.matched() == 1);
    writer.write(cdr([7; 4])).unwrap();
    wait_until("the reply is dropped", || server.unreachable_clients() == 1);
    Ran::Done(None)
}

pub(super) fn requests_beyond_the_bound_are_refused_and_counted(domain: &Domain<'_>) {
    let (alice, bob, carol) = (Peer::join(domain), Peer::join(domain), Peer::join(domain));
    let (server, requests) = alice.listen();
    let clients = [bob.client(), carol.client()];
    for client in &clients {
        assert!(client.wait_for_server(WATCHDOG));
    }
    let (half, beyond) = (MAX_IN_FLIGHT / 2, 10);
    let mut answers = Vec::new();
    let mut open = Vec::new();
    for count in [half, half] {
        answers.extend((0..count).map(|_| call(&clients[0], &[1; 4], WATCHDOG)));
        open.extend((0..count).map(|_| requests.recv_timeout(WATCHDOG).unwrap()));
    }
    let _refused: Vec<_> = (0..beyond).map(|_| call(&clients[1], &[2; 4], WATCHDOG)).collect();
    wait_until("the others are refused", || server.refused_requests() == beyond);
    open.drain(..).for_each(echo);
    for answer in &answers {
        is_echo(answer, &[1; 4]);
    }
    let again = call(&clients[1], &[3; 4], WATCHDOG);
    echo(requests.recv_timeout(WATCHDOG).unwrap());
    is_echo(&again, &[3; 4]);
}

pub(super) fn calls_beyond_the_bound_are_refused(domain: &Domain<'_>) {
    let (alice, bob) = (Peer::join(domain), Peer::join(domain));
    let (_server, requests) = alice.listen();
    let client = bob.client();
    assert!(client.wait_for_server(WATCHDOG));
    let answers: Vec<_> = (0..MAX_IN_FLIGHT).map(|_| call(&client, &[1; 4], WATCHDOG)).collect();
    let error = answer(&call(&client, &[1; 4], WATCHDOG)).unwrap_err();
    assert_eq!(error, CallError::TooManyCalls { service: "/reset".into() });
    for answer in &answers {
        echo(requests.recv_timeout(WATCHDOG).unwrap());
        is_echo(answer, &[1; 4]);
    }
}

pub(super) fn a_server_that_left_is_no_longer_there(domain: &Domain<'_>) {
    let (alice, bob) = (Peer::join(domain), Peer::join(domain));
    let (server, requests) = alice.listen();
    let client = bob.client();
    assert!(client.wait_for_server(WATCHDOG));
    let unanswered = call(&client, &[1; 4], WATCHDOG);
    let responder: Responder = requests.recv_timeout(WATCHDOG).unwrap().responder;
    drop(server);
    assert!(responder.reply(cdr([1; 4])).is_err(), "there is no writer for it any more");
    wait_until("the client knows", || client.servers() == 0);
    assert!(answer(&call(&client, &[2; 4], WATCHDOG)).is_err());
    drop(client);
    assert_eq!(answer(&unanswered), Err(CallError::Closed { service: "/reset".into() }));
}

pub(super) fn a_server_that_leaves_delivers_its_reply_first(domain: &Domain<'_>) {
    let bob = Peer::join(domain);
    let client = bob.client();
    for number in 0..10_u8 {
        let alice = Peer::join(domain);
        let (server, requests) = alice.listen();
        assert!(client.wait_for_server(WATCHDOG));
        let answer = call(&client, &[number; 4], WATCHDOG);
        echo(requests.recv_timeout(WATCHDOG).unwrap());
        drop(server);
        drop(alice);
        is_echo(&answer, &[number; 4]);
        wait_until("the client knows", || client.servers() == 0);
    }
}

pub(super) fn a_server_that_leaves_waits_for_a_client_that_is_found_late(domain: &Domain<'_>) -> Ran {
    let (alice, bob) = (Peer::join(domain), Peer::join(domain));
    if alice.middleware.services().is_some() {
        return Ran::NotApplicable(ONE_WAY);
    }
    let (server, requests) = alice.listen();
    let ServiceEndpoint { request_topic, request_type, reply_topic, reply_type, qos, .. } = reset();
    let writer = bob.middleware.create_writer(&Endpoint::new(request_topic, request_type, qos)).unwrap();
    ask_until_heard(&*writer, &requests);
    let leaving = std::thread::spawn(move || drop(server));
    let (_reader, replies) = subscribe(&*bob.middleware, &Endpoint::new(reply_topic, reply_type, qos));
    assert_eq!(next(&replies).cdr, cdr([7; 4]));
    leaving.join().unwrap();
    Ran::Done(None)
}

pub(super) fn a_dropped_client_ends_its_calls(domain: &Domain<'_>) {
    let (alice, bob) = (Peer::join(domain), Peer::join(domain));
    let (server, requests) = alice.listen();
    let client = bob.client();
    assert!(client.wait_for_server(WATCHDOG));
    let asked = call(&client, &[1; 4], WATCHDOG);
    let request = requests.recv_timeout(WATCHDOG).unwrap();
    drop(client);
    assert_eq!(answer(&asked), Err(CallError::Closed { service: "/reset".into() }));
    // Both of its endpoints: while the one for replies is matched, a reply goes there.
    let is_client = |topic: &String| [reset().request_topic, reset().reply_topic].contains(topic);
    wait_until("the server knows", || {
        let endpoints = alice.middleware.remote_endpoints();
        server.matched_clients() == 0 && !endpoints.iter().any(|end| is_client(&end.topic_name))
    });
    echo(request);
    wait_until("its reply is dropped", || server.unreachable_clients() == 1);
}

pub(super) fn large_requests_and_replies_arrive_whole(domain: &Domain<'_>) {
    let (alice, bob) = (Peer::join(domain), Peer::join(domain));
    let _server = alice.serve(echo);
    let client = bob.client();
    assert!(client.wait_for_server(WATCHDOG));
    for length in [1000_u32, 1368, 1369, 1500, 100_000] {
        let map: Vec<u8> = (0..length).map(|index| index.to_le_bytes()[1]).collect();
        is_echo(&call(&client, &map, WATCHDOG), &map);
    }
}
