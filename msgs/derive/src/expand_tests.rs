#![allow(clippy::unwrap_used)]

use std::fs;

use quote::quote;
use tempfile::TempDir;

use super::expand_in;
use crate::definition::Crate;
use crate::structure::Structure;

/// A crate `my-msgs` with `msg/Leg.msg` in it.
fn crate_with(definition: &str) -> (TempDir, Crate) {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("msg")).unwrap();
    fs::write(folder.path().join("msg/Leg.msg"), definition).unwrap();
    let here = Crate { name: "my-msgs".into(), folder: folder.path().into() };
    (folder, here)
}

fn expand(input: proc_macro2::TokenStream, definition: &str) -> Result<String, String> {
    let (folder, here) = crate_with(definition);
    let expanded = syn::parse2(input).and_then(Structure::parse).and_then(|of| expand_in(&of, &here));
    let short = |text: String| text.replace(&folder.path().display().to_string(), "");
    expanded.map(|tokens| short(tokens.to_string())).map_err(|error| short(error.to_string()))
}

#[test]
fn the_name_comes_from_the_attribute_the_file_or_crate_and_struct() {
    for (attribute, name) in [
        (quote!(#[message(file = "msg/Leg.msg")]), "my_msgs/msg/Leg"),
        (quote!(#[message(file = "msg/Leg.msg", name = "lab_msgs/msg/Leg")]), "lab_msgs/msg/Leg"),
        (quote!(#[message(name = "lab_msgs/msg/Arm")]), "lab_msgs/msg/Arm"),
        (quote!(), "my_msgs/msg/Limb"),
    ] {
        let expanded = expand(quote!(#attribute struct Limb { side: u8 }), "uint8 side\n").unwrap();
        assert!(
            expanded.contains(&format!("TYPE_NAME : & 'static :: core :: primitive :: str = \"{name}\"")),
            "{expanded}"
        );
    }
}

#[test]
fn the_fields_have_to_be_those_of_the_file() {
    let definition = "# c\nuint8 side\nfloat64[<=3] angles\n";
    for (fields, error) in [
        (quote!(side: u8, angle: Vec<f64>), "msg/Leg.msg:3:1: the field here is `float64[<=3] angles`"),
        (quote!(angles: Vec<f64>, side: u8), "msg/Leg.msg:2:1: the field here is `uint8 side`"),
        (quote!(side: u8), "msg/Leg.msg:3:1: the struct lacks the field `float64[<=3] angles`"),
        (quote!(side: u8, angles: Vec<f64>, more: u8), "msg/Leg.msg has no more fields"),
        (
            quote!(#[message(type = "byte")] side: u8, angles: Vec<f64>),
            "the type of this field is defined in msg/Leg.msg",
        ),
    ] {
        let input = quote!(#[message(file = "msg/Leg.msg")] struct Leg { #fields });
        assert_eq!(expand(input, definition).unwrap_err(), error);
    }
}

#[test]
fn the_types_of_the_fields_are_checked_by_the_compiler_with_the_place_in_the_file() {
    let definition = "std_msgs/Header header\nstring<=4[<=2] names\nbyte flags\n";
    let input = quote! {
        #[message(file = "msg/Leg.msg")]
        struct Leg { header: Header, names: Vec<String>, flags: u8 }
    };
    let expanded = expand(input, definition).unwrap();
    for part in [
        r#"check :: < Header > (:: downbeat_msgs :: definitions :: FieldType { element : :: downbeat_msgs :: definitions :: Element :: Message ("std_msgs/msg/Header") , shape : :: downbeat_msgs :: definitions :: Shape :: Single , } , "msg/Leg.msg:1:1: `header` is `std_msgs/Header`, in Rust the struct of std_msgs/msg/Header")"#,
        r#""msg/Leg.msg:2:1: `names` is `string<=4[<=2]`, in Rust `Vec<String>`""#,
        r#"of :: < Vec < String > > ("names") . bounded (2) . bounded_text (4)"#,
        r#"of :: < u8 > ("flags") . byte ()"#,
        r#"reader . bounded_texts_field ("names" , 2 , 4) ?"#,
        r#"include_str ! ("/msg/Leg.msg")"#,
    ] {
        assert!(expanded.contains(part), "{part}\n{expanded}");
    }
}

#[test]
fn types_that_rust_does_not_have_are_set_by_an_attribute() {
    let field = |attribute: &str| {
        quote!(
            struct Leg {
                #[message(type = #attribute)]
                names: Vec<String>,
            }
        )
    };
    let expanded = expand(field("string<=4[]"), "").unwrap();
    assert!(expanded.contains(r#"of :: < Vec < String > > ("names") . bounded_text (4)"#), "{expanded}");
    for (attribute, error) in [
        ("strin", "`strin` is neither a primitive type nor a message name"),
        ("string<=4[] names", "is not the type of a field"),
        ("string[]#", "is not the type of a field"),
        ("uint8 X=1\nstring", "is not the type of a field"),
    ] {
        let found = expand(field(attribute), "").unwrap_err();
        assert!(found.contains(error), "{found}");
    }
}

#[test]
fn what_cannot_be_a_message_is_refused() {
    for (input, error) in [
        (
            quote!(
                struct Leg<T> {
                    side: T,
                }
            ),
            "a message has one hash",
        ),
        (
            quote!(
                enum Side {
                    Left,
                }
            ),
            "only a struct can be a message",
        ),
        (
            quote!(
                struct Leg(u8);
            ),
            "the fields of a message have names",
        ),
        (
            quote!(
                struct Leg {
                    Side: u8,
                }
            ),
            "`Side` cannot name a field",
        ),
        (
            quote!(
                #[message(name = "Leg")]
                struct Leg {}
            ),
            "`Leg` is not the name of a message",
        ),
        (
            quote!(
                #[message(name = "a_msgs/srv/Leg")]
                struct Leg {}
            ),
            "`a_msgs/srv/Leg` is not the name of a message",
        ),
        (
            quote!(
                #[message(nam = "Leg")]
                struct Leg {}
            ),
            "expected `name = \"…\"`",
        ),
        (
            quote!(
                #[message(file = "msg/Arm.msg")]
                struct Arm {}
            ),
            "cannot read /msg/Arm.msg",
        ),
        (
            quote!(
                #[message(file = "msg/Leg.msg")]
                struct Leg {
                    side: u8,
                }
            ),
            "msg/Leg.msg:1:1: `int7` is neither",
        ),
    ] {
        let found = expand(input, "int7 side\n").unwrap_err();
        assert!(found.starts_with(error), "{found}");
    }
}

#[test]
fn documentation_becomes_the_comments_of_the_definition() {
    let expanded = expand(
        quote!(
            #[doc = " A leg.\n\n Of two."]
            struct Leg {
                #[doc = " Angle [rad]."]
                angle: f64,
            }
        ),
        "",
    )
    .unwrap();
    assert!(
        expanded.contains(r##"comment : "# A leg.\n#\n# Of two.\n" , comments : & ["# Angle [rad].\n"]"##),
        "{expanded}"
    );
}

#[test]
fn a_struct_without_fields_is_one_byte() {
    let expanded = expand(
        quote!(
            struct Leg {}
        ),
        "",
    )
    .unwrap();
    assert!(
        expanded.contains("LEAST_SIZE : :: core :: primitive :: usize = 1")
            && expanded.contains("empty_message")
    );
}
