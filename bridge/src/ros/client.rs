//! Services that a node calls.

use super::definition::Definition;
use super::introspection::{Event, ServiceEvents};
use super::node::{Hold, Listed};
use super::{Introspection, Node, NodeError, ServiceName, ServiceType};
use crate::middleware::Direction;
use crate::middleware::rpc::{Answer, CallError, RequestClient};
use bytes::Bytes;
use downbeat_executor::Clock;
use downbeat_msgs::cdr;
use downbeat_msgs::qos::QosProfile;
use std::marker::PhantomData;
use std::sync::Arc;
use std::time::Duration;

/// Calls a service of type `S` that nodes of other processes offer. See [`Service`](super::Service) for an
/// example.
pub struct Client<S> {
    raw: RawClient,
    service: PhantomData<fn() -> S>,
}

impl<S: downbeat_msgs::Service> Client<S> {
    /// The absolute name of the service.
    #[must_use]
    pub fn name(&self) -> &ServiceName {
        self.raw.name()
    }

    /// Whether a server is matched.
    #[must_use]
    pub fn is_available(&self) -> bool {
        self.raw.is_available()
    }

    /// Waits until a server is matched, at most for `timeout`. Returns true if one is.
    #[must_use]
    pub fn wait_for_service(&self, timeout: Duration) -> bool {
        self.raw.wait_for_service(timeout)
    }

    /// Publishes what this client sends and receives; see [`RawClient::configure_introspection`].
    ///
    /// # Errors
    /// [`NodeError`] when the engine refuses the publisher.
    pub fn configure_introspection(
        &self,
        node: &Node,
        introspection: Introspection,
        qos: QosProfile,
        clock: Arc<dyn Clock>,
    ) -> Result<(), NodeError> {
        self.raw.configure_introspection(node, introspection, qos, clock)
    }

    /// Asks. `on_reply` is called once, with the answer or why there is none, on the thread that the services
    /// and clients of the participant share; it must return soon, and may ask again. Does not block.
    pub fn call(
        &self,
        request: &S::Request,
        timeout: Duration,
        on_reply: impl FnOnce(Result<S::Response, CallError>) + Send + 'static,
    ) {
        let service = self.name().to_string();
        self.raw.call(cdr::to_vec(request).into(), timeout, move |result| {
            on_reply(result.and_then(|cdr| {
                cdr::from_slice(&cdr)
                    .map_err(|error| CallError::Answer { service, reason: error.to_string() })
            }));
        });
    }

    /// Asks and waits for the answer. Not for handlers of services and clients: they run on the thread that
    /// would bring the answer, so that the time would always run out.
    ///
    /// # Errors
    /// [`CallError`] when there is no answer.
    pub fn call_and_wait(&self, request: &S::Request, timeout: Duration) -> Result<S::Response, CallError> {
        let (sender, answer) = crossbeam::channel::bounded(1);
        self.call(request, timeout, move |result| {
            // Who waits takes the first.
            let _ = sender.try_send(result);
        });
        let service = || self.name().to_string();
        match answer.recv_timeout(timeout.saturating_add(GRACE)) {
            Ok(result) => result,
            Err(_) => Err(CallError::TimedOut { service: service(), timeout }),
        }
    }
}

/// The thread of the handlers may be busy when the time is up.
const GRACE: Duration = Duration::from_secs(1);

/// Calls a service by bytes: encapsulation header and body.
pub struct RawClient {
    name: ServiceName,
    service_type: ServiceType,
    // Fields drop in this order, as in a publisher.
    _listed: [Listed; 2],
    client: RequestClient,
    events: Arc<ServiceEvents>,
    _hold: Hold,
}

impl RawClient {
    /// The absolute name of the service.
    #[must_use]
    pub fn name(&self) -> &ServiceName {
        &self.name
    }

    /// Its type.
    #[must_use]
    pub fn service_type(&self) -> &ServiceType {
        &self.service_type
    }

    /// Whether a server is matched.
    #[must_use]
    pub fn is_available(&self) -> bool {
        self.client.servers() > 0
    }

    /// Waits until a server is matched, at most for `timeout`. Returns true if one is.
    #[must_use]
    pub fn wait_for_service(&self, timeout: Duration) -> bool {
        self.client.wait_for_server(timeout)
    }

    /// Asks, with the bytes of the request (little-endian); see [`Client::call`].
    pub fn call(
        &self,
        request: Bytes,
        timeout: Duration,
        on_reply: impl FnOnce(Result<Bytes, CallError>) + Send + 'static,
    ) {
        let (_, client) = self.client.gids();
        let events = Arc::clone(&self.events);
        // Held until the event of the request is published: that of its answer follows.
        let publishing = self.events.hold();
        let number = self.client.call(request.clone(), timeout, move |answer| {
            on_reply(answer.map(|Answer { number, cdr }| {
                events.publish_event(Event::ResponseReceived, client, number, &cdr);
                cdr
            }));
        });
        if let Some(number) = number {
            publishing.publish_event(Event::RequestSent, client, number, &request);
        }
    }

    /// Sets what is published on `<service>/_service_event` of the requests and responses of this client.
    /// `node` is the node of the client, `clock` stamps the events.
    ///
    /// # Errors
    /// [`NodeError`] when the engine refuses the publisher.
    pub fn configure_introspection(
        &self,
        node: &Node,
        introspection: Introspection,
        qos: QosProfile,
        clock: Arc<dyn Clock>,
    ) -> Result<(), NodeError> {
        self.events.configure(node, introspection, qos, clock)
    }
}

impl Node {
    /// A client of a service; `service` may be absolute, relative or private (`~/…`).
    ///
    /// # Errors
    /// [`NodeError`] when a name is not valid or the engine refuses.
    pub fn client<S: downbeat_msgs::Service>(
        &self,
        service: &str,
        qos: QosProfile,
    ) -> Result<Client<S>, NodeError> {
        let raw = self.client_raw(service, &ServiceType::new(S::TYPE_NAME)?, qos)?;
        Ok(Client { raw, service: PhantomData })
    }

    /// A client of a service whose type this program may not know.
    ///
    /// # Errors
    /// [`NodeError`] when a name is not valid or the engine refuses.
    pub fn client_raw(
        &self,
        service: &str,
        service_type: &ServiceType,
        qos: QosProfile,
    ) -> Result<RawClient, NodeError> {
        let name = self.service_name(service)?;
        let shared = &self.membership.shared;
        let endpoint = name.endpoint(self.name(), &shared.interfaces, service_type, qos);
        let client = RequestClient::new(&*shared.middleware, &shared.worker, &endpoint)?;
        let [requests, replies] = Definition::of_service(shared, &name, service_type, &endpoint);
        client.on_events(requests, replies);
        let (reader, writer) = client.gids();
        let events = ServiceEvents::new(&name, service_type);
        Ok(RawClient {
            name,
            service_type: service_type.clone(),
            _listed: [
                Listed::new(self.hold(), Direction::In, reader),
                Listed::new(self.hold(), Direction::Out, writer),
            ],
            client,
            events,
            _hold: self.hold(),
        })
    }
}
