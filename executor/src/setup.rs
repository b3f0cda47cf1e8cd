//! What a module declares when it is added to a core.

use std::collections::BTreeMap;
use std::marker::PhantomData;
use std::ops::RangeInclusive;
use std::time::Duration;

use crate::behaviour::{Callbacks, Subscription};
use crate::context::ModuleIo;
use crate::setting::{SettingInfo, SettingType};
use crate::timer::Timer;
use crate::topic::Topics;
use crate::{Context, Publication, Received, Setting, SettingValue, SetupError, TopicInfo};

/// Passed to [`Module::setup`](crate::Module::setup): topics, timers and settings are declared here.
pub struct Setup<'a, M> {
    io: &'a mut ModuleIo,
    topics: &'a mut Topics,
    callbacks: Callbacks<M>,
    given_settings: BTreeMap<String, SettingValue>,
    remaps: BTreeMap<String, String>,
    own_topics: Vec<String>,
}

impl<'a, M> Setup<'a, M> {
    pub(crate) fn new(
        io: &'a mut ModuleIo,
        topics: &'a mut Topics,
        given_settings: BTreeMap<String, SettingValue>,
        remaps: BTreeMap<String, String>,
    ) -> Self {
        let (callbacks, own_topics) = (Callbacks::default(), Vec::new());
        Self { io, topics, callbacks, given_settings, remaps, own_topics }
    }

    /// Checks that nothing was given that the module did not ask for.
    pub(crate) fn finish(self) -> Result<Callbacks<M>, SetupError> {
        let module = self.io.name.to_string();
        if let Some((setting, _)) = self.given_settings.into_iter().next() {
            let known = self.io.settings.infos().iter().map(|info| info.name.clone()).collect();
            return Err(SetupError::UnknownSetting { module, setting, known });
        }
        if let Some((topic, _)) = self.remaps.into_iter().find(|(from, _)| !self.own_topics.contains(from)) {
            return Err(SetupError::UnknownTopic { module, topic, known: self.own_topics });
        }
        Ok(self.callbacks)
    }

    /// The name under which the module is being added.
    #[must_use]
    pub fn module_name(&self) -> &str {
        &self.io.name
    }

    /// The topics that modules have declared so far.
    #[must_use]
    pub fn topics(&self) -> &[TopicInfo] {
        self.topics.infos()
    }

    /// An error with a reason of the module's own.
    #[must_use]
    pub fn refuse(&self, reason: impl Into<String>) -> SetupError {
        SetupError::Refused { module: self.io.name.to_string(), reason: reason.into() }
    }

    /// An error with what is wrong with the value that a setting was given.
    #[must_use]
    pub fn refuse_value<T>(&self, setting: Setting<T>, refusal: impl Into<String>) -> SetupError {
        let name = self.io.settings.infos().get(setting.index).map(|info| info.name.clone());
        SetupError::SettingValue {
            module: self.io.name.to_string(),
            setting: name.unwrap_or_default(),
            refusal: refusal.into(),
        }
    }

    /// Declares that the module publishes messages of type `T` on a topic; the key is for
    /// [`Context::publish`].
    ///
    /// # Errors
    /// A name that is not valid, or a topic that carries another type.
    pub fn publish<T: Send + Sync + 'static>(&mut self, topic: &str) -> Result<Publication<T>, SetupError> {
        let index = self.open_topic::<T>(topic)?;
        self.topics.mark_published(index);
        Ok(self.io.outboxes.open(index))
    }

    /// Calls `callback` with each message of a topic, in the cycle after it was published.
    ///
    /// # Errors
    /// A name that is not valid, or a topic that carries another type.
    pub fn subscribe<T, F>(&mut self, topic: &str, callback: F) -> Result<(), SetupError>
    where
        T: Send + Sync + 'static,
        F: FnMut(&mut M, Received<'_, T>, &mut Context<'_>) + Send + 'static,
        M: 'static,
    {
        let topic = self.open_topic::<T>(topic)?;
        self.callbacks.subscriptions.push(Box::new(Subscription { topic, callback, message: PhantomData }));
        Ok(())
    }

    /// Calls `callback` every `period`, first one period after the start. Due times that were missed are
    /// skipped.
    ///
    /// # Errors
    /// A period of zero.
    pub fn every<F>(&mut self, period: Duration, callback: F) -> Result<(), SetupError>
    where
        F: FnMut(&mut M, &mut Context<'_>) + Send + 'static,
    {
        if period.is_zero() {
            return Err(SetupError::ZeroPeriod(self.io.name.to_string()));
        }
        self.io.timers.push(Timer::new(period));
        self.callbacks.timers.push(Box::new(callback));
        Ok(())
    }

    /// Declares a setting; the key is for [`Context::get`].
    ///
    /// # Errors
    /// A name used twice, or a given value of another type.
    pub fn setting<T: SettingType>(
        &mut self,
        name: &str,
        default: T,
        description: &str,
    ) -> Result<Setting<T>, SetupError> {
        self.declare_setting(name, default, None, description)
    }

    /// Declares a setting that must lie in a range.
    ///
    /// # Errors
    /// A name used twice, or a given value of another type or out of range.
    pub fn setting_in<T: SettingType>(
        &mut self,
        name: &str,
        default: T,
        range: RangeInclusive<f64>,
        description: &str,
    ) -> Result<Setting<T>, SetupError> {
        self.declare_setting(name, default, Some(range), description)
    }

    /// Calls `callback` when the value of a setting has changed.
    pub fn on_change<T, F>(&mut self, setting: Setting<T>, callback: F)
    where
        F: FnMut(&mut M, &mut Context<'_>) + Send + 'static,
    {
        self.callbacks.settings.push((setting.index, Box::new(callback)));
    }

    /// The value a setting has at the start: for what the module must know before it runs.
    #[must_use]
    pub fn value<T: SettingType>(&self, setting: Setting<T>) -> Option<&T> {
        self.io.settings.value(setting.index).and_then(T::from_value)
    }

    fn declare_setting<T: SettingType>(
        &mut self,
        name: &str,
        default: T,
        range: Option<RangeInclusive<f64>>,
        description: &str,
    ) -> Result<Setting<T>, SetupError> {
        let given = self.given_settings.remove(name);
        let (value, description) = (default.into_value(), description.to_owned());
        let info = SettingInfo { name: name.to_owned(), description, value, range };
        Ok(Setting::new(self.io.settings.declare(&self.io.name, info, given)?))
    }

    fn open_topic<T: Send + Sync + 'static>(&mut self, name: &str) -> Result<usize, SetupError> {
        let name = name.strip_prefix('/').unwrap_or(name);
        self.own_topics.push(name.to_owned());
        self.topics.open::<T>(self.remaps.get(name).map_or(name, String::as_str), &self.io.name)
    }
}
