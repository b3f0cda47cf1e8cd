//! The services of modules that viewers can call.

use crate::outbox::{Frame, Outbox};
use crate::protocol::call_failure;
use downbeat_edge::{EncodedCaller, Interfaces, KnownService};
use downbeat_executor::{Core, ServiceInfo, SetupError};
use downbeat_msgs::dynamic::{Definitions, Schemas};
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// How long a server may take.
const PATIENCE: Duration = Duration::from_secs(10);

/// A service of modules.
pub(crate) struct ShownService {
    id: u32,
    name: Arc<str>,
    service_type: KnownService,
    /// The definition texts of request and response.
    texts: [String; 2],
    caller: EncodedCaller,
}

/// The services that modules serve when the server starts, also those of actions, except for those whose
/// types are unknown.
///
/// # Errors
/// [`SetupError`] when the core has no caller for a service.
pub(crate) fn shown(core: &mut Core, interfaces: &Interfaces) -> Result<Vec<ShownService>, SetupError> {
    let served: Vec<ServiceInfo> = core.services().filter(|info| info.server.is_some()).cloned().collect();
    let definitions = interfaces.definitions();
    let mut shown = Vec::new();
    for (id, info) in (1..).zip(served) {
        let Some(service_type) = interfaces.service_in(core, &info.name) else { continue };
        let name = service_type.name();
        // Of another version than the name stands for.
        let own =
            interfaces.service(name).is_ok_and(|known| known.hash() != service_type.hash()).then(|| {
                let mut schemas = Schemas::new("the service");
                schemas
                    .add(name, "ros2msg", service_type.definition())
                    .map(|()| Definitions::new().with(schemas))
            });
        let definitions = own.as_ref().and_then(|own| own.as_ref().ok()).unwrap_or(&definitions);
        let text = |part| definitions.find_text(&format!("{name}_{part}")).map(|found| found.0);
        let (Ok(request), Ok(response)) = (text("Request"), text("Response")) else { continue };
        let caller = service_type.caller(core, &info.name)?;
        shown.push(ShownService { id, name: info.name, service_type, texts: [request, response], caller });
    }
    Ok(shown)
}

impl ShownService {
    pub(crate) fn id(&self) -> u32 {
        self.id
    }

    /// As the protocol announces it.
    pub(crate) fn announcement(&self) -> Value {
        let type_name = self.service_type.name();
        let part = |suffix: &str, text: &str| {
            json!({
                "encoding": "cdr",
                "schemaName": format!("{type_name}_{suffix}"),
                "schemaEncoding": "ros2msg",
                "schema": text,
            })
        };
        json!({
            "id": self.id,
            "name": format!("/{}", self.name),
            "type": type_name,
            "request": part("Request", &self.texts[0]),
            "response": part("Response", &self.texts[1]),
        })
    }

    /// Calls the service. The response goes to `outbox`; `open` counts the calls without one.
    pub(crate) fn call(&self, call_id: u32, request: &[u8], outbox: &Arc<Outbox>, open: &Arc<AtomicUsize>) {
        let (service_id, outbox, open) = (self.id, Arc::clone(outbox), Arc::clone(open));
        open.fetch_add(1, Ordering::Relaxed);
        self.caller.call(request, PATIENCE, move |result| {
            open.fetch_sub(1, Ordering::Relaxed);
            let frame = match result {
                Ok(answer) => Frame::Response { service_id, call_id, answer },
                Err(error) => Frame::Text(call_failure(service_id, call_id, &error.to_string())),
            };
            // On the thread of the core: a viewer that reads no answers loses this one.
            let _ = outbox.announce(frame);
        });
    }
}
