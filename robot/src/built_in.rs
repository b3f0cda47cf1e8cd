//! The kinds of modules that this program has: those of its packages of modules.

use downbeat_darwin_op::emulator::MemoryPorts;
use downbeat_kind::Kind;

pub(crate) fn kinds() -> Vec<Kind> {
    // Emulators and hardware modules of one catalog meet here.
    let ports = MemoryPorts::default();
    let mut kinds = [
        downbeat_darwin_op::kinds(&ports),
        downbeat_imu_filter::kinds(),
        downbeat_kinematics::kinds(),
        downbeat_library_host::kinds(),
        downbeat_servos::kinds(&ports),
        downbeat_transforms::kinds(),
    ]
    .concat();
    kinds.extend(of_features(&ports));
    kinds
}

/// The names of the kinds that features of this program add.
#[cfg(test)]
pub(crate) fn kinds_of_features() -> Vec<String> {
    of_features(&MemoryPorts::default()).iter().map(|kind| kind.name().to_owned()).collect()
}

#[cfg_attr(not(feature = "physics"), allow(unused_variables))]
fn of_features(ports: &MemoryPorts) -> Vec<Kind> {
    let of_packages: &[Vec<Kind>] = &[
        #[cfg(feature = "physics")]
        downbeat_physics::kinds(ports),
        #[cfg(feature = "football")]
        downbeat_match::kinds(ports),
        #[cfg(feature = "football")]
        downbeat_player::kinds(),
        #[cfg(feature = "football")]
        downbeat_localisation::kinds(),
        #[cfg(feature = "football")]
        downbeat_vision::kinds(),
        #[cfg(feature = "leagues")]
        downbeat_leagues::kinds(),
        #[cfg(feature = "network")]
        downbeat_network::kinds(),
        #[cfg(feature = "policy")]
        downbeat_policy::kinds(),
        #[cfg(feature = "px4")]
        downbeat_px4::kinds(),
        #[cfg(feature = "sensors")]
        downbeat_sensors::kinds(),
        #[cfg(feature = "state_machine")]
        downbeat_state_machine::kinds(),
    ];
    of_packages.concat()
}
