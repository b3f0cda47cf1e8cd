//! The messages between the arena and the robots.
#![allow(rustdoc::broken_intra_doc_links)] // units in brackets, as ROS writes them in comments of messages

use downbeat::msgs::Message;

/// The light on a robot, which shows its decision to all others.
pub struct Light;

impl Light {
    /// In neither group yet.
    pub const UNDECIDED: u8 = 0;
    /// In the red group.
    pub const RED: u8 = 1;
    /// In the blue group.
    pub const BLUE: u8 = 2;
}

/// What one robot says to one other.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "swarm/msg/Word", crate = "downbeat::msgs")]
pub struct Word {
    /// The robot that is spoken to, as in [`Neighbour::id`].
    pub to: u32,
    /// What is said.
    pub word: u8,
}

impl Word {
    /// "Let us decide: I become red, you blue."
    pub const PROPOSE: u8 = 0;
    /// "I am blue now."
    pub const ACCEPT: u8 = 1;
    /// "I have decided already, or wait for an answer myself."
    pub const REFUSE: u8 = 2;
}

/// A word as it arrives.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "swarm/msg/Heard", crate = "downbeat::msgs")]
pub struct Heard {
    /// The robot that said it.
    pub from: u32,
    /// What it said, see [`Word`].
    pub word: u8,
}

/// What a robot asks of its body.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "swarm/msg/Command", crate = "downbeat::msgs")]
pub struct Command {
    /// Speeds of the left and the right wheel [m/s], until the next command.
    pub wheels: [f64; 2],
    /// See [`Light`].
    pub light: u8,
    /// What it says.
    pub words: Vec<Word>,
}

/// A robot as another one senses it.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "swarm/msg/Neighbour", crate = "downbeat::msgs")]
pub struct Neighbour {
    /// Its address for words.
    pub id: u32,
    /// Its distance [m].
    pub range: f32,
    /// Its direction from that in which the sensing robot faces [rad], positive to the left.
    pub bearing: f32,
    /// See [`Light`].
    pub light: u8,
}

/// What a robot senses.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "swarm/msg/Sight", crate = "downbeat::msgs")]
pub struct Sight {
    /// The robots within the range of its sensor.
    pub neighbours: Vec<Neighbour>,
    /// What was said to it since its last sight.
    pub heard: Vec<Heard>,
}

/// Where a robot is and how it is turned, in the frame of the arena.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "swarm/msg/Pose", crate = "downbeat::msgs")]
pub struct Pose {
    /// Position [m].
    pub x: f64,
    /// Position [m].
    pub y: f64,
    /// Heading, counterclockwise from the x axis [rad].
    pub heading: f64,
}

/// The whole swarm from above, which no robot knows.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "swarm/msg/Overview", crate = "downbeat::msgs")]
pub struct Overview {
    /// All robots, in the order of their numbers.
    pub poses: Vec<Pose>,
    /// Their lights, see [`Light`].
    pub lights: Vec<u8>,
    /// How many are undecided, red and blue.
    pub sizes: [u32; 3],
    /// The greatest distance of a robot from the centre of all [m].
    pub spread: f64,
    /// The greatest distance of a red robot from the centre of the red ones, and of a blue one from that of
    /// the blue ones [m].
    pub group_spreads: [f64; 2],
    /// The distance between the closest two robots of different groups [m]; 0 without two groups.
    pub gap: f64,
    /// True from the moment at which all robots were together.
    pub have_gathered: bool,
    /// True from the moment at which all had decided and stood in two groups apart.
    pub have_split: bool,
}
