//! Large samples.
#![allow(clippy::unwrap_used)]

use crate::engine::Domain;
use crate::peer::chatter;
use crate::support::{cdr, next, subscribe, wait_until};
use downbeat_msgs::qos::QosProfile;
use std::time::Instant;

pub(super) fn a_sample_of_many_fragments_arrives_whole(domain: &Domain<'_>) {
    let (alice, bob) = (domain.join(), domain.join());
    let (reader, samples) = subscribe(&*bob, &chatter(QosProfile::DEFAULT));
    let writer = alice.create_writer(&chatter(QosProfile::DEFAULT)).unwrap();
    wait_until("both are matched", || writer.matched() == 1 && reader.matched() == 1);
    let image: Vec<u8> = (0..300_000_u32).map(|index| index.to_le_bytes()[1]).collect();
    writer.write(cdr(&image)).unwrap();
    assert!(next(&samples).cdr == cdr(&image), "300 kB arrive unchanged");
}

pub(super) fn samples_of_64_kilobytes_to_8_megabytes_arrive_whole(domain: &Domain<'_>) -> String {
    let (alice, bob) = (domain.join(), domain.join());
    let (reader, samples) = subscribe(&*bob, &chatter(QosProfile::DEFAULT));
    let writer = alice.create_writer(&chatter(QosProfile::DEFAULT)).unwrap();
    wait_until("both are matched", || writer.matched() == 1 && reader.matched() == 1);
    let mut figures = Vec::new();
    for (name, length) in
        [("64 kB", 64_000_u32), ("512 kB", 512_000), ("2 MB", 2_000_000), ("8 MB", 8_000_000)]
    {
        let image: Vec<u8> = (0..length).map(|index| (index ^ (index >> 8)).to_le_bytes()[0]).collect();
        let payload = cdr(&image);
        let start = Instant::now();
        writer.write(payload.clone()).unwrap();
        assert!(next(&samples).cdr == payload, "{name} arrive unchanged");
        figures.push(format!("{name} {:.1} ms", start.elapsed().as_secs_f64() * 1e3));
    }
    figures.join(", ")
}
