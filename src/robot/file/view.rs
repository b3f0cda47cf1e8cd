//! `[view]`: the server for Foxglove, Lichtblick and PlotJuggler.

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
    /// The port; 0 for a free one.
    pub port: u16,
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
    /// All topics, for viewers on this machine, which need a random token to change the robot.
    fn default() -> Self {
        Self {
            address: IpAddr::V4(Ipv4Addr::LOCALHOST),
            port: 8765,
            topics: None,
            access: ViewAccess::Token,
            token: None,
            packages: Vec::new(),
        }
    }
}

/// Reads `[view]`: `foxglove = true`, or a table.
pub(super) fn view(value: Value<'_>) -> Result<Option<ViewEntry>> {
    let mut table = value.table("[view]")?;
    let foxglove = table.require("foxglove")?;
    table.finish()?;
    let mut entry = ViewEntry::default();
    let Some(mut table) = foxglove.as_table("foxglove") else {
        let is_on = foxglove.flag().map_err(|_| foxglove.error("expected true, false or a table"))?;
        return Ok(is_on.then_some(entry));
    };
    if let Some(value) = table.take("port") {
        entry.port = value.number_in(0..=65535, "a port from 0 to 65535")?;
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
    Ok(Some(entry))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::robot::file::Source;
    use crate::robot::{Catalog, RobotFile};
    use std::path::Path;

    fn read(view: &str) -> Result<Option<ViewEntry>> {
        let text = format!("[robot]\nname = \"r\"\n[[module]]\nkind = \"stand_nod_wave\"\n[view]\n{view}");
        let source = Source::new(Path::new("robots/robot.toml"), text);
        RobotFile::parse(source, &Catalog::built_in()).map(|(file, _)| file.view)
    }

    #[test]
    fn a_server_is_asked_for_with_one_word_or_a_table() {
        assert!(read("foxglove = false").unwrap().is_none());
        let usual = read("foxglove = true").unwrap().unwrap();
        assert_eq!(
            (usual.port, usual.address.to_string(), usual.access),
            (8765, "127.0.0.1".into(), ViewAccess::Token)
        );
        let given = read(
            "[view.foxglove]\nport = 9000\naddress = \"0.0.0.0\"\ntopics = [\"joint_states\", \"camera/**\"]\n\
             token = \"my-own-secret\"\npackages = { my_robot = \"meshes\" }",
        );
        let given = given.unwrap().unwrap();
        assert_eq!((given.port, given.address.to_string()), (9000, "0.0.0.0".into()));
        assert!(given.topics.unwrap()[1].matches("camera/left/image"));
        assert_eq!(given.token.as_deref(), Some("my-own-secret"));
        assert_eq!(given.packages, [("my_robot".to_owned(), PathBuf::from("robots/meshes"))]);
        assert_eq!(
            read("foxglove = { access = \"read_only\" }").unwrap().unwrap().access,
            ViewAccess::ReadOnly
        );
    }

    #[test]
    fn errors_contain_the_line() {
        for (view, words) in [
            ("foxglov = true", "[view] needs \"foxglove\""),
            ("foxglove = 1", "expected true, false or a table"),
            ("foxglove = { port = 70000 }", "a port from 0 to 65535"),
            ("foxglove = { address = \"robot\" }", "is no IP address"),
            ("foxglove = { access = \"all\" }", "unknown choice \"all\""),
            ("foxglove = { access = \"open\", token = \"12345678\" }", "only with access"),
        ] {
            let error = read(view).unwrap_err().to_string();
            assert!(error.starts_with("robots/robot.toml:") && error.contains(words), "{error}");
        }
    }
}
