//! `downbeat bag view`

use std::collections::BTreeSet;
use std::net::IpAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use clap::Args;
use serde_json::{Value, json};

use super::open;
use super::play::seconds;
use super::select::{TopicArguments, carried_over};
use crate::stop::Stop;
use downbeat_bags::{Rate, Reader};
use downbeat_bridge::edge::Interfaces;
use downbeat_robot::table::series;
use downbeat_robot::{Catalog, FOXGLOVE_PORT};
use downbeat_view::{Access, Ask, BagPlayback, Host, PageOptions, ViewOptions, ViewServer};

/// Fields of one question for curves.
const MOST_FIELDS: usize = 64;
const DEFAULT_POINTS: u64 = 2000;

#[derive(Args)]
pub(crate) struct ViewBagArguments {
    /// Bags to show, merged by time: rosbag2 directories or single files.
    #[arg(required = true)]
    pub(crate) bags: Vec<PathBuf>,
    #[command(flatten)]
    pub(crate) topics: TopicArguments,
    /// The port for Foxglove, Lichtblick and PlotJuggler; 0 for a free one.
    #[arg(long, default_value_t = FOXGLOVE_PORT)]
    pub(crate) port: u16,
    /// The port of the page for browsers; 7373, or a free one where that is in use.
    #[arg(long, value_name = "PORT")]
    pub(crate) page: Option<u16>,
    /// The address on which viewers connect; 0.0.0.0 for viewers on other machines.
    #[arg(long, default_value = "127.0.0.1", value_name = "ADDRESS")]
    pub(crate) address: IpAddr,
    /// Playback rate: 2 is twice as fast as recorded.
    #[arg(long, short, default_value_t = 1.0)]
    pub(crate) rate: f64,
    /// Start this far into the bag: seconds, or with a unit 500ms, 10s, 5min.
    #[arg(long, visible_alias = "start", value_parser = seconds, value_name = "TIME")]
    pub(crate) start_offset: Option<Duration>,
    /// Start again at the end.
    #[arg(long = "loop", short = 'l')]
    pub(crate) repeats: bool,
    /// Start paused, until a viewer plays. Otherwise playback starts when the first viewer connects.
    #[arg(long, short = 'p', visible_alias = "paused")]
    pub(crate) start_paused: bool,
    /// The folder behind package://NAME/, for the meshes of a robot description.
    #[arg(long, value_name = "NAME=FOLDER", value_parser = package)]
    pub(crate) package: Vec<(String, PathBuf)>,
    /// End after this time: seconds, or with a unit.
    #[arg(long, value_parser = seconds, value_name = "TIME")]
    pub(crate) duration: Option<Duration>,
}

pub(crate) fn view(arguments: &ViewBagArguments, catalog: &Catalog) -> anyhow::Result<()> {
    let bags = arguments.bags.iter().map(|bag| open(bag)).collect::<anyhow::Result<Vec<Reader>>>()?;
    let bags: Arc<[Reader]> = bags.into();
    let topics = || bags.iter().flat_map(Reader::topics).map(|topic| &topic.info);
    let filter = arguments.topics.filter()?;
    arguments.topics.check(topics())?;
    let wanted = topics().filter(|topic| filter.is_wanted(topic));
    let wanted: BTreeSet<_> = wanted.map(|topic| topic.name.trim_start_matches('/').to_owned()).collect();
    let names: Vec<_> = bags.iter().filter_map(|bag| bag.path().file_name()).collect();
    let names: Vec<_> = names.iter().map(|name| name.to_string_lossy()).collect();
    let options = ViewOptions {
        address: arguments.address,
        foxglove: Some(arguments.port),
        page: Some(PageOptions {
            port: arguments.page,
            host: Some(Arc::new(Asks { bags: Arc::clone(&bags), interfaces: catalog.interfaces.clone() })),
            ..PageOptions::default()
        }),
        // There is nothing to change but the time that is shown.
        access: Access::ReadOnly,
        topics: Arc::new(move |topic| wanted.contains(topic)),
        packages: arguments.package.clone(),
        ..ViewOptions::new(&names.join(", "))?
    };
    let playback = BagPlayback {
        rate: Rate::new(arguments.rate)?,
        start_offset: arguments.start_offset.unwrap_or_default(),
        repeats: arguments.repeats,
        starts_paused: arguments.start_paused,
    };
    let stop = Stop::new()?.after(arguments.duration);
    let server = ViewServer::show_bags(Arc::clone(&bags), &catalog.interfaces, playback, options)?;
    if let Some(url) = server.page_url() {
        println!("open in a browser: {url}");
    }
    if let Some(url) = server.foxglove_url() {
        println!("open in Foxglove, Lichtblick or PlotJuggler, as Foxglove WebSocket: {url}");
    }
    while !stop.is_due() {
        stop.sleep(Duration::from_secs(1));
    }
    drop(server);
    carried_over(&bags, 0)
}

/// Answers what the page asks about a bag.
pub(super) struct Asks {
    pub(super) bags: Arc<[Reader]>,
    pub(super) interfaces: Interfaces,
}

impl Host for Asks {
    fn answer(&self, ask: Ask<'_>) -> Option<Result<Value, String>> {
        (ask.name == "series").then(|| self.series(ask))
    }
}

impl Asks {
    fn series(&self, ask: Ask<'_>) -> Result<Value, String> {
        let topic = ask.require_text("topic")?;
        let fields = ask.arguments.get("fields").and_then(Value::as_array);
        let fields = fields.and_then(|fields| fields.iter().map(Value::as_str).collect::<Option<Vec<_>>>());
        let fields = fields.ok_or("the question \"series\" lacks \"fields\", a list of texts")?;
        if fields.len() > MOST_FIELDS {
            return Err(format!("at most {MOST_FIELDS} fields are read at a time"));
        }
        let points = ask.arguments.get("points").and_then(Value::as_u64).unwrap_or(DEFAULT_POINTS);
        let points = usize::try_from(points).unwrap_or(usize::MAX);
        let found = series(&self.bags, topic, &fields, points, &self.interfaces);
        Ok(json!({ "fields": found.map_err(|error| error.to_string())? }))
    }
}

fn package(text: &str) -> Result<(String, PathBuf), String> {
    match text.split_once('=') {
        Some((name, folder)) if !name.is_empty() && !folder.is_empty() => {
            Ok((name.to_owned(), folder.into()))
        }
        _ => Err("write NAME=FOLDER, such as my_robot=description".to_owned()),
    }
}
