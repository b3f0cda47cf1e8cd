//! A router of Zenoh for the contestants.

use anyhow::Context;
use downbeat_zenoh::{Router, Settings};

/// A router on a free port of this machine.
pub struct LocalRouter {
    _router: Router,
    pub endpoint: String,
}

impl LocalRouter {
    pub fn start() -> anyhow::Result<Self> {
        let overrides = Some(r#"listen/endpoints=["tcp/127.0.0.1:0"]"#.to_owned());
        let router = Router::start(&Settings { overrides, ..Settings::default() })?;
        let endpoint = router.locators().into_iter().next().context("the router listens nowhere")?;
        Ok(Self { _router: router, endpoint })
    }
}

/// The defaults of `rmw_zenoh_cpp` with the router at this endpoint.
pub fn sessions_of(endpoint: Option<&str>) -> Settings {
    Settings { router: endpoint.map(str::to_owned), ..Settings::default() }
}
