//! `downbeat view layout`: a layout file of Foxglove and Lichtblick for a robot.
//!
//! The format is that of Lichtblick's `LayoutData`
//! (`packages/suite-base/src/context/CurrentLayoutContext/actions.ts`), which Foxglove reads too; the options
//! of each panel are those of its type there.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde_json::{Map, Value, json};

use crate::graph::of_robot;
use crate::new_output::{Force, Output};
use crate::unfinished::write_file;
use downbeat_executor::{Graph, SettingValue};
use downbeat_kinematics::Robot;
use downbeat_robot::{Catalog, RobotFile, RosArgs};

#[derive(Args)]
pub(crate) struct LayoutArguments {
    /// The robot file.
    #[arg(value_name = "ROBOT.toml")]
    pub(crate) robot: PathBuf,
    /// The viewer.
    #[arg(long = "for", value_enum, default_value_t, value_name = "VIEWER")]
    pub(crate) viewer: LayoutViewer,
    /// The new file; default is standard output.
    #[arg(long, short, value_name = "FILE.json")]
    pub(crate) output: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) force: Force,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum LayoutViewer {
    #[default]
    Lichtblick,
    Foxglove,
}

pub(crate) fn layout(arguments: &LayoutArguments, catalog: &Catalog, ros: &RosArgs) -> anyhow::Result<()> {
    if let Some(output) = &arguments.output {
        arguments.force.make_way(Output::File, output, [])?;
    }
    let graph = of_robot(&arguments.robot, catalog, ros)?;
    let file = RobotFile::read_with(&arguments.robot, catalog, ros)?;
    let layout = of(&graph, description(&file).as_ref(), arguments.viewer);
    let text = serde_json::to_string_pretty(&layout)? + "\n";
    match &arguments.output {
        Some(output) => write_file(output, text),
        None => {
            print!("{text}");
            Ok(())
        }
    }
}

/// The first URDF file that a module names.
fn description(file: &RobotFile) -> Option<Robot> {
    let texts =
        file.modules.iter().filter_map(|module| match &module.settings.get("robot_description")?.value {
            SettingValue::Text(text) => Some(Path::new(text)),
            _ => None,
        });
    let mut files = texts.filter(|path| path.extension().is_some_and(|extension| extension == "urdf"));
    let path = files.next()?;
    Robot::read(path).inspect_err(|error| tracing::warn!("the layout has no joints: {error}")).ok()
}

/// Lines of one plot; more are not distinguishable.
const MOST_LINES: usize = 20;
/// Lines of a plot if the number of joints is unknown.
const FEW_LINES: usize = 6;

/// Types that the 3D panel shows, besides transforms and images.
const SHOWN_IN_3D: [&str; 11] = [
    "geometry_msgs/msg/PolygonStamped",
    "geometry_msgs/msg/PoseArray",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "nav_msgs/msg/OccupancyGrid",
    "nav_msgs/msg/Odometry",
    "nav_msgs/msg/Path",
    "sensor_msgs/msg/LaserScan",
    "sensor_msgs/msg/PointCloud2",
    "visualization_msgs/msg/Marker",
    "visualization_msgs/msg/MarkerArray",
];

/// The layout for a robot with these topics.
pub(crate) fn of(graph: &Graph, description: Option<&Robot>, viewer: LayoutViewer) -> Value {
    let topics = Topics(graph);
    let mut panels = Map::new();
    let mut add = |id: &str, config: Value| {
        panels.insert(id.to_owned(), config);
        json!(id)
    };
    let scene = add("3D!downbeat", scene(topics, description, viewer));
    let image = image(topics).map(|config| add("Image!downbeat", config));
    let positions = topics.of(&["sensor_msgs/msg/JointState"]).find(|topic| topic.ends_with("joint_states"));
    let positions = positions.or_else(|| topics.of(&["sensor_msgs/msg/JointState"]).next());
    let plot = positions.map(|topic| add("Plot!downbeat", plot(&topic, description)));
    let mut tabs = Vec::new();
    let mut tab = |title: &str, id: &str, config: Value| {
        tabs.push(json!({ "title": title, "layout": add(id, config) }));
    };
    if let Some(topic) = topics.of(&["diagnostic_msgs/msg/DiagnosticArray"]).next() {
        let config = json!({
            "minLevel": 0, "pinnedIds": [], "topicToRender": topic, "hardwareIdFilter": "", "sortByLevel": true,
        });
        tab("Diagnostics", "DiagnosticSummary!downbeat", config);
    }
    if let Some(topic) = topics.of(&["rcl_interfaces/msg/Log"]).next() {
        tab("Log", "RosOut!downbeat", json!({ "searchTerms": [], "minLogLevel": 1, "topicToRender": topic }));
    }
    tab("Parameters", "Parameters!downbeat", json!({ "title": "Parameters" }));
    tab("Graph", "TopicGraph!downbeat", json!({}));
    let tabs = add("Tab!downbeat", json!({ "activeTabIdx": 0, "tabs": tabs }));
    let left = match plot {
        Some(plot) => split("column", scene, plot, 65),
        None => scene,
    };
    let right = match image {
        Some(image) => split("column", image, tabs, 50),
        None => tabs,
    };
    json!({
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": { "speed": 1 },
        "layout": split("row", left, right, 65),
    })
}

fn split(direction: &str, first: Value, second: Value, percentage: u8) -> Value {
    json!({ "direction": direction, "first": first, "second": second, "splitPercentage": percentage })
}

fn scene(topics: Topics<'_>, description: Option<&Robot>, viewer: LayoutViewer) -> Value {
    let mut shown: Map<_, _> =
        topics.of(&SHOWN_IN_3D).map(|topic| (topic, json!({ "visible": true }))).collect();
    let grid = json!({
        "visible": true, "frameLocked": true, "label": "Grid", "instanceId": "grid", "layerId": "foxglove.Grid",
        "size": 10, "divisions": 10, "lineWidth": 1, "color": "#248eff", "position": [0, 0, 0], "rotation": [0, 0, 0],
        "order": 1,
    });
    let mut layers = Map::from_iter([("grid".to_owned(), grid)]);
    if let Some(topic) =
        topics.of(&["std_msgs/msg/String"]).find(|topic| topic.ends_with("/robot_description"))
    {
        match viewer {
            // It shows the topic by itself.
            LayoutViewer::Lichtblick => drop(shown.insert(topic, json!({ "visible": true }))),
            LayoutViewer::Foxglove => {
                let urdf = json!({
                    "visible": true, "frameLocked": true, "label": "URDF", "instanceId": "urdf",
                    "layerId": "foxglove.Urdf", "sourceType": "topic", "topic": topic, "framePrefix": "",
                    "displayMode": "auto", "order": 2,
                });
                layers.insert("urdf".to_owned(), urdf);
            }
        }
    }
    let mut scene = json!({
        "cameraState": {
            "perspective": true, "distance": 1.5, "phi": 65, "thetaOffset": 45, "targetOffset": [0, 0, 0],
            "target": [0, 0, 0], "targetOrientation": [0, 0, 0, 1], "fovy": 45, "near": 0.01, "far": 5000,
        },
        "followMode": "follow-position",
        "scene": {},
        "transforms": {},
        "topics": shown,
        "layers": layers,
        "imageMode": {},
    });
    if let Some(description) = description {
        scene["followTf"] = json!(description.root().name);
    }
    scene
}

fn image(topics: Topics<'_>) -> Option<Value> {
    let image = topics.of(&["sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"]).next()?;
    let folder = |topic: &str| topic.rsplit_once('/').map(|(folder, _)| folder.to_owned());
    let mut mode = json!({ "imageTopic": image });
    let beside = |info: &String| folder(info) == folder(&image);
    if let Some(info) = topics.of(&["sensor_msgs/msg/CameraInfo"]).find(beside) {
        mode["calibrationTopic"] = json!(info);
    }
    Some(json!({ "imageMode": mode, "topics": {}, "layers": {}, "transforms": {}, "scene": {} }))
}

fn plot(topic: &str, description: Option<&Robot>) -> Value {
    let moves = |robot: &Robot| robot.joints().iter().filter(|joint| joint.drive.is_some()).count();
    let lines = description.map_or(FEW_LINES, moves).clamp(1, MOST_LINES);
    let paths = (0..lines).map(|joint| {
        json!({ "value": format!("{topic}.position[{joint}]"), "enabled": true, "timestampMethod": "receiveTime" })
    });
    json!({
        "title": "Joint positions",
        "paths": paths.collect::<Vec<_>>(),
        "showLegend": true,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": false,
        "showXAxisLabels": true,
        "showYAxisLabels": true,
        "isSynced": true,
        "xAxisVal": "timestamp",
        "followingViewWidth": 10,
        "sidebarDimension": 240,
    })
}

#[derive(Clone, Copy)]
struct Topics<'a>(&'a Graph);

impl<'a> Topics<'a> {
    /// The topics of these types, as viewers name them.
    fn of(self, types: &[&'a str]) -> impl Iterator<Item = String> + use<'a> {
        let types = types.to_vec();
        let topics = self.0.topics.iter().filter(move |topic| types.contains(&topic.message_type.as_str()));
        topics.map(|topic| format!("/{}", topic.name))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::collections::BTreeSet;

    use super::*;

    /// The emulated robot, with its description.
    fn robot() -> (Graph, Robot) {
        let robots = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../robots"));
        let (catalog, ros) = (Catalog::built_in(), RosArgs::default());
        let emulated = std::fs::read_to_string(robots.join("darwin_op.toml")).unwrap();
        let urdf = robots.join("darwin_op.urdf");
        let publisher = format!(
            "\n[[module]]\nkind = \"robot_state_publisher\"\nsettings = {{ robot_description = \"{}\" }}\n",
            urdf.display()
        );
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("robot.toml");
        std::fs::write(&path, emulated + publisher.as_str()).unwrap();
        let graph = of_robot(&path, &catalog, &ros).unwrap();
        let file = RobotFile::read_with(&path, &catalog, &ros).unwrap();
        (graph, description(&file).unwrap())
    }

    /// The ids of the panels in a tree of the layout.
    fn panels(node: &Value, found: &mut Vec<String>) {
        match node {
            Value::String(id) => found.push(id.clone()),
            node => {
                assert!(["row", "column"].contains(&node["direction"].as_str().unwrap()), "{node}");
                assert!((1.0..100.0).contains(&node["splitPercentage"].as_f64().unwrap()), "{node}");
                assert_eq!(node.as_object().unwrap().len(), 4, "{node}");
                panels(&node["first"], found);
                panels(&node["second"], found);
            }
        }
    }

    /// The texts in a value that are names of topics, with or without a field.
    fn topics(value: &Value, found: &mut BTreeSet<String>) {
        match value {
            Value::String(text) if text.starts_with('/') => {
                found.insert(text.split('.').next().unwrap().to_owned());
            }
            Value::Array(values) => values.iter().for_each(|value| topics(value, found)),
            Value::Object(fields) => fields.iter().for_each(|(name, value)| {
                topics(&json!(name), found);
                topics(value, found);
            }),
            _ => {}
        }
    }

    #[test]
    fn a_layout_has_the_form_of_lichtblick() {
        let (graph, description) = robot();
        for viewer in [LayoutViewer::Lichtblick, LayoutViewer::Foxglove] {
            let layout = of(&graph, Some(&description), viewer);
            let keys: Vec<_> = layout.as_object().unwrap().keys().cloned().collect();
            assert_eq!(keys, ["configById", "globalVariables", "layout", "playbackConfig", "userNodes"]);
            assert_eq!(layout["playbackConfig"], json!({ "speed": 1 }));
            let configs = layout["configById"].as_object().unwrap();
            // Every panel stands in the tree or in a tab, once, and is of a type that Lichtblick registers.
            let mut placed = Vec::new();
            panels(&layout["layout"], &mut placed);
            for tab in configs["Tab!downbeat"]["tabs"].as_array().unwrap() {
                assert!(tab["title"].is_string());
                panels(&tab["layout"], &mut placed);
            }
            placed.sort();
            assert_eq!(placed, configs.keys().cloned().collect::<Vec<_>>());
            const TYPES: [&str; 8] =
                ["3D", "Image", "Plot", "DiagnosticSummary", "RosOut", "Parameters", "TopicGraph", "Tab"];
            assert!(placed.iter().all(|id| TYPES.contains(&id.split_once('!').unwrap().0)), "{placed:?}");
            for path in configs["Plot!downbeat"]["paths"].as_array().unwrap() {
                assert!(path["enabled"].is_boolean() && path["timestampMethod"] == "receiveTime");
            }
            for (id, layer) in configs["3D!downbeat"]["layers"].as_object().unwrap() {
                assert_eq!(layer["instanceId"], id.as_str());
                assert!(["foxglove.Grid", "foxglove.Urdf"].contains(&layer["layerId"].as_str().unwrap()));
            }
            assert_eq!(configs["3D!downbeat"]["followTf"], description.root().name);
        }
    }

    #[test]
    fn every_topic_of_a_layout_is_one_of_the_robot() {
        let (graph, description) = robot();
        let known: BTreeSet<_> = graph.topics.iter().map(|topic| format!("/{}", topic.name)).collect();
        let mut found = BTreeSet::new();
        topics(&of(&graph, Some(&description), LayoutViewer::Foxglove), &mut found);
        assert!(found.is_subset(&known), "{:?}", found.difference(&known));
        for expected in ["/joint_states", "/robot_description", "/diagnostics"] {
            assert!(found.contains(expected), "{found:?}");
        }
    }

    #[test]
    fn a_robot_without_topics_has_a_layout_too() {
        let layout = of(&Graph::default(), None, LayoutViewer::Lichtblick);
        let mut found = BTreeSet::new();
        topics(&layout, &mut found);
        assert_eq!(found, BTreeSet::new());
        assert_eq!(layout["layout"]["first"], "3D!downbeat");
    }
}
