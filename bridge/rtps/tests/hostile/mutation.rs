//! Random changes of datagrams: of single bytes, of numbers at the places where RTPS has them, and of whole
//! submessages.

use fuzzing::Random;

/// Changes a datagram at a few places.
pub fn mutate(datagram: &mut Vec<u8>, random: &mut Random) {
    for _ in 0..=random.below(4) {
        match random.below(4) {
            0 => change_submessages(datagram, random),
            1 => change_number(datagram, random),
            _ => change_bytes(datagram, random),
        }
    }
}

const HEADER: usize = 20;

/// The ranges of the submessages, as far as their lengths are valid.
pub fn submessages(datagram: &[u8]) -> Vec<(usize, usize)> {
    let mut found = Vec::new();
    let mut start = HEADER;
    while let Some([_, flags, a, b]) = datagram.get(start..).and_then(|rest| rest.first_chunk()) {
        let length = if flags & 1 == 0 { u16::from_be_bytes([*a, *b]) } else { u16::from_le_bytes([*a, *b]) };
        let end = datagram.len().min(start + 4 + usize::from(length));
        found.push((start, end));
        start = end;
    }
    found
}

fn change_submessages(datagram: &mut Vec<u8>, random: &mut Random) {
    let parts = submessages(datagram);
    if parts.is_empty() {
        return;
    }
    let (start, end) = *random.choose(&parts);
    let part = datagram[start..end].to_vec();
    match random.below(5) {
        0 => drop(datagram.drain(start..end)),
        1 => drop(datagram.splice(start..start, part)),
        2 => datagram.extend(part),
        3 => {
            datagram[start] = *random.choose(&[1, 6, 7, 8, 9, 0x0c, 0x0e, 0x12, 0x13, 0x15, 0x16, 0x30, 0x33])
        }
        _ => datagram[start + 1] ^= 1 << random.below(4), // byte order, Q, D or final, K
    }
}

/// Overwrites a number, which begins at a multiple of four in RTPS, with a boundary value.
fn change_number(datagram: &mut [u8], random: &mut Random) {
    let length = datagram.len() as u64;
    let at = random.below(datagram.len()) & !3;
    let value = *random.choose(&[
        0,
        1,
        2,
        256,
        257,
        length,
        0xffff,
        1 << 30,
        i32::MAX as u64,
        1 << 31,
        u32::MAX.into(),
        1 << 40,
        1 << 60,
        1 << 62,
        i64::MAX as u64,
        1 << 63,
        u64::MAX,
    ]);
    let mut bytes = value.to_le_bytes();
    let width = *random.choose(&[2, 4, 8]);
    match random.below(3) {
        0 => bytes[..width].reverse(),
        1 => bytes.rotate_left(4), // a sequence number: the high half first
        _ => {}
    }
    datagram[at..].iter_mut().zip(&bytes[..width]).for_each(|(byte, new)| *byte = *new);
}

fn change_bytes(datagram: &mut Vec<u8>, random: &mut Random) {
    let at = random.below(datagram.len());
    match random.below(6) {
        0 if at < datagram.len() => datagram[at] ^= 1 << random.below(8),
        1 if at < datagram.len() => datagram[at] = random.bits() as u8,
        2 => datagram.truncate(at),
        3 => {
            let length = random.below(40).min(datagram.len() - at);
            datagram.drain(at..at + length);
        }
        4 => {
            let from = random.below(datagram.len());
            let length = random.below(40).min(datagram.len() - from);
            let stretch = datagram[from..from + length].to_vec();
            datagram.splice(at..at, stretch);
        }
        _ => datagram.insert(at, random.bits() as u8),
    }
}
