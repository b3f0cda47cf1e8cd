//! Macros that expand code for each kind of value.

/// Evaluates `$body` with `$Type` standing for the Rust type of a primitive.
macro_rules! each_primitive {
    ($primitive:expr, $Type:ident => $body:expr) => {
        match $primitive {
            ::downbeat_msgs_definitions::Primitive::Bool => each_primitive!(@ bool, $Type, $body),
            ::downbeat_msgs_definitions::Primitive::Byte
            | ::downbeat_msgs_definitions::Primitive::Char
            | ::downbeat_msgs_definitions::Primitive::UInt8 => each_primitive!(@ u8, $Type, $body),
            ::downbeat_msgs_definitions::Primitive::Int8 => each_primitive!(@ i8, $Type, $body),
            ::downbeat_msgs_definitions::Primitive::Int16 => each_primitive!(@ i16, $Type, $body),
            ::downbeat_msgs_definitions::Primitive::UInt16 => each_primitive!(@ u16, $Type, $body),
            ::downbeat_msgs_definitions::Primitive::Int32 => each_primitive!(@ i32, $Type, $body),
            ::downbeat_msgs_definitions::Primitive::UInt32 => each_primitive!(@ u32, $Type, $body),
            ::downbeat_msgs_definitions::Primitive::Int64 => each_primitive!(@ i64, $Type, $body),
            ::downbeat_msgs_definitions::Primitive::UInt64 => each_primitive!(@ u64, $Type, $body),
            ::downbeat_msgs_definitions::Primitive::Float32 => each_primitive!(@ f32, $Type, $body),
            ::downbeat_msgs_definitions::Primitive::Float64 => each_primitive!(@ f64, $Type, $body),
        }
    };
    (@ $of:ty, $Type:ident, $body:expr) => {{
        type $Type = $of;
        $body
    }};
}

/// Evaluates `$body` with `$values` standing for the values of an array of any type.
macro_rules! each_array {
    ($array:expr, $values:ident => $body:expr) => {
        match $array {
            $crate::dynamic::Array::Bool($values) => $body,
            $crate::dynamic::Array::Int8($values) => $body,
            $crate::dynamic::Array::UInt8($values) => $body,
            $crate::dynamic::Array::Int16($values) => $body,
            $crate::dynamic::Array::UInt16($values) => $body,
            $crate::dynamic::Array::Int32($values) => $body,
            $crate::dynamic::Array::UInt32($values) => $body,
            $crate::dynamic::Array::Int64($values) => $body,
            $crate::dynamic::Array::UInt64($values) => $body,
            $crate::dynamic::Array::Float32($values) => $body,
            $crate::dynamic::Array::Float64($values) => $body,
            $crate::dynamic::Array::String($values) => $body,
            $crate::dynamic::Array::WString($values) => $body,
            $crate::dynamic::Array::Message($values) => $body,
        }
    };
}
