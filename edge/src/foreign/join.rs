//! How a module in another language joins a core: its declarations become ports.

use super::contract::{Event, Publisher};
use super::declarations::{Declaration, Declarations, Named};
use super::module::ForeignModule;
use super::versions::{Life, Made, prepare};
use crate::{KnownService, KnownType};
use downbeat_executor::{Context, Module, Setup, SetupError, Transition, TransitionError};
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

/// How often a module that can be reloaded is asked for a successor.
const RELOAD_PERIOD: Duration = Duration::from_millis(200);

impl Module for ForeignModule {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let joined = self.join(setup);
        self.versions.note(if joined.is_ok() { Life::Runs } else { Life::Stopped });
        joined
    }

    fn configure(&mut self, ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        self.make_transition(Transition::Configure, ctx).map_err(TransitionError::new)
    }

    fn activate(&mut self, ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        self.schedule_reload(ctx);
        self.make_transition(Transition::Activate, ctx).map_err(TransitionError::new)
    }

    fn deactivate(&mut self, ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        self.make_transition(Transition::Deactivate, ctx).map_err(TransitionError::new)
    }

    fn cleanup(&mut self, ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        self.make_transition(Transition::Cleanup, ctx).map_err(TransitionError::new)
    }

    fn shutdown(&mut self, ctx: &mut Context<'_>) {
        if let Err(reason) = self.make_transition(Transition::Shutdown, ctx) {
            tracing::error!(module = ctx.module_name(), "its shutdown failed: {reason}");
        }
    }

    fn debug(&self) -> Option<&dyn fmt::Debug> {
        self.foreign.as_ref()?.debug()
    }
}

impl ForeignModule {
    fn join(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let declared = match self.declared.take() {
            Some(declared) => declared,
            None => Arc::new(self.make(setup)?),
        };
        if let Some(description) = self.description.take() {
            setup.made_from(description);
        }
        self.declare_settings(&declared, setup)?;
        let (mut subscriptions, mut servers, mut timers) = (0_u32.., 0_u32.., 0_u32..);
        let (mut clients, mut tasks) = (0_u32.., 0_u32..);
        for declaration in &declared.items {
            match declaration {
                Declaration::Publish { topic, message } => self.declare_publisher(setup, topic, message)?,
                Declaration::Subscribe { topic, message } => {
                    let message = self.message_on(setup, topic, message)?;
                    subscribe(setup, topic, message, number(&mut subscriptions))?;
                }
                Declaration::Serve { service, of } => {
                    let service_type = self.service(setup, of)?;
                    service_type.serve_foreign(setup, service, number(&mut servers))?;
                }
                Declaration::Client { service, of, timeout } => {
                    let service_type = self.service(setup, of)?;
                    let call = service_type.foreign_client(setup, service, *timeout, number(&mut clients))?;
                    self.ports.clients.push(call);
                }
                Declaration::Every { period } => {
                    let timer = number(&mut timers);
                    setup.every(*period, move |module, ctx| module.take(Event::Timer { timer }, ctx))?;
                }
                Declaration::Task => {
                    let task = number(&mut tasks);
                    let task = setup.task(move |module, ctx| module.take(Event::Task { task }, ctx));
                    self.ports.tasks.push(task);
                }
            }
        }
        if declared.is_run_each_cycle {
            setup.each_run(|module, ctx| module.take(Event::EachRun, ctx));
        }
        if declared.is_reloading || self.versions.has_successors() {
            setup.every(RELOAD_PERIOD, Self::look_for_successor)?;
        }
        if self.versions.has_successors() {
            self.ports.reload = Some(setup.task(|module, _| module.ports.is_reload_due = true));
            // At the end of the run: where the timer is due too, it keeps its place among the others.
            setup.each_run(|module, ctx| {
                if std::mem::take(&mut module.ports.is_reload_due) {
                    module.look_for_successor(ctx);
                    module.schedule_reload(ctx);
                }
            });
        }
        self.declared = Some(declared);
        Ok(())
    }

    /// Makes the module, unless another thread has prepared it.
    fn make(&mut self, setup: &mut Setup<'_, Self>) -> Result<Declarations, SetupError> {
        let made = match self.versions.take_prepared() {
            Some(prepared) => Ok(prepared),
            None => {
                let settings = self.options.settings.clone();
                prepare(&*self.versions, setup.module_name(), settings, &self.interfaces)
            }
        };
        let failure = made.as_ref().err().map(String::as_str);
        if let Some(description) = self.versions.describe(Made::Anew(failure)) {
            setup.made_from(description);
        }
        let (foreign, declared) = made.map_err(|reason| setup.refuse(reason))?;
        self.foreign = Some(foreign);
        Ok(declared)
    }

    fn declare_settings(
        &mut self,
        declared: &Declarations,
        setup: &mut Setup<'_, Self>,
    ) -> Result<(), SetupError> {
        for (number, setting) in (0_u32..).zip(&declared.settings) {
            let (name, about, default) = (&setting.name, &setting.description, setting.default.clone());
            let key = match &setting.range {
                _ if setting.is_read_only => setup.read_only_setting(name, default, about)?,
                Some(range) => setup.setting_in(name, default, range.clone(), about)?,
                None => setup.setting(name, default, about)?,
            };
            setup.accept_if(key, move |module, value| match &mut module.foreign {
                Some(foreign) => foreign.accept(number, value),
                None => Ok(()),
            });
            setup.on_change(key, move |module, ctx| module.take(Event::Setting { setting: number }, ctx));
            self.ports.settings.push(key);
        }
        Ok(())
    }

    fn declare_publisher(
        &mut self,
        setup: &mut Setup<'_, Self>,
        topic: &str,
        message: &Named,
    ) -> Result<(), SetupError> {
        let message = self.message_on(setup, topic, message)?;
        self.ports.publishers.push(Publisher {
            key: setup.publish_of(message.in_core(), topic)?,
            topic: topic.to_owned(),
            message,
        });
        Ok(())
    }

    /// The type of that name. If the topic carries another Rust type of the same definition, that.
    fn message_on(
        &self,
        setup: &mut Setup<'_, Self>,
        topic: &str,
        Named { name, hash }: &Named,
    ) -> Result<KnownType, SetupError> {
        let found =
            self.interfaces.find_message(name).map_err(|unknown| setup.refuse(unknown.to_string()))?;
        check_hash(setup, name, hash.as_deref(), found.hash())?;
        Ok(self.interfaces.message_on(setup, topic, found))
    }

    fn service(
        &self,
        setup: &Setup<'_, Self>,
        Named { name, hash }: &Named,
    ) -> Result<KnownService, SetupError> {
        let found = self.interfaces.service(name).map_err(|unknown| setup.refuse(unknown.to_string()))?;
        check_hash(setup, name, hash.as_deref(), found.hash())?;
        Ok(found)
    }
}

fn check_hash(
    setup: &Setup<'_, ForeignModule>,
    name: &str,
    compiled: Option<&str>,
    known: &str,
) -> Result<(), SetupError> {
    match compiled {
        Some(compiled) if compiled != known => Err(setup.refuse(format!(
            "it was compiled with another definition of {name}: {compiled}, but the robot has {known}; generate its \
             messages again and compile it again"
        ))),
        _ => Ok(()),
    }
}

fn subscribe(
    setup: &mut Setup<'_, ForeignModule>,
    topic: &str,
    message: KnownType,
    subscription: u32,
) -> Result<(), SetupError> {
    let (topic_name, mut has_failed) = (topic.to_owned(), false);
    setup.subscribe_of(message.in_core(), topic, move |module, received, ctx| {
        if !message.is_type_of(received.message) {
            return;
        }
        let Some(cdr) = message.encode(received.message) else { return };
        let cdr = match message.checked(cdr) {
            Ok(cdr) => cdr,
            Err(error) => {
                if !std::mem::replace(&mut has_failed, true) {
                    let (module, topic) = (ctx.module_name(), topic_name.as_str());
                    tracing::warn!(
                        module,
                        topic,
                        "a message is no {message}: {error}; further ones are not logged"
                    );
                }
                return;
            }
        };
        let (time, missed, is_last) = (received.time, received.missed, received.is_last);
        module.take(Event::Message { subscription, cdr, time, missed, is_last }, ctx);
    })
}

fn number(numbers: &mut std::ops::RangeFrom<u32>) -> u32 {
    numbers.next().unwrap_or(u32::MAX)
}
