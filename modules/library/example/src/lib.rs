//! A module in Rust as a shared library.

use downbeat_library::executor::{Client, Module, Publication, Setting, Setup, SetupError, Task};
use downbeat_library::msgs::Service;
use downbeat_library::msgs::std_msgs::msg::Float64;
use downbeat_library::msgs::std_srvs::srv::{SetBoolRequest, SetBoolResponse};
use std::time::Duration;
use user_msgs::my_msgs::srv::{LevelRequest, LevelResponse};

/// Publishes on `out` what it receives on `in`, times its setting `gain`; counts on `ticks`; serves `enable` and, of a type of its own, `level`; calls `other`.
#[derive(Default)]
pub struct Amplifier {
    ticks: f64,
}

/// The ports of an [`Amplifier`].
pub struct Ports {
    out: Publication<Float64>,
    ticks: Publication<Float64>,
    answers: Publication<Float64>,
    gain: Setting<f64>,
    client: Client<SetBoolRequest, SetBoolResponse>,
    later: Task,
}

impl Module for Amplifier {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        setup.subscribe::<Float64, _>("in", |_, message, ctx| {
            let Ports { out, gain, .. } = *ctx.ports;
            let (gain, number) = (*ctx.get(gain), message.data);
            assert!(number >= 0.0, "a negative number");
            ctx.publish(out, Float64 { data: gain * number });
        })?;
        setup.every(Duration::from_millis(10), |amplifier, ctx| {
            amplifier.ticks += 1.0;
            let ticks = ctx.ports.ticks;
            ctx.publish(ticks, Float64 { data: amplifier.ticks });
        })?;
        setup.serve::<SetBoolRequest, SetBoolResponse, _>("enable", |_, request, _| match request.data {
            true => Ok(SetBoolResponse { success: true, message: "on".to_owned() }),
            false => Err("it stays on".to_owned()),
        })?;
        setup.serve::<LevelRequest, LevelResponse, _>("level", |_, request, _| {
            let is_level = request.speed < 1.0;
            Ok(LevelResponse { is_level, ..LevelResponse::default() })
        })?;
        setup.subscribe::<Float64, _>("ask", |_, _, ctx| {
            let later = ctx.ports.later;
            ctx.schedule_after(later, Duration::from_millis(10));
        })?;
        let later = setup.task(|_, ctx| {
            let client = ctx.ports.client;
            ctx.call(client, SetBoolRequest { data: true });
            ctx.call(client, SetBoolRequest { data: false });
        });
        let gain = setup.setting_in("gain", 2.0, 0.0..=10.0, "of the output")?;
        setup.accept_if(gain, |_, gain| if *gain == 7.0 { Err("not seven".to_owned()) } else { Ok(()) });
        Ok(Ports {
            out: setup.publish("out")?,
            ticks: setup.publish("ticks")?,
            answers: setup.publish("answers")?,
            gain,
            client: setup.client::<SetBoolRequest, SetBoolResponse, _>(
                "other",
                Duration::from_secs(1),
                |_, reply, ctx| {
                    let answers = ctx.ports.answers;
                    ctx.publish(answers, Float64 { data: if reply.result.is_ok() { 1.0 } else { -1.0 } });
                },
            )?,
            later,
        })
    }
}

downbeat_library::export_module!(Amplifier, user_msgs::my_msgs::srv::Level::INTERFACES);
