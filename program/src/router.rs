//! The command `router`.

use std::time::Duration;

use anyhow::Context;
use downbeat_zenoh::{Router, Settings};

use crate::stop::Stop;

/// Zenoh says what it denies among the most detailed lines of its log only.
const SHOW_DENIED: &str =
    "DOWNBEAT_LOG=info,zenoh=error,zenoh::net::routing::interceptor::access_control=trace";

pub(crate) fn router() -> anyhow::Result<()> {
    let stop = Stop::new()?;
    let settings = Settings::from_variables(|name| std::env::var(name).ok())?;
    let router = Router::start(&settings).context(
        "cannot start a Zenoh router; if its port is in use, another router runs already, which serves all nodes",
    )?;
    if router.is_without_ipv6() {
        tracing::info!("this machine has no IPv6: the router listens on IPv4 only");
    }
    tracing::info!("Zenoh router {} listens on {}", router.id(), router.locators().join(", "));
    if router.has_access_control() {
        tracing::info!(
            "access control is on: what its rules deny is dropped without an error at the sender; {SHOW_DENIED} logs each decision"
        );
    }
    while !stop.is_due() {
        stop.sleep(Duration::from_secs(3600));
    }
    Ok(())
}
