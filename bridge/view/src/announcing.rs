//! What the server announces to viewers: at first all that there is, then what changes.

use crate::channels::Changes;
use crate::client::{Client, Watched};
use crate::connection::Proof;
use crate::graph::Connections;
use crate::options::ViewTime;
use crate::outbox::{Closed, Frame};
use crate::parameters::{parameter, settings};
use crate::protocol::{Level, status, time, timestamp};
use crate::services::ShownService;
use crate::shared::Shared;
use downbeat_bags::metadata::ros_distro;
use serde_json::json;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// How often the core is compared with what viewers know.
const LOOK: Duration = Duration::from_secs(1);

/// How often viewers are sent the time of the core.
const TIME: Duration = Duration::from_millis(50);

/// The interval of reports to a viewer that messages of a topic are dropped.
const TELL: Duration = Duration::from_secs(10);

/// How often viewers are sent a ping.
const PING: Duration = Duration::from_secs(10);

impl Shared {
    /// Tells a new viewer what there is, and every change from now on.
    pub(crate) fn welcome(&self, client: &Arc<Client>, proof: Proof) -> Result<(), Closed> {
        let mut capabilities = self.source.capabilities(&self.options);
        if proof == Proof::Full && self.source.core().is_ok() {
            capabilities.extend(["clientPublish", "services"]);
        }
        let mut info = json!({
            "op": "serverInfo",
            "name": self.options.name,
            "capabilities": capabilities,
            "supportedEncodings": ["cdr", "json"],
            "metadata": { "ROS_DISTRO": ros_distro() },
            "sessionId": self.session_id,
        });
        if let Some(bag) = self.source.bag() {
            info["dataStartTime"] = timestamp(u64::try_from(bag.start).unwrap_or(0));
            info["dataEndTime"] = timestamp(u64::try_from(bag.end).unwrap_or(0));
        }
        let _announcing = self.announcing.lock();
        client.outbox.announce(Frame::Text(info.to_string()))?;
        let channels = json!({ "op": "advertise", "channels": self.source.channels() });
        client.outbox.announce(Frame::Text(channels.to_string()))?;
        if proof == Proof::Full && self.source.core().is_ok() {
            let services: Vec<_> = self.source.services().iter().map(ShownService::announcement).collect();
            let services = json!({ "op": "advertiseServices", "services": services });
            client.outbox.announce(Frame::Text(services.to_string()))?;
        }
        self.clients.lock().insert(client.id, Arc::clone(client));
        if let Some(bag) = self.source.bag() {
            bag.greet(client.id);
        }
        Ok(())
    }

    /// The thread that announces what changes in the core, until the server stops.
    pub(crate) fn announce_changes(&self) {
        let (mut last_look, mut last_ping) = (Instant::now(), Instant::now());
        let mut last_time = None;
        loop {
            let is_asked = self.wait();
            if self.is_stopping.load(Ordering::SeqCst) {
                return;
            }
            if self.options.time == ViewTime::Core
                && let Ok(core) = self.source.core()
            {
                let now = core.time_ns();
                if last_time.replace(now) != Some(now) {
                    let frame = time(now);
                    self.for_each_client(|_| Some(Frame::Binary(frame.clone())));
                }
            }
            if is_asked || last_look.elapsed() >= LOOK {
                last_look = Instant::now();
                self.announce_channels();
                self.announce_connections();
                self.announce_parameters();
                self.report_losses();
            }
            if last_ping.elapsed() >= PING {
                last_ping = Instant::now();
                self.for_each_client(|_| Some(Frame::Ping));
            }
        }
    }

    /// Waits for the next look, without end while there are no viewers. Returns true if the look was asked
    /// for.
    fn wait(&self) -> bool {
        let period = if self.options.time == ViewTime::Core { TIME } else { LOOK };
        let mut pulse = self.pulse.lock();
        while !*pulse {
            if self.clients.lock().is_empty() {
                self.pulsed.wait(&mut pulse);
            } else if self.pulsed.wait_for(&mut pulse, period).timed_out() {
                break;
            }
        }
        std::mem::take(&mut *pulse)
    }

    fn announce_channels(&self) {
        let Ok(core) = self.source.core() else { return };
        let _announcing = self.announcing.lock();
        let Some(Changes { added, removed }) = core.refresh(&self.options, LOOK) else { return };
        if !removed.is_empty() {
            let text = json!({ "op": "unadvertise", "channelIds": removed }).to_string();
            self.for_each_client(|_| Some(Frame::Text(text.clone())));
        }
        if !added.is_empty() {
            let channels: Vec<_> = added.iter().map(|channel| channel.announcement()).collect();
            let text = json!({ "op": "advertise", "channels": channels }).to_string();
            self.for_each_client(|_| Some(Frame::Text(text.clone())));
        }
    }

    fn announce_connections(&self) {
        if !self.clients.lock().values().any(|client| client.watched.lock().connections.is_some()) {
            return;
        }
        let Ok(core) = self.source.core() else { return };
        let Some(graph) = core.handle.graph().wait(LOOK) else { return };
        let connections = Connections::of(&graph);
        self.for_each_client(|client| {
            let mut watched = client.watched.lock();
            let known = watched.connections.as_mut()?;
            let update = connections.update(known)?;
            known.clone_from(&connections);
            Some(Frame::Text(update))
        });
    }

    fn announce_parameters(&self) {
        if !self.clients.lock().values().any(|client| !client.watched.lock().parameters.is_empty()) {
            return;
        }
        let Ok(core) = self.source.core() else { return };
        let Some(settings) = settings(&core.handle, LOOK) else { return };
        self.for_each_client(|client| {
            let mut changed = Vec::new();
            for (name, known) in &mut client.watched.lock().parameters {
                let Some((_, info)) = settings.get(name) else { continue };
                let value = parameter(name, &info.value);
                if known.as_ref() != Some(&value) {
                    changed.push(value.clone());
                    *known = Some(value);
                }
            }
            let text = json!({ "op": "parameterValues", "parameters": changed }).to_string();
            (!changed.is_empty()).then_some(Frame::Text(text))
        });
    }

    fn report_losses(&self) {
        let clients: Vec<_> = self.clients.lock().values().cloned().collect();
        for client in clients {
            let dropped = client.outbox.take_dropped();
            let mut watched = client.watched.lock();
            let Watched { topics, told, .. } = &mut *watched;
            told.retain(|_, told| told.elapsed() < TELL);
            for topic in dropped.keys().filter_map(|subscription| topics.get(subscription)) {
                if told.contains_key(topic) {
                    continue;
                }
                told.insert(Arc::clone(topic), Instant::now());
                // Without a number: viewers show each different text once.
                let text = format!(
                    "messages of /{topic} are dropped: the connection or the viewer is too slow for what it subscribed to"
                );
                // If there is no room the viewer is disconnected with the next announcement.
                let _ = client.outbox.announce(Frame::Text(status(Level::Warning, &text)));
            }
            let lost: u64 = dropped.values().sum();
            if lost > 0 {
                tracing::debug!("{lost} messages to viewer {} were dropped", client.id);
            }
        }
    }
}
