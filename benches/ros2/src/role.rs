//! What the processes of a pair agree on.

/// The line printed when both ends have discovered each other.
pub const GO: &str = "go";

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Role {
    /// Sends messages and waits for the answers.
    Ping,
    /// Sends each received message back.
    Echo,
    /// Sends back the number of each received message.
    Acknowledge,
    /// Counts received messages. Only Python contestants have this role.
    Count,
    /// Subscribes to joint states and measures how old they are. Only Python contestants have this role.
    JointStates,
    /// Sends large messages at a constant rate. Only Python contestants have this role.
    Camera,
    /// Offers a latched sample.
    Latch,
    /// Joins and measures how long it takes to discover the process that offers a latched sample.
    Late,
}
