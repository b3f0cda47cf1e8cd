//! The mechanism "settings": gives settings the values that were asked for.

use super::{SettingsChange, report};
use crate::core::SyncPhase;
use crate::detached::Parcel;
use crate::management::{Command, Place, SettingRefused, find};
use crate::mechanism::{Mechanism, Version};
use crate::{ModuleId, SettingInfo};

/// Values are given in the order in which they were asked for: by other threads before by modules.
pub(crate) struct SettingsMechanism;

impl Mechanism for SettingsMechanism {
    type View = ();
    type Request = ();

    const NAME: &'static str = "settings";
    const VERSION: Version = Version::new(1, 0);

    fn view(&self) {}

    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        for command in std::mem::take(&mut phase.world.joined.settings) {
            match command {
                Command::Set { module, setting, value, receipt } => match find(phase, &module) {
                    Ok(id) => {
                        let parcel = Parcel::Set { setting, value, receipt };
                        set(phase, id, &module, parcel);
                    }
                    Err(unknown) => refuse(receipt, unknown.into()),
                },
                Command::Transfer { from, to, receipt } => match (find(phase, &from), find(phase, &to)) {
                    (Ok(from), Ok(id)) => {
                        transfer(phase, from, id, &to);
                        if let Some(receipt) = receipt {
                            receipt.send(Ok(()));
                        }
                    }
                    (Err(unknown), _) | (_, Err(unknown)) => refuse(receipt, unknown.into()),
                },
                // The mechanism "modules" keeps the others.
                _ => {}
            }
        }
    }
}

fn set(phase: &mut SyncPhase<'_>, id: ModuleId, module: &str, parcel: Parcel) {
    match (id.place, parcel) {
        (Place::Attached(slot), Parcel::Set { setting, value, receipt }) => {
            let cell = phase.stage.cell(slot);
            let value = cell.and_then(|cell| {
                let result = cell.set(&setting, value);
                report(module, &setting, result, receipt)
            });
            if let Some(value) = value {
                let (time, settings) = (phase.now, vec![(setting, value)]);
                phase.note_change(id, SettingsChange { time, module: module.into(), step: None, settings });
            }
            phase.wake(id);
        }
        (Place::Detached(slot), parcel) => {
            if let Some(module) = &phase.world.detached[slot] {
                module.send(parcel);
            }
        }
        (Place::Attached(_), _) => {}
    }
}

fn transfer(phase: &mut SyncPhase<'_>, from: ModuleId, to: ModuleId, module: &str) {
    let given = settings_of(phase, from);
    let taken = settings_of(phase, to);
    for SettingInfo { name, value, .. } in given {
        let is_taken = |info: &SettingInfo| info.name == name && !info.is_read_only && info.value != value;
        if taken.iter().any(is_taken) {
            set(phase, to, module, Parcel::Set { setting: name, value, receipt: None });
        }
    }
}

fn settings_of(phase: &mut SyncPhase<'_>, id: ModuleId) -> Vec<SettingInfo> {
    phase.world.settings(phase.stage, id)
}

fn refuse(
    receipt: Option<crate::receipt::ReceiptSender<Result<(), SettingRefused>>>,
    refused: SettingRefused,
) {
    match receipt {
        Some(receipt) => receipt.send(Err(refused)),
        None => tracing::warn!("setting not changed: {refused}"),
    }
}
