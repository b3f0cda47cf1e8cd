//! Random changes of bytes.

use fuzzing::Random;

/// Changes bytes at a few places, and numbers where CDR has them.
pub fn mutate(bytes: &mut Vec<u8>, random: &mut Random) {
    for _ in 0..=random.below(3) {
        let at = random.below(bytes.len());
        match random.below(6) {
            0 => bytes.truncate(at),
            1 => bytes.insert(at, random.bits() as u8),
            2 => drop(bytes.drain(at..bytes.len().min(at + random.below(40)))),
            3 => {
                let values = [0, 1, 2, bytes.len() as u32, 0xffff, i32::MAX as u32, u32::MAX - 3, u32::MAX];
                let value = *random.choose(&values);
                let number = if random.one_in(2) { value.to_le_bytes() } else { value.to_be_bytes() };
                bytes.iter_mut().skip(at & !3).zip(number).for_each(|(byte, new)| *byte = new);
            }
            4 => {
                let end = bytes.len().min(at + random.below(200));
                let stretch = bytes[at..end].to_vec();
                let to = random.below(bytes.len());
                drop(bytes.splice(to..to, stretch));
            }
            _ => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte ^= 1 << random.below(8)),
        }
    }
}
