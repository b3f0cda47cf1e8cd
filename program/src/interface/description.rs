//! `downbeat interface hash` and `downbeat interface description`

use serde::Serialize;

use super::interfaces::Interfaces;
use super::{DescriptionArguments, HashArguments, Registered};
use downbeat_msgs::definitions::{Catalog, IndividualTypeDescription, TypeDescription, TypeName, Value};

pub(super) fn hash(arguments: &HashArguments, registered: &Registered) -> anyhow::Result<()> {
    let interfaces = Interfaces::load(&arguments.types.source, registered)?;
    let names = interfaces.chosen(&arguments.types)?;
    let hashes = names.iter().map(|name| TypeHash::of(&interfaces.catalog, name));
    let hashes = hashes.collect::<anyhow::Result<Vec<_>>>()?;
    if arguments.json {
        println!("{}", in_ascii(&serde_json::to_string_pretty(&hashes)?));
        return Ok(());
    }
    for TypeHash { type_name, hash_string } in hashes {
        match arguments.types.all {
            true => println!("{hash_string}  {type_name}"),
            false => println!("{hash_string}"),
        }
    }
    Ok(())
}

pub(super) fn description(arguments: &DescriptionArguments, registered: &Registered) -> anyhow::Result<()> {
    let interfaces = Interfaces::load(&arguments.types.source, registered)?;
    let names = interfaces.chosen(&arguments.types)?;
    let described = names.iter().map(|name| Described::of(&interfaces.catalog, name));
    let described = described.collect::<anyhow::Result<Vec<_>>>()?;
    let json = match (arguments.types.all, described.as_slice()) {
        (false, [one]) => serde_json::to_string_pretty(one)?,
        (_, several) => serde_json::to_string_pretty(several)?,
    };
    println!("{}", in_ascii(&json));
    Ok(())
}

/// The `.json` file of an interface, as written by `rosidl_generator_type_description`.
#[derive(Serialize)]
struct Described {
    type_description_msg: Description,
    type_hashes: Vec<TypeHash>,
}

/// `type_description_interfaces/msg/TypeDescription`
#[derive(Serialize)]
struct Description {
    type_description: Individual,
    referenced_type_descriptions: Vec<Individual>,
}

/// `type_description_interfaces/msg/IndividualTypeDescription`
#[derive(Serialize)]
struct Individual {
    type_name: String,
    fields: Vec<DescribedField>,
}

/// `type_description_interfaces/msg/Field`
#[derive(Serialize)]
struct DescribedField {
    name: String,
    #[serde(rename = "type")]
    field_type: DescribedType,
    default_value: String,
}

/// `type_description_interfaces/msg/FieldType`
#[derive(Serialize)]
struct DescribedType {
    type_id: u8,
    capacity: u64,
    string_capacity: u64,
    nested_type_name: String,
}

#[derive(Serialize)]
struct TypeHash {
    type_name: String,
    hash_string: String,
}

impl Described {
    fn of(catalog: &Catalog, name: &TypeName) -> anyhow::Result<Self> {
        let TypeDescription { type_description, referenced_type_descriptions } =
            catalog.type_description(name)?;
        let individuals = std::iter::once(&type_description).chain(&referenced_type_descriptions);
        let hashes = individuals.map(|of| TypeHash::of(catalog, &of.type_name.parse()?));
        let type_hashes = hashes.collect::<anyhow::Result<_>>()?;
        let referenced = referenced_type_descriptions.into_iter().map(|of| Individual::of(catalog, of));
        let type_description_msg = Description {
            type_description: Individual::of(catalog, type_description)?,
            referenced_type_descriptions: referenced.collect::<anyhow::Result<_>>()?,
        };
        Ok(Self { type_description_msg, type_hashes })
    }
}

impl Individual {
    fn of(catalog: &Catalog, described: IndividualTypeDescription) -> anyhow::Result<Self> {
        let name: TypeName = described.type_name.parse()?;
        // Services and actions have no defaults, nor has the placeholder byte of empty messages.
        let defined = catalog.message(&name).map(|message| message.fields.as_slice()).unwrap_or_default();
        let fields = described.fields.into_iter().map(|(name, of)| {
            let field = defined.iter().find(|field| field.name == name);
            DescribedField {
                default_value: field
                    .and_then(|field| field.default.as_ref())
                    .map(Value::to_python_str)
                    .unwrap_or_default(),
                name,
                field_type: DescribedType {
                    type_id: of.type_id,
                    capacity: of.capacity,
                    string_capacity: of.string_capacity,
                    nested_type_name: of.nested_type_name,
                },
            }
        });
        Ok(Self { fields: fields.collect(), type_name: described.type_name })
    }
}

impl TypeHash {
    fn of(catalog: &Catalog, name: &TypeName) -> anyhow::Result<Self> {
        Ok(Self { type_name: name.to_string(), hash_string: catalog.type_hash(name)? })
    }
}

/// Escapes non-ASCII characters, as in Python's JSON.
fn in_ascii(json: &str) -> String {
    let mut ascii = String::with_capacity(json.len());
    for character in json.chars() {
        if character.is_ascii() && character != '\u{7f}' {
            ascii.push(character);
            continue;
        }
        for unit in character.encode_utf16(&mut [0; 2]) {
            ascii.push_str(&format!("\\u{unit:04x}"));
        }
    }
    ascii
}

#[cfg(test)]
mod tests {
    use super::in_ascii;

    #[test]
    fn non_ascii_characters_are_escaped_in_utf_16() {
        assert_eq!(in_ascii("{\n  \"ö\": \"😀\"\n}"), "{\n  \"\\u00f6\": \"\\ud83d\\ude00\"\n}");
    }
}
