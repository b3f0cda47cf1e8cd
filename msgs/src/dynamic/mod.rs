//! Messages whose type is known only at run time.
//!
//! ```
//! use downbeat_msgs::dynamic::{DynamicMessage, DynamicType};
//!
//! // The definition may come from a bag, from files, from another node, or from this crate.
//! let text = "float64 voltage\nstring[] warnings\n";
//! let battery = DynamicType::from_definition_text("my_msgs/msg/Battery", "ros2msg", text)?;
//!
//! let mut message = DynamicMessage::new(&battery);
//! message.set("voltage", 11.7)?;
//! message.push("warnings", "low")?;
//! let bytes = message.to_cdr();
//! let back = DynamicMessage::from_cdr(&battery, &bytes)?;
//! assert_eq!(back.get("voltage")?.as_f64(), Some(11.7));
//! assert_eq!(back.get("warnings[0]")?.as_str(), Some("low"));
//! assert_eq!(
//!     back.get("voltag").unwrap_err().to_string(),
//!     "my_msgs/msg/Battery, field `voltag`: my_msgs/msg/Battery has no field `voltag`, did you mean `voltage`?"
//! );
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#[macro_use]
mod macros;

mod change;
mod compile;
mod error;
mod fit;
mod lookup;
mod message;
mod model;
mod text;
mod validate;
mod value;
mod view;
mod wire;

pub use error::{ConvertError, FieldError, FieldProblem, TypeError};
pub use lookup::{
    AmentPrefixPath, DefinitionSource, Definitions, DescribedTypes, Found, InterfaceDefinition,
    InterfaceFolders, RecordedDefinition, Schemas, TypeDefinition, TypeLookupError,
};
pub use model::{Array, DynamicField, DynamicMessage, DynamicType, MessageRef, Messages, Value, ValueRef};
pub use text::{
    Stamps, TextError, TextProblem, YamlContext, YamlStyle, python, write_yaml_float, write_yaml_text,
};
pub use value::ArrayElement;
pub use view::{ArrayView, DynamicView, ViewError, ViewValue};
