//! `downbeat service`

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use bytes::Bytes;
use clap::{Args, Subcommand};
use downbeat_bridge::middleware::rpc::CallError;
use downbeat_bridge::ros::{EndpointKind, Found, RawClient, ServiceType};
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType};
use downbeat_msgs::qos::QosProfile;

use super::clock::LookClock;
use super::definitions::{Types, full_name};
use super::network::{
    Environment, Look, LookArguments, NamesAndTypes, OF_SERVICES, Patience, count, is_hidden,
    names_and_types, print_list, print_types, type_or_types,
};
use super::values::{FieldArguments, period, positive};

#[derive(Subcommand)]
pub(crate) enum ServiceCommand {
    /// List services.
    List(ListArguments),
    /// Print the type of a service, and the numbers of servers and clients.
    Info(NameArguments),
    /// Call a service and print the response.
    Call(CallArguments),
    /// Print the type of a service.
    Type(NameArguments),
    /// List the services of a type.
    Find(FindArguments),
}

#[derive(Args)]
pub(crate) struct ListArguments {
    /// Also print the types.
    #[arg(short = 't', long)]
    show_types: bool,
    #[command(flatten)]
    names: NamesArguments,
}

/// Which services are listed, and how.
#[derive(Args)]
struct NamesArguments {
    /// Print only the number.
    #[arg(short, long)]
    count_services: bool,
    /// Also print services whose name has a part that starts with an underscore.
    #[arg(short = 'a', long)]
    include_hidden_services: bool,
    #[command(flatten)]
    look: LookArguments,
}

impl NamesArguments {
    fn services(&self, found: &Found) -> NamesAndTypes {
        let mut services = names_and_types(found, OF_SERVICES, None);
        services.retain(|name, _| self.include_hidden_services || !is_hidden(name));
        services
    }
}

#[derive(Args)]
pub(crate) struct NameArguments {
    /// The service.
    service: String,
    #[command(flatten)]
    look: LookArguments,
}

#[derive(Args)]
pub(crate) struct FindArguments {
    /// The type, for example std_srvs/srv/SetBool.
    #[arg(value_name = "TYPE")]
    type_name: String,
    #[command(flatten)]
    names: NamesArguments,
}

#[derive(Args)]
pub(crate) struct CallArguments {
    /// The service.
    service: String,
    /// Its type, for example std_srvs/srv/SetBool.
    #[arg(value_name = "TYPE")]
    type_name: String,
    #[command(flatten)]
    fields: FieldArguments,
    /// Call repeatedly, this many times per second.
    #[arg(short, long, value_name = "HZ", value_parser = positive)]
    rate: Option<f64>,
    /// Search definitions here first: an ament prefix, a folder of packages, or a package.
    #[arg(long, value_name = "PATH")]
    from: Vec<PathBuf>,
    #[command(flatten)]
    look: LookArguments,
}

pub(crate) fn service(command: &ServiceCommand, environment: &Environment<'_>) -> anyhow::Result<()> {
    match command {
        ServiceCommand::List(arguments) => list(arguments, environment),
        ServiceCommand::Info(arguments) => info(arguments, environment),
        ServiceCommand::Call(arguments) => call(arguments, environment),
        ServiceCommand::Type(arguments) => type_of(arguments, environment),
        ServiceCommand::Find(arguments) => find(arguments, environment),
    }
}

fn list(arguments: &ListArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let ListArguments { show_types, names } = arguments;
    let look = Look::join("service", &names.look, environment)?;
    let services = names.services(&look.all(Patience::Endpoints));
    print_list(&services, *show_types, names.count_services);
    Ok(())
}

fn info(arguments: &NameArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let look = Look::join("service", &arguments.look, environment)?;
    let name = look.node.service_name(&arguments.service)?;
    let types = |found: &Found| names_and_types(found, OF_SERVICES, None).remove(name.as_str());
    let found = look.all_with(Patience::Endpoints, |found| types(found).is_some());
    let Some(types) = types(&found) else { bail!("Unknown service '{name}'") };
    println!("Type: {}", type_or_types(&types));
    println!("Clients count: {}", count(&found, name.as_str(), EndpointKind::Client));
    println!("Services count: {}", count(&found, name.as_str(), EndpointKind::Server));
    Ok(())
}

fn type_of(arguments: &NameArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let look = Look::join("service", &arguments.look, environment)?;
    let name = look.node.service_name(&arguments.service)?;
    let types = |found: &Found| names_and_types(found, OF_SERVICES, None).remove(name.as_str());
    print_types(&look, types).with_context(|| format!("Unknown service '{name}'"))
}

fn find(arguments: &FindArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let FindArguments { type_name, names } = arguments;
    let look = Look::join("service", &names.look, environment)?;
    let mut services = names.services(&look.all(Patience::Endpoints));
    services.retain(|_, types| types.contains(type_name));
    print_list(&services, false, names.count_services);
    Ok(())
}

/// Calls a service of any type.
pub(super) struct DynamicClient {
    client: RawClient,
    service_type: ServiceType,
    pub(super) request: DynamicType,
    pub(super) response: DynamicType,
}

/// The maximum time of discovery on an idle machine.
pub(super) const DISCOVERY: Duration = Duration::from_secs(2);

/// How soon Ctrl-C is noticed.
const POLL: Duration = Duration::from_millis(50);

/// `ros2` waits forever.
const NO_END: Duration = Duration::from_secs(365 * 24 * 3600);

impl DynamicClient {
    pub(super) fn new(look: &Look, types: &Types, service: &str, type_name: &str) -> anyhow::Result<Self> {
        let service_type = ServiceType::new(type_name)?;
        let client = look.node.client_raw(service, &service_type, QosProfile::SERVICES)?;
        let [request, response] = types.service(look, service, &service_type)?;
        Ok(Self { client, service_type, request, response })
    }

    /// Waits until a server is matched, and takes the definitions that it announces if they differ from those
    /// at hand. Returns false if no server is there in time, or the command is stopped first.
    pub(super) fn wait(
        &mut self,
        look: &Look,
        types: &Types,
        time: Option<Duration>,
    ) -> anyhow::Result<bool> {
        let is_there = look.wait_for(time, || self.client.is_available());
        if is_there {
            let service = self.client.name().to_string();
            [self.request, self.response] = types.service(look, &service, &self.service_type)?;
        }
        Ok(is_there)
    }

    /// Sends a request; the response arrives at the returned call.
    pub(super) fn call(&self, request: &DynamicMessage) -> Call<'_> {
        let (sender, answer) = std::sync::mpsc::sync_channel(1);
        self.client.call(request.to_cdr().into(), NO_END, move |result| {
            // The receiver no longer exists if the command was stopped.
            let _ = sender.try_send(result);
        });
        Call { client: self, answer }
    }
}

/// A pending call.
pub(super) struct Call<'a> {
    client: &'a DynamicClient,
    answer: std::sync::mpsc::Receiver<Result<Bytes, CallError>>,
}

impl Call<'_> {
    /// Waits for the response; returns `None` if the command is stopped first.
    pub(super) fn wait(&self, look: &Look) -> anyhow::Result<Option<DynamicMessage>> {
        while !look.stop.is_due() {
            if let Some(response) = self.poll(POLL)? {
                return Ok(Some(response));
            }
        }
        Ok(None)
    }

    /// The response, if it arrives within `time`.
    pub(super) fn poll(&self, time: Duration) -> anyhow::Result<Option<DynamicMessage>> {
        let Ok(answer) = self.answer.recv_timeout(time) else { return Ok(None) };
        let cdr = answer.context("Exception while calling service")?;
        let of = &self.client.response;
        Ok(Some(
            DynamicMessage::from_cdr(of, &cdr)
                .with_context(|| format!("the response is not a {}", of.name()))?,
        ))
    }
}

fn call(arguments: &CallArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let period = arguments.rate.map(period).transpose()?;
    let yaml = arguments.fields.read()?;
    let look = Look::join("service", &arguments.look, environment)?;
    let types = Types::load(&look, &arguments.from)?;
    let type_name = full_name(&arguments.type_name, "srv");
    let mut client = DynamicClient::new(&look, &types, &arguments.service, &type_name)
        .context("The passed service type is invalid")?;
    let filled = |client: &DynamicClient| {
        let mut request = DynamicMessage::new(&client.request);
        let stamps = request.fill_yaml(&yaml).context("Failed to populate field")?;
        anyhow::Ok((request, stamps))
    };
    let (clock, _follower) = LookClock::new(&look, arguments.look.use_sim_time)?;
    // An existing server is matched after a moment, without printing a line.
    if !client.wait(&look, &types, Some(DISCOVERY))? {
        filled(&client)?;
        println!("waiting for service to become available...");
        if !client.wait(&look, &types, None)? {
            return Ok(());
        }
    }
    let (mut request, stamps) = filled(&client)?;
    let mut next = Instant::now();
    loop {
        stamps.set(&mut request, Time::from_nanos(clock.now()))?;
        println!("requester: making request: {}\n", request.as_message().to_python_repr());
        let Some(response) = client.call(&request).wait(&look)? else { return Ok(()) };
        println!("response:\n{}\n", response.as_message().to_python_repr());
        let Some(period) = period else { return Ok(()) };
        next = (next + period).max(Instant::now());
        look.stop.sleep(next.saturating_duration_since(Instant::now()));
        if look.stop.is_due() {
            return Ok(());
        }
    }
}
