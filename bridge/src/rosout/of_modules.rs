//! Which publisher sends the lines of a module.

use super::LogLine;
use crate::ros::Publisher;
use downbeat_msgs::rcl_interfaces::msg::Log;
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::{Arc, Weak};

/// The publishers of the lines of modules that have their own nodes.
#[derive(Default)]
pub(super) struct OfModules {
    by_module: Mutex<BTreeMap<String, OfModule>>,
}

struct OfModule {
    publisher: Weak<Publisher>,
    logger: String,
}

impl OfModules {
    /// Publishes the lines of a module with this publisher under this name, as long as the publisher exists.
    pub(super) fn insert(&self, module: &str, publisher: &Arc<Publisher>, logger: String) {
        let of_module = OfModule { publisher: Arc::downgrade(publisher), logger };
        self.by_module.lock().insert(module.to_owned(), of_module);
    }

    /// The publisher for a line and the message that it is, where its module has a node that is still there.
    pub(super) fn find(&self, line: &LogLine) -> Option<(Arc<Publisher>, Log)> {
        let by_module = self.by_module.lock();
        let OfModule { publisher, logger } = by_module.get(line.module.as_ref()?)?;
        Some((publisher.upgrade()?, Log { name: logger.clone(), ..line.to_message("") }))
    }
}
