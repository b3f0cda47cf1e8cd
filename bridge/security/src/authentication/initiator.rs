//! The participant that sends the request and the final message.

use std::time::Instant;

use downbeat_rtps::wire::Guid;

use super::agreement::{EphemeralKey, Method};
use super::context::{Context, GIVE_UP, Output, Peers, unexpected};
use super::credentials::Credentials;
use super::identity::SharedSecret;
use super::messages::{Exchange, REPLY, Reply, Request, emit_final};
use super::refusal::Refusal;
use super::resend::Resend;
use crate::tokens::{GenericMessage, Token};

#[derive(Debug)]
pub(super) struct Initiator(State);

#[derive(Debug)]
enum State {
    /// The request is sent at this time.
    Idle(Instant),
    Waiting(Box<Waiting>),
    /// The final message is repeated if the reply is.
    Done {
        reply: Token,
        last: GenericMessage,
    },
}

/// A request was sent.
struct Waiting {
    request: Token,
    message: GenericMessage,
    key: EphemeralKey,
    resend: Resend,
    gives_up: Instant,
    refusal: Option<Refusal>,
}

impl Initiator {
    pub(super) fn new(now: Instant) -> Self {
        Self(State::Idle(now))
    }

    pub(super) fn begin_again(&mut self, now: Instant) {
        if !matches!(self.0, State::Waiting(_)) {
            self.0 = State::Idle(now);
        }
    }

    pub(super) fn is_done(&self) -> bool {
        matches!(self.0, State::Done { .. })
    }

    pub(super) fn next_timeout(&self) -> Option<Instant> {
        match &self.0 {
            State::Idle(begin) => Some(*begin),
            State::Waiting(waiting) => Some(waiting.resend.next.min(waiting.gives_up)),
            State::Done { .. } => None,
        }
    }

    pub(super) fn handle_timeout(&mut self, peers: Peers, context: &mut Context<'_>) -> Vec<Output> {
        let now = context.now;
        match &mut self.0 {
            State::Idle(begin) if *begin <= now => {
                let waiting = Waiting::begin(peers, context);
                let request = waiting.message.clone();
                self.0 = State::Waiting(Box::new(waiting));
                vec![Output::Send(request)]
            }
            State::Waiting(waiting) if waiting.gives_up <= now => {
                let no_answer = Refusal::NoAnswer { seconds: GIVE_UP.as_secs() };
                let refusal = waiting.refusal.take().unwrap_or(no_answer);
                self.0 = State::Idle(now + GIVE_UP);
                vec![Output::GaveUp(refusal)]
            }
            State::Waiting(waiting) => match waiting.resend.is_due(now) {
                true => vec![Output::Send(waiting.message.clone())],
                false => Vec::new(),
            },
            State::Idle(_) | State::Done { .. } => Vec::new(),
        }
    }

    pub(super) fn handle(
        &mut self,
        peers: Peers,
        source: (Guid, i64),
        token: &Token,
        context: &mut Context<'_>,
    ) -> Vec<Output> {
        if token.class_id != REPLY {
            return vec![unexpected(token)];
        }
        match &mut self.0 {
            State::Idle(_) => Vec::new(),
            State::Waiting(waiting) => match waiting.finish(peers, source, token, context) {
                Ok((last, done)) => {
                    self.0 = State::Done { reply: token.clone(), last: last.clone() };
                    vec![Output::Send(last), done]
                }
                Err(refusal) => {
                    waiting.refusal = Some(refusal.clone());
                    vec![Output::Refused(refusal)]
                }
            },
            State::Done { reply, last } if reply == token => vec![Output::Send(last.clone())],
            State::Done { .. } => Vec::new(),
        }
    }
}

impl Waiting {
    fn begin(peers: Peers, context: &mut Context<'_>) -> Self {
        let method = Method::Ecdh;
        let key = EphemeralKey::generate(method, context.random);
        let mut challenge1 = [0; 32];
        (context.random)(&mut challenge1);
        let credentials = Credentials::own(context.identity, context.participant_data, method);
        let (hash1, dh1) = (credentials.hash(), key.public());
        let request = Request { credentials, method, hash1, dh1, challenge1 }.emit();
        Self {
            message: peers.message(request.clone(), None, context),
            request,
            key,
            resend: Resend::new(context.now),
            gives_up: context.now + GIVE_UP,
            refusal: None,
        }
    }

    fn finish(
        &self,
        peers: Peers,
        source: (Guid, i64),
        token: &Token,
        context: &mut Context<'_>,
    ) -> Result<(GenericMessage, Output), Refusal> {
        let reply = Reply::parse(token, &Request::parse(&self.request)?)?;
        let remote = reply.credentials.check(peers.remote.prefix, context.identity, context.time)?;
        reply.verify(&remote)?;
        let exchange = &reply.exchange;
        let secret = self.key.agree(&exchange.dh2).ok_or(Refusal::PublicKey { field: "dh2" })?;
        let last = emit_final(exchange, context.identity);
        let last = peers.message(last, Some(source), context);
        let Exchange { challenge1, challenge2, .. } = *exchange;
        let secret = SharedSecret { challenge1, challenge2, secret };
        Ok((last, Output::Done { remote: Box::new(remote), secret }))
    }
}

impl std::fmt::Debug for Waiting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Waiting").field("resend", &self.resend).finish_non_exhaustive()
    }
}
