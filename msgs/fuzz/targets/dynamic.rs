//! Serialised messages of every built-in type, read by their definition, compared with the compiled types.
//! The first two bytes choose the type.

use std::sync::LazyLock;

use downbeat_msgs::dynamic::{DynamicMessage, DynamicType};
use downbeat_msgs::{Message, cdr};

struct Pair {
    typed: fn(&[u8]) -> Option<Vec<u8>>,
    dynamic: DynamicType,
}

macro_rules! pairs {
    ($($message:ty),* $(,)?) => { vec![$(pair::<$message>()),*] };
}

static PAIRS: LazyLock<Vec<Pair>> = LazyLock::new(|| downbeat_msgs::for_each_message!(pairs));

fn pair<T: Message>() -> Pair {
    let dynamic = DynamicType::from_definition_text(T::TYPE_NAME, "ros2msg", T::DEFINITION);
    Pair {
        typed: |bytes| cdr::from_slice::<T>(bytes).ok().map(|message| cdr::to_vec(&message)),
        dynamic: dynamic.unwrap_or_else(|error| panic!("{}: {error}", T::TYPE_NAME)),
    }
}

pub fn run(bytes: &[u8]) {
    let Some((&[high, low], bytes)) = bytes.split_first_chunk() else { return };
    let Pair { typed, dynamic } = &PAIRS[usize::from(u16::from_be_bytes([high, low])) % PAIRS.len()];
    let read = DynamicMessage::from_cdr(dynamic, bytes).ok();
    assert_eq!(read.map(|message| message.to_cdr()), typed(bytes), "{}", dynamic.name());
}
