//! iceoryx2 within one process.

use anyhow::anyhow;
use benches::contestants::Contestant;
use benches::{Load, Reading, Sum};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;

/// A [`Reading`] in a form that is valid in shared memory.
#[derive(Clone, Copy, Debug, ZeroCopySend)]
#[repr(C)]
struct SharedReading {
    time_ns: u64,
    angular_velocity: [f32; 3],
    linear_acceleration: [f32; 3],
}

impl From<Reading> for SharedReading {
    fn from(reading: Reading) -> Self {
        let Reading { time_ns, angular_velocity, linear_acceleration } = reading;
        Self { time_ns, angular_velocity, linear_acceleration }
    }
}

impl From<&SharedReading> for Reading {
    fn from(reading: &SharedReading) -> Self {
        let &SharedReading { time_ns, angular_velocity, linear_acceleration } = reading;
        Self { time_ns, angular_velocity, linear_acceleration }
    }
}

/// One process-local publish-subscribe service, with buffers of one batch for each subscriber.
pub struct Iceoryx {
    load: Load,
    publisher: Publisher<local::Service, SharedReading, ()>,
    subscribers: Vec<(Subscriber<local::Service, SharedReading, ()>, Sum)>,
    /// Keeps the service's participant alive.
    _node: Node<local::Service>,
}

impl Iceoryx {
    pub fn new(load: Load) -> anyhow::Result<Self> {
        let failed = |what: &str, error: String| anyhow!("iceoryx2 cannot {what} for {load:?}: {error}");
        let node = NodeBuilder::new()
            .create::<local::Service>()
            .map_err(|error| failed("make a node", format!("{error:?}")))?;
        let name = format!("peers/{}x{}", load.modules, load.messages);
        let name =
            name.as_str().try_into().map_err(|error| failed("name a service", format!("{error:?}")))?;
        let service = node
            .service_builder(&name)
            .publish_subscribe::<SharedReading>()
            .max_publishers(1)
            .max_subscribers(usize::try_from(load.modules)?)
            .subscriber_max_buffer_size(usize::try_from(load.batch.get().min(load.messages))?)
            .create()
            .map_err(|error| failed("make a service", format!("{error:?}")))?;
        let publisher = service
            .publisher_builder()
            .create()
            .map_err(|error| failed("make a publisher", format!("{error:?}")))?;
        let subscribers = (0..load.modules)
            .map(|_| Ok((service.subscriber_builder().create()?, Sum::default())))
            .collect::<Result<_, iceoryx2::port::subscriber::SubscriberCreateError>>()
            .map_err(|error| failed("make a subscriber", format!("{error:?}")))?;
        Ok(Self { load, publisher, subscribers, _node: node })
    }
}

impl Contestant for Iceoryx {
    fn trial(&mut self) {
        for batch in self.load.batches() {
            for number in batch {
                // Messages lost by an error show in the sum.
                if let Ok(sample) = self.publisher.loan_uninit() {
                    let _ = sample.write_payload(Reading::new(number).into()).send();
                }
            }
            for (subscriber, sum) in &mut self.subscribers {
                while let Ok(Some(sample)) = subscriber.receive() {
                    sum.add(&sample.payload().into());
                }
            }
        }
    }

    fn finish(self: Box<Self>) -> u64 {
        self.subscribers.iter().fold(0, |total, (_, sum)| total.wrapping_add(sum.value()))
    }
}
