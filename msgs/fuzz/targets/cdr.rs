//! Serialised messages of every built-in type, and views of them. The first two bytes choose the type.

use downbeat_msgs::{
    Message,
    cdr::{self, Viewed},
};

type Reader = fn(&[u8]);

macro_rules! readers {
    ($($message:ty),* $(,)?) => { &[$(read::<$message>),*] };
}

static READERS: &[Reader] = downbeat_msgs::for_each_message!(readers);

pub fn run(bytes: &[u8]) {
    let Some((&[high, low], bytes)) = bytes.split_first_chunk() else { return };
    READERS[usize::from(u16::from_be_bytes([high, low])) % READERS.len()](bytes);
}

fn read<T: Message + Viewed>(bytes: &[u8]) {
    let message = cdr::from_slice::<T>(bytes);
    let view = cdr::from_slice::<T::View<'_>>(bytes);
    assert_eq!(message.is_ok(), view.is_ok(), "a message and its view must agree: {view:?}");
    // Formatting a view reads the borrowed data.
    let _ = std::hint::black_box(format!("{view:?}"));
    let Ok(message) = message else { return };
    let written = cdr::to_vec(&message);
    let again: T = cdr::from_slice(&written).expect("our own bytes are valid");
    // Compares bytes, not values: NaN is not equal to itself.
    assert_eq!(cdr::to_vec(&again), written);
}
