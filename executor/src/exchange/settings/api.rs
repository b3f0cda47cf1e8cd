//! The use of settings by modules and programs: functions of [`Setup`], [`Context`], [`Core`] and
//! [`CoreHandle`].

use std::ops::RangeInclusive;
use std::sync::Arc;

use super::{Command, SetReceipt, Setting, SettingRefused, Settings, SettingsPort};
use crate::module::{Causes, Direction, Host, ModuleIo, Place, SETTINGS, Use, UseEnds};
use crate::threads::receipt;
use crate::{
    Context, Core, CoreHandle, Module, Receipt, SettingInfo, SettingType, SettingValue, Setup, SetupError,
};

impl<M: Module> Setup<'_, M> {
    /// Declares a setting; the key is for [`Context::get`].
    ///
    /// # Errors
    /// If the name is used twice, or the given value has another type.
    pub fn setting<T: SettingType>(
        &mut self,
        name: &str,
        default: T,
        description: &str,
    ) -> Result<Setting<T>, SetupError> {
        self.declare_setting(SettingInfo::new(name, default, description))
    }

    /// Declares a setting that must lie in a range.
    ///
    /// # Errors
    /// If the name is used twice, or the default or the given value has another type or is out of range.
    pub fn setting_in<T: SettingType>(
        &mut self,
        name: &str,
        default: T,
        range: RangeInclusive<f64>,
        description: &str,
    ) -> Result<Setting<T>, SetupError> {
        let range = Some(range);
        self.declare_setting(SettingInfo { range, ..SettingInfo::new(name, default, description) })
    }

    /// Declares a setting that is set before the start and cannot change after it.
    ///
    /// # Errors
    /// If the name is used twice, or the given value has another type.
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use downbeat_executor::{Core, ManualClock, Module, ModuleOptions, Setup, SetupError, Time};
    /// struct Servos;
    ///
    /// impl Module for Servos {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         setup.read_only_setting("port", "/dev/ttyUSB0".to_owned(), "serial device")?;
    ///         Ok(())
    ///     }
    /// }
    ///
    /// let settings = [("port".to_owned(), "/dev/ttyACM0".to_owned().into())].into();
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add_with("servos", Servos, ModuleOptions { settings, ..ModuleOptions::default() })?;
    /// let refused = core.handle().set("servos", "port", "/dev/null".to_owned());
    /// core.cycle()?;
    /// assert!(refused.try_take().unwrap().is_err());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn read_only_setting<T: SettingType>(
        &mut self,
        name: &str,
        default: T,
        description: &str,
    ) -> Result<Setting<T>, SetupError> {
        self.declare_setting(SettingInfo {
            is_read_only: true,
            ..SettingInfo::new(name, default, description)
        })
    }

    /// Declares a text setting with fixed choices, which is set before the start and cannot change after it.
    ///
    /// # Errors
    /// If the name is used twice, or the default or the given value is not one of the choices.
    ///
    /// ```
    /// # use downbeat_executor::{Core, Module, ModuleOptions, Setup, SetupError};
    /// struct Camera;
    ///
    /// impl Module for Camera {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         setup.read_only_choice("format", "rgb8", &["rgb8", "mono8"], "of the pixels")?;
    ///         Ok(())
    ///     }
    /// }
    ///
    /// let settings = [("format".to_owned(), "rbg8".to_owned().into())].into();
    /// let options = ModuleOptions { settings, ..ModuleOptions::default() };
    /// let refused = Core::new().add_with("camera", Camera, options).unwrap_err();
    /// assert!(refused.to_string().contains("\"rbg8\" is none of rgb8, mono8"));
    /// ```
    pub fn read_only_choice(
        &mut self,
        name: &str,
        default: &str,
        choices: &[&str],
        description: &str,
    ) -> Result<Setting<String>, SetupError> {
        let choices = choices.iter().map(|&choice| choice.to_owned()).collect();
        self.declare_setting(SettingInfo {
            choices,
            is_read_only: true,
            ..SettingInfo::new(name, default.to_owned(), description)
        })
    }

    /// Calls `callback` when the value of a setting has changed.
    pub fn on_change<T, F>(&mut self, setting: Setting<T>, callback: F)
    where
        F: FnMut(&mut M, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        let next = |io: &mut ModuleIo, _| io.port::<SettingsPort>(SETTINGS)?.take_change();
        self.steps.add_chosen(Causes::SETTINGS, next, setting.index, callback);
    }

    /// The initial value of a setting, for modules that need it before they run.
    #[must_use]
    pub fn value<T: SettingType>(&self, setting: Setting<T>) -> Option<&T> {
        self.io.look::<SettingsPort>(SETTINGS)?.value(setting.index).and_then(T::from_value)
    }

    /// Calls `check` with each new value of a setting before it takes effect while the module runs. If
    /// `check` returns an error text, the value is refused and nothing changes. `check` runs in the sync
    /// phase, or on the module's thread if the module is detached.
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use downbeat_executor::{Core, ManualClock, Module, ModuleOptions, Setup, SetupError, Time};
    /// struct Camera;
    ///
    /// impl Module for Camera {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         let width = setup.setting("width", 640_i64, "of the image, pixels")?;
    ///         setup.accept_if(width, |_, width| match width % 16 {
    ///             0 => Ok(()),
    ///             _ => Err(format!("{width} is not a multiple of 16")),
    ///         });
    ///         Ok(())
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("camera", Camera)?;
    /// let refused = core.handle().set("camera", "width", 600_i64);
    /// core.cycle()?;
    /// assert!(refused.try_take().unwrap().unwrap_err().to_string().contains("600 is not a multiple of 16"));
    /// assert_eq!(core.settings("camera").unwrap()[0].value, 640_i64.into());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn accept_if<T, F>(&mut self, setting: Setting<T>, mut check: F)
    where
        T: SettingType,
        F: FnMut(&mut M, &T) -> Result<(), String> + Send + 'static,
    {
        let check = move |module: &mut M, value: &SettingValue| {
            T::from_value(value).map_or(Ok(()), |value| check(module, value))
        };
        self.steps.checks.push((setting.index, Box::new(check)));
    }

    /// An error that refuses the given value of a setting, with a reason.
    #[must_use]
    pub fn refuse_value<T>(&self, setting: Setting<T>, refusal: impl Into<String>) -> SetupError {
        let settings = self.io.look::<SettingsPort>(SETTINGS).map_or(&[][..], |port| &port.infos);
        SetupError::SettingValue {
            module: self.io.name.to_string(),
            setting: settings.get(setting.index).map(|info| info.name.clone()).unwrap_or_default(),
            refusal: refusal.into(),
        }
    }

    fn declare_setting<T: SettingType>(&mut self, info: SettingInfo) -> Result<Setting<T>, SetupError> {
        let given = self.take_given_setting(&info.name);
        let (name, place) = (Arc::clone(&self.io.name), self.io.id.place);
        let port = self.io.open_own::<SettingsPort>(SETTINGS);
        let index = port.declare(&name, info, given)?;
        if let Place::Detached(_) = place {
            let info = port.infos[index].clone();
            if let Some(settings) = settings_of(self.host) {
                settings.detached.entry(self.io.id).or_default().push(info);
            }
            self.uses.push(Use {
                of: SETTINGS,
                direction: Direction::In,
                index,
                ends: UseEnds::AtEnd,
                give_back: |host, module, _| {
                    settings_of(host).map(|settings| settings.detached.remove(&module));
                },
            });
        }
        Ok(Setting::new(index))
    }
}

fn settings_of(host: &mut dyn Host) -> Option<&mut Settings> {
    host.mechanism(SETTINGS)?.downcast_mut()
}

impl<P> Context<'_, P> {
    /// The value of a setting in this cycle.
    #[must_use]
    pub fn get<T: SettingType>(&self, setting: Setting<T>) -> &T {
        let port = self.look::<SettingsPort>(SETTINGS);
        match port.and_then(|port| port.value(setting.index)).and_then(T::from_value) {
            Some(value) => value,
            None => self.foreign("read a setting with"),
        }
    }

    /// Changes a setting of this module or another. A refused value is logged, and nothing changes.
    pub fn set(&mut self, module: &str, setting: &str, value: impl Into<SettingValue>) {
        let (module, setting, value) = (module.to_owned(), setting.to_owned(), value.into());
        self.set_later(Command::Set { module, setting, value, receipt: None });
    }

    /// Copies the current values of the settings of `from` to `to` in the sync phase, for all settings that
    /// both have and `to` does not refuse. This is for a module that replaces another.
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, Module, ModuleOptions, Setup, SetupError, Time};
    /// struct Gait;
    ///
    /// impl Module for Gait {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         let step = setup.setting("step_length", 0.03, "m")?;
    ///         // The name by which the next gait is asked for.
    ///         setup.subscribe::<String, _>("next_gait", move |_, name, ctx| {
    ///             let old = ctx.module_name().to_owned();
    ///             assert!(*ctx.get(step) > 0.0);
    ///             ctx.add(&name, Gait, ModuleOptions::default());
    ///             ctx.transfer_settings(&old, &name); // Additions come before settings.
    ///         })
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// let settings = [("step_length".to_owned(), 0.05.into())].into();
    /// core.add_with("walk", Gait, ModuleOptions { settings, ..ModuleOptions::default() })?;
    /// core.inlet("next_gait")?.publish("trot".to_owned())?;
    /// core.cycle()?;
    /// core.cycle()?;
    /// assert_eq!(core.settings("trot").unwrap()[0].value, 0.05.into());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn transfer_settings(&mut self, from: &str, to: &str) {
        self.set_later(Command::Transfer { from: from.to_owned(), to: to.to_owned(), receipt: None });
    }

    fn set_later(&mut self, command: Command) {
        self.io().ask(SETTINGS);
        self.io().open_own::<SettingsPort>(SETTINGS).commands.push(command);
    }
}

impl Core {
    /// The settings of a module; `None` if there is no such module.
    #[must_use]
    pub fn settings(&self, module: &str) -> Option<Vec<SettingInfo>> {
        let id = self.state.members.find(module)?.id;
        Some(self.mechanisms.get::<Settings>(SETTINGS)?.infos(&self.stage, id))
    }

    /// The settings declared by the module whose setup failed most recently; for descriptions of modules that
    /// lack a required setting.
    #[must_use]
    pub fn refused_settings(&self) -> &[SettingInfo] {
        &self.state.refused_settings
    }
}

impl CoreHandle {
    /// Changes a setting of a module.
    pub fn set(
        &self,
        module: &str,
        setting: &str,
        value: impl Into<SettingValue>,
    ) -> Receipt<Result<(), SettingRefused>> {
        let (module, setting, value) = (module.to_owned(), setting.to_owned(), value.into());
        self.set_later(|receipt| Command::Set { module, setting, value, receipt })
    }

    /// Copies the values of the settings of `from` to `to`, see
    /// [`Context::transfer_settings`](crate::Context::transfer_settings).
    pub fn transfer_settings(&self, from: &str, to: &str) -> Receipt<Result<(), SettingRefused>> {
        let (from, to) = (from.to_owned(), to.to_owned());
        self.set_later(|receipt| Command::Transfer { from, to, receipt })
    }

    /// The settings of a module with their values; `None` if there is no such module.
    #[must_use = "the answer is in the receipt"]
    pub fn settings(&self, module: &str) -> Receipt<Option<Vec<SettingInfo>>> {
        let module = module.to_owned();
        self.ask(move |phase| {
            let id = phase.state.members.find(&module)?.id;
            Some(phase.mechanisms.get::<Settings>(SETTINGS)?.infos(phase.stage, id))
        })
    }

    fn set_later(&self, command: impl FnOnce(SetReceipt) -> Command) -> Receipt<Result<(), SettingRefused>> {
        let (sender, receipt) = receipt();
        if !self.link.is_closed() {
            let command = command(Some(sender));
            self.link.post(SETTINGS, |settings: &mut Settings| settings.commands.push((None, command)));
        }
        receipt
    }
}
