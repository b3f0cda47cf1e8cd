//! A robot with a server for viewers, and a viewer.

use downbeat_edge::Interfaces;
use downbeat_executor::{Core, CoreHandle, Inlet, Module, Setup, SetupError};
use downbeat_msgs::geometry_msgs::msg::Twist;
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_msgs::std_msgs::msg::String as Text;
use downbeat_msgs::std_srvs::srv::{SetBoolRequest, SetBoolResponse};
use downbeat_view::{Access, Token, ViewOptions, ViewServer};
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::net::{SocketAddr, TcpStream};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tungstenite::{ClientRequestBuilder, Message, WebSocket};

/// Ends a test that would wait forever.
pub const WATCHDOG: Duration = Duration::from_secs(20);

pub const TOKEN: &str = "secret-of-the-test";

/// Serves `stand`, has the settings `gain` and `name`, and passes on what it hears on `cmd_vel`.
struct Legs {
    heard: Sender<f64>,
}

impl Module for Legs {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.setting_in("gain", 1.0, 0.0..=10.0, "")?;
        setup.setting("name", "legs".to_owned(), "")?;
        setup.subscribe::<Twist, _>("cmd_vel", |legs: &mut Self, twist, _| {
            let _ = legs.heard.send(twist.linear.x);
        })?;
        setup.serve::<SetBoolRequest, SetBoolResponse, _>("stand", |_, request, _| {
            if request.data {
                Ok(SetBoolResponse { success: true, message: "up".into() })
            } else {
                Err("there is no chair".into())
            }
        })
    }
}

/// A running core with a server.
pub struct Robot {
    pub server: Option<ViewServer>,
    pub core: CoreHandle,
    pub joint_states: Inlet<JointState>,
    pub description: Inlet<Text>,
    pub heard: Receiver<f64>,
    pub folder: tempfile::TempDir,
    thread: Option<JoinHandle<()>>,
}

/// A robot whose options `change` has changed.
pub fn robot(change: impl FnOnce(&mut ViewOptions)) -> Robot {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("arm.stl"), "solid arm").unwrap();
    let (heard, twists) = channel();
    let mut core = Core::new();
    core.add("legs", Legs { heard }).unwrap();
    let joint_states = core.inlet("joint_states").unwrap();
    let description = core.inlet("robot_description").unwrap();
    let mut options = ViewOptions::new("test robot").unwrap();
    options.foxglove = Some(0);
    options.access = Access::Token(Token::new(TOKEN).unwrap());
    options.latched = vec![("robot_description".into(), 1)];
    options.packages = vec![("robot".into(), folder.path().to_owned())];
    change(&mut options);
    let server = ViewServer::start(&mut core, &Interfaces::carried(), options).unwrap();
    let handle = core.handle();
    let thread = std::thread::spawn(move || core.run().unwrap());
    let server = Some(server);
    Robot { server, core: handle, joint_states, description, heard: twists, folder, thread: Some(thread) }
}

impl Robot {
    pub fn address(&self) -> SocketAddr {
        self.server.as_ref().unwrap().foxglove_address().unwrap()
    }

    /// A viewer with the token.
    pub fn viewer(&self) -> Viewer {
        Viewer::connect(self.address(), &format!("/?token={TOKEN}")).unwrap()
    }

    /// A viewer without it.
    pub fn spectator(&self) -> Viewer {
        Viewer::connect(self.address(), "/").unwrap()
    }

    pub fn move_to(&self, position: f64) {
        self.joint_states.publish(joint_state(position)).unwrap();
    }

    /// The inboxes through which messages leave the core.
    pub fn outlets(&self) -> usize {
        let graph = self.core.graph().wait(WATCHDOG).unwrap();
        graph.edges.iter().filter(|edge| matches!(edge, downbeat_executor::GraphEdge::Leaves { .. })).count()
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        self.core.stop();
        let ran = self.thread.take().map(JoinHandle::join);
        self.server = None;
        assert!(std::thread::panicking() || matches!(ran, Some(Ok(()))), "the core ran to its end");
    }
}

pub fn joint_state(position: f64) -> JointState {
    JointState { name: vec!["pan".into()], position: vec![position], ..JointState::default() }
}

/// Repeats a look until it succeeds.
pub fn until<T>(mut look: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + WATCHDOG;
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < deadline, "it did not happen");
        std::thread::yield_now();
    }
}

/// A frame from the server.
#[derive(Debug)]
pub enum Frame {
    Json(Value),
    Binary(Vec<u8>),
}

/// The client side of a connection.
pub struct Viewer {
    pub socket: WebSocket<TcpStream>,
    /// What the server announced first.
    pub info: Value,
    pub channels: Vec<Value>,
    /// Frames that were read while another one was awaited.
    pending: VecDeque<Frame>,
}

impl Viewer {
    /// Connects, and reads what the server announces first.
    pub fn connect(address: SocketAddr, path: &str) -> Result<Self, String> {
        Self::connect_as(address, path, "foxglove.websocket.v1")
    }

    /// Connects with this version of the protocol.
    pub fn connect_as(address: SocketAddr, path: &str, protocol: &str) -> Result<Self, String> {
        Ok(Self::of(open(address, path, protocol)?))
    }

    /// Reads what the server announces first.
    pub fn of(mut socket: WebSocket<TcpStream>) -> Self {
        let info = next_json(&mut socket).unwrap();
        let advertise = next_json(&mut socket).unwrap();
        let channels = advertise["channels"].as_array().unwrap().clone();
        Self { socket, info, channels, pending: VecDeque::new() }
    }

    pub fn send(&mut self, request: Value) {
        self.socket.send(Message::text(request.to_string())).unwrap();
    }

    pub fn send_binary(&mut self, frame: Vec<u8>) {
        self.socket.send(Message::binary(frame)).unwrap();
    }

    /// The next frame for which `is_meant` returns true.
    pub fn wait_for(&mut self, mut is_meant: impl FnMut(&Frame) -> bool) -> Frame {
        loop {
            let frame = self.pending.pop_front().unwrap_or_else(|| self.read());
            if is_meant(&frame) {
                return frame;
            }
        }
    }

    fn read(&mut self) -> Frame {
        loop {
            match self.socket.read().unwrap() {
                Message::Text(text) => return Frame::Json(serde_json::from_str(&text).unwrap()),
                Message::Binary(bytes) => return Frame::Binary(bytes.to_vec()),
                _ => {}
            }
        }
    }

    /// The next JSON message with this operation.
    pub fn json(&mut self, op: &str) -> Value {
        match self.wait_for(|frame| matches!(frame, Frame::Json(value) if value["op"] == op)) {
            Frame::Json(value) => value,
            Frame::Binary(_) => unreachable!(),
        }
    }

    /// The next binary frame with this opcode, without it.
    pub fn binary(&mut self, opcode: u8) -> Vec<u8> {
        match self.wait_for(|frame| matches!(frame, Frame::Binary(bytes) if bytes[0] == opcode)) {
            Frame::Binary(bytes) => bytes[1..].to_vec(),
            Frame::Json(_) => unreachable!(),
        }
    }

    /// The channel of a topic.
    pub fn channel(&self, topic: &str) -> Value {
        self.channels.iter().find(|channel| channel["topic"] == topic).unwrap().clone()
    }

    /// Subscribes, and returns when the server has done it.
    pub fn subscribe(&mut self, id: u32, topic: &str) {
        let channel = self.channel(topic)["id"].clone();
        self.send(json!({ "op": "subscribe", "subscriptions": [{ "id": id, "channelId": channel }] }));
        self.settle();
    }

    /// Returns when the server has served all requests so far.
    pub fn settle(&mut self) {
        self.send(json!({ "op": "fetchAsset", "uri": "settle", "requestId": u32::MAX }));
        loop {
            let frame = self.read();
            if matches!(&frame, Frame::Binary(bytes) if bytes[..5] == [4, 255, 255, 255, 255]) {
                return;
            }
            self.pending.push_back(frame);
        }
    }

    /// Waits until a topic is announced that was not there from the start.
    pub fn wait_for_topic(&mut self, topic: &str) {
        while self.channels.iter().all(|channel| channel["topic"] != topic) {
            let added = self.json("advertise");
            self.channels.extend(added["channels"].as_array().unwrap().clone());
        }
    }

    /// The next message of any subscription: its number, its time and its bytes.
    pub fn message(&mut self) -> (u32, u64, Vec<u8>) {
        let frame = self.binary(1);
        let subscription = u32::from_le_bytes(frame[..4].try_into().unwrap());
        let time = u64::from_le_bytes(frame[4..12].try_into().unwrap());
        (subscription, time, frame[12..].to_vec())
    }

    /// Reads until the server ends the connection; returns the code of its close frame, if that arrived.
    pub fn ended(mut self) -> Option<u16> {
        loop {
            match self.socket.read() {
                Ok(Message::Close(frame)) => return frame.map(|frame| frame.code.into()),
                Ok(_) => {}
                Err(_) => return None,
            }
        }
    }
}

/// A WebSocket connection.
pub fn open(address: SocketAddr, path: &str, protocol: &str) -> Result<WebSocket<TcpStream>, String> {
    let stream = TcpStream::connect(address).map_err(|error| error.to_string())?;
    stream.set_read_timeout(Some(WATCHDOG)).unwrap();
    stream.set_write_timeout(Some(WATCHDOG)).unwrap();
    let uri = format!("ws://{address}{path}").parse().unwrap();
    let request = ClientRequestBuilder::new(uri).with_sub_protocol(protocol);
    let (socket, response) = tungstenite::client(request, stream).map_err(|error| error.to_string())?;
    assert_eq!(response.headers()["sec-websocket-protocol"], protocol);
    Ok(socket)
}

fn next_json(socket: &mut WebSocket<TcpStream>) -> Result<Value, String> {
    loop {
        if let Message::Text(text) = socket.read().map_err(|error| error.to_string())? {
            return Ok(serde_json::from_str(&text).unwrap());
        }
    }
}
