//! Settings of a module as parameters of a secured node.

use crate::common::RunningCore;
use crate::peer::Vendor;
use crate::{check, pairs};
use downbeat_bridge::expose::{ParameterExposure, ParameterServer, TopicPattern};
use downbeat_executor::{Core, Module, Setup, SetupError};

struct Arm;

impl Module for Arm {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.setting("gain", 1.0, "of the joint controller, 1/s")?;
        Ok(())
    }
}

fn parameters_are_listed(vendor: Vendor) {
    let Some(_check) = check(vendor, "names of parameters") else { return };
    for (ours, mut peer) in pairs(vendor, &["list /node"]) {
        let mut core = Core::new();
        core.add("arm", Arm).unwrap();
        let exposure =
            ParameterExposure { settings: [TopicPattern::new("arm.*").unwrap()].into(), of_module: None };
        let _parameters = ParameterServer::new(&core, None).serve(&ours.node, exposure).unwrap();
        let _running = RunningCore::start(core);
        let listed = peer.wait_until("the names of parameters", |line| line.starts_with("listed /node"));
        assert!(listed.split(' ').any(|name| name == "arm.gain"), "{listed}");
    }
}

#[test]
fn cyclone_dds_lists_parameters() {
    parameters_are_listed(Vendor::Cyclone);
}

#[test]
fn fast_dds_lists_parameters() {
    parameters_are_listed(Vendor::Fast);
}
