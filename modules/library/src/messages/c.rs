//! C11.

use super::{
    Language, PREFACE, Unit, bounds, comment, definition_parts, field_name, guard, literal, path_of,
    primitive_name, primitive_type,
};
use downbeat_msgs::definitions::{
    Catalog, Element, Error, Field, FieldType, MessageDefinition, Shape, TypeName, Value,
};
use std::fmt::Write;

pub(super) fn header(catalog: &Catalog, file: &TypeName, unit: &Unit<'_>) -> Result<String, Error> {
    let guard = guard(file, Language::C);
    let mut text = format!(
        "{PREFACE} {file}.\n#ifndef {guard}\n#define {guard}\n\n#include <math.h>\n\n#include \"downbeat.h\"\n#include \"downbeat_cdr.h\"\n"
    );
    if unit.action.is_some() {
        text.push_str("#include \"downbeat_action.h\"\n");
    }
    for include in &unit.includes {
        let _ = writeln!(text, "#include \"{}.h\"", path_of(include));
    }
    for message in &unit.messages {
        text.push('\n');
        message_of(&mut text, message, &catalog.type_hash(&message.name)?);
    }
    for service in &unit.services {
        let (name, hash) = (c_name(&service.name), catalog.type_hash(&service.name)?);
        let _ =
            write!(text, "\n#define {name}__TYPE \"{}\"\n#define {name}__HASH \"{hash}\"\n", service.name);
    }
    let name = c_name(file);
    let body = match &unit.definition {
        Some(definition) => format!(
            "    static const char *const text[] = {{\n{}}};\n    return downbeat_define(host, \"{file}\", text);\n",
            definition_parts(definition, "NULL")
        ),
        None => "    (void)host;\n    return 0;\n".to_owned(),
    };
    let _ = write!(
        text,
        "\n/* In `setup`, before declarations with types of this header: gives the robot their definition, which it may not know. */\n\
         static inline int32_t {name}__define(const downbeat_host_v1 *host) {{\n{body}}}\n"
    );
    if unit.action.is_some() {
        text.push_str(&action_functions(&name));
    }
    text.push_str("\n#endif\n");
    Ok(text)
}

/// What `downbeat_action.h` leaves to the type.
fn action_functions(name: &str) -> String {
    let type_and_hash = |of: &str| format!("{of}__TYPE, {of}__HASH");
    let parts = [
        type_and_hash(&format!("{name}_SendGoal")),
        type_and_hash(&format!("{name}_GetResult")),
        type_and_hash("action_msgs__srv__CancelGoal"),
        type_and_hash(&format!("{name}_FeedbackMessage")),
        type_and_hash("action_msgs__msg__GoalStatusArray"),
    ];
    let parts = parts.join(",\n        ");
    format!(
        r#"
static inline void {name}__put_default_result(downbeat_writer *writer) {{
    {name}_Result result;
    if ({name}_Result__init(&result) != 0) {{
        downbeat_write_fails(writer, "out of memory");
    }}
    {name}_Result__put(writer, &result);
    {name}_Result__fini(&result);
}}

static inline const downbeat_action_type *{name}__type(void) {{
    static const downbeat_action_type type = {{
        {parts},
        {name}__put_default_result}};
    return &type;
}}

/* In `setup`: serves the action. */
static inline int32_t {name}__serve(const downbeat_host_v1 *host, const char *action, downbeat_action_server *server) {{
    int32_t code = {name}__define(host);
    return code ? code : downbeat_action_serve(host, action, {name}__type(), server);
}}

/* Reads what is asked for into an initialized message. */
static inline int32_t {name}__goal(const downbeat_host_v1 *host, const downbeat_goal *goal, {name}_Goal *message) {{
    downbeat_reader reader;
    uint8_t id[16];
    downbeat_reader_start(&reader, goal->request, goal->request_size);
    downbeat_get_uint8_array(&reader, id, 16);
    {name}_Goal__get(&reader, message);
    return reader.error ? host->fail(host, reader.error) : 0;
}}

static inline int32_t {name}__publish_feedback(const downbeat_host_v1 *host, downbeat_action_server *server, const downbeat_goal *goal,
                                               const {name}_Feedback *feedback) {{
    downbeat_writer *writer = &server->writer;
    downbeat_writer_start(writer);
    downbeat_put_uint8_array(writer, goal->id, 16);
    {name}_Feedback__put(writer, feedback);
    return writer->error ? host->fail(host, writer->error) : host->publish(host, server->feedback, writer->data, writer->size);
}}

/* Ends a goal: `status` is DOWNBEAT_GOAL_SUCCEEDED, DOWNBEAT_GOAL_ABORTED or DOWNBEAT_GOAL_CANCELED. */
static inline int32_t {name}__end(const downbeat_host_v1 *host, downbeat_action_server *server, downbeat_goal *goal, int8_t status,
                                  const {name}_Result *result) {{
    downbeat_writer_start(&server->writer);
    downbeat_put_int8(&server->writer, status);
    {name}_Result__put(&server->writer, result);
    return downbeat_goal_end(host, server, goal, status);
}}

/* In `setup`: uses the action. `timeout_ns` is for the acceptance of a goal and for canceling it. */
static inline int32_t {name}__use(const downbeat_host_v1 *host, const char *action, int64_t timeout_ns, downbeat_action_client *client) {{
    int32_t code = {name}__define(host);
    return code ? code : downbeat_action_use(host, action, timeout_ns, {name}__type(), client);
}}

/* Sends a goal, and stores its id. */
static inline int32_t {name}__send(const downbeat_host_v1 *host, downbeat_action_client *client, const {name}_Goal *goal, uint8_t id[16]) {{
    downbeat_action_new_id(host, client, id);
    downbeat_writer_start(&client->writer);
    downbeat_put_uint8_array(&client->writer, id, 16);
    {name}_Goal__put(&client->writer, goal);
    return downbeat_action_send(host, client, id);
}}

/* Reads the feedback of an event into an initialized message. */
static inline int32_t {name}__take_feedback(const downbeat_host_v1 *host, const downbeat_event_v1 *event, {name}_Feedback *feedback) {{
    downbeat_reader reader;
    uint8_t id[16];
    downbeat_reader_start(&reader, event->data, event->size);
    downbeat_get_uint8_array(&reader, id, 16);
    {name}_Feedback__get(&reader, feedback);
    return reader.error ? host->fail(host, reader.error) : 0;
}}

/* Reads the result of an event into an initialized message. */
static inline int32_t {name}__take_result(const downbeat_host_v1 *host, const downbeat_event_v1 *event, {name}_Result *result) {{
    downbeat_reader reader;
    int8_t status;
    downbeat_reader_start(&reader, event->data, event->size);
    downbeat_get_int8(&reader, &status);
    {name}_Result__get(&reader, result);
    return reader.error ? host->fail(host, reader.error) : 0;
}}
"#
    )
}

/// As rosidl names structs.
fn c_name(name: &TypeName) -> String {
    format!("{}__{}__{}", name.package, name.kind.as_str(), name.name)
}

fn message_of(text: &mut String, message: &MessageDefinition, hash: &str) {
    let name = c_name(&message.name);
    let _ = write!(text, "#define {name}__TYPE \"{}\"\n#define {name}__HASH \"{hash}\"\n", message.name);
    for constant in &message.constants {
        text.push_str(&comment(&constant.comment, ""));
        let value = literal(&constant.value, &constant.element);
        let _ = match &constant.element {
            Element::Primitive(of) => {
                writeln!(text, "#define {name}__{} (({}){value})", constant.name, primitive_type(*of))
            }
            _ => writeln!(text, "#define {name}__{} {value}", constant.name),
        };
    }
    text.push('\n');
    text.push_str(&comment(&message.comment, ""));
    let _ = writeln!(text, "typedef struct {name} {{");
    for field in &message.fields {
        text.push_str(&comment(&field.comment, "    "));
        let array = match field.field_type.shape {
            Shape::Array(count) => format!("[{count}]"),
            _ => String::new(),
        };
        let _ = writeln!(text, "    {} {}{array};", field_type(&field.field_type), field_name(field));
    }
    if message.fields.is_empty() {
        text.push_str("    uint8_t structure_needs_at_least_one_member;\n");
    }
    let _ = writeln!(text, "}} {name};\n");
    functions(text, &name, message);
}

/// The stem of the functions of an element: `downbeat_…_float64`.
fn stem(element: &Element) -> String {
    match element {
        Element::Primitive(primitive) => primitive_name(*primitive).to_owned(),
        Element::String { .. } => "string".to_owned(),
        Element::WString { .. } => "wstring".to_owned(),
        Element::Message(name) => c_name(name),
    }
}

fn is_primitive(element: &Element) -> bool {
    matches!(element, Element::Primitive(_))
}

fn element_type(element: &Element) -> String {
    match element {
        Element::Primitive(primitive) => primitive_type(*primitive).to_owned(),
        Element::String { .. } => "downbeat_string".to_owned(),
        Element::WString { .. } => "downbeat_wstring".to_owned(),
        Element::Message(name) => c_name(name),
    }
}

fn field_type(of: &FieldType) -> String {
    match (of.shape, &of.element) {
        (Shape::Single | Shape::Array(_), element) => element_type(element),
        (_, Element::Message(name)) => format!("{}__Sequence", c_name(name)),
        (_, element) => format!("downbeat_{}_sequence", stem(element)),
    }
}

/// A call of `what` (put, get, init, fini) for an element at `place`.
fn call(what: &str, element: &Element, place: &str) -> String {
    match (what, element) {
        ("put", Element::Primitive(_)) => format!("downbeat_put_{}(writer, {place});", stem(element)),
        ("put", Element::Message(_)) => format!("{}__put(writer, &{place});", stem(element)),
        ("put", _) => format!("downbeat_put_{}(writer, &{place});", stem(element)),
        ("get", Element::Message(_)) => format!("{}__get(reader, &{place});", stem(element)),
        ("get", _) => format!("downbeat_get_{}(reader, &{place});", stem(element)),
        (_, Element::Message(_)) => format!("{}__{what}(&{place});", stem(element)),
        (_, _) => format!("downbeat_{}_{what}(&{place});", stem(element)),
    }
}

fn for_each(count: &str, line: &str) -> String {
    format!("    for (size_t index = 0; index < {count}; index++) {{\n        {line}\n    }}\n")
}

fn functions(text: &mut String, name: &str, message: &MessageDefinition) {
    let (mut init, mut fini, mut put, mut get) = (String::new(), String::new(), String::new(), String::new());
    for field in &message.fields {
        init.push_str(&initialize(field));
        fini.push_str(&finish(field));
        put.push_str(&encode(field));
        get.push_str(&decode(field));
    }
    if message.fields.is_empty() {
        put.push_str("    downbeat_put_uint8(writer, message->structure_needs_at_least_one_member);\n");
        get.push_str("    downbeat_get_uint8(reader, &message->structure_needs_at_least_one_member);\n");
    }
    let _ = write!(
        text,
        "static inline void {name}__fini({name} *message) {{\n{fini}    memset(message, 0, sizeof *message);\n}}\n\n\
         /* Gives the fields their defaults. Returns -1 without memory. */\n\
         static inline int {name}__init({name} *message) {{\n    int code = 0;\n    memset(message, 0, sizeof *message);\n{init}    return code;\n}}\n\n\
         static inline void {name}__put(downbeat_writer *writer, const {name} *message) {{\n{put}}}\n\n\
         static inline void {name}__get(downbeat_reader *reader, {name} *message) {{\n{get}}}\n\n\
         /* Writes CDR; the bytes are writer->data. Returns -1 with writer->error. */\n\
         static inline int {name}__encode(const {name} *message, downbeat_writer *writer) {{\n    downbeat_writer_start(writer);\n    {name}__put(writer, message);\n    return writer->error ? -1 : 0;\n}}\n\n\
         /* Reads CDR into an initialized message. Returns NULL, or why the bytes are no such message. */\n\
         static inline const char *{name}__decode({name} *message, const uint8_t *cdr, size_t size) {{\n    downbeat_reader reader;\n    downbeat_reader_start(&reader, cdr, size);\n    {name}__get(&reader, message);\n    return reader.error;\n}}\n\n\
         /* Publishes the message; `writer` is reused from call to call. */\n\
         static inline int32_t {name}__publish(const downbeat_host_v1 *host, uint32_t publisher, const {name} *message,\n                                              downbeat_writer *writer) {{\n    if ({name}__encode(message, writer) != 0) {{\n        return host->fail(host, writer->error);\n    }}\n    return host->publish(host, publisher, writer->data, writer->size);\n}}\n\n\
         /* Reads the message, request or response of an event into an initialized message. */\n\
         static inline int32_t {name}__take(const downbeat_host_v1 *host, const downbeat_event_v1 *event, {name} *message) {{\n    const char *error = {name}__decode(message, event->data, event->size);\n    return error ? host->fail(host, error) : 0;\n}}\n\n\
         typedef struct {name}__Sequence {{\n    {name} *data;\n    size_t size;\n    size_t capacity;\n}} {name}__Sequence;\n\n\
         /* Changes the number of elements; new ones are initialized. Returns -1 without memory. */\n\
         static inline int {name}__Sequence__resize({name}__Sequence *sequence, size_t count) {{\n    size_t before = sequence->size;\n    void *data = sequence->data;\n    for (size_t index = count; index < before; index++) {{\n        {name}__fini(&sequence->data[index]);\n    }}\n    int code = downbeat_reserve(&data, &sequence->size, &sequence->capacity, sizeof({name}), count);\n    sequence->data = ({name} *)data;\n    for (size_t index = before; code == 0 && index < count; index++) {{\n        code = {name}__init(&sequence->data[index]);\n    }}\n    return code;\n}}\n\n\
         static inline void {name}__Sequence__fini({name}__Sequence *sequence) {{\n    (void){name}__Sequence__resize(sequence, 0);\n    free(sequence->data);\n    memset(sequence, 0, sizeof *sequence);\n}}\n"
    );
}

fn initialize(field: &Field) -> String {
    let (place, of) = (format!("message->{}", field_name(field)), &field.field_type);
    let assign = |place: &str, value: &Value| {
        let literal = literal(value, &of.element);
        match &of.element {
            Element::Primitive(_) => format!("{place} = {literal};"),
            Element::WString { .. } => {
                let units = match value {
                    Value::Text(text) => text.encode_utf16().count(),
                    _ => 0,
                };
                format!("code |= downbeat_wstring_assign(&{place}, (const uint16_t *){literal}, {units});")
            }
            _ => format!("code |= downbeat_string_assign(&{place}, {literal});"),
        }
    };
    let mut lines = String::new();
    let is_list = !matches!(of.shape, Shape::Single | Shape::Array(_));
    match (&field.default, of.shape) {
        (Some(Value::List(values)), _) => {
            let element = if is_list { format!("{place}.data") } else { place.clone() };
            if is_list {
                let resize = format!("{}_resize(&{place}, {})", field_type(of), values.len());
                let _ = writeln!(lines, "    if ({resize} != 0) {{\n        return -1;\n    }}");
            }
            for (index, value) in values.iter().enumerate() {
                let _ = writeln!(lines, "    {}", assign(&format!("{element}[{index}]"), value));
            }
        }
        (Some(value), _) => {
            let _ = writeln!(lines, "    {}", assign(&place, value));
        }
        (None, Shape::Single) if matches!(of.element, Element::Message(_)) => {
            let _ = writeln!(lines, "    code |= {}", call("init", &of.element, &place));
        }
        (None, Shape::Array(count)) if matches!(of.element, Element::Message(_)) => {
            let line = format!("code |= {}", call("init", &of.element, &format!("{place}[index]")));
            lines.push_str(&for_each(&count.to_string(), &line));
        }
        // Zero, as the whole struct is.
        (None, _) => {}
    }
    lines
}

fn finish(field: &Field) -> String {
    let (place, of) = (format!("message->{}", field_name(field)), &field.field_type);
    match (of.shape, &of.element) {
        (Shape::Single | Shape::Array(_), element) if is_primitive(element) => String::new(),
        (Shape::Single, element) => format!("    {}\n", call("fini", element, &place)),
        (Shape::Array(count), element) => {
            for_each(&count.to_string(), &call("fini", element, &format!("{place}[index]")))
        }
        (_, Element::Message(_)) => format!("    {}__fini(&{place});\n", field_type(of)),
        (_, _) => format!("    {}_fini(&{place});\n", field_type(of)),
    }
}

fn encode(field: &Field) -> String {
    let (place, of) = (format!("message->{}", field_name(field)), &field.field_type);
    let (of_text, of_sequence) = bounds(of);
    let mut lines = String::new();
    let check = |size: &str, bound: u64| {
        format!(
            "if ({size} > {bound}) {{ downbeat_write_fails(writer, \"{} has more than {bound} elements\"); }}",
            field.name
        )
    };
    if let Some(bound) = of_sequence {
        let _ = writeln!(lines, "    {}", check(&format!("{place}.size"), bound));
    }
    let (data, count) = match of.shape {
        Shape::Single => {
            if let Some(bound) = of_text {
                let _ = writeln!(lines, "    {}", check(&format!("{place}.size"), bound));
            }
            let _ = writeln!(lines, "    {}", call("put", &of.element, &place));
            return lines;
        }
        Shape::Array(count) => (place.clone(), count.to_string()),
        _ => {
            let _ = writeln!(lines, "    downbeat_put_uint32(writer, (uint32_t){place}.size);");
            (format!("{place}.data"), format!("{place}.size"))
        }
    };
    if is_primitive(&of.element) {
        let _ = writeln!(lines, "    downbeat_put_{}_array(writer, {data}, {count});", stem(&of.element));
        return lines;
    }
    let element = format!("{data}[index]");
    let checked = of_text.map(|bound| check(&format!("{element}.size"), bound) + "\n        ");
    let line = checked.unwrap_or_default() + &call("put", &of.element, &element);
    lines.push_str(&for_each(&count, &line));
    lines
}

fn decode(field: &Field) -> String {
    let (place, of) = (format!("message->{}", field_name(field)), &field.field_type);
    let (of_text, of_sequence) = bounds(of);
    let mut lines = String::new();
    let check = |size: &str, bound: u64| {
        format!(
            "if ({size} > {bound}) {{ downbeat_read_fails(reader, \"{} has more than {bound} elements\"); }}",
            field.name
        )
    };
    let (data, count) = match of.shape {
        Shape::Single => {
            let _ = writeln!(lines, "    {}", call("get", &of.element, &place));
            if let Some(bound) = of_text {
                let _ = writeln!(lines, "    {}", check(&format!("{place}.size"), bound));
            }
            return lines;
        }
        Shape::Array(count) => (place.clone(), count.to_string()),
        _ => {
            let resize = match &of.element {
                Element::Message(_) => format!("{}__resize", field_type(of)),
                _ => format!("{}_resize", field_type(of)),
            };
            let _ = write!(
                lines,
                "    if ({resize}(&{place}, downbeat_get_count(reader)) != 0) {{\n        downbeat_read_fails(reader, \"out of memory\");\n        return;\n    }}\n"
            );
            if let Some(bound) = of_sequence {
                let _ = writeln!(lines, "    {}", check(&format!("{place}.size"), bound));
            }
            (format!("{place}.data"), format!("{place}.size"))
        }
    };
    if is_primitive(&of.element) {
        let _ = writeln!(lines, "    downbeat_get_{}_array(reader, {data}, {count});", stem(&of.element));
        return lines;
    }
    let element = format!("{data}[index]");
    let checked = of_text.map(|bound| "\n        ".to_owned() + &check(&format!("{element}.size"), bound));
    let line = call("get", &of.element, &element) + &checked.unwrap_or_default();
    lines.push_str(&for_each(&count, &line));
    lines
}
