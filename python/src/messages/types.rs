//! Message types: what a class of messages knows of its fields.

use std::collections::HashMap;
use std::path::Path;
use std::sync::{Arc, LazyLock};

use bytes::Bytes;
use downbeat_msgs::definitions::{
    Catalog, DefinitionEncoding, Element, FieldType, Kind, MessageDefinition, Primitive, Shape, TypeName,
};
use downbeat_msgs::dynamic::{AmentPrefixPath, Definitions, DynamicMessage, DynamicType};
use parking_lot::Mutex;
use pyo3::exceptions::{PyKeyError, PyOSError, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyString, PyType};

use super::buffer::SharedBytes;

/// The most fields that are decoded together.
const MOST_TOGETHER: usize = 4;

/// A message type. Two types of the same name and hash are one object.
pub(crate) struct MessageType {
    /// As in `sensor_msgs/msg/JointState`.
    pub(crate) name: String,
    /// `RIHS01_…`
    pub(crate) hash: String,
    /// The `ros2msg` text with all dependencies, as in bags.
    pub(crate) definition: String,
    /// The type itself as it was parsed: comments, defaults, constants.
    pub(super) parsed: MessageDefinition,
    pub(super) dynamic: DynamicType,
    pub(super) fields: Vec<Field>,
    /// If the fields are numbers of one width only: this width, and the size of all.
    pub(super) uniform: Option<(usize, usize)>,
    /// Whether it has a few fields which are numbers and texts: they are decoded together.
    pub(super) is_scalars: bool,
    /// The least size in CDR, without padding; at least 1.
    pub(super) least_size: usize,
    /// The CDR of a message with the defaults of the definition.
    defaults: Bytes,
    shared_defaults: PyOnceLock<Py<SharedBytes>>,
    pub(super) class: PyOnceLock<Py<PyType>>,
}

/// A field of a message type.
pub(super) struct Field {
    pub(super) name: String,
    /// The same as an interned object, which is compared by address.
    pub(super) key: Py<PyString>,
    pub(super) of: FieldType<Arc<MessageType>>,
    /// As in the definition, for errors.
    pub(super) declared: String,
}

impl MessageType {
    /// Finds a field by its name.
    pub(super) fn field(&self, name: &Bound<'_, PyString>) -> Option<usize> {
        let by_address = self.fields.iter().position(|field| field.key.is(name));
        by_address.or_else(|| {
            let name = name.to_cow().ok()?;
            self.fields.iter().position(|field| field.name == name)
        })
    }

    /// A message with the defaults, as bytes.
    pub(super) fn defaults(&self, py: Python<'_>) -> PyResult<Py<SharedBytes>> {
        let shared = self.shared_defaults.get_or_try_init(py, || {
            Py::new(py, SharedBytes { bytes: self.defaults.clone(), is_default: true })
        })?;
        Ok(shared.clone_ref(py))
    }
}

/// The definitions that are searched by name.
struct Known {
    /// What `downbeat-msgs` carries, what [`search`] added, and what was found in `AMENT_PREFIX_PATH`.
    catalog: Arc<Catalog>,
    /// By name: those of [`message_type`].
    named: HashMap<String, Arc<MessageType>>,
    /// By name and hash: these and those of bags.
    all: HashMap<(String, String), Arc<MessageType>>,
}

static KNOWN: LazyLock<Mutex<Known>> = LazyLock::new(|| {
    Mutex::new(Known {
        catalog: Arc::new(downbeat_msgs::carried().clone()),
        named: HashMap::new(),
        all: HashMap::new(),
    })
});

/// Returns the type of that name: a message, or a message of a service or an action. Definitions are searched
/// in what `downbeat-msgs` carries, in folders given to [`search`], and in `AMENT_PREFIX_PATH`, in this
/// order.
///
/// # Errors
/// `KeyError` if there is no such type; the error suggests a similar name or lists what was searched.
/// `ValueError` if its definition is invalid.
pub(crate) fn message_type(py: Python<'_>, name: &str) -> PyResult<Arc<MessageType>> {
    // No Python code runs while this is locked, so that it cannot wait for itself.
    let mut known = KNOWN.lock();
    if let Some(found) = known.named.get(name) {
        return Ok(Arc::clone(found));
    }
    let parsed: TypeName = name.parse().map_err(|error| PyValueError::new_err(format!("{error}")))?;
    known.require(&parsed)?;
    let catalog = Arc::clone(&known.catalog);
    let found = known.compile(py, &catalog, &parsed)?;
    known.named.insert(name.to_owned(), Arc::clone(&found));
    Ok(found)
}

/// Returns the type of that name with the definition in a bag, which is the type of that name if its
/// definition is the same.
///
/// # Errors
/// `ValueError` if the text is not a definition of the type.
pub(crate) fn described_type(
    py: Python<'_>,
    name: &str,
    encoding: &str,
    text: &str,
    origin: &str,
) -> PyResult<Arc<MessageType>> {
    let invalid =
        |error| PyValueError::new_err(format!("cannot use the definition of {name} in {origin}: {error}"));
    let parsed: TypeName = name.parse().map_err(invalid)?;
    let mut catalog = Catalog::new();
    // Jazzy's rosbag2 writes this encoding for the text of a service, which starts with a line of `=`.
    let is_service = encoding == "unknown" && text.starts_with("===");
    let encoding = if is_service { "ros2msg" } else { encoding };
    catalog
        .add_definition_text(&parsed, encoding.parse().map_err(invalid)?, text, origin)
        .map_err(invalid)?;
    KNOWN.lock().compile(py, &catalog, &parsed)
}

/// Adds the interfaces in a folder: an ament prefix, a folder of packages, or a package.
///
/// # Errors
/// `OSError` if it has no interfaces, `ValueError` if one is invalid or has another definition than a known
/// one.
pub(crate) fn search(path: &Path) -> PyResult<usize> {
    let invalid = |error: downbeat_msgs::definitions::Error| match error {
        downbeat_msgs::definitions::Error::Read { .. }
        | downbeat_msgs::definitions::Error::NoInterfaces(_) => PyOSError::new_err(error.to_string()),
        other => PyValueError::new_err(other.to_string()),
    };
    // A copy, so that an invalid file leaves nothing behind.
    let mut catalog = Catalog::clone(&KNOWN.lock().catalog);
    let count = catalog.add_folder(path).map_err(invalid)?;
    KNOWN.lock().catalog = Arc::new(catalog);
    Ok(count)
}

/// The name and the definition text of the message, service or action that a name is of or a part of, and the
/// hash of the name; `None` if it is not known.
pub(crate) fn interface(name: &str) -> Option<(String, String, String)> {
    let name: TypeName = name.parse().ok()?;
    let stem = match name.kind {
        Kind::Message => name.name.as_str(),
        Kind::Service | Kind::Action => name.name.split('_').next()?,
    };
    let whole = TypeName::new(&name.package, name.kind, stem);
    let known = KNOWN.lock();
    Some((
        whole.to_string(),
        known.catalog.definition_text(&whole).ok()?,
        known.catalog.type_hash(&name).ok()?,
    ))
}

/// Adds the definition text of a message, service or action that a robot knows.
///
/// # Errors
/// `ValueError` if it has another definition than a known one.
pub(crate) fn learn(name: &str, text: &str) -> PyResult<()> {
    let invalid = |error: downbeat_msgs::definitions::Error| PyValueError::new_err(error.to_string());
    let mut known = KNOWN.lock();
    let mut catalog = Catalog::clone(&known.catalog);
    let name: TypeName = name.parse().map_err(invalid)?;
    catalog.add_definition_text(&name, DefinitionEncoding::Ros2Msg, text, "the robot").map_err(invalid)?;
    known.catalog = Arc::new(catalog);
    Ok(())
}

/// The interfaces of a package that are known by now: messages, services and actions, without the parts of
/// the latter.
pub(super) fn interfaces(package: &str) -> Vec<TypeName> {
    let known = KNOWN.lock();
    let mut names: Vec<TypeName> = (known.catalog.messages().map(|message| &message.name))
        .filter(|name| name.kind == Kind::Message)
        .chain(
            known.catalog.services().map(|service| &service.name).filter(|name| name.kind == Kind::Service),
        )
        .chain(known.catalog.actions().map(|action| &action.name))
        .filter(|name| name.package == package)
        .cloned()
        .collect();
    names.sort();
    names
}

/// The packages of which interfaces are known by now, not only the request of a service, for example.
pub(super) fn packages() -> Vec<String> {
    let packages: Vec<String> = KNOWN.lock().catalog.packages().into_iter().map(str::to_owned).collect();
    packages.into_iter().filter(|package| !interfaces(package).is_empty()).collect()
}

impl Known {
    /// Adds the definition from `AMENT_PREFIX_PATH` if the type is not known yet.
    fn require(&mut self, name: &TypeName) -> PyResult<()> {
        let Err(unknown) = self.catalog.message(name) else { return Ok(()) };
        let elsewhere = Definitions::new().with(AmentPrefixPath::from_environment()).with_carried();
        let (text, _) = elsewhere.find_text(&name.to_string()).map_err(|installed| {
            // The first error suggests a name, if it knows the package.
            let is_package_known = self.catalog.packages().contains(&name.package.as_str());
            PyKeyError::new_err(if is_package_known { unknown.to_string() } else { installed.to_string() })
        })?;
        Arc::make_mut(&mut self.catalog)
            .add_definition_text(name, DefinitionEncoding::Ros2Msg, &text, "AMENT_PREFIX_PATH")
            .map_err(|error| PyValueError::new_err(error.to_string()))
    }

    fn compile(&mut self, py: Python<'_>, catalog: &Catalog, name: &TypeName) -> PyResult<Arc<MessageType>> {
        let invalid =
            |error: String| PyValueError::new_err(format!("cannot use the definition of {name}: {error}"));
        let hash = catalog.type_hash(name).map_err(|error| invalid(error.to_string()))?;
        let key = (name.to_string(), hash);
        if let Some(found) = self.all.get(&key) {
            return Ok(Arc::clone(found));
        }
        // The definition in a bag may lack defaults and constants, which are not part of the hash: a known
        // one has them.
        let known = Arc::clone(&self.catalog);
        if !std::ptr::eq(catalog, &raw const *known) && known.type_hash(name).is_ok_and(|hash| hash == key.1)
        {
            return self.compile(py, &known, name);
        }
        // Also checks that no type contains itself.
        let dynamic = DynamicType::new(catalog, name).map_err(|error| invalid(error.to_string()))?;
        let parsed = catalog.message(name).map_err(|error| invalid(error.to_string()))?.clone();
        let mut fields = Vec::with_capacity(parsed.fields.len());
        for field in &parsed.fields {
            let element = match &field.field_type.element {
                Element::Primitive(primitive) => Element::Primitive(*primitive),
                Element::String { bound } => Element::String { bound: *bound },
                Element::WString { bound } => Element::WString { bound: *bound },
                Element::Message(nested) => Element::Message(self.compile(py, catalog, nested)?),
            };
            fields.push(Field {
                name: field.name.clone(),
                key: PyString::intern(py, &field.name).unbind(),
                of: FieldType { element, shape: field.field_type.shape },
                declared: field.field_type.to_string(),
            });
        }
        let is_scalar = |field: &Field| {
            field.of.shape == Shape::Single && !matches!(field.of.element, Element::Message(_))
        };
        let compiled = Arc::new(MessageType {
            is_scalars: (1..=MOST_TOGETHER).contains(&fields.len()) && fields.iter().all(is_scalar),
            uniform: uniform(&fields),
            least_size: fields.iter().map(least_size).sum::<usize>().max(1),
            definition: catalog.definition_text(name).map_err(|error| invalid(error.to_string()))?,
            defaults: DynamicMessage::new(&dynamic).to_cdr().into(),
            shared_defaults: PyOnceLock::new(),
            class: PyOnceLock::new(),
            name: key.0.clone(),
            hash: key.1.clone(),
            parsed,
            dynamic,
            fields,
        });
        self.all.insert(key, Arc::clone(&compiled));
        Ok(compiled)
    }
}

fn uniform(fields: &[Field]) -> Option<(usize, usize)> {
    let mut sum: Option<(usize, usize)> = None;
    for field in fields {
        let (width, size) = match &field.of.element {
            Element::Primitive(primitive) => (primitive.size(), primitive.size()),
            Element::Message(nested) => nested.uniform?,
            Element::String { .. } | Element::WString { .. } => return None,
        };
        let count = match field.of.shape {
            Shape::Single => 1,
            Shape::Array(count) => usize::try_from(count).ok()?,
            Shape::Bounded(_) | Shape::Sequence => return None,
        };
        let size = size.checked_mul(count)?;
        sum = match sum {
            None => Some((width, size)),
            Some((same, before)) if same == width => Some((width, before + size)),
            Some(_) => return None,
        };
    }
    sum
}

fn least_size(field: &Field) -> usize {
    let count = match field.of.shape {
        Shape::Bounded(_) | Shape::Sequence => return 4,
        Shape::Single => 1,
        Shape::Array(count) => usize::try_from(count).unwrap_or(usize::MAX),
    };
    least_size_of_element(&field.of.element).saturating_mul(count)
}

pub(super) fn least_size_of_element(element: &Element<Arc<MessageType>>) -> usize {
    match element {
        Element::Primitive(primitive) => primitive.size(),
        Element::String { .. } | Element::WString { .. } => 4,
        Element::Message(nested) => nested.least_size,
    }
}

/// The type of a field in the words of rosidl: `sequence<double, 3>`.
pub(super) fn rosidl_name(field: &Field) -> String {
    let element = match &field.of.element {
        Element::Primitive(primitive) => match primitive {
            Primitive::Bool => "boolean".to_owned(),
            Primitive::Byte => "octet".to_owned(),
            Primitive::Char => "uint8".to_owned(),
            Primitive::Float32 => "float".to_owned(),
            Primitive::Float64 => "double".to_owned(),
            other => other.as_str().to_owned(),
        },
        Element::String { bound: None } => "string".to_owned(),
        Element::String { bound: Some(bound) } => format!("string<{bound}>"),
        Element::WString { bound: None } => "wstring".to_owned(),
        Element::WString { bound: Some(bound) } => format!("wstring<{bound}>"),
        Element::Message(nested) => nested.parsed.name.short(),
    };
    match field.of.shape {
        Shape::Single => element,
        Shape::Array(count) => format!("{element}[{count}]"),
        Shape::Bounded(bound) => format!("sequence<{element}, {bound}>"),
        Shape::Sequence => format!("sequence<{element}>"),
    }
}
