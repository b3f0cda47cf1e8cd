//! Guards with the enclaves of the keystore that sros2 wrote.

#![allow(dead_code)] // each test program uses a part

use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use downbeat_rtps::protocol::{Config, Guard};
use downbeat_rtps::wire::GuidPrefix;
use downbeat_security::enclave::Enclave;
use downbeat_security::guard::{Credentials, SecurityGuard, Status};
use fuzzing::Random;

thread_local! {
    static ENCLAVE: Cell<Option<&'static str>> = const { Cell::new(None) };
    static CREDENTIALS: RefCell<BTreeMap<(String, u32), Arc<Credentials>>> = const { RefCell::new(BTreeMap::new()) };
}

/// A time at which the certificates are valid.
pub fn valid() -> SystemTime {
    UNIX_EPOCH + Duration::from_secs(1_800_000_000)
}

pub fn enclave(name: &str) -> Enclave {
    let keystore = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/keystores/all_domains"));
    let folder = keystore.join("enclaves").join(name.trim_start_matches('/'));
    Enclave::load(&folder, valid()).unwrap_or_else(|error| panic!("{error}"))
}

/// Lets the participants that `make` makes have that enclave.
pub fn as_enclave<T>(name: &'static str, make: impl FnOnce() -> T) -> T {
    ENCLAVE.set(Some(name));
    let made = make();
    ENCLAVE.set(None);
    made
}

/// The guard of each participant of a network: none, unless it has an enclave.
pub fn guard(config: &Config) -> Option<(GuidPrefix, Box<dyn Guard>)> {
    ENCLAVE.get().map(|name| guard_of(name, config))
}

/// The guard of a participant with an enclave.
pub fn guard_of(name: &str, config: &Config) -> (GuidPrefix, Box<dyn Guard>) {
    let credentials = CREDENTIALS.with_borrow_mut(|known| {
        let make = || {
            Arc::new(
                Credentials::new(&enclave(name), config.domain_id, valid()).expect("a rule for the domain"),
            )
        };
        known.entry((name.to_owned(), config.domain_id)).or_insert_with(make).clone()
    });
    guard_with(credentials, config, Status::default())
}

/// The guard of a participant with credentials, whose random numbers depend on its prefix only.
pub fn guard_with(
    credentials: Arc<Credentials>,
    config: &Config,
    status: Status,
) -> (GuidPrefix, Box<dyn Guard>) {
    let seed = config
        .prefix
        .0
        .iter()
        .fold(0_u64, |seed, byte| seed.wrapping_mul(0x100_0000_01b3) ^ u64::from(*byte));
    let mut random = Random::new(seed);
    let fill = move |bytes: &mut [u8]| bytes.iter_mut().for_each(|byte| *byte = random.below(256) as u8);
    let guard = SecurityGuard::new(credentials, config.prefix, Box::new(fill), status);
    (guard.prefix(), Box::new(guard))
}
