//! The crate `zenoh` alone, with the sessions and the congestion control that the engine has.
//!
//! A sample is received in one piece, as any receiver that decodes it needs it. There is no attachment, no
//! liveliness token and no advanced publisher.

use std::hint::black_box;
use std::io::Write;
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use downbeat_zenoh::Reach;
use downbeat_zenoh::zenoh::bytes::ZBytes;
use downbeat_zenoh::zenoh::pubsub::Publisher;
use downbeat_zenoh::zenoh::qos::CongestionControl;
use downbeat_zenoh::zenoh::sample::Sample;
use downbeat_zenoh::zenoh::{self, Session, Wait};

use super::{End, PeerOptions, Stream, at_the_pace_of_a_camera, trips, wait_for_the_end, wait_until};
use crate::router::sessions_of;

pub fn run(options: &PeerOptions) -> anyhow::Result<()> {
    let (session, _) = downbeat_zenoh::open(&sessions_of(options.router.as_deref()), Reach::Configured)?;
    println!("0");
    std::io::stdout().flush()?;
    let done = match options.end {
        End::Echo => echo(&session),
        End::Ping => ping(&session, options),
        End::Flood => flood(&session, options),
        End::Camera => camera(&session, options.size),
        End::Count => count(&session),
    };
    done.map_err(|error| anyhow!(error))?;
    session.close().wait().map_err(|error| anyhow!(error))
}

fn publisher(
    session: &Session,
    topic: &'static str,
    congestion: CongestionControl,
) -> zenoh::Result<Publisher<'static>> {
    session.declare_publisher(topic).congestion_control(congestion).wait()
}

/// Waits for the other end, and until the way to it is direct.
fn wait_for(session: &Session, publisher: &Publisher<'_>) -> anyhow::Result<()> {
    wait_until("the other end is matched", || {
        publisher.matching_status().wait().is_ok_and(|status| status.matching())
            && session.info().peers_zid().wait().next().is_some()
    })?;
    // The other end may not have discovered this one yet.
    std::thread::sleep(Duration::from_millis(500));
    Ok(())
}

fn echo(session: &Session) -> zenoh::Result<()> {
    let pong = publisher(session, "pong", CongestionControl::Drop)?;
    let answer = move |sample: Sample| {
        if let Err(error) = pong.put(sample.payload().clone()).wait() {
            eprintln!("no answer: {error}");
        }
    };
    let _subscriber = session.declare_subscriber("ping").callback(answer).wait()?;
    Ok(wait_for_the_end()?)
}

fn ping(session: &Session, options: &PeerOptions) -> zenoh::Result<()> {
    let ping = Arc::new(publisher(session, "ping", CongestionControl::Drop)?);
    let payload = ZBytes::from(vec![0x5a; options.size]);
    struct State {
        until: Instant,
        sent: Instant,
        times: Vec<Duration>,
    }
    let state =
        Arc::new(Mutex::new(State { until: Instant::now(), sent: Instant::now(), times: Vec::new() }));
    let (done, is_done) = channel();
    let on_answer = {
        let (ping, state, payload) = (Arc::clone(&ping), Arc::clone(&state), payload.clone());
        move |_: Sample| {
            let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
            let time = state.sent.elapsed();
            state.times.push(time);
            let is_over = Instant::now() >= state.until;
            state.sent = Instant::now();
            if is_over || ping.put(payload.clone()).wait().is_err() {
                // Only the first send has a receiver.
                let _ = done.send(());
            }
        }
    };
    let _subscriber = session.declare_subscriber("pong").callback(on_answer).wait()?;
    wait_for(session, &ping)?;
    {
        let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
        state.until = Instant::now() + Duration::from_secs_f64(options.seconds);
        state.sent = Instant::now();
    }
    ping.put(payload).wait()?;
    is_done.recv().context("an answer is missing")?;
    let times = std::mem::take(&mut state.lock().unwrap_or_else(PoisonError::into_inner).times);
    println!("{}", serde_json::to_string(&trips(times)?)?);
    Ok(())
}

fn flood(session: &Session, options: &PeerOptions) -> zenoh::Result<()> {
    let publisher = publisher(session, "ping", CongestionControl::Block)?;
    wait_for(session, &publisher)?;
    let payload = ZBytes::from(vec![0x5a; options.size]);
    let mut samples = 0;
    let start = Instant::now();
    while start.elapsed().as_secs_f64() < options.seconds {
        publisher.put(payload.clone()).wait()?;
        samples += 1;
    }
    let (bytes, seconds) = (samples * options.size as u64, start.elapsed().as_secs_f64());
    // The last samples are under way.
    std::thread::sleep(Duration::from_millis(500));
    println!("{}", serde_json::to_string(&Stream { bytes, samples, seconds })?);
    Ok(())
}

fn camera(session: &Session, size: usize) -> zenoh::Result<()> {
    let publisher = publisher(session, "ping", CongestionControl::Drop)?;
    wait_for(session, &publisher)?;
    let picture = ZBytes::from(vec![0x5a; size]);
    at_the_pace_of_a_camera(|| publisher.put(picture.clone()).wait().map_err(|error| anyhow!(error)))?;
    println!("{}", serde_json::to_string(&Stream::of_a_camera(size))?);
    Ok(())
}

fn count(session: &Session) -> zenoh::Result<()> {
    let stream = Stream { bytes: 0, samples: 0, seconds: 0.0 };
    let counter = Arc::new(Mutex::new((stream, None)));
    let counted = Arc::clone(&counter);
    let on_sample = move |sample: Sample| {
        let payload = sample.payload().to_bytes();
        let mut counter = counted.lock().unwrap_or_else(PoisonError::into_inner);
        let (stream, first) = &mut *counter;
        let now = Instant::now();
        stream.bytes += black_box(&payload).len() as u64;
        stream.samples += 1;
        stream.seconds = (now - *first.get_or_insert(now)).as_secs_f64();
    };
    let _subscriber = session.declare_subscriber("ping").callback(on_sample).wait()?;
    wait_for_the_end()?;
    let stream = counter.lock().unwrap_or_else(PoisonError::into_inner).0;
    println!("{}", serde_json::to_string(&stream)?);
    Ok(())
}
