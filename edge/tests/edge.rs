//! Every message type goes out of a core as bytes, and comes in from bytes.
#![allow(clippy::unwrap_used)]

use downbeat_edge::{CoreAccess, Interfaces};
use downbeat_executor::{Core, Inbox, ManualClock, OutletInbox, Time};
use std::sync::mpsc::channel;
use std::time::Duration;

#[test]
fn every_type_goes_in_and_out_unchanged() {
    let clock = ManualClock::new(Time::from_nanos(1_000));
    let mut core = Core::new().with_clock(clock.clone());
    let (sender, taken) = channel();
    let inbox = OutletInbox::new("tap", Inbox::KeepAll);
    for (number, known) in Interfaces::carried().messages().enumerate() {
        let sender = sender.clone();
        let sink = move |time, cdr| sender.send((known.name(), time, cdr)).unwrap();
        let topic = format!("topic_{number}");
        known.outlet(&mut CoreAccess::Idle(&mut core), &topic, &inbox, sink).unwrap().keep();
    }
    let inlets: Vec<_> = Interfaces::carried()
        .messages()
        .enumerate()
        .map(|(number, known)| known.inlet(&mut core, &format!("topic_{number}")).unwrap())
        .collect();
    assert!(inlets.len() > 50, "the registry is not empty");
    for inlet in &inlets {
        inlet.publish(&inlet.message_type().default_cdr()).unwrap();
    }
    core.cycle().unwrap();
    clock.advance(Duration::from_millis(1));
    core.cycle().unwrap();

    let taken: Vec<_> = taken.try_iter().collect();
    assert_eq!(taken.len(), inlets.len());
    for (inlet, (name, time, cdr)) in inlets.iter().zip(taken) {
        assert_eq!(inlet.message_type().name(), name);
        assert_eq!(time, Time::from_nanos(1_000), "the cycle that published it");
        assert_eq!(cdr, inlet.message_type().default_cdr());
    }
}

#[test]
fn an_inlet_says_topic_and_type_when_the_bytes_are_wrong() {
    let mut core = Core::new();
    let inlet =
        Interfaces::carried().message("sensor_msgs/msg/Imu").unwrap().inlet(&mut core, "imu").unwrap();
    let error = inlet.publish(&[0, 1, 0, 0, 1]).unwrap_err().to_string();
    assert!(error.contains("\"imu\"") && error.contains("sensor_msgs/msg/Imu"), "{error}");
}
