//! Copper: a graph of tasks that is compiled from a file, one message per connection and iteration.
// The typed handle of a running application names its log's storage; inside, the same calls are deprecated.
#![allow(deprecated)]

use std::sync::atomic::{AtomicU64, Ordering};

use benches::contestants::Contestant;
use benches::{Load, Reading, Sum};

/// The graph for a load, if there is one: graphs are fixed when this program is compiled. Copper's log of
/// messages is off.
pub fn for_load(load: Load) -> anyhow::Result<Option<Box<dyn Contestant>>> {
    Ok(match load.modules {
        1 => Some(Box::new(hop::Copper::new(load)?)),
        10 => Some(Box::new(fan_out::Copper::new(load)?)),
        _ => None,
    })
}

/// The total of the sinks when they stop.
static TOTAL: AtomicU64 = AtomicU64::new(0);
/// The number of messages of a trial; a static, because a task receives only its part of the configuration
/// file.
static MESSAGES: AtomicU64 = AtomicU64::new(1);

fn failed(load: Load, error: &dyn std::fmt::Debug) -> anyhow::Error {
    anyhow::anyhow!("Copper cannot run {load:?}: {error:?}")
}

macro_rules! graph {
    ($name:ident, $config:literal) => {
        mod $name {
            use cu29::prelude::*;

            use super::*;

            #[derive(Reflect)]
            pub struct Source {
                next: u64,
                messages: u64,
            }

            impl Freezable for Source {}

            impl CuSrcTask for Source {
                type Resources<'r> = ();
                type Output<'m> = output_msg!([u64; 4]);

                fn new(_: Option<&ComponentConfig>, _: Self::Resources<'_>) -> CuResult<Self> {
                    Ok(Self { next: 0, messages: MESSAGES.load(Ordering::Relaxed) })
                }

                fn process(&mut self, _: &CuContext, output: &mut Self::Output<'_>) -> CuResult<()> {
                    // As large as a `Reading`, which would need traits of Copper to be a payload.
                    self.next = self.next % self.messages + 1;
                    output.set_payload([self.next, 1, 2, 3]);
                    Ok(())
                }
            }

            #[derive(Reflect)]
            pub struct Sink {
                #[reflect(ignore)]
                sum: Sum,
            }

            impl Freezable for Sink {}

            impl CuSinkTask for Sink {
                type Resources<'r> = ();
                type Input<'m> = input_msg!([u64; 4]);

                fn new(_: Option<&ComponentConfig>, _: Self::Resources<'_>) -> CuResult<Self> {
                    Ok(Self { sum: Sum::default() })
                }

                fn process(&mut self, _: &CuContext, input: &Self::Input<'_>) -> CuResult<()> {
                    if let Some(payload) = input.payload() {
                        self.sum.add(&Reading { time_ns: payload[0], ..Reading::default() });
                    }
                    Ok(())
                }

                fn stop(&mut self, _: &CuContext) -> CuResult<()> {
                    TOTAL.fetch_add(self.sum.value(), Ordering::Relaxed);
                    Ok(())
                }
            }

            #[copper_runtime(config = $config)]
            struct App {}

            pub struct Copper {
                app: App,
                messages: u64,
                _log: tempfile::TempDir,
            }

            impl Copper {
                pub fn new(load: Load) -> anyhow::Result<Self> {
                    MESSAGES.store(load.messages, Ordering::Relaxed);
                    let log = tempfile::tempdir()?;
                    let path = log.path().join("peers.copper");
                    let app = App::builder()
                        .with_log_path(&path, Some(16 << 20))
                        .map_err(|error| failed(load, &error))?;
                    let app = app.build().map_err(|error| failed(load, &error))?;
                    let app = app.start().map_err(|error| failed(load, &error))?.into_inner();
                    Ok(Self { app, messages: load.messages, _log: log })
                }
            }

            impl Contestant for Copper {
                fn trial(&mut self) {
                    for _ in 0..self.messages {
                        // Messages lost by an error show in the sum.
                        let _ = self.app.run_one_iteration();
                    }
                }

                fn finish(mut self: Box<Self>) -> u64 {
                    TOTAL.store(0, Ordering::Relaxed);
                    let _ = self.app.stop_all_tasks();
                    TOTAL.load(Ordering::Relaxed)
                }
            }
        }
    };
}

graph!(hop, "src/copper_hop.ron");
graph!(fan_out, "src/copper_fan_out.ron");
