//! Services that a node offers.

use super::definition::Definition;
use super::introspection::{Event, ServiceEvents};
use super::node::{Hold, Listed};
use super::{Introspection, Node, NodeError, ServiceName, ServiceType};
use crate::edge::KnownService;
#[cfg(doc)]
use crate::edge::Refusals;
use crate::limiter::Limiter;
use crate::middleware::Direction;
use crate::middleware::rpc::{
    IncomingRequest, RefusalHandler, ReplyError, RequestHandler, RequestServer, Responder,
};
use crate::worker::Mailbox;
use downbeat_executor::Clock;
use downbeat_msgs::cdr;
use downbeat_msgs::qos::QosProfile;
use std::marker::PhantomData;
use std::sync::Arc;

/// A service that a node offers, until this is dropped.
///
/// ```
/// # use downbeat_bridge::middleware::in_process::Hub;
/// use downbeat_bridge::ros::{NodeName, Participant};
/// use downbeat_msgs::qos::QosProfile;
/// use downbeat_msgs::std_srvs::srv::{SetBool, SetBoolResponse};
/// use std::time::Duration;
/// # let hub = Hub::new();
/// # let join = || Participant::on(std::sync::Arc::new(hub.join()));
///
/// let robot = join()?.create_node(NodeName::new("/", "robot")?)?;
/// let _light = robot.serve::<SetBool>("light", QosProfile::SERVICES, |request| SetBoolResponse {
///     success: true,
///     message: format!("on: {}", request.data),
/// })?;
///
/// let script = join()?.create_node(NodeName::new("/", "script")?)?;
/// let light = script.client::<SetBool>("light", QosProfile::SERVICES)?;
/// assert!(light.wait_for_service(Duration::from_secs(10)));
/// let answer = light.call_and_wait(&Default::default(), Duration::from_secs(10))?;
/// assert_eq!(answer.message, "on: false");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Service {
    name: ServiceName,
    service_type: ServiceType,
    // Fields drop in this order, as in a publisher.
    _listed: [Listed; 2],
    server: RequestServer,
    events: Arc<ServiceEvents>,
    _hold: Hold,
}

impl Service {
    /// Its absolute name.
    #[must_use]
    pub fn name(&self) -> &ServiceName {
        &self.name
    }

    /// Its type.
    #[must_use]
    pub fn service_type(&self) -> &ServiceType {
        &self.service_type
    }

    /// Sets what is published on `<service>/_service_event` of the requests and responses of this service.
    /// `node` is the node that offers it, `clock` stamps the events.
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

    /// See [`RequestServer::on_refusal`].
    pub fn on_refusal(&self, refusal: RefusalHandler) {
        self.server.on_refusal(refusal);
    }

    /// How many clients are matched.
    #[must_use]
    pub fn matched_clients(&self) -> usize {
        self.server.matched_clients()
    }

    /// Requests that were refused since too many others were not answered yet.
    #[must_use]
    pub fn refused_requests(&self) -> u64 {
        self.server.refused_requests()
    }

    /// Replies that were dropped since their client was not matched in time.
    #[must_use]
    pub fn unreachable_clients(&self) -> u64 {
        self.server.unreachable_clients()
    }
}

/// Answers one request of service `S`. Dropped without an answer, it refuses the request, see [`Refusals`].
#[must_use = "a request is answered with `send`"]
pub struct Reply<S> {
    responder: Responder,
    service: PhantomData<fn() -> S>,
}

impl<S: downbeat_msgs::Service> Reply<S> {
    /// Sends the answer. Does not block.
    ///
    /// # Errors
    /// [`ReplyError`] when it was not sent.
    pub fn send(self, response: &S::Response) -> Result<(), ReplyError> {
        self.responder.reply(cdr::to_vec(response).into())
    }
}

/// A handler of raw requests that reads them. Those that it cannot read are refused.
fn typed<S: downbeat_msgs::Service>(
    mut on_request: impl FnMut(S::Request, Reply<S>) + Send + 'static,
) -> RequestHandler {
    let unread = Limiter::default();
    let refusals = refusals_of(KnownService::of::<S>());
    Box::new(move |IncomingRequest { cdr, client, responder, .. }| match cdr::from_slice(&cdr) {
        Ok(request) => on_request(request, Reply { responder, service: PhantomData }),
        Err(error) => {
            let type_name = S::TYPE_NAME;
            if let Some(left_out) = unread.allow() {
                tracing::warn!(%client, "a request is refused: its bytes are no {type_name}: {error}{left_out}");
            }
            let refusal = refusals(&format!("the request is no {type_name}: {error}"));
            if let Err(error) = responder.reply(refusal) {
                tracing::debug!(%error, "a refusal was not sent");
            }
        }
    })
}

fn refusals_of(service_type: KnownService) -> RefusalHandler {
    let refusals = service_type.refusals();
    Box::new(move |reason| refusals.response(reason).into())
}

/// Publishes events of each request and its response.
fn observed(events: Arc<ServiceEvents>, mut on_request: RequestHandler) -> RequestHandler {
    Box::new(move |mut request: IncomingRequest| {
        let (client, number, events) = (request.request_client, request.number, Arc::clone(&events));
        events.publish_event(Event::RequestReceived, client, number, &request.cdr);
        request.responder = request
            .responder
            .when_sent(move |response| events.publish_event(Event::ResponseSent, client, number, response));
        on_request(request);
    })
}

impl Node {
    /// Offers a service whose requests are answered at once. `service` may be absolute, relative or private
    /// (`~/…`). `on_request` runs on the thread that the services and clients of the participant share, so it
    /// must return soon.
    ///
    /// # Errors
    /// [`NodeError`] when a name is not valid or the engine refuses.
    pub fn serve<S: downbeat_msgs::Service>(
        &self,
        service: &str,
        qos: QosProfile,
        mut on_request: impl FnMut(S::Request) -> S::Response + Send + 'static,
    ) -> Result<Service, NodeError> {
        self.serve_later::<S>(service, qos, move |request, reply| {
            if let Err(error) = reply.send(&on_request(request)) {
                tracing::debug!(%error, "a reply was not sent");
            }
        })
    }

    /// Offers a service whose requests may be answered later, from any thread; see [`Node::serve`]. A request
    /// that is not of the type of the service is refused, see [`Refusals`]: with rclcpp its client would wait
    /// for ever.
    ///
    /// # Errors
    /// [`NodeError`] when a name is not valid or the engine refuses.
    pub fn serve_later<S: downbeat_msgs::Service>(
        &self,
        service: &str,
        qos: QosProfile,
        on_request: impl FnMut(S::Request, Reply<S>) + Send + 'static,
    ) -> Result<Service, NodeError> {
        let service =
            self.serve_raw(service, &ServiceType::new(S::TYPE_NAME)?, qos, typed::<S>(on_request))?;
        service.on_refusal(refusals_of(KnownService::of::<S>()));
        Ok(service)
    }

    /// Offers a service whose requests wait in a mailbox until somebody answers them. One that finds it full
    /// is not answered, which is logged.
    pub(crate) fn serve_into<S: downbeat_msgs::Service, T: Send + 'static>(
        &self,
        service: &str,
        qos: QosProfile,
        mailbox: &Mailbox<T>,
        request: fn(S::Request, Reply<S>) -> T,
    ) -> Result<Service, NodeError> {
        let (requests, unanswered) = (mailbox.clone(), Limiter::default());
        let name = service.to_owned();
        self.serve_later::<S>(service, qos, move |body, reply| {
            if requests.push(request(body, reply)).is_err()
                && let Some(left_out) = unanswered.allow()
            {
                tracing::warn!(service = name, "a request is not answered: too many others wait{left_out}");
            }
        })
    }

    /// Offers a service of a type that this program may not know: requests and replies are their bytes,
    /// encapsulation header and body.
    ///
    /// # Errors
    /// [`NodeError`] when a name is not valid or the engine refuses.
    pub fn serve_raw(
        &self,
        service: &str,
        service_type: &ServiceType,
        qos: QosProfile,
        on_request: RequestHandler,
    ) -> Result<Service, NodeError> {
        let name = self.service_name(service)?;
        let shared = &self.membership.shared;
        let endpoint = name.endpoint(self.name(), &shared.interfaces, service_type, qos);
        let events = ServiceEvents::new(&name, service_type);
        let on_request = observed(Arc::clone(&events), on_request);
        let server = RequestServer::new(&*shared.middleware, &shared.worker, &endpoint, on_request)?;
        let [requests, replies] = Definition::of_service(shared, &name, service_type, &endpoint);
        server.on_events(requests, replies);
        let (reader, writer) = server.gids();
        Ok(Service {
            name,
            service_type: service_type.clone(),
            _listed: [
                Listed::new(self.hold(), Direction::In, reader),
                Listed::new(self.hold(), Direction::Out, writer),
            ],
            server,
            events,
            _hold: self.hold(),
        })
    }
}
