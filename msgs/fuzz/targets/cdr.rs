//! Serialised messages of every carried type. The first two bytes choose the type.

use downbeat_msgs::{Message, cdr};

type Reader = fn(&[u8]);

macro_rules! readers {
    ($($message:ty),* $(,)?) => { &[$(read::<$message>),*] };
}

static READERS: &[Reader] = downbeat_msgs::for_each_message!(readers);

pub fn run(bytes: &[u8]) {
    let Some((&[high, low], bytes)) = bytes.split_first_chunk() else { return };
    READERS[usize::from(u16::from_be_bytes([high, low])) % READERS.len()](bytes);
}

fn read<T: Message>(bytes: &[u8]) {
    let Ok(message) = cdr::from_slice::<T>(bytes) else { return };
    let written = cdr::to_vec(&message);
    let again: T = cdr::from_slice(&written).expect("what we wrote is read");
    // Not the values: NaN equals nothing.
    assert_eq!(cdr::to_vec(&again), written);
}
