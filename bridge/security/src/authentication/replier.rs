//! The participant that waits for the request and sends the reply.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use downbeat_rtps::wire::Guid;

use super::agreement::EphemeralKey;
use super::context::{Context, GIVE_UP, Output, Peers, unexpected};
use super::credentials::Credentials;
use super::identity::{RemoteIdentity, SharedSecret};
use super::messages::{
    Challenge, Exchange, FINAL, REQUEST, Reply, Request, challenges, emit_begin, verify_final,
};
use super::refusal::Refusal;
use super::resend::Resend;
use crate::tokens::{GenericMessage, Token, class};

/// Anyone can send a request in the name of the initiator. Several are kept, so that a forged one does not
/// displace the initiator's own.
const MAX_PENDING: usize = 4;
/// After this time without a request, the initiator is asked for one: it may not know that this participant
/// has forgotten it.
const ASKS_AFTER: Duration = Duration::from_secs(1);
/// After which a reply is forgotten.
const MAX_RESENT: u32 = 10;

#[derive(Debug)]
pub(super) struct Replier {
    /// The oldest first.
    pending: VecDeque<Pending>,
    /// The random numbers of the last finished handshake.
    done: Option<(Challenge, Challenge)>,
    /// Questions for a request, with the random number that they announce.
    asks: Resend,
    announced: Option<Challenge>,
    gives_up: Instant,
    refusal: Option<Refusal>,
}

/// A reply was sent.
struct Pending {
    request: Token,
    message: GenericMessage,
    exchange: Exchange,
    remote: RemoteIdentity,
    secret: SharedSecret,
    resend: Resend,
}

impl Replier {
    pub(super) fn new(now: Instant) -> Self {
        Self {
            pending: VecDeque::new(),
            done: None,
            asks: Resend::after(ASKS_AFTER, now),
            announced: None,
            gives_up: now + GIVE_UP,
            refusal: None,
        }
    }

    pub(super) fn is_done(&self) -> bool {
        self.done.is_some()
    }

    pub(super) fn next_timeout(&self) -> Option<Instant> {
        let gives_up = (!self.is_done()).then_some(self.gives_up);
        let asks = self.is_waiting().then_some(self.asks.next);
        self.pending.iter().map(|pending| pending.resend.next).chain(gives_up).chain(asks).min()
    }

    /// Whether no request has arrived.
    fn is_waiting(&self) -> bool {
        !self.is_done() && self.pending.is_empty()
    }

    pub(super) fn handle_timeout(&mut self, peers: Peers, context: &mut Context<'_>) -> Vec<Output> {
        let now = context.now;
        let mut outputs = Vec::new();
        if self.is_waiting() && self.asks.is_due(now) {
            let token = emit_begin(&self.challenge(context));
            let message = peers.message(token, None, context);
            let class = class::AUTHENTICATION_REQUEST.into();
            outputs.push(Output::Send(GenericMessage { class, ..message }));
        }
        self.pending.retain_mut(|pending| {
            if pending.resend.is_due(now) && pending.resend.count <= MAX_RESENT {
                outputs.push(Output::Send(pending.message.clone()));
            }
            pending.resend.count <= MAX_RESENT
        });
        if !self.is_done() && self.gives_up <= now {
            self.gives_up = now + GIVE_UP;
            let no_answer = Refusal::NoAnswer { seconds: GIVE_UP.as_secs() };
            outputs.push(Output::GaveUp(self.refusal.take().unwrap_or(no_answer)));
        }
        outputs
    }

    /// The random number of the next reply, which has to be the announced one.
    fn challenge(&mut self, context: &mut Context<'_>) -> Challenge {
        *self.announced.get_or_insert_with(|| {
            let mut challenge = [0; 32];
            (context.random)(&mut challenge);
            challenge
        })
    }

    pub(super) fn handle(
        &mut self,
        peers: Peers,
        source: (Guid, i64),
        token: &Token,
        context: &mut Context<'_>,
    ) -> Vec<Output> {
        let result = match &*token.class_id {
            REQUEST => self.handle_request(peers, source, token, context),
            FINAL => self.handle_final(token),
            _ => return vec![unexpected(token)],
        };
        match result {
            Ok(output) => output.into_iter().collect(),
            Err(refusal) => {
                self.refusal = Some(refusal.clone());
                vec![Output::Refused(refusal)]
            }
        }
    }

    fn handle_request(
        &mut self,
        peers: Peers,
        source: (Guid, i64),
        token: &Token,
        context: &mut Context<'_>,
    ) -> Result<Option<Output>, Refusal> {
        if let Some(pending) = self.pending.iter().find(|pending| pending.request == *token) {
            return Ok(Some(Output::Send(pending.message.clone())));
        }
        let request = Request::parse(token)?;
        // A late copy of the request that is already answered.
        if self.done.is_some_and(|(challenge1, _)| challenge1 == request.challenge1) {
            return Ok(None);
        }
        let challenge2 = self.challenge(context);
        let pending = Pending::begin(peers, source, token, &request, challenge2, context)?;
        let reply = pending.message.clone();
        if self.pending.len() >= MAX_PENDING {
            self.pending.pop_front();
        }
        self.pending.push_back(pending);
        Ok(Some(Output::Send(reply)))
    }

    fn handle_final(&mut self, token: &Token) -> Result<Option<Output>, Refusal> {
        let challenges = challenges(token)?;
        if self.done == Some(challenges) {
            return Ok(None);
        }
        let of_token = |pending: &&Pending| pending.challenges() == challenges;
        let pending = self.pending.iter().find(of_token).ok_or(Refusal::Mismatch { field: "challenge2" })?;
        verify_final(token, &pending.exchange, &pending.remote)?;
        let (remote, secret) = (Box::new(pending.remote.clone()), pending.secret.clone());
        (self.done, self.announced) = (Some(challenges), None);
        self.pending.clear();
        self.refusal = None;
        Ok(Some(Output::Done { remote, secret }))
    }
}

impl Pending {
    fn begin(
        peers: Peers,
        source: (Guid, i64),
        token: &Token,
        request: &Request<'_>,
        challenge2: Challenge,
        context: &mut Context<'_>,
    ) -> Result<Self, Refusal> {
        let remote = request.credentials.check(peers.remote.prefix, context.identity, context.time)?;
        let key = EphemeralKey::generate(request.method, context.random);
        let secret = key.agree(&request.dh1).ok_or(Refusal::PublicKey { field: "dh1" })?;
        let credentials = Credentials::own(context.identity, context.participant_data, request.method);
        let Request { hash1, challenge1, .. } = *request;
        let (dh1, hash2) = (request.dh1.clone(), credentials.hash());
        let exchange = Exchange { hash1, hash2, dh1, dh2: key.public(), challenge1, challenge2 };
        let reply = Reply::sign(credentials, exchange, context.identity);
        let message = peers.message(reply.emit(), Some(source), context);
        Ok(Self {
            request: token.clone(),
            message,
            exchange: reply.exchange,
            remote,
            secret: SharedSecret { challenge1, challenge2, secret },
            resend: Resend::new(context.now),
        })
    }

    fn challenges(&self) -> (Challenge, Challenge) {
        (self.exchange.challenge1, self.exchange.challenge2)
    }
}

impl std::fmt::Debug for Pending {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Pending").field("resend", &self.resend).finish_non_exhaustive()
    }
}
