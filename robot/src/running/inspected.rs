//! A running robot as other processes see it: its core, and what it exposes to ROS 2.

use std::sync::Arc;

use crate::inspect::{Inspected, Unavailable, Watch};
use crate::{ChainReport, EndpointReport, Latencies, RobotFile};
use downbeat_bridge::expose::{Bridge, ExposedEndpoint, TopicPattern};
use downbeat_executor::{CoreHandle, CycleTrace, Graph, Snapshot};

pub(crate) struct InspectedRobot {
    pub(crate) core: CoreHandle,
    pub(crate) bridge: Option<Bridge>,
    pub(crate) file: Arc<RobotFile>,
    pub(crate) latencies: Latencies,
    #[cfg(feature = "view")]
    pub(crate) view: Option<Arc<super::view::RobotView>>,
}

impl Inspected for InspectedRobot {
    fn snapshot(&self) -> Result<Snapshot, Unavailable> {
        Inspected::snapshot(&self.core)
    }

    fn trace(&self, cycles: u32) -> Result<CycleTrace, Unavailable> {
        Inspected::trace(&self.core, cycles)
    }

    fn graph(&self) -> Result<Graph, Unavailable> {
        Inspected::graph(&self.core)
    }

    fn latencies(&self) -> Vec<ChainReport> {
        self.latencies.reports()
    }

    fn pause(&self) {
        self.core.pause();
    }

    fn resume(&self) {
        self.core.resume();
    }

    fn step(&self) {
        self.core.step();
    }

    #[cfg(feature = "view")]
    fn view(&self) -> Result<String, String> {
        let view = self.view.as_ref().ok_or("this program has no page for its robot")?;
        view.open_page().map_err(|error| error.to_string())
    }

    fn exposed(&self) -> Result<Vec<EndpointReport>, String> {
        Ok(self.bridge()?.status().endpoints())
    }

    fn expose(&self, entries: &str) -> Result<Vec<EndpointReport>, String> {
        let exposures = self.file.exposures_while_running(entries, &self.core, &self.bridge()?.status());
        let exposures = exposures.map_err(|error| error.to_string())?;
        let added = self.bridge()?.add(&exposures).map_err(|error| error.to_string())?;
        for EndpointReport { endpoint, .. } in &added {
            tracing::info!("exposed while running: {} [{}]", endpoint.ros_topic, endpoint.type_name);
        }
        Ok(added)
    }

    fn take_back(&self, topics: &[String]) -> Result<Vec<EndpointReport>, String> {
        let bridge = self.bridge()?;
        let patterns = topics.iter().map(|topic| TopicPattern::new(topic).map_err(|error| error.to_string()));
        let patterns = patterns.collect::<Result<Vec<_>, _>>()?;
        let is_meant = |endpoint: &ExposedEndpoint, pattern: &TopicPattern| {
            pattern.matches(&endpoint.ros_topic) || pattern.matches(&endpoint.topic)
        };
        let exposed = bridge.status().endpoints();
        for pattern in &patterns {
            if !exposed.iter().any(|report| is_meant(&report.endpoint, pattern)) {
                let names: Vec<_> = exposed.iter().map(|report| report.endpoint.ros_topic.as_str()).collect();
                return Err(format!("\"{pattern}\" is not exposed; there is {}", names.join(", ")));
            }
        }
        let removed = bridge.remove(|endpoint| patterns.iter().any(|pattern| is_meant(endpoint, pattern)));
        for EndpointReport { endpoint, .. } in &removed {
            tracing::info!("exposed no more: {} [{}]", endpoint.ros_topic, endpoint.type_name);
        }
        Ok(removed)
    }

    fn watch(&self) -> Result<Watch, String> {
        Ok(Watch::new(self.core.clone(), self.file.catalog.interfaces.clone()))
    }
}

impl InspectedRobot {
    fn bridge(&self) -> Result<&Bridge, String> {
        self.bridge.as_ref().ok_or_else(|| "it runs without a ROS 2 node".into())
    }
}
