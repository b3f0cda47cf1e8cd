//! Names of emulated devices in this process.

use std::collections::BTreeMap;
use std::sync::{Arc, Weak};

use parking_lot::Mutex;

/// What names of devices in memory start with.
const PREFIX: &str = "memory:";

/// Returns whether this names a device in memory.
pub(crate) fn is_memory(name: &str) -> bool {
    name.starts_with(PREFIX)
}

/// Another emulated device has the name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("\"{0}\" is in use by another emulator; choose another name")]
pub struct NameInUse(String);

/// Devices by their names, as long as their owners keep them. Clones share them.
pub(crate) struct Registry<T>(Arc<Mutex<BTreeMap<String, Weak<Mutex<T>>>>>);

impl<T> Clone for Registry<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<T> Default for Registry<T> {
    fn default() -> Self {
        Self(Arc::default())
    }
}

impl<T> Registry<T> {
    /// Offers a device as long as the result lives.
    ///
    /// # Errors
    /// If the name is in use.
    pub(crate) fn offer(&self, name: &str, device: T) -> Result<Arc<Mutex<T>>, NameInUse> {
        let mut devices = self.0.lock();
        devices.retain(|_, device| device.strong_count() > 0);
        if devices.contains_key(name) {
            return Err(NameInUse(name.to_owned()));
        }
        let device = Arc::new(Mutex::new(device));
        devices.insert(name.to_owned(), Arc::downgrade(&device));
        Ok(device)
    }

    /// The device of this name. `None` if no emulator offers it.
    pub(crate) fn find(&self, name: &str) -> Option<Weak<Mutex<T>>> {
        self.0.lock().get(name).filter(|device| device.strong_count() > 0).cloned()
    }
}
