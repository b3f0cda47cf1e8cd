//! An engine, used directly through the middleware trait of the bridge.

use std::io::Write;
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use anyhow::Context;
use bytes::Bytes;
use downbeat_bridge::middleware::{
    Endpoint, Engine, Middleware, ParticipantOptions, Sample, SampleHandler, WriteError, Writer, join,
};
use downbeat_msgs::Message;
use downbeat_msgs::qos::{History, QosProfile};
use downbeat_msgs::std_msgs::msg::UInt8MultiArray;

use super::{
    End, PATIENCE, PeerOptions, Stream, at_the_pace_of_a_camera, trips, wait_for_the_end, wait_until,
};
use crate::peer::on_this_machine;

const DEFAULT: History = QosProfile::DEFAULT.history;

pub fn run(options: &PeerOptions, engine: Engine) -> anyhow::Result<()> {
    let joined = ParticipantOptions {
        engine,
        #[cfg(feature = "zenoh")]
        zenoh: crate::router::sessions_of(options.router.as_deref()),
        #[cfg(feature = "security")]
        security: options.keystore.as_deref().map(|keystore| super::secured::options(keystore, options.end)),
        ..on_this_machine(options.domain)?
    };
    let participant = join(&joined)?;
    println!("0");
    std::io::stdout().flush()?;
    match options.end {
        End::Echo => echo(&*participant),
        End::Ping => ping(&*participant, options),
        End::Flood => flood(&*participant, options),
        End::Camera => camera(&*participant, options.size),
        End::Count => count(&*participant),
    }
}

fn endpoint(topic: &str, history: History) -> Endpoint {
    let qos = QosProfile { history, ..QosProfile::DEFAULT };
    Endpoint {
        type_hash: Some(UInt8MultiArray::TYPE_HASH.to_owned()),
        ..Endpoint::new(format!("rt/{topic}"), "std_msgs::msg::dds_::UInt8MultiArray_", qos)
    }
}

/// A little-endian payload of `size` bytes.
fn payload(size: usize) -> Bytes {
    let mut bytes = vec![0x5a; size.max(4)];
    bytes[..4].copy_from_slice(&[0, 1, 0, 0]);
    bytes.into()
}

fn echo(participant: &dyn Middleware) -> anyhow::Result<()> {
    let writer = participant.create_writer(&endpoint("pong", DEFAULT))?;
    let answer: SampleHandler = Box::new(move |sample: Sample| {
        if let Err(error) = writer.write(sample.cdr) {
            eprintln!("no answer: {error}");
        }
    });
    let _reader = participant.create_reader(&endpoint("ping", DEFAULT), answer)?;
    wait_for_the_end()
}

/// Sends the next ping from the handler of the previous answer.
struct Pinger {
    payload: Bytes,
    until: Instant,
    sent: Instant,
    times: Vec<Duration>,
}

fn ping(participant: &dyn Middleware, options: &PeerOptions) -> anyhow::Result<()> {
    // The handler uses the writer and is created before it.
    let slot: Arc<OnceLock<Box<dyn Writer>>> = Arc::default();
    let pinger = Arc::new(Mutex::new(Pinger {
        payload: payload(options.size),
        until: Instant::now(),
        sent: Instant::now(),
        times: Vec::new(),
    }));
    let (done, is_done) = channel();
    let on_answer: SampleHandler = {
        let (writer, pinger) = (Arc::clone(&slot), Arc::clone(&pinger));
        Box::new(move |_| {
            let mut pinger = pinger.lock().unwrap_or_else(PoisonError::into_inner);
            let time = pinger.sent.elapsed();
            pinger.times.push(time);
            let next = writer.get().filter(|_| Instant::now() < pinger.until);
            pinger.sent = Instant::now();
            if next.is_none_or(|writer| writer.write(pinger.payload.clone()).is_err()) {
                // Only the first send has a receiver.
                let _ = done.send(());
            }
        })
    };
    let reader = participant.create_reader(&endpoint("pong", DEFAULT), on_answer)?;
    let writer = participant.create_writer(&endpoint("ping", DEFAULT))?;
    let writer = slot.get_or_init(|| writer);
    wait_until("the other end is matched", || writer.matched() == 1 && reader.matched() == 1)?;
    // The other end may not have discovered this one yet.
    std::thread::sleep(Duration::from_millis(500));
    {
        let mut pinger = pinger.lock().unwrap_or_else(PoisonError::into_inner);
        pinger.until = Instant::now() + Duration::from_secs_f64(options.seconds);
        pinger.sent = Instant::now();
        writer.write(pinger.payload.clone())?;
    }
    is_done.recv_timeout(PATIENCE).context("an answer is missing")?;
    let times = std::mem::take(&mut pinger.lock().unwrap_or_else(PoisonError::into_inner).times);
    println!("{}", serde_json::to_string(&trips(times)?)?);
    Ok(())
}

fn flood(participant: &dyn Middleware, options: &PeerOptions) -> anyhow::Result<()> {
    let writer = participant.create_writer(&endpoint("ping", History::KeepAll))?;
    wait_until("the other end is matched", || writer.matched() == 1)?;
    std::thread::sleep(Duration::from_millis(500));
    let payload = payload(options.size);
    let (mut bytes, mut samples) = (0, 0);
    let start = Instant::now();
    while start.elapsed().as_secs_f64() < options.seconds {
        match writer.write(payload.clone()) {
            Ok(()) => {
                bytes += payload.len() as u64;
                samples += 1;
            }
            // The reader has not caught up: yield the processor to it.
            Err(WriteError::WindowFull) => std::thread::sleep(Duration::from_micros(20)),
            Err(error) => return Err(error.into()),
        }
    }
    let seconds = start.elapsed().as_secs_f64();
    writer.flush(PATIENCE);
    println!("{}", serde_json::to_string(&Stream { bytes, samples, seconds })?);
    Ok(())
}

fn camera(participant: &dyn Middleware, size: usize) -> anyhow::Result<()> {
    let writer = participant.create_writer(&endpoint("ping", DEFAULT))?;
    wait_until("the other end is matched", || writer.matched() == 1)?;
    std::thread::sleep(Duration::from_millis(500));
    let picture = payload(size);
    at_the_pace_of_a_camera(|| Ok(writer.write(picture.clone())?))?;
    println!("{}", serde_json::to_string(&Stream::of_a_camera(size))?);
    Ok(())
}

fn count(participant: &dyn Middleware) -> anyhow::Result<()> {
    struct Counter {
        stream: Stream,
        first: Option<Instant>,
    }
    let stream = Stream { bytes: 0, samples: 0, seconds: 0.0 };
    let counter = Arc::new(Mutex::new(Counter { stream, first: None }));
    let counted = Arc::clone(&counter);
    let on_sample: SampleHandler = Box::new(move |sample: Sample| {
        let mut counter = counted.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        let first = *counter.first.get_or_insert(now);
        counter.stream.bytes += sample.cdr.len() as u64;
        counter.stream.samples += 1;
        counter.stream.seconds = (now - first).as_secs_f64();
    });
    let _reader = participant.create_reader(&endpoint("ping", History::KeepAll), on_sample)?;
    wait_for_the_end()?;
    let stream = counter.lock().unwrap_or_else(PoisonError::into_inner).stream;
    println!("{}", serde_json::to_string(&stream)?);
    Ok(())
}
