//! Reads URDF.
//!
//! # References
//! <https://wiki.ros.org/urdf/XML>, and `ros/urdfdom`, whose defaults are used.

use super::{
    DescriptionError, DescriptionWarning, Drive, Dynamics, Geometry, Inertial, Joint, JointId, JointKind,
    Limits, Link, LinkId, Material, Mesh, Mimic, Oddity, Problem, Robot, Shape,
};
use downbeat_files::lines::{Lines, line_of};
use downbeat_files::suggestion;
use downbeat_transforms::Isometry;
use glam::{DMat3, DQuat, DVec3};
use roxmltree::{Document, Node};
use std::borrow::Cow;
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::marker::PhantomData;
use std::path::Path;

/// How far the length of an axis may be from 1: a unit vector with three digits.
const AXIS_TOLERANCE: f64 = 1e-3;
/// The most links of a robot, and the most joints.
const MOST_LINKS: usize = 10_000;
/// The most shapes of all links: each has a copy of its material.
const MOST_SHAPES: usize = 100_000;
/// The longest value of an attribute, in bytes: names are stored with everything that uses them.
const LONGEST_VALUE: usize = 1024;
/// The most attributes of an element, which the XML parser compares with each other.
const MOST_ATTRIBUTES: usize = 100;

pub(super) fn read(text: &str, file: String) -> Result<Robot, DescriptionError> {
    let (text, oddities) = without_surroundings(text);
    if let Some((line, found, most)) = beyond_bounds(&text) {
        return Err(DescriptionError { file, line, problem: Problem::TooMany { found, most }.into() });
    }
    let document = Document::parse(&text).map_err(|error| DescriptionError {
        file: file.clone(),
        line: Some(error.pos().row),
        problem: Problem::NotXml(error.to_string()).into(),
    })?;
    let reader =
        Reader { lines: Lines::new(&text), document: PhantomData, file: &file, warnings: RefCell::default() };
    oddities.into_iter().for_each(|(line, oddity)| reader.warn_in(line, oddity));
    let root = document.root_element();
    let is_macro =
        |node: &Node<'_, '_>| node.tag_name().namespace().is_some_and(|name| name.contains("xacro"));
    if let Some(node) = root.descendants().find(is_macro) {
        let element = format!("xacro:{}", node.tag_name().name());
        return Err(reader.error(node, Problem::Xacro { element }));
    }
    if !root.has_tag_name("robot") {
        return Err(reader.error(root, Problem::NotUrdf { root: root.tag_name().name().to_owned() }));
    }
    let name = reader.robot_name(root);
    let parts = Parts::read(&reader, root)?;
    let Parts { links, joints, joint_nodes } = parts.in_tree_order(&reader)?;
    let (coordinates, file) = (Vec::new(), file.clone());
    let mut robot = Robot { name, links, joints, coordinates, file, warnings: Vec::new() };
    drive(&mut robot, &joint_nodes, &reader)?;
    robot.warnings = reader.warnings.into_inner();
    Ok(robot)
}

/// What goes beyond the bounds of tags: the line, what was found, and what is possible. Found before the text
/// is parsed, whose time grows with the square of the number of attributes.
fn beyond_bounds(text: &str) -> Option<(Option<u32>, String, usize)> {
    if text.len() as u64 > super::LONGEST_FILE {
        return Some((None, format!("{} bytes", text.len()), super::LONGEST_FILE as usize));
    }
    let (mut line, mut attributes, mut quote) = (1, 0, None);
    let (mut rest, mut is_tag) = (text.as_bytes(), false);
    let mut value_start = 0;
    while let Some((&byte, behind)) = rest.split_first() {
        line += u32::from(byte == b'\n');
        match (quote, byte) {
            (Some(open), byte) if open == byte => quote = None,
            (Some(_), _) => {
                let length = value_start - rest.len();
                if length > LONGEST_VALUE {
                    return Some((
                        Some(line),
                        format!("a value of more than {LONGEST_VALUE} bytes"),
                        LONGEST_VALUE,
                    ));
                }
            }
            (None, b'<') if rest.starts_with(b"<!--") => {
                let comment =
                    rest.windows(3).position(|bytes| bytes == b"-->").map_or(rest.len(), |end| end + 3);
                let lines = rest[1..comment].iter().filter(|byte| **byte == b'\n').count();
                line += u32::try_from(lines).unwrap_or(0);
                rest = &rest[comment..];
                continue;
            }
            (None, b'<') => (is_tag, attributes) = (true, 0),
            (None, b'>') => is_tag = false,
            (None, b'"' | b'\'') if is_tag => (quote, value_start) = (Some(byte), rest.len()),
            (None, b'=') if is_tag => {
                attributes += 1;
                if attributes > MOST_ATTRIBUTES {
                    return Some((
                        Some(line),
                        format!("an element of more than {MOST_ATTRIBUTES} attributes"),
                        MOST_ATTRIBUTES,
                    ));
                }
            }
            _ => {}
        }
        rest = behind;
    }
    None
}

/// The text without what stands before the XML declaration, and without zero bytes at its end; lines stay
/// where they are.
fn without_surroundings(text: &str) -> (Cow<'_, str>, Vec<(u32, Oddity)>) {
    let mut oddities = Vec::new();
    let trimmed = text.trim_end_matches(|last: char| last == '\0' || last.is_whitespace());
    let text = if text[trimmed.len()..].contains('\0') {
        let line = line_of(text, trimmed.len());
        oddities.push((u32::try_from(line).unwrap_or(u32::MAX), Oddity::ZerosBehindEnd));
        trimmed
    } else {
        text
    };
    let declaration = text.find("<?xml ").filter(|&start| {
        let before = &text[..start];
        !before.trim_start_matches('\u{feff}').is_empty() && !before.contains("<robot")
    });
    let end = declaration.and_then(|start| Some(start + text[start..].find("?>")? + 2));
    let Some(end) = end else { return (text.into(), oddities) };
    oddities.push((1, Oddity::BeforeDeclaration));
    let lines = text[..end].chars().filter(|character| *character == '\n');
    (lines.chain(text[end..].chars()).collect::<String>().into(), oddities)
}

/// Attributes and elements of a document, with errors and warnings that name their line.
struct Reader<'r, 'i> {
    lines: Lines,
    document: PhantomData<&'i ()>,
    file: &'r str,
    warnings: RefCell<Vec<DescriptionWarning>>,
}

impl<'i> Reader<'_, 'i> {
    fn line(&self, node: Node<'_, 'i>) -> u32 {
        u32::try_from(self.lines.line_of(node.range().start)).unwrap_or(u32::MAX)
    }

    fn error(&self, node: Node<'_, 'i>, problem: Problem) -> DescriptionError {
        DescriptionError { file: self.file.to_owned(), line: Some(self.line(node)), problem: problem.into() }
    }

    fn warn(&self, node: Node<'_, 'i>, oddity: Oddity) {
        self.warn_in(self.line(node), oddity);
    }

    fn warn_in(&self, line: u32, oddity: Oddity) {
        let file = self.file.to_owned();
        self.warnings.borrow_mut().push(DescriptionWarning { file, line, oddity });
    }

    fn missing(&self, node: Node<'_, 'i>, owner: &str, missing: &str, remedy: &str) -> DescriptionError {
        let (owner, missing, remedy) = (owner.to_owned(), missing.to_owned(), remedy.to_owned());
        self.error(node, Problem::Missing { owner, missing, remedy })
    }

    /// The name of the robot, else that of its file.
    fn robot_name(&self, root: Node<'_, 'i>) -> String {
        if let Some(name) = root.attribute("name").filter(|name| !name.trim().is_empty()) {
            return name.to_owned();
        }
        let stem = Path::new(self.file).file_stem();
        let taken = stem.map_or_else(|| "robot".to_owned(), |stem| stem.to_string_lossy().into_owned());
        self.warn(root, Oddity::NoName { taken: taken.clone() });
        taken
    }

    fn name<'a>(&self, node: Node<'a, 'i>, owner: &str) -> Result<&'a str, DescriptionError> {
        self.text(node, owner, "name")
    }

    fn text<'a>(
        &self,
        node: Node<'a, 'i>,
        owner: &str,
        attribute: &str,
    ) -> Result<&'a str, DescriptionError> {
        let found = node.attribute(attribute).filter(|text| !text.trim().is_empty());
        let remedy = || format!("{attribute}=\"...\" to <{}>", node.tag_name().name());
        found.ok_or_else(|| self.missing(node, owner, attribute, &remedy()))
    }

    fn element<'a>(
        &self,
        node: Node<'a, 'i>,
        owner: &str,
        element: &str,
        example: &str,
    ) -> Result<Node<'a, 'i>, DescriptionError> {
        child(node, element).ok_or_else(|| {
            self.missing(node, owner, &format!("<{element}>"), &format!("<{element} {example}/>"))
        })
    }

    /// The numbers of an attribute; `None` if it is absent.
    fn numbers<const N: usize>(
        &self,
        node: Node<'_, 'i>,
        owner: &str,
        attribute: &str,
    ) -> Result<Option<[f64; N]>, DescriptionError> {
        let Some(text) = node.attribute(attribute) else { return Ok(None) };
        let (owner, attribute, text) = (owner.to_owned(), attribute.to_owned(), text.to_owned());
        let mut words = text.split(|c: char| c.is_whitespace() || c == ',').filter(|word| !word.is_empty());
        let numbers =
            std::array::from_fn(|_| words.next().and_then(|word| word.parse().ok()).unwrap_or(f64::NAN));
        let (are_finite, is_more) = (numbers.iter().all(|number: &f64| number.is_finite()), words.next());
        if !are_finite || (N == 1 && (is_more.is_some() || text.contains(','))) {
            let expected = if N == 1 { "a finite number".into() } else { format!("{N} finite numbers") };
            return Err(self.error(node, Problem::BadNumber { owner, attribute, text, expected }));
        }
        if is_more.is_some() {
            self.warn(node, Oddity::MoreNumbers { owner, attribute, text, count: N });
        } else if text.contains(',') {
            self.warn(node, Oddity::Commas { owner, attribute, text });
        }
        Ok(Some(numbers))
    }

    fn number(&self, node: Node<'_, 'i>, owner: &str, attribute: &str) -> Result<f64, DescriptionError> {
        self.text(node, owner, attribute)?;
        Ok(self.numbers::<1>(node, owner, attribute)?.map_or(0.0, |[number]| number))
    }

    fn number_or(
        &self,
        node: Node<'_, 'i>,
        owner: &str,
        attribute: &str,
        default: f64,
    ) -> Result<f64, DescriptionError> {
        Ok(self.numbers::<1>(node, owner, attribute)?.map_or(default, |[number]| number))
    }

    fn not_negative(
        &self,
        node: Node<'_, 'i>,
        owner: &str,
        attribute: &str,
        value: f64,
    ) -> Result<f64, DescriptionError> {
        if value >= 0.0 {
            return Ok(value);
        }
        let (owner, attribute, expected) = (owner.to_owned(), attribute.to_owned(), "0 or more".into());
        Err(self.error(node, Problem::OutOfRange { owner, attribute, value, expected }))
    }

    fn vector(
        &self,
        node: Node<'_, 'i>,
        owner: &str,
        attribute: &str,
        default: DVec3,
    ) -> Result<DVec3, DescriptionError> {
        Ok(self.numbers(node, owner, attribute)?.map_or(default, DVec3::from_array))
    }

    /// The `<origin>` of an element; the identity if it has none.
    fn origin(&self, node: Node<'_, 'i>, owner: &str) -> Result<Isometry, DescriptionError> {
        let Some(origin) = child(node, "origin") else { return Ok(Isometry::IDENTITY) };
        let translation = self.vector(origin, owner, "xyz", DVec3::ZERO)?;
        let [roll, pitch, yaw] = self.vector(origin, owner, "rpy", DVec3::ZERO)?.to_array();
        // Rotations about the fixed axes x, y and z, in this order.
        let rotation =
            DQuat::from_rotation_z(yaw) * DQuat::from_rotation_y(pitch) * DQuat::from_rotation_x(roll);
        Ok(Isometry { translation, rotation })
    }

    fn link(
        &self,
        node: Node<'_, 'i>,
        materials: &BTreeMap<&str, Material>,
    ) -> Result<Link, DescriptionError> {
        let name = self.name(node, "a link")?;
        let owner = format!("link \"{name}\"");
        let shapes = |tag: &str| {
            let nodes = children(node, tag);
            let shapes = nodes.map(|shape| self.shape(shape, &owner, materials));
            shapes.filter_map(Result::transpose).collect::<Result<Vec<Shape>, _>>()
        };
        Ok(Link {
            inertial: child(node, "inertial").map(|inertial| self.inertial(inertial, &owner)).transpose()?,
            visuals: shapes("visual")?,
            collisions: shapes("collision")?,
            name: name.to_owned(),
            parent: None,
            line: self.line(node),
        })
    }

    fn inertial(&self, node: Node<'_, 'i>, owner: &str) -> Result<Inertial, DescriptionError> {
        let mass_node = self.element(node, owner, "mass", "value=\"...\"")?;
        let mass = self.number(mass_node, owner, "value")?;
        let mass = self.not_negative(mass_node, owner, "mass", mass)?;
        let inertia = self.element(
            node,
            owner,
            "inertia",
            "ixx=\"...\" iyy=\"...\" izz=\"...\" ixy=\"0\" ixz=\"0\" iyz=\"0\"",
        )?;
        let [xx, yy, zz] = ["ixx", "iyy", "izz"].map(|name| self.number(inertia, owner, name));
        let [xy, xz, yz] = ["ixy", "ixz", "iyz"].map(|name| self.number_or(inertia, owner, name, 0.0));
        let (xx, yy, zz, xy, xz, yz) = (xx?, yy?, zz?, xy?, xz?, yz?);
        let inertia = DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz]);
        Ok(Inertial { link_from_inertial: self.origin(node, owner)?, mass, inertia })
    }

    fn shape(
        &self,
        node: Node<'_, 'i>,
        owner: &str,
        materials: &BTreeMap<&str, Material>,
    ) -> Result<Option<Shape>, DescriptionError> {
        let geometry =
            child(node, "geometry").and_then(|geometry| geometry.children().find(Node::is_element));
        let geometry = geometry.ok_or_else(|| {
            let shape = format!("a <{}> of {owner}", node.tag_name().name());
            self.missing(node, &shape, "<geometry>", "<geometry><box size=\"...\"/></geometry>")
        })?;
        let Some(geometry) = self.geometry(geometry, owner)? else { return Ok(None) };
        let material = match child(node, "material") {
            None => None,
            Some(node) => match self.material(node) {
                Material { name, rgba: None, texture: None } => {
                    let known = materials.get(&*name).cloned();
                    if known.is_none() && !name.is_empty() {
                        let hint = suggestion(&name, materials.keys());
                        self.warn(node, Oddity::UnknownMaterial { material: name.clone(), hint });
                    }
                    known.or(Some(Material { name, rgba: None, texture: None }))
                }
                inline => Some(inline),
            },
        };
        Ok(Some(Shape {
            name: node.attribute("name").unwrap_or_default().to_owned(),
            link_from_shape: self.origin(node, owner)?,
            geometry,
            material,
            line: self.line(node),
        }))
    }

    /// `None` for shapes that URDF does not have.
    fn geometry(&self, node: Node<'_, 'i>, owner: &str) -> Result<Option<Geometry>, DescriptionError> {
        let extent = |attribute: &str, length: f64| {
            self.not_negative(node, owner, attribute, length)?;
            if length == 0.0 {
                let (owner, attribute) = (owner.to_owned(), attribute.to_owned());
                self.warn(node, Oddity::NoExtent { owner, attribute });
            }
            Ok(length)
        };
        let length = |attribute: &str| extent(attribute, self.number(node, owner, attribute)?);
        let geometry = match node.tag_name().name() {
            "box" => {
                self.text(node, owner, "size")?;
                let size = self.vector(node, owner, "size", DVec3::ZERO)?;
                extent("size", size.min_element())?;
                Geometry::Box { size }
            }
            "cylinder" => Geometry::Cylinder { radius: length("radius")?, length: length("length")? },
            "sphere" => Geometry::Sphere { radius: length("radius")? },
            "mesh" => Geometry::Mesh(Mesh {
                file_name: self.text(node, owner, "filename")?.to_owned(),
                scale: self.vector(node, owner, "scale", DVec3::ONE)?,
            }),
            other => {
                let (owner, element) = (owner.to_owned(), other.to_owned());
                self.warn(node, Oddity::UnknownShape { owner, element });
                return Ok(None);
            }
        };
        Ok(Some(geometry))
    }

    fn material(&self, node: Node<'_, 'i>) -> Material {
        let name = node.attribute("name").unwrap_or_default().to_owned();
        let rgba = child(node, "color").and_then(|color| {
            let text = color.attribute("rgba")?;
            let parts: Option<Vec<f32>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
            let parts = parts.filter(|parts| parts.iter().all(|part: &f32| part.is_finite()));
            let rgba = parts.and_then(|parts| <[f32; 4]>::try_from(parts).ok());
            if rgba.is_none() {
                let (owner, text) = (format!("material \"{name}\""), text.to_owned());
                self.warn(color, Oddity::BadColor { owner, text });
            }
            rgba
        });
        let texture = child(node, "texture").and_then(|texture| texture.attribute("filename"));
        Material { name, rgba, texture: texture.map(str::to_owned) }
    }

    fn joint(&self, node: Node<'_, 'i>, links: &BTreeMap<&str, usize>) -> Result<Joint, DescriptionError> {
        let name = self.name(node, "a joint")?;
        let owner = format!("joint \"{name}\"");
        let kind = match self.text(node, &owner, "type")? {
            "revolute" => JointKind::Revolute,
            "continuous" => JointKind::Continuous,
            "prismatic" => JointKind::Prismatic,
            "fixed" => JointKind::Fixed,
            "floating" => JointKind::Floating,
            "planar" => JointKind::Planar,
            // An extension of Bullet.
            "spherical" => {
                self.warn(node, Oddity::Spherical { joint: name.to_owned() });
                JointKind::Floating
            }
            kind => {
                let (joint, kind) = (name.to_owned(), kind.to_owned());
                return Err(self.error(node, Problem::JointKind { joint, kind }));
            }
        };
        let link = |element: &str| {
            let node = self.element(node, &owner, element, "link=\"...\"")?;
            let link = self.text(node, &owner, "link")?;
            let hint = || suggestion(link, links.keys());
            let unknown = || Problem::UnknownLink { link: link.to_owned(), hint: hint() };
            links.get(link).copied().map(LinkId).ok_or_else(|| self.error(node, unknown()))
        };
        let dynamics = match child(node, "dynamics") {
            None => Dynamics::default(),
            Some(dynamics) => {
                let value = |attribute: &str| {
                    let value = self.number_or(dynamics, &owner, attribute, 0.0)?;
                    self.not_negative(dynamics, &owner, attribute, value)
                };
                Dynamics { damping: value("damping")?, friction: value("friction")? }
            }
        };
        Ok(Joint {
            kind,
            parent: link("parent")?,
            child: link("child")?,
            parent_from_joint: self.origin(node, &owner)?,
            axis: match kind {
                JointKind::Fixed | JointKind::Floating => DVec3::X,
                _ => self.axis(node, name)?,
            },
            limits: self.limits(node, kind, name)?,
            dynamics,
            drive: None,
            mimic: None,
            line: self.line(node),
            name: name.to_owned(),
        })
    }

    fn axis(&self, node: Node<'_, 'i>, joint: &str) -> Result<DVec3, DescriptionError> {
        let Some(node) = child(node, "axis") else { return Ok(DVec3::X) };
        let axis = self.vector(node, &format!("joint \"{joint}\""), "xyz", DVec3::X)?;
        let length = axis.length();
        let Some(unit) = axis.try_normalize() else {
            return Err(self.error(node, Problem::NoAxis { joint: joint.to_owned() }));
        };
        if (length - 1.0).abs() > AXIS_TOLERANCE {
            let words =
                |axis: DVec3| axis.to_array().map(|part| ((part * 1e6).round() / 1e6).to_string()).join(" ");
            let (joint, axis, unit) = (joint.to_owned(), words(axis), words(unit));
            self.warn(node, Oddity::AxisLength { joint, axis, length, unit });
        }
        Ok(unit)
    }

    fn limits(
        &self,
        node: Node<'_, 'i>,
        kind: JointKind,
        joint: &str,
    ) -> Result<Option<Limits>, DescriptionError> {
        let owner = format!("joint \"{joint}\"");
        let is_limited = matches!(kind, JointKind::Revolute | JointKind::Prismatic);
        let example = "lower=\"...\" upper=\"...\" effort=\"...\" velocity=\"...\"";
        let Some(node) = child(node, "limit") else {
            if is_limited {
                let remedy = format!("<limit {example}/>, or make it continuous");
                return Err(self.missing(node, &owner, "<limit>", &remedy));
            }
            return Ok(None);
        };
        if !kind.has_position() {
            return Ok(None);
        }
        let [lower, upper] = ["lower", "upper"].map(|name| self.number_or(node, &owner, name, 0.0));
        let [effort, velocity] = ["effort", "velocity"].map(|name| self.number(node, &owner, name));
        let (lower, upper, effort, velocity) = (lower?, upper?, effort?, velocity?);
        if lower > upper && is_limited {
            self.warn(node, Oddity::Limits { joint: joint.to_owned(), lower, upper });
            return Ok(Some(Limits { lower: upper, upper: lower, effort, velocity }));
        }
        Ok(Some(Limits { lower, upper, effort, velocity }))
    }
}

/// Links and joints, with the elements of the latter.
struct Parts<'a, 'i> {
    links: Vec<Link>,
    joints: Vec<Joint>,
    joint_nodes: Vec<Node<'a, 'i>>,
}

impl<'a, 'i> Parts<'a, 'i> {
    fn read(reader: &Reader<'_, 'i>, root: Node<'a, 'i>) -> Result<Self, DescriptionError> {
        let mut materials = BTreeMap::new();
        // Materials may be used before they are defined, and a definition inside a link is valid everywhere.
        for node in root.descendants().filter(|node| node.has_tag_name("material")) {
            let name = node.attribute("name").filter(|name| !name.is_empty());
            if let (Some(name), Some(_)) = (name, child(node, "color").or(child(node, "texture"))) {
                materials.entry(name).or_insert_with(|| reader.material(node));
            }
        }
        let link_nodes: Vec<_> = children(root, "link").collect();
        let joint_nodes: Vec<_> = children(root, "joint").collect();
        let shapes: usize = link_nodes
            .iter()
            .map(|node| children(*node, "visual").count() + children(*node, "collision").count())
            .sum();
        for (what, count, most) in [
            ("links", link_nodes.len(), MOST_LINKS),
            ("joints", joint_nodes.len(), MOST_LINKS),
            ("shapes", shapes, MOST_SHAPES),
        ] {
            if count > most {
                return Err(reader.error(root, Problem::TooMany { found: format!("{count} {what}"), most }));
            }
        }
        let link_index = unique_names(reader, &link_nodes, "link")?;
        unique_names(reader, &joint_nodes, "joint")?;
        if link_nodes.is_empty() {
            return Err(reader.error(root, Problem::NoLinks));
        }
        let links = link_nodes.iter().map(|node| reader.link(*node, &materials)).collect::<Result<_, _>>()?;
        let joints =
            joint_nodes.iter().map(|node| reader.joint(*node, &link_index)).collect::<Result<_, _>>()?;
        Ok(Self { links, joints, joint_nodes })
    }

    /// Checks that the links form a tree, and puts parents before children.
    fn in_tree_order(&self, reader: &Reader<'_, 'i>) -> Result<Self, DescriptionError> {
        let mut joint_to = vec![None; self.links.len()];
        let mut joints_from = vec![Vec::new(); self.links.len()];
        for (index, joint) in self.joints.iter().enumerate() {
            if let Some(first) = joint_to[joint.child.0].replace(index) {
                let first: &Joint = &self.joints[first];
                return Err(reader.error(
                    self.joint_nodes[index],
                    Problem::TwoParents {
                        link: self.links[joint.child.0].name.clone(),
                        first: first.name.clone(),
                        first_line: first.line,
                        second: joint.name.clone(),
                    },
                ));
            }
            joints_from[joint.parent.0].push(index);
        }
        let roots: Vec<usize> = (0..self.links.len()).filter(|&link| joint_to[link].is_none()).collect();
        let root = match roots[..] {
            [root] => root,
            // Every link has a parent, so going up from any one ends in a loop.
            [] => return Err(self.loop_above(0, &joint_to, reader)),
            [_, second, ..] => {
                let links = roots.iter().map(|&link| self.links[link].name.clone()).collect();
                let (file, line) = (reader.file.to_owned(), Some(self.links[second].line));
                return Err(DescriptionError { file, line, problem: Problem::SeveralRoots { links }.into() });
            }
        };
        let (mut links, mut joints, mut joint_nodes) =
            (vec![self.links[root].clone()], Vec::new(), Vec::new());
        let mut new_ids = vec![None; self.links.len()];
        new_ids[root] = Some(LinkId(0));
        let mut open: Vec<usize> = joints_from[root].iter().rev().copied().collect();
        while let Some(index) = open.pop() {
            let mut joint = self.joints[index].clone();
            let old_child = joint.child.0;
            let mut link = self.links[old_child].clone();
            (joint.parent, joint.child) = (new_ids[joint.parent.0].unwrap_or(LinkId(0)), LinkId(links.len()));
            link.parent = Some(JointId(joints.len()));
            new_ids[old_child] = Some(joint.child);
            links.push(link);
            joints.push(joint);
            joint_nodes.push(self.joint_nodes[index]);
            open.extend(joints_from[old_child].iter().rev());
        }
        match new_ids.iter().position(Option::is_none) {
            Some(unreached) => Err(self.loop_above(unreached, &joint_to, reader)),
            None => Ok(Self { links, joints, joint_nodes }),
        }
    }

    fn loop_above(
        &self,
        link: usize,
        joint_to: &[Option<usize>],
        reader: &Reader<'_, 'i>,
    ) -> DescriptionError {
        let (mut link, mut seen, mut path) = (link, BTreeSet::new(), Vec::new());
        while let (true, Some(joint)) = (seen.insert(link), joint_to[link]) {
            path.push((link, joint));
            link = self.joints[joint].parent.0;
        }
        let of_loop = path.iter().skip_while(|(passed, _)| *passed != link).map(|(_, joint)| *joint);
        let of_loop: BTreeSet<usize> = of_loop.collect();
        let joints = of_loop.iter().map(|&joint| self.joints[joint].name.clone()).collect();
        let last = of_loop.last().copied().unwrap_or(0);
        reader.error(self.joint_nodes[last], Problem::Loop { joints })
    }
}

/// Gives each moving joint its coordinate, in tree order, or that of the joint that it follows.
fn drive(robot: &mut Robot, nodes: &[Node<'_, '_>], reader: &Reader<'_, '_>) -> Result<(), DescriptionError> {
    for (index, node) in nodes.iter().enumerate() {
        let Some(node) = child(*node, "mimic") else { continue };
        let name = robot.joints[index].name.clone();
        let owner = format!("joint \"{name}\"");
        let other = reader.text(node, &owner, "joint")?;
        let leader = robot.joint_id(other).map_err(|error| format!("but {}", error.problem));
        let leader = leader.and_then(|leader| {
            let fixed = [JointId(index), leader].into_iter().find(|&id| !robot.joint(id).kind.has_position());
            fixed.map_or(Ok(leader), |id| Err(format!("and \"{}\" has no position", robot.joint(id).name)))
        });
        let joint = match leader {
            Ok(joint) => joint,
            Err(reason) => {
                reader.warn(node, Oddity::Mimic { joint: name, other: other.to_owned(), reason });
                continue;
            }
        };
        let multiplier = reader.number_or(node, &owner, "multiplier", 1.0)?;
        let offset = reader.number_or(node, &owner, "offset", 0.0)?;
        robot.joints[index].mimic = Some(Mimic { joint, multiplier, offset });
    }
    for index in 0..robot.joints.len() {
        if robot.joints[index].kind.has_position() && robot.joints[index].mimic.is_none() {
            let drive = Drive { coordinate: robot.coordinates.len(), multiplier: 1.0, offset: 0.0 };
            robot.joints[index].drive = Some(drive);
            robot.coordinates.push(JointId(index));
        }
    }
    for (index, node) in nodes.iter().enumerate() {
        let (mut leader, mut multiplier, mut offset, mut steps) = (index, 1.0, 0.0, 0);
        while let Some(mimic) = robot.joints[leader].mimic {
            offset += multiplier * mimic.offset;
            multiplier *= mimic.multiplier;
            leader = mimic.joint.0;
            steps += 1;
            if steps > robot.joints.len() {
                let [joint, other] = [index, mimic.joint.0].map(|index| robot.joints[index].name.clone());
                let reason = "follows it in turn: remove one <mimic>";
                return Err(reader.error(*node, Problem::Mimic { joint, other, reason }));
            }
        }
        if let (true, Some(of_leader)) = (steps > 0, robot.joints[leader].drive) {
            robot.joints[index].drive = Some(Drive { coordinate: of_leader.coordinate, multiplier, offset });
        }
    }
    Ok(())
}

fn children<'a, 'i>(node: Node<'a, 'i>, name: &str) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children().filter(move |child| child.has_tag_name(name))
}

fn child<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    children(node, name).next()
}

/// The indices of elements by their names.
fn unique_names<'a, 'i>(
    reader: &Reader<'_, 'i>,
    nodes: &[Node<'a, 'i>],
    kind: &'static str,
) -> Result<BTreeMap<&'a str, usize>, DescriptionError> {
    let mut indices = BTreeMap::new();
    for (index, node) in nodes.iter().enumerate() {
        let name = reader.name(*node, &format!("a {kind}"))?;
        if let Some(first) = indices.insert(name, index) {
            let first = reader.line(nodes[first]);
            return Err(reader.error(*node, Problem::Duplicate { kind, name: name.to_owned(), first }));
        }
    }
    Ok(indices)
}
