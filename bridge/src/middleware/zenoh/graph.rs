//! The nodes and endpoints that tokens announce, and their matches with the endpoints of this participant.

use crate::middleware::{EndpointEvent, EventHandler, Gid, MatchHandler, MiddlewareError};
use crossbeam::channel::{Sender, unbounded};
use downbeat_zenoh::wire::{Announced, EndpointToken, NodeName, Role, Token, gid};
use parking_lot::Mutex;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::JoinHandle;

/// The most nodes and endpoints of others that are remembered; further ones are counted only.
pub(super) const MOST_TOKENS: usize = 16_384;

/// Nodes and endpoints of a domain.
pub(super) struct Graph {
    state: Mutex<State>,
    delivery: Delivery,
}

struct State {
    /// The session of this participant, whose tokens are known without being heard.
    own_session: String,
    endpoints: BTreeMap<Gid, Known>,
    /// The nodes of others, by the hash of their token.
    nodes: HashMap<Gid, NodeKey>,
    locals: HashMap<Gid, Local>,
    invalid: u64,
    surplus: u64,
}

/// A node of a session.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct NodeKey {
    pub(super) session: String,
    number: u64,
    pub(super) name: NodeName,
}

/// An endpoint of this or another session.
#[derive(Clone)]
pub(super) struct Known {
    pub(super) node: NodeKey,
    pub(super) endpoint: EndpointToken,
}

/// A token that others know and this participant does not, or the other way round.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Difference {
    Missing(String),
    /// Of a session.
    Gone(Gid, String),
}

impl Difference {
    /// Whether it is the end of a token of one of these sessions.
    pub(super) fn is_of(&self, sessions: &BTreeSet<String>) -> bool {
        matches!(self, Self::Gone(_, session) if sessions.contains(session))
    }
}

/// An endpoint of this participant.
struct Local {
    endpoint: EndpointToken,
    on_match: Option<Arc<MatchHandler>>,
    on_event: Option<Arc<EventHandler>>,
    matched: Arc<AtomicUsize>,
}

/// How an endpoint of this participant and another one of the same name stand to each other.
enum Relation {
    Matched,
    OtherType,
    OtherDefinition,
}

/// An event, and the handlers that were registered when it happened. `None` where only the way to a matched
/// endpoint has changed.
struct News {
    on_match: Option<Arc<MatchHandler>>,
    on_event: Option<Arc<EventHandler>>,
    event: Option<EndpointEvent>,
}

/// The thread that calls the handlers.
struct Delivery {
    news: Option<Sender<News>>,
    thread: Option<JoinHandle<()>>,
}

impl Delivery {
    fn start() -> Result<Self, MiddlewareError> {
        // Unbounded: each token brings at most one event for each endpoint of this participant.
        let (news, received) = unbounded::<News>();
        let run = move || {
            for News { on_match, on_event, event } in received {
                let is_match = matches!(
                    event,
                    None | Some(EndpointEvent::Matched { .. } | EndpointEvent::Unmatched { .. })
                );
                if let Some(handler) = on_match.filter(|_| is_match) {
                    handler();
                }
                if let (Some(handler), Some(event)) = (on_event, event) {
                    handler(&event);
                }
            }
        };
        let thread = std::thread::Builder::new().name("downbeat-zenoh-events".into()).spawn(run)?;
        Ok(Self { news: Some(news), thread: Some(thread) })
    }

    fn send(&self, news: News) {
        if let Some(sender) = &self.news {
            // Fails only when a handler has panicked.
            let _ = sender.send(news);
        }
    }
}

impl Drop for Delivery {
    fn drop(&mut self) {
        self.news = None;
        if let Some(thread) = self.thread.take()
            && thread.thread().id() != std::thread::current().id()
        {
            let _ = thread.join();
        }
    }
}

impl Graph {
    pub(super) fn new(own_session: String) -> Result<Self, MiddlewareError> {
        let state = State {
            own_session,
            endpoints: BTreeMap::new(),
            nodes: HashMap::new(),
            locals: HashMap::new(),
            invalid: 0,
            surplus: 0,
        };
        Ok(Self { state: Mutex::new(state), delivery: Delivery::start()? })
    }

    /// Takes a token, which may have been there before. Returns false if it is not one of another session.
    pub(super) fn appeared(&self, text: &str) -> bool {
        let mut state = self.state.lock();
        let Some(token) = state.read(text) else { return false };
        let key = NodeKey { session: token.session, number: token.node_id, name: token.node };
        let gid = Gid(gid(text));
        if state.nodes.len() + state.endpoints.len() >= MOST_TOKENS {
            state.surplus += 1;
            if state.surplus == 1 {
                tracing::warn!(
                    "more than {MOST_TOKENS} nodes and endpoints are announced on Zenoh: this node does not see the others"
                );
            }
            return true;
        }
        match token.announced {
            Announced::Node => {
                state.nodes.insert(gid, key);
            }
            Announced::Endpoint(endpoint) => state.add(gid, Known { node: key, endpoint }, &self.delivery),
        }
        true
    }

    /// Forgets the token of another session, which may have gone before. A node goes with its endpoints.
    pub(super) fn disappeared(&self, text: &str) {
        let mut state = self.state.lock();
        let Some(token) = state.read(text) else { return };
        let gid = Gid(gid(text));
        if token.announced != Announced::Node {
            state.remove(gid, &self.delivery);
            return;
        }
        state.nodes.remove(&gid);
        let is_its =
            |known: &Known| known.node.session == token.session && known.node.number == token.node_id;
        let its = state.endpoints.iter().filter(|(_, known)| is_its(known)).map(|(gid, _)| *gid);
        for gid in its.collect::<Vec<_>>() {
            state.remove(gid, &self.delivery);
        }
    }

    /// How what is known of other sessions differs from all tokens of the domain.
    pub(super) fn difference(&self, told: &BTreeSet<String>) -> BTreeSet<Difference> {
        let mut state = self.state.lock();
        let mut differences = BTreeSet::new();
        let mut there = HashSet::new();
        for text in told {
            if state.read(text).is_some() {
                let gid = Gid(gid(text));
                there.insert(gid);
                if !state.nodes.contains_key(&gid) && !state.endpoints.contains_key(&gid) {
                    differences.insert(Difference::Missing(text.clone()));
                }
            }
        }
        let endpoints = state.endpoints.iter().map(|(gid, known)| (gid, &known.node.session));
        let nodes = state.nodes.iter().map(|(gid, node)| (gid, &node.session));
        for (gid, session) in nodes.chain(endpoints) {
            if *session != state.own_session && !there.contains(gid) {
                differences.insert(Difference::Gone(*gid, session.clone()));
            }
        }
        differences
    }

    pub(super) fn put_right(&self, difference: &Difference) {
        match difference {
            Difference::Missing(token) => {
                self.appeared(token);
            }
            Difference::Gone(gid, _) => {
                let mut state = self.state.lock();
                state.nodes.remove(gid);
                state.remove(*gid, &self.delivery);
            }
        }
    }

    /// Adds an endpoint of this participant.
    pub(super) fn add_local(&self, gid: Gid, token: Token) {
        let Announced::Endpoint(endpoint) = token.announced else { return };
        let node = NodeKey { session: token.session, number: token.node_id, name: token.node };
        let mut state = self.state.lock();
        let local =
            Local { endpoint: endpoint.clone(), on_match: None, on_event: None, matched: Arc::default() };
        let matched = state.related(&local.endpoint, |relation| matches!(relation, Relation::Matched));
        local.matched.store(matched.len(), Ordering::Relaxed);
        state.locals.insert(gid, local);
        state.add(gid, Known { node, endpoint }, &self.delivery);
    }

    pub(super) fn remove_local(&self, gid: Gid) {
        let mut state = self.state.lock();
        state.locals.remove(&gid);
        state.remove(gid, &self.delivery);
    }

    /// The endpoints that match one of this participant.
    pub(super) fn matched(&self, local: Gid) -> Vec<Gid> {
        let state = self.state.lock();
        let of =
            |local: &Local| state.related(&local.endpoint, |relation| matches!(relation, Relation::Matched));
        state.locals.get(&local).map(of).unwrap_or_default()
    }

    /// The number of endpoints that match one of this participant, as it changes.
    pub(super) fn match_count(&self, local: Gid) -> Arc<AtomicUsize> {
        let state = self.state.lock();
        state.locals.get(&local).map(|local| Arc::clone(&local.matched)).unwrap_or_default()
    }

    pub(super) fn on_match(&self, local: Gid, handler: MatchHandler) {
        if let Some(local) = self.state.lock().locals.get_mut(&local) {
            local.on_match = Some(Arc::new(handler));
        }
    }

    /// Registers a handler and sends it the present state.
    pub(super) fn on_event(&self, local: Gid, handler: EventHandler) {
        let handler = Arc::new(handler);
        let mut state = self.state.lock();
        let Some(found) = state.locals.get_mut(&local) else { return };
        found.on_event = Some(Arc::clone(&handler));
        let endpoint = found.endpoint.clone();
        for (peer, known) in &state.endpoints {
            if let Some(relation) = relation(&endpoint, &known.endpoint) {
                let event = event(&relation, *peer, &known.endpoint);
                let on_event = Some(Arc::clone(&handler));
                self.delivery.send(News { on_match: None, on_event, event: Some(event) });
            }
        }
    }

    /// Calls the handler for changes of the matched endpoints.
    pub(super) fn way_changed(&self, local: Gid) {
        let on_match = self.state.lock().locals.get(&local).and_then(|local| local.on_match.clone());
        self.delivery.send(News { on_match, on_event: None, event: None });
    }

    /// Reports an event of an endpoint of this participant.
    pub(super) fn happened(&self, local: Gid, event: EndpointEvent) {
        let on_event = self.state.lock().locals.get(&local).and_then(|local| local.on_event.clone());
        self.delivery.send(News { on_match: None, on_event, event: Some(event) });
    }

    pub(super) fn is_known(&self, gid: Gid) -> bool {
        self.state.lock().endpoints.contains_key(&gid)
    }

    /// The endpoints of other sessions.
    pub(super) fn remote(&self) -> Vec<(Gid, Known)> {
        let state = self.state.lock();
        let is_remote = |known: &Known| known.node.session != state.own_session;
        let remote = state.endpoints.iter().filter(|(_, known)| is_remote(known));
        remote.map(|(gid, known)| (*gid, known.clone())).collect()
    }

    /// The nodes of other sessions. A node is known by any of its tokens.
    pub(super) fn remote_nodes(&self) -> Vec<NodeKey> {
        let state = self.state.lock();
        let with_token = state.nodes.values();
        let with_endpoint = state.endpoints.values().map(|known| &known.node);
        let mut nodes: Vec<_> = with_token
            .chain(with_endpoint.filter(|node| node.session != state.own_session))
            .cloned()
            .collect();
        nodes.sort();
        nodes.dedup();
        nodes
    }

    /// The hash with which a server of this name and type is announced.
    pub(super) fn server_hash(&self, name: &str, type_name: &str) -> Option<String> {
        let state = self.state.lock();
        let mut servers = state.endpoints.values().filter(|known| {
            let EndpointToken { role, name: its, type_name: of_type, .. } = &known.endpoint;
            *role == Role::Server && its == name && of_type == type_name
        });
        servers.find_map(|known| known.endpoint.hash.clone())
    }
}

impl State {
    /// Reads the token of another session; `None` if it is none, or of this session.
    fn read(&mut self, text: &str) -> Option<Token> {
        match text.parse::<Token>() {
            Ok(token) => (token.session != self.own_session).then_some(token),
            Err(error) => {
                self.invalid += 1;
                if self.invalid == 1 {
                    let text = downbeat_msgs::printable(text);
                    tracing::debug!(token = %text, "a token on Zenoh is skipped, further ones are counted: {error}");
                }
                None
            }
        }
    }

    fn add(&mut self, gid: Gid, known: Known, delivery: &Delivery) {
        if self.endpoints.contains_key(&gid) {
            return;
        }
        for local in self.locals.values() {
            if let Some(relation) = relation(&local.endpoint, &known.endpoint) {
                if matches!(relation, Relation::Matched) {
                    local.matched.fetch_add(1, Ordering::Relaxed);
                }
                delivery.send(local.news(event(&relation, gid, &known.endpoint)));
            }
        }
        self.endpoints.insert(gid, known);
    }

    fn remove(&mut self, gid: Gid, delivery: &Delivery) {
        let Some(known) = self.endpoints.remove(&gid) else { return };
        for local in self.locals.values() {
            if let Some(Relation::Matched) = relation(&local.endpoint, &known.endpoint) {
                local.matched.fetch_sub(1, Ordering::Relaxed);
                delivery.send(local.news(EndpointEvent::Unmatched { peer: gid }));
            }
        }
    }

    fn related(&self, local: &EndpointToken, is_meant: impl Fn(&Relation) -> bool) -> Vec<Gid> {
        let meant = |known: &Known| relation(local, &known.endpoint).is_some_and(|found| is_meant(&found));
        self.endpoints.iter().filter(|(_, known)| meant(known)).map(|(gid, _)| *gid).collect()
    }
}

impl Local {
    fn news(&self, event: EndpointEvent) -> News {
        News { on_match: self.on_match.clone(), on_event: self.on_event.clone(), event: Some(event) }
    }
}

/// `None` where the two have nothing to do with each other.
fn relation(local: &EndpointToken, other: &EndpointToken) -> Option<Relation> {
    if other.role != local.role.opposite() || other.name != local.name {
        return None;
    }
    if other.type_name != local.type_name {
        return Some(Relation::OtherType);
    }
    let (asking, asked) = match local.role {
        Role::Subscription | Role::Client => (local, other),
        Role::Publisher | Role::Server => (other, local),
    };
    // A subscription or client that knows no hash uses the key with any.
    let is_same = asking.hash.is_none() || asking.hash == asked.hash;
    Some(if is_same { Relation::Matched } else { Relation::OtherDefinition })
}

/// The event about another endpoint, `peer`.
fn event(relation: &Relation, peer: Gid, theirs: &EndpointToken) -> EndpointEvent {
    match relation {
        Relation::Matched => EndpointEvent::Matched { peer },
        Relation::OtherType => {
            EndpointEvent::IncompatibleType { peer, type_name: theirs.type_name[..].into() }
        }
        Relation::OtherDefinition => {
            EndpointEvent::IncompatibleDefinition { peer, type_hash: theirs.hash.as_deref().map(Into::into) }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::sync::mpsc;
    use std::time::Duration;

    const HASH: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

    fn token(session: &str, number: u64, role: &str, hash: &str) -> String {
        let node = format!("@ros2_lv/0/{session}/0/{number}/{role}/%/%/node");
        format!("{node}/%chatter/std_msgs::msg::dds_::String_/{hash}/::,10:,:,:,,")
    }

    fn local(graph: &Graph, role: &str) -> Gid {
        let text = token("a", 1, role, HASH);
        let gid = Gid(gid(&text));
        graph.add_local(gid, text.parse().unwrap());
        gid
    }

    #[test]
    fn a_token_that_comes_or_goes_twice_counts_once() {
        let graph = Graph::new("a".into()).unwrap();
        let local = local(&graph, "MS");
        let (sender, events) = mpsc::channel();
        graph.on_event(local, Box::new(move |event| sender.send(event.clone()).unwrap()));
        let publisher = token("b", 1, "MP", HASH);
        let peer = Gid(gid(&publisher));
        for _ in 0..2 {
            graph.appeared(&publisher);
        }
        assert_eq!(graph.matched(local), [peer]);
        for _ in 0..2 {
            graph.disappeared(&publisher);
        }
        assert_eq!(graph.match_count(local).load(Ordering::Relaxed), 0);
        drop(graph);
        let events: Vec<_> = events.iter().collect();
        assert_eq!(events, [EndpointEvent::Matched { peer }, EndpointEvent::Unmatched { peer }]);
    }

    #[test]
    fn another_hash_is_reported_and_not_matched() {
        let graph = Graph::new("a".into()).unwrap();
        let local = local(&graph, "MP");
        let other = HASH.replace("df66", "0000");
        let subscription = token("b", 1, "MS", &other);
        graph.appeared(&subscription);
        let (sender, events) = mpsc::channel();
        graph.on_event(local, Box::new(move |event| sender.send(event.clone()).unwrap()));
        let peer = Gid(gid(&subscription));
        let expected = EndpointEvent::IncompatibleDefinition { peer, type_hash: Some(other[..].into()) };
        assert_eq!(events.recv_timeout(Duration::from_secs(10)).unwrap(), expected);
        assert_eq!(graph.matched(local), []);
    }

    #[test]
    fn a_node_goes_with_its_endpoints_and_is_known_by_any_token() {
        let graph = Graph::new("a".into()).unwrap();
        graph.appeared(&token("b", 1, "MP", HASH));
        assert_eq!(graph.remote_nodes().len(), 1);
        let node = "@ros2_lv/0/b/0/0/NN/%/%/node";
        graph.appeared(node);
        assert_eq!((graph.remote_nodes().len(), graph.remote().len()), (1, 1));
        graph.disappeared(node);
        assert_eq!((graph.remote_nodes().len(), graph.remote().len()), (0, 0));
        graph.disappeared(&token("b", 1, "MP", HASH));
    }

    #[test]
    fn more_tokens_than_the_bound_are_not_remembered() {
        let graph = Graph::new("a".into()).unwrap();
        for number in 0..MOST_TOKENS as u64 + 10 {
            graph.appeared(&token("b", number, "MP", HASH));
        }
        assert_eq!(graph.remote().len(), MOST_TOKENS);
    }

    #[test]
    fn keys_that_are_no_tokens_are_skipped() {
        let graph = Graph::new("a".into()).unwrap();
        for wrong in ["", "@ros2_lv/0", "@ros2_lv/0/\u{1b}[2J/0/0/NN/%/%/x", "@ros2_lv/0/b/0/1/XX/%/%/x"] {
            graph.appeared(wrong);
            graph.disappeared(wrong);
        }
        assert_eq!(graph.remote_nodes(), []);
    }
}
