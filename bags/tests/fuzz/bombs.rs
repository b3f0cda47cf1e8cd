//! Small files designed to exhaust memory.

use downbeat_bags::{BagInfo, Check, Problem, Reader, check};
use fuzzing::most_in;
use mcap::records::op;

use crate::parts::{Chunk, Content, Part, Parts, add, records, text, zstd_with_zeros};

const MIB: usize = 1024 * 1024;

/// A chunk with one record, whose body ends with `zeros` zeros.
fn chunk_of(opcode: u8, body: &[u8], zeros: usize, times: (u64, u64)) -> Part {
    let mut record = vec![opcode];
    record.extend_from_slice(&((body.len() + zeros) as u64).to_le_bytes());
    record.extend_from_slice(body);
    let content = Content::Compressed(zstd_with_zeros(&record, zeros), (record.len() + zeros) as u64);
    Part::Chunk(Chunk::new("zstd", times, content))
}

fn message(time: u64) -> Vec<u8> {
    [&1_u16.to_le_bytes()[..], &[0; 4], &time.to_le_bytes(), &time.to_le_bytes()].concat()
}

fn channel(id: u16, schema: u16) -> Vec<u8> {
    let ids = [id.to_le_bytes(), schema.to_le_bytes()].concat();
    [ids, text(&format!("/topic_{id}")), text("cdr"), vec![0; 4]].concat()
}

/// A schema without its text.
fn schema(id: u16, length: usize) -> Vec<u8> {
    let name = format!("demo_msgs/msg/Type{id}");
    [&id.to_le_bytes()[..], &text(&name), &text("ros2msg"), &(length as u32).to_le_bytes()].concat()
}

fn file_of(data: Vec<Part>) -> Vec<u8> {
    Parts { data, summary: Vec::new(), has_summary: false }.to_file()
}

/// Opens and checks a file; returns the memory used.
fn read(file: Vec<u8>) -> (usize, Check) {
    most_in(|| check(&Reader::from_bytes("bomb.mcap", file).unwrap(), |_| {}).unwrap())
}

fn is_told(check: &Check, words: &str) -> bool {
    check.problems.iter().any(|problem| problem.to_string().contains(words))
}

#[test]
fn chunks_that_overlap_in_time_use_bounded_memory() {
    let mut data = vec![Part::Record(op::CHANNEL, channel(1, 0))];
    // Each chunk lasts until all have started: a second, small message in a separate chunk would be last.
    data.extend((0..30).map(|_| chunk_of(op::MESSAGE, &message(5), 16 * MIB, (5, 5))));
    let file = file_of(data);
    assert!(file.len() < 30 * 1024, "{}", file.len());
    let (memory, check) = read(file);
    assert!(memory < 256 * MIB + 3 * 17 * MIB, "{} MiB", memory / MIB);
    assert!((10..18).contains(&check.messages), "{}", check.messages);
    assert!(
        is_told(&check, "with those that overlap it in time, its messages take more than"),
        "{:?}",
        check.problems
    );
}

#[test]
fn memory_of_chunks_is_released_as_they_are_read() {
    let mut data = vec![Part::Record(op::CHANNEL, channel(1, 0))];
    data.extend((1..30).map(|time| chunk_of(op::MESSAGE, &message(time), 16 * MIB, (time, time))));
    let (memory, check) = read(file_of(data));
    assert!(memory < 5 * 17 * MIB, "{} MiB", memory / MIB);
    assert_eq!(check.messages, 29, "{:?}", check.problems);
}

#[test]
fn the_size_of_an_individually_compressed_message_is_bounded() {
    let record = "version: 9\nstorage_identifier: mcap\nduration:\n  nanoseconds: 0\nstarting_time:\n  nanoseconds_since_epoch: 0\n\
                  message_count: 30\ntopics_with_message_count: []\ncompression_format: zstd\ncompression_mode: MESSAGE\n\
                  relative_file_paths: []\nfiles: []\ncustom_data: ~\nros_distro: jazzy\n";
    let entry = [text("serialized_metadata"), text(record)].concat();
    let metadata = [text("rosbag2"), (entry.len() as u32).to_le_bytes().to_vec(), entry].concat();
    let mut content = Vec::new();
    for _ in 0..30 {
        add(&mut content, op::MESSAGE, &[message(5), zstd_with_zeros(&[0, 1, 0, 0], 16 * MIB)].concat());
    }
    let chunk = Chunk::new("", (5, 5), Content::Plain(content));
    let channel = Part::Record(op::CHANNEL, channel(1, 0));
    let (memory, check) =
        read(file_of(vec![channel, Part::Record(op::METADATA, metadata), Part::Chunk(chunk)]));
    assert!(memory < 256 * MIB + 3 * 17 * MIB, "{} MiB", memory / MIB);
    assert!((10..18).contains(&check.messages), "{} {:?}", check.messages, check.problems);
    assert!(is_told(&check, "a compressed message: it decompresses to more than"), "{:?}", check.problems);
}

#[test]
fn schemas_that_decompress_to_too_much_are_left_out() {
    let schemas = (1..=20).map(|id| chunk_of(op::SCHEMA, &schema(id, 8 * MIB), 8 * MIB, (0, 0)));
    let (memory, check) = read(file_of(schemas.collect()));
    assert!(memory < 64 * MIB + 4 * 9 * MIB, "{} MiB", memory / MIB);
    assert!(is_told(&check, "it brings schemas and channels to more than"), "{:?}", check.problems);
}

#[test]
fn a_large_schema_of_thousands_of_topics_is_not_copied_for_each() {
    let text = vec![b'#'; MIB];
    let mut data = vec![Part::Record(op::SCHEMA, [schema(1, MIB), text].concat())];
    data.extend((1..=4000).map(|id| Part::Record(op::CHANNEL, channel(id, 1))));
    let file = file_of(data);
    let (memory, reader) = most_in(|| Reader::from_bytes("bomb.mcap", file).unwrap());
    assert!(memory < 300 * MIB, "{} MiB", memory / MIB);
    assert_eq!(reader.topics().len(), 4000);
    let defined = reader.topics().iter().filter(|topic| !topic.info.definition.is_empty()).count();
    assert!((200..300).contains(&defined), "{defined}");
}

#[test]
fn a_chunk_that_a_summary_lists_many_times_is_read_once() {
    let mut parts = Parts {
        data: vec![
            Part::Record(op::CHANNEL, channel(1, 0)),
            chunk_of(op::MESSAGE, &message(5), 16 * MIB, (5, 5)),
        ],
        // One message in all.
        summary: vec![(
            op::STATISTICS,
            [
                &1_u64.to_le_bytes()[..],
                &[0; 34],
                &10_u32.to_le_bytes(),
                &1_u16.to_le_bytes(),
                &1_u64.to_le_bytes(),
            ]
            .concat(),
        )],
        has_summary: true,
    };
    let once = parts.to_file();
    let index = records(&once[8..]).into_iter().find(|(opcode, _)| *opcode == op::CHUNK_INDEX).unwrap();
    parts.summary.extend(std::iter::repeat_n(index, 1000));
    let (memory, check) = read(parts.to_file());
    assert!(memory < 5 * 17 * MIB, "{} MiB", memory / MIB);
    assert_eq!(check.messages, 1, "{:?}", check.problems);
}

#[test]
fn a_file_compressed_as_a_whole_is_abandoned_if_it_decompresses_to_too_much() {
    let packed = zstd_with_zeros(mcap::MAGIC, 64 * MIB);
    let (memory, check) = read(packed);
    // Data above 1 MiB is stored in a file.
    assert!(memory < 6 * MIB, "{} KiB", memory / 1024);
    assert!(is_told(&check, "more than 10000 times its length"), "{:?}", check.problems);
}

/// The parser of `mcap` would allocate that memory before checking the length.
#[test]
fn texts_with_the_maximum_declared_length_take_no_memory() {
    let huge = (1_u32 << 31).to_le_bytes();
    let header = [0; 28];
    let records = [
        (op::SCHEMA, [&[1, 0][..], &huge].concat()),
        (op::CHANNEL, [&[1, 0, 1, 0][..], &huge].concat()),
        (
            op::CHANNEL,
            [&[1, 0, 1, 0][..], &text("/topic"), &text("cdr"), &20_u32.to_le_bytes(), &huge].concat(),
        ),
        (op::METADATA, huge.to_vec()),
        (op::CHUNK, [&header[..], &huge].concat()),
        (op::CHUNK_INDEX, [&[0; 32][..], &5_u32.to_le_bytes(), &[0; 10], &[0; 8], &huge].concat()),
        (op::METADATA_INDEX, [&[0; 16][..], &huge].concat()),
        (op::ATTACHMENT_INDEX, [&[0; 40][..], &huge].concat()),
    ];
    for (opcode, body) in records {
        let (data, summary) = (Part::Record(opcode, body.clone()), vec![(opcode, body)]);
        for parts in [
            Parts { data: vec![data], summary: Vec::new(), has_summary: false },
            Parts { data: Vec::new(), summary, has_summary: true },
        ] {
            let (memory, _) = read(parts.to_file());
            assert!(memory < 128 * 1024, "opcode {opcode}: {memory} bytes");
        }
    }
}

/// A definition in which each type has two of the next: with 30 of them a message has 2^30 numbers.
#[test]
fn a_definition_that_doubles_thirty_times_is_refused_quickly() {
    let rule = "=".repeat(80);
    let mut definition = "Part1 one\nPart1 other\n".to_owned();
    for n in 1..30 {
        let next = n + 1;
        let fields = format!("Part{next} one\nPart{next} other\n");
        definition.push_str(&format!("{rule}\nMSG: demo_msgs/Part{n}\n{fields}"));
    }
    definition.push_str(&format!("{rule}\nMSG: demo_msgs/Part30\nuint8 number\n"));
    let mut content = Vec::new();
    add(&mut content, op::MESSAGE, &[message(5), vec![0; 1000]].concat());
    let file = file_of(vec![
        Part::Record(op::SCHEMA, [schema(1, definition.len()), definition.into()].concat()),
        Part::Record(op::CHANNEL, channel(1, 1)),
        Part::Chunk(Chunk::new("", (5, 5), Content::Plain(content))),
    ]);
    // The carried definitions, in which the check looks for another one, are read once.
    downbeat_msgs::carried();
    let begun = std::time::Instant::now();
    let (memory, check) = read(file);
    assert!(memory < MIB, "{memory}");
    assert!(begun.elapsed() < crate::LONGEST);
    assert!(is_told(&check, "has more than 65536 fields"), "{:?}", check.problems);
}

#[test]
fn an_array_with_the_maximum_declared_length_is_refused() {
    let definition = "uint8[] data\n";
    let mut data = vec![Part::Record(op::SCHEMA, [schema(1, definition.len()), definition.into()].concat())];
    data.push(Part::Record(op::CHANNEL, channel(1, 1)));
    let mut content = Vec::new();
    add(&mut content, op::MESSAGE, &[&message(5)[..], &[0, 1, 0, 0], &[0xff; 4]].concat());
    data.push(Part::Chunk(Chunk::new("", (5, 5), Content::Plain(content))));
    let (memory, check) = read(file_of(data));
    assert!(memory < MIB, "{memory}");
    assert!(
        matches!(check.problems.as_slice(), [.., Problem::Message { count: 1, .. }]),
        "{:?}",
        check.problems
    );
}

#[test]
fn a_chunk_that_decompresses_to_thousands_of_times_the_file_is_left_out() {
    let small = chunk_of(op::MESSAGE, &message(1), 1000, (1, 1));
    let bomb = chunk_of(op::MESSAGE, &message(2), 800 * MIB, (2, 2));
    let file = file_of(vec![Part::Record(op::CHANNEL, channel(1, 0)), small, bomb]);
    assert!(file.len() < 28 * 1024, "{}", file.len());
    let (memory, (count, text)) = most_in(|| {
        let reader = Reader::from_bytes("bomb.mcap", file).unwrap();
        (reader.message_count(), BagInfo::of(&reader).unwrap().to_string())
    });
    assert!(memory < 4 * MIB, "{} MiB", memory / MIB);
    assert_eq!(count, 1);
    assert!(text.contains("is damaged: ") && text.contains("are decompressed"), "{text}");
}

#[test]
fn a_message_that_decompresses_to_thousands_of_times_the_file_is_left_out() {
    let (memory, result) = most_in(|| read_packed(800 * MIB));
    assert!(memory < 256 * MIB, "{} MiB", memory / MIB);
    assert!(is_told(&result, "a compressed message: it decompresses to more than"), "{:?}", result.problems);
}

/// A bag with one individually compressed message of `zeros` zeros.
fn read_packed(zeros: usize) -> Check {
    let record = "version: 9\nstorage_identifier: mcap\nduration:\n  nanoseconds: 0\nstarting_time:\n  nanoseconds_since_epoch: 0\n\
                  message_count: 1\ntopics_with_message_count: []\ncompression_format: zstd\ncompression_mode: MESSAGE\n\
                  relative_file_paths: []\nfiles: []\ncustom_data: ~\nros_distro: jazzy\n";
    let entry = [text("serialized_metadata"), text(record)].concat();
    let metadata = [text("rosbag2"), (entry.len() as u32).to_le_bytes().to_vec(), entry].concat();
    let mut content = Vec::new();
    add(&mut content, op::MESSAGE, &[message(5), zstd_with_zeros(&[0, 1, 0, 0], zeros)].concat());
    let chunk = Chunk::new("", (5, 5), Content::Plain(content));
    let parts = vec![
        Part::Record(op::CHANNEL, channel(1, 0)),
        Part::Record(op::METADATA, metadata),
        Part::Chunk(chunk),
    ];
    check(&Reader::from_bytes("bomb.mcap", file_of(parts)).unwrap(), |_| {}).unwrap()
}
