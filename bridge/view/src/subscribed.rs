//! A subscription of a viewer.

use std::sync::Arc;

/// A subscription of a viewer, which ends when this is dropped.
pub(crate) struct Subscribed {
    pub(crate) topic: Arc<str>,
    end: Option<Box<dyn FnOnce() + Send>>,
}

impl Subscribed {
    pub(crate) fn new(topic: Arc<str>, end: impl FnOnce() + Send + 'static) -> Self {
        Self { topic, end: Some(Box::new(end)) }
    }
}

impl Drop for Subscribed {
    fn drop(&mut self) {
        if let Some(end) = self.end.take() {
            end();
        }
    }
}

pub(crate) fn no_channel(channel: u32) -> String {
    format!("there is no channel {channel}")
}
