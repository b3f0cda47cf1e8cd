//! `downbeat action`

use std::hash::{BuildHasher, Hasher, RandomState};
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

use anyhow::{Context, bail};
use bytes::Bytes;
use clap::{Args, Subcommand};
use downbeat_bridge::middleware::Sample;
use downbeat_bridge::ros::{EndpointKind, Found, MessageType, Subscription};
use downbeat_msgs::action_msgs::msg::GoalStatus;
use downbeat_msgs::action_msgs::srv::{CancelGoal, CancelGoalRequest};
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType, MessageRef, YamlStyle};
use downbeat_msgs::qos::QosProfile;

use super::clock::LookClock;
use super::definitions::{Types, full_name};
use super::network::{
    Environment, Look, LookArguments, NamesAndTypes, OF_TOPICS, Patience, actions, joined, print_list,
    print_types,
};
use super::service::{Call, DISCOVERY, DynamicClient};
use super::values::FieldArguments;

#[derive(Subcommand)]
pub(crate) enum ActionCommand {
    /// List actions.
    List(ListArguments),
    /// Print the nodes that serve and use an action.
    Info(InfoArguments),
    /// Send a goal, wait for it, and print the result. Ctrl-C cancels the goal.
    #[command(name = "send_goal")]
    SendGoal(SendGoalArguments),
    /// Print the type of an action.
    Type(NameArguments),
}

#[derive(Args)]
pub(crate) struct ListArguments {
    /// Also print the types.
    #[arg(short = 't', long)]
    show_types: bool,
    /// Print only the number.
    #[arg(short, long)]
    count_actions: bool,
    #[command(flatten)]
    look: LookArguments,
}

#[derive(Args)]
pub(crate) struct InfoArguments {
    /// The action.
    action: String,
    /// Also print the types.
    #[arg(short = 't', long)]
    show_types: bool,
    /// Print only the number.
    #[arg(short, long)]
    count: bool,
    #[command(flatten)]
    look: LookArguments,
}

#[derive(Args)]
pub(crate) struct NameArguments {
    /// The action.
    action: String,
    #[command(flatten)]
    look: LookArguments,
}

#[derive(Args)]
pub(crate) struct SendGoalArguments {
    /// The action.
    action: String,
    /// Its type, for example test_msgs/action/Fibonacci.
    #[arg(value_name = "TYPE")]
    type_name: String,
    #[command(flatten)]
    goal: FieldArguments,
    /// Also print feedback.
    #[arg(short, long)]
    feedback: bool,
    /// Search definitions here first: an ament prefix, a folder of packages, or a package.
    #[arg(long, value_name = "PATH")]
    from: Vec<PathBuf>,
    #[command(flatten)]
    look: LookArguments,
}

pub(crate) fn action(command: &ActionCommand, environment: &Environment<'_>) -> anyhow::Result<()> {
    match command {
        ActionCommand::List(arguments) => list(arguments, environment),
        ActionCommand::Info(arguments) => info(arguments, environment),
        ActionCommand::SendGoal(arguments) => send_goal(arguments, environment),
        ActionCommand::Type(arguments) => type_of(arguments, environment),
    }
}

fn list(arguments: &ListArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let look = Look::join("action", &arguments.look, environment)?;
    let actions = actions(&look.all(Patience::Endpoints), OF_TOPICS, None);
    print_list(&actions, arguments.show_types, arguments.count_actions);
    Ok(())
}

fn info(arguments: &InfoArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let look = Look::join("action", &arguments.look, environment)?;
    let name = look.node.topic_name(&arguments.action)?;
    let has_it = |found: &Found| actions(found, OF_TOPICS, None).contains_key(name.as_str());
    let found = look.all_with(Patience::Nodes, has_it);
    println!("Action: {}", arguments.action);
    for (title, kind) in [("clients", EndpointKind::Subscription), ("servers", EndpointKind::Publisher)] {
        let nodes = nodes_with(&found, name.as_str(), kind);
        println!("Action {title}: {}", nodes.len());
        if arguments.count {
            continue;
        }
        for (node, types) in &nodes {
            match arguments.show_types {
                true => println!("    {node} [{}]", joined(types)),
                false => println!("    {node}"),
            }
        }
    }
    Ok(())
}

/// The nodes that serve or use an action, with its types.
fn nodes_with(found: &Found, action: &str, kind: EndpointKind) -> NamesAndTypes {
    let mut nodes = NamesAndTypes::new();
    for node in &found.nodes {
        if let Some(types) = actions(found, &[kind], Some(&node.name)).remove(action) {
            nodes.insert(node.name.clone(), types);
        }
    }
    nodes
}

fn type_of(arguments: &NameArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let look = Look::join("action", &arguments.look, environment)?;
    let name = look.node.topic_name(&arguments.action)?;
    let types = |found: &Found| actions(found, OF_TOPICS, None).remove(name.as_str());
    print_types(&look, types).with_context(|| format!("Unknown action '{name}'"))
}

/// A unique id.
fn new_id() -> [u8; 16] {
    let random = || RandomState::new().build_hasher().finish();
    (u128::from(random()) << 64 | u128::from(random())).to_be_bytes()
}

const POLL: Duration = Duration::from_millis(50);

/// How long a server may take to cancel a goal.
const CANCEL_TIMEOUT: Duration = Duration::from_secs(10);

/// The maximum number of queued feedback messages.
const MOST_WAITING: usize = 1024;

/// The feedback of all goals of an action.
struct Feedback {
    of: DynamicType,
    heard: Receiver<Bytes>,
    _subscription: Subscription,
}

impl Feedback {
    fn subscribe(look: &Look, types: &Types, action: &str, type_name: &str) -> anyhow::Result<Self> {
        let (topic, type_name) =
            (format!("{action}/_action/feedback"), format!("{type_name}_FeedbackMessage"));
        let (sender, heard) = sync_channel(MOST_WAITING);
        let on_sample = move |sample: Sample| {
            let _ = sender.try_send(sample.cdr);
        };
        let message_type = MessageType::new(&type_name)?;
        let qos = QosProfile::DEFAULT;
        let subscription = look.node.subscribe(&topic, &message_type, qos, Box::new(on_sample))?;
        let of = types.message(look, &topic, &type_name)?;
        Ok(Self { of, heard, _subscription: subscription })
    }

    /// Prints the feedback of a goal.
    fn print(&self, goal: &[u8]) {
        while let Ok(cdr) = self.heard.try_recv() {
            let Ok(message) = DynamicMessage::from_cdr(&self.of, &cdr) else { continue };
            let of_goal = message.get("goal_id.uuid").ok().and_then(|id| id.as_slice::<u8>());
            let feedback = message.get("feedback").ok().and_then(|value| value.as_message());
            if let (true, Some(feedback)) = (of_goal == Some(goal), feedback) {
                println!("Feedback:\n    {}", feedback.to_yaml(&YamlStyle::default()));
            }
        }
    }
}

fn send_goal(arguments: &SendGoalArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let yaml = arguments.goal.read()?;
    let look = Look::join("action", &arguments.look, environment)?;
    let types = Types::load(&look, &arguments.from)?;
    let type_name = full_name(&arguments.type_name, "action");
    let client = |service: &str, of: &str| {
        let service = format!("{}/_action/{service}", arguments.action);
        DynamicClient::new(&look, &types, &service, &format!("{type_name}_{of}"))
            .context("The passed action type is invalid")
    };
    let (mut sending, mut getting) = (client("send_goal", "SendGoal")?, client("get_result", "GetResult")?);
    let feedback = match arguments.feedback {
        true => Some(Feedback::subscribe(&look, &types, &arguments.action, &type_name)?),
        false => None,
    };
    let filled = |sending: &DynamicClient| {
        let goal_type =
            sending.request.fields().find(|field| field.name == "goal").and_then(|field| field.message);
        let mut goal = DynamicMessage::new(&goal_type.context("The passed type is not an action")?);
        let stamps = goal.fill_yaml(&yaml).context("Failed to populate message fields")?;
        anyhow::Ok((goal, stamps))
    };
    let (clock, _follower) = LookClock::new(&look, arguments.look.use_sim_time)?;

    println!("Waiting for an action server to become available...");
    if !sending.wait(&look, &types, Some(DISCOVERY))? {
        filled(&sending)?;
    }
    if !(sending.wait(&look, &types, None)? && getting.wait(&look, &types, None)?) {
        return Ok(());
    }
    let (mut goal, stamps) = filled(&sending)?;
    let mut request = DynamicMessage::new(&sending.request);
    stamps.set(&mut goal, Time::from_nanos(clock.now()))?;
    println!("Sending goal:\n     {}", goal.to_yaml(&YamlStyle::default()));
    let id = new_id();
    request.set("goal", goal)?;
    request.set("goal_id.uuid", id.to_vec())?;
    let Some(accepted) = sending.call(&request).wait(&look)? else { return Ok(()) };
    if accepted.get("accepted")?.as_bool() != Some(true) {
        println!("Goal was rejected.");
        return Ok(());
    }
    println!("Goal accepted with ID: {}\n", id.iter().map(|byte| format!("{byte:02x}")).collect::<String>());
    let mut request = DynamicMessage::new(&getting.request);
    request.set("goal_id.uuid", id.to_vec())?;
    match wait_for_result(&look, &getting.call(&request), feedback.as_ref(), &id)? {
        Some(result) => print_result(result.as_message()),
        None => cancel(&look, &arguments.action, id),
    }
}

/// Waits for the result; returns `None` if the command is stopped first.
fn wait_for_result(
    look: &Look,
    call: &Call<'_>,
    feedback: Option<&Feedback>,
    goal: &[u8],
) -> anyhow::Result<Option<DynamicMessage>> {
    while !look.stop.is_due() {
        let result = call.poll(POLL)?;
        if let Some(feedback) = feedback {
            feedback.print(goal);
        }
        if result.is_some() {
            return Ok(result);
        }
    }
    Ok(None)
}

fn print_result(response: MessageRef<'_>) -> anyhow::Result<()> {
    let result = response.get("result")?.as_message().context("the result is not a message")?;
    let status = match response.get("status")?.as_i64().and_then(|status| i8::try_from(status).ok()) {
        Some(GoalStatus::STATUS_ACCEPTED) => "ACCEPTED",
        Some(GoalStatus::STATUS_EXECUTING) => "EXECUTING",
        Some(GoalStatus::STATUS_CANCELING) => "CANCELING",
        Some(GoalStatus::STATUS_SUCCEEDED) => "SUCCEEDED",
        Some(GoalStatus::STATUS_CANCELED) => "CANCELED",
        Some(GoalStatus::STATUS_ABORTED) => "ABORTED",
        _ => "UNKNOWN",
    };
    println!("Result:\n    {}", result.to_yaml(&YamlStyle::default()));
    println!("Goal finished with status: {status}");
    Ok(())
}

fn cancel(look: &Look, action: &str, id: [u8; 16]) -> anyhow::Result<()> {
    println!("Canceling goal...");
    let client =
        look.node.client::<CancelGoal>(&format!("{action}/_action/cancel_goal"), QosProfile::SERVICES)?;
    let mut request = CancelGoalRequest::default();
    request.goal_info.goal_id.uuid = id;
    let _ = client.wait_for_service(CANCEL_TIMEOUT);
    let answer = client.call_and_wait(&request, CANCEL_TIMEOUT).context("Exception while canceling goal")?;
    match answer.goals_canceling.as_slice() {
        [] => bail!("Failed to cancel goal"),
        [one] if one.goal_id.uuid == id => {}
        [_] => bail!("Canceled goal with incorrect goal ID"),
        _ => bail!("More than one goal canceled"),
    }
    println!("Goal canceled.");
    Ok(())
}
