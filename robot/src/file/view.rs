//! `[view]`: the server for Foxglove, Lichtblick and PlotJuggler, and for the page of our own.

use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;

use downbeat_bridge::expose::TopicPattern;

use super::table::Value;
use super::{Result, choice};

/// The server for viewers.
#[derive(Clone, Debug)]
pub struct ViewEntry {
    /// The address on which it listens.
    pub address: IpAddr,
    /// The port for Foxglove, Lichtblick and PlotJuggler, if they are served; 0 for a free one.
    pub foxglove: Option<u16>,
    /// The page, if it is served, and its port; `None` for the usual one, or a free one where that is in use.
    pub page: Option<Option<u16>>,
    /// Names of the machine under which browsers open the page, besides `localhost` and addresses.
    pub hosts: Vec<String>,
    /// The topics that it shows; `None` for all.
    pub topics: Option<Vec<TopicPattern>>,
    /// Who may change the robot.
    pub access: ViewAccess,
    /// The token; `None` for a random one.
    pub token: Option<String>,
    /// The folders behind `package://NAME/`, by name.
    pub packages: Vec<(String, PathBuf)>,
}

/// Who may publish, call and set through the server for viewers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ViewAccess {
    /// Viewers with the token.
    Token,
    /// Nobody.
    ReadOnly,
    /// All viewers.
    Open,
}

impl Default for ViewEntry {
    /// All topics, for viewers on this machine, which need a random token to change the robot. Neither of the
    /// two is served.
    fn default() -> Self {
        Self {
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            foxglove: None,
            page: None,
            hosts: Vec::new(),
            topics: None,
            access: ViewAccess::Token,
            token: None,
            packages: Vec::new(),
        }
    }
}

/// The port that Foxglove suggests.
pub const FOXGLOVE_PORT: u16 = 8765;

/// Reads `[view]`.
pub(super) fn view(value: Value<'_>) -> Result<ViewEntry> {
    let mut table = value.table("[view]")?;
    let mut entry = ViewEntry::default();
    let mut door = |name: &'static str| match table.take(name) {
        None => Ok(None),
        Some(value) => match value.flag() {
            Ok(is_on) => Ok(is_on.then_some(None)),
            Err(_) => value
                .number_in(0..=65535, "true, false or a port from 0 to 65535")
                .map(|port| Some(Some(port))),
        },
    };
    entry.foxglove = door("foxglove")?.map(|port| port.unwrap_or(FOXGLOVE_PORT));
    entry.page = door("page")?;
    if let Some(value) = table.take("hosts") {
        let host = |value: Value<'_>| value.text().map(str::to_owned);
        entry.hosts = value.list()?.into_iter().map(host).collect::<Result<_>>()?;
    }
    if let Some(value) = table.take("address") {
        let text = value.text()?;
        let address = text.parse().map_err(|_| {
            value.error(format!("\"{text}\" is no IP address; \"0.0.0.0\" listens on all of this machine"))
        });
        entry.address = address?;
    }
    if let Some(value) = table.take("topics") {
        let pattern = |value: Value<'_>| {
            TopicPattern::new(value.text()?).map_err(|error| value.error(error.to_string()))
        };
        entry.topics = Some(value.list()?.into_iter().map(pattern).collect::<Result<_>>()?);
    }
    if let Some(value) = table.take("access") {
        let choices =
            [("token", ViewAccess::Token), ("read_only", ViewAccess::ReadOnly), ("open", ViewAccess::Open)];
        entry.access = choice(value, &choices)?;
    }
    if let Some(value) = table.take("token") {
        if entry.access != ViewAccess::Token {
            return Err(value.error("a token is of use only with access = \"token\""));
        }
        let token = value.text()?;
        #[cfg(feature = "view")]
        downbeat_view::Token::new(token).map_err(|error| value.error(error.to_string()))?;
        entry.token = Some(token.to_owned());
    }
    if let Some(value) = table.take("packages") {
        let root = value.path().parent().map(PathBuf::from).unwrap_or_default();
        for (name, folder) in value.table("packages")?.take_rest() {
            entry.packages.push((name, root.join(folder.text()?)));
        }
    }
    table.finish()?;
    Ok(entry)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::file::Source;
    use crate::{Catalog, RobotFile};
    use std::path::Path;

    fn read(view: &str) -> Result<ViewEntry> {
        let text = format!("[robot]\nname = \"r\"\n[[module]]\nkind = \"stand_nod_wave\"\n{view}");
        let source = Source::new(Path::new("robots/robot.toml"), text);
        RobotFile::parse(source, &Catalog::built_in()).map(|(file, _)| file.view)
    }

    #[test]
    fn a_server_is_asked_for_with_one_word_or_a_port() {
        for nothing in ["", "[view]", "[view]\nfoxglove = false\npage = false"] {
            let entry = read(nothing).unwrap();
            assert_eq!((entry.foxglove, entry.page), (None, None));
        }
        let usual = read("[view]\nfoxglove = true\npage = true").unwrap();
        assert_eq!((usual.foxglove, usual.page), (Some(8765), Some(None)));
        assert_eq!((usual.address.to_string(), usual.access), ("127.0.0.1".into(), ViewAccess::Token));
        let given = read(
            "[view]\nfoxglove = 9000\npage = 9001\naddress = \"0.0.0.0\"\nhosts = [\"robot.local\"]\n\
             topics = [\"joint_states\", \"camera/**\"]\ntoken = \"my-own-secret\"\npackages = { my_robot = \"meshes\" }",
        );
        let given = given.unwrap();
        assert_eq!((given.foxglove, given.page), (Some(9000), Some(Some(9001))));
        assert_eq!(
            (given.address.to_string(), given.hosts),
            ("0.0.0.0".into(), vec!["robot.local".to_owned()])
        );
        assert!(given.topics.unwrap()[1].matches("camera/left/image"));
        assert_eq!(given.token.as_deref(), Some("my-own-secret"));
        assert_eq!(given.packages, [("my_robot".to_owned(), PathBuf::from("robots/meshes"))]);
        assert_eq!(read("[view]\naccess = \"read_only\"").unwrap().access, ViewAccess::ReadOnly);
    }

    #[test]
    fn errors_contain_the_line() {
        for (view, words) in [
            ("foxglov = true", "foxglov"),
            ("foxglove = \"yes\"", "expected true, false or a port"),
            ("page = 70000", "a port from 0 to 65535"),
            ("address = \"robot\"", "is no IP address"),
            ("access = \"all\"", "unknown choice \"all\""),
            ("access = \"open\"\ntoken = \"12345678\"", "only with access"),
        ] {
            let error = read(&format!("[view]\n{view}")).unwrap_err().to_string();
            assert!(error.starts_with("robots/robot.toml:") && error.contains(words), "{error}");
        }
    }
}
