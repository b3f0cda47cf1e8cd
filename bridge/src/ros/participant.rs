//! A participant as ROS 2 sees it: nodes in the graph.

use super::graph::{Graph, RemoteNode};
use super::membership::{Furnisher, Membership, NodeError, Shared};
use super::{Node, NodeName, RemapRules, type_description};
use crate::edge::Interfaces;
use crate::middleware::{
    self, Middleware, MiddlewareError, ParticipantOptions, RemoteEndpoint, SecurityWatch,
};
use crate::worker::{Worker, WorkerLink};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::type_description_interfaces::srv::GetTypeDescription;
use parking_lot::Mutex;
use std::sync::{Arc, Weak};

/// One participant of the domain, which all nodes of a process share.
///
/// When the last node, publisher and subscription made from it is dropped too, it leaves the domain: its
/// nodes disappear from the graph of others at once, and its threads have ended when the drop returns.
#[derive(Clone)]
pub struct Participant {
    pub(super) shared: Arc<Shared>,
}

/// The participants of this process, for [`leave_all`].
static JOINED: Mutex<Vec<Weak<Shared>>> = Mutex::new(Vec::new());

/// Leaves all domains without waiting for acknowledgements, for a process that is about to end without
/// dropping its participants. Their nodes and endpoints disappear from the graphs of others at once.
pub fn leave_all() {
    let joined: Vec<_> = JOINED.lock().iter().filter_map(Weak::upgrade).collect();
    for shared in &joined {
        shared.graph.leave();
        shared.middleware.leave();
    }
    // Dropping the last handle of a participant would wait for its peers and threads.
    std::mem::forget(joined);
}

/// Keeps the registration of [`Participant::furnish`] until it is dropped.
pub struct Furnishing {
    _furnisher: Arc<Furnisher>,
}

impl Participant {
    /// Joins the domain that the options name.
    ///
    /// # Errors
    /// [`MiddlewareError`] when the domain cannot be joined.
    pub fn join(options: &ParticipantOptions) -> Result<Self, MiddlewareError> {
        Self::on(middleware::join(options)?)
    }

    /// Joins the domain that the options name; the rules apply to all names of its nodes. `interfaces` has
    /// the types that its endpoints announce and its nodes describe.
    ///
    /// # Errors
    /// [`MiddlewareError`] when the domain cannot be joined.
    pub fn join_with(
        options: &ParticipantOptions,
        remaps: RemapRules,
        interfaces: Interfaces,
    ) -> Result<Self, MiddlewareError> {
        Self::on_with(middleware::join(options)?, remaps, interfaces)
    }

    /// Stands on a participant that exists, of whatever engine.
    ///
    /// # Errors
    /// [`MiddlewareError`] when the endpoints of the node graph cannot be created.
    pub fn on(middleware: Arc<dyn Middleware>) -> Result<Self, MiddlewareError> {
        Self::on_with(middleware, RemapRules::default(), Interfaces::carried())
    }

    /// Stands on a participant that exists; otherwise as [`Participant::join_with`].
    ///
    /// # Errors
    /// [`MiddlewareError`] when the endpoints of the node graph cannot be created.
    pub fn on_with(
        middleware: Arc<dyn Middleware>,
        remaps: RemapRules,
        interfaces: Interfaces,
    ) -> Result<Self, MiddlewareError> {
        let worker = Worker::start().map_err(MiddlewareError::ServiceThread)?;
        let graph = Graph::join(&middleware, worker.link())?;
        let (nodes, furnishers) = (Mutex::default(), Mutex::default());
        let shared = Arc::new(Shared { graph, worker, middleware, remaps, interfaces, nodes, furnishers });
        let mut joined = JOINED.lock();
        joined.retain(|shared| shared.strong_count() > 0);
        joined.push(Arc::downgrade(&shared));
        drop(joined);
        Ok(Self { shared })
    }

    /// Creates a node, with another name if a remapping rule applies. It offers the service
    /// `~/get_type_description`, as all nodes of Jazzy do.
    ///
    /// # Errors
    /// [`NodeError`] when this participant has a node of that name, or the engine refuses the service.
    pub fn create_node(&self, name: NodeName) -> Result<Node, NodeError> {
        let given = name;
        let name = self.shared.remaps.node(&given)?;
        if !self.shared.graph.add_node(&name)? {
            return Err(NodeError::Exists(name));
        }
        let node = Node::new(&self.shared, name);
        let interfaces = self.shared.interfaces.clone();
        let service = node.by_itself().serve::<GetTypeDescription>(
            type_description::SERVICE,
            QosProfile::SERVICES,
            move |request| type_description::answer(&interfaces, &request),
        )?;
        node.attach(service);
        let furnishers: Vec<_> = self.shared.furnishers.lock().iter().filter_map(Weak::upgrade).collect();
        furnishers.iter().try_for_each(|furnish| furnish(&node.membership))?;
        self.shared.nodes.lock().insert(given, node.downgrade());
        Ok(node)
    }

    pub(crate) fn worker(&self) -> WorkerLink {
        self.shared.worker.link()
    }

    /// Calls `furnish` with each node that is created from now on, until the returned value is dropped: for
    /// the endpoints that all nodes of a program have. Those that are made from the node it is given go when
    /// the node goes, and are given to [`Node::attach`] for that.
    #[must_use = "it ends when it is dropped"]
    pub fn furnish(
        &self,
        furnish: impl Fn(&Node) -> Result<(), NodeError> + Send + Sync + 'static,
    ) -> Furnishing {
        let furnisher: Arc<Furnisher> = Arc::new(move |membership: &Arc<Membership>| {
            furnish(&Node::of(Arc::clone(membership)).by_itself())
        });
        let mut furnishers = self.shared.furnishers.lock();
        furnishers.retain(|furnisher| furnisher.strong_count() > 0);
        furnishers.push(Arc::downgrade(&furnisher));
        Furnishing { _furnisher: furnisher }
    }

    /// The types that its endpoints and nodes know.
    #[must_use]
    pub fn interfaces(&self) -> &Interfaces {
        &self.shared.interfaces
    }

    /// Tells the state of DDS Security. `None` without it.
    #[must_use]
    pub fn security(&self) -> Option<SecurityWatch> {
        self.shared.middleware.security()
    }

    /// The endpoints of other participants that are known at this moment.
    #[must_use]
    pub fn remote_endpoints(&self) -> Vec<RemoteEndpoint> {
        self.shared.middleware.remote_endpoints()
    }

    /// Whether everything that others have announced so far is known: the nodes of each participant that was
    /// discovered, and all endpoints of these. Participants that have not answered yet are not known, so that
    /// it may become false again. Never true while there are none, or participants that are no ROS 2 nodes.
    #[must_use]
    pub fn has_heard_all(&self) -> bool {
        self.shared.graph.has_heard_all(&*self.shared.middleware)
    }

    /// The nodes of other participants. Those that were there before take some seconds to be heard of.
    #[must_use]
    pub fn remote_nodes(&self) -> Vec<RemoteNode> {
        self.shared.graph.remote_nodes(&self.shared.middleware.remote_endpoints())
    }
}

impl Node {
    /// The node of the same participant that was requested with that name; it is created if there is none.
    ///
    /// # Errors
    /// [`NodeError`] if a remapping rule gives it an invalid name, or the name of another node.
    pub fn sibling(&self, name: &NodeName) -> Result<Self, NodeError> {
        let shared = &self.membership.shared;
        let found = shared.nodes.lock().get(name).and_then(Weak::upgrade);
        match found {
            Some(membership) => Ok(Self::of(membership)),
            None => Participant { shared: Arc::clone(shared) }.create_node(name.clone()),
        }
    }

    /// The participant it is a node of.
    #[must_use]
    pub fn participant(&self) -> Participant {
        Participant { shared: Arc::clone(&self.membership.shared) }
    }
}
