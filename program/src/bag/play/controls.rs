//! Requests to a player while it plays: the services of rosbag2's player.
//!
//! Names, types and responses are those of `rosbag2_transport/src/rosbag2_transport/player.cpp`, branch
//! jazzy.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use downbeat_bridge::ros::{Node, NodeError, Reply, Service};
use downbeat_msgs::Service as ServiceType;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rosbag2_interfaces::srv::{
    Burst, GetRate, IsPaused, Pause, Play, PlayNext, PlayRequest, Resume, Seek, SetRate, Stop, TogglePaused,
};

/// A request, with the handle for its response.
pub(super) enum Control {
    Burst(u64, Reply<Burst>),
    GetRate(Reply<GetRate>),
    IsPaused(Reply<IsPaused>),
    Pause(Reply<Pause>),
    /// Restart with a part.
    Play(Part, Reply<Play>),
    PlayNext(Reply<PlayNext>),
    Resume(Reply<Resume>),
    /// Seek to this time, in nanoseconds since the epoch.
    Seek(i64, Reply<Seek>),
    SetRate(f64, Reply<SetRate>),
    Stop(Reply<Stop>),
    TogglePaused(Reply<TogglePaused>),
}

/// A part of the bag.
pub(super) struct Part {
    pub(super) start_offset: Duration,
    pub(super) duration: Option<Duration>,
    /// In nanoseconds since the epoch.
    pub(super) until: Option<i64>,
}

impl From<PlayRequest> for Part {
    /// A duration or time of zero (the default of a request) or less means none.
    fn from(request: PlayRequest) -> Self {
        let positive = |nanos: i64| u64::try_from(nanos).ok().filter(|nanos| *nanos > 0);
        let duration = |nanos| positive(nanos).map(Duration::from_nanos);
        Self {
            start_offset: duration(request.start_offset.as_nanos()).unwrap_or_default(),
            duration: duration(request.playback_duration.as_nanos()),
            until: Some(request.playback_until_timestamp.as_nanos()).filter(|until| *until > 0),
        }
    }
}

/// The services, which exist until it is dropped.
pub(super) struct Controls {
    requests: Receiver<Control>,
    _services: Vec<Service>,
}

impl Controls {
    pub(super) fn offer(node: &Node) -> Result<Self, NodeError> {
        let (sender, requests) = channel();
        let services = vec![
            serve::<Burst>(node, "~/burst", &sender, |request, reply| {
                Control::Burst(request.num_messages, reply)
            })?,
            serve::<GetRate>(node, "~/get_rate", &sender, |_, reply| Control::GetRate(reply))?,
            serve::<IsPaused>(node, "~/is_paused", &sender, |_, reply| Control::IsPaused(reply))?,
            serve::<Pause>(node, "~/pause", &sender, |_, reply| Control::Pause(reply))?,
            serve::<Play>(node, "~/play", &sender, |request, reply| Control::Play(request.into(), reply))?,
            serve::<PlayNext>(node, "~/play_next", &sender, |_, reply| Control::PlayNext(reply))?,
            serve::<Resume>(node, "~/resume", &sender, |_, reply| Control::Resume(reply))?,
            serve::<Seek>(node, "~/seek", &sender, |request, reply| {
                Control::Seek(request.time.as_nanos(), reply)
            })?,
            serve::<SetRate>(node, "~/set_rate", &sender, |request, reply| {
                Control::SetRate(request.rate, reply)
            })?,
            serve::<Stop>(node, "~/stop", &sender, |_, reply| Control::Stop(reply))?,
            serve::<TogglePaused>(node, "~/toggle_paused", &sender, |_, reply| Control::TogglePaused(reply))?,
        ];
        Ok(Self { requests, _services: services })
    }

    /// Waits for a request, at most for `most`.
    pub(super) fn wait(&self, most: Duration) -> Option<Control> {
        self.requests.recv_timeout(most).ok()
    }
}

fn serve<S: ServiceType>(
    node: &Node,
    name: &str,
    sender: &Sender<Control>,
    control: fn(S::Request, Reply<S>) -> Control,
) -> Result<Service, NodeError> {
    let sender = sender.clone();
    node.serve_later::<S>(name, QosProfile::SERVICES, move |request, reply| {
        // If the player has ended, the service is about to be removed.
        let _ = sender.send(control(request, reply));
    })
}

/// Sends a response; errors are ignored, since the client may have disappeared.
pub(super) fn answer<S: ServiceType>(reply: Reply<S>, response: &S::Response) {
    if let Err(error) = reply.send(response) {
        tracing::debug!("an answer was not sent: {error}");
    }
}
