//! What options of the recorder make of a bag, as other readers see it.

use super::*;

/// The topic and the text of a message.
type Read = [String; 2];
/// Those of each file, by its name.
type ReadOfFiles = BTreeMap<String, Vec<Read>>;

/// What `mcap` finds in each file of a bag, and `rosbags` in all of it.
fn read_by_others(bag: &Path) -> Option<(ReadOfFiles, Vec<Read>)> {
    let mut found = python("read_files.py", &[bag])?;
    let [files, whole] = ["files", "bag"].map(|key| found[key].take());
    Some((serde_json::from_value(files).unwrap(), serde_json::from_value(whole).unwrap()))
}

/// Publishes two texts on the latched topic `/map`; a late subscriber receives the second.
fn latched_map(node: &Node) -> downbeat::bridge::ros::Publisher {
    let message_type = MessageType::new(std_msgs::msg::String::TYPE_NAME).unwrap();
    let publisher = node.publish("/map", &message_type, QosProfile::LATCHED).unwrap();
    for data in ["old lawn", "lawn"] {
        publisher.publish(cdr::to_vec(&std_msgs::msg::String { data: data.to_owned() }).into()).unwrap();
    }
    publisher
}

fn map() -> Read {
    ["/map", "lawn"].map(str::to_owned)
}

#[test]
fn other_readers_find_latched_messages_at_the_start_of_each_file_if_they_are_to_be_repeated() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let node = node("mapper", domain);
    let _map = latched_map(&node);
    for (name, options) in [("repeated", &["--repeat-latched"][..]), ("once", &[])] {
        let bag = folder.path().join(name);
        let arguments = ["bag", "record", "/map", "/chatter", "-o", text(&bag), "--domain"];
        let mut recorder = Running::start(&[&arguments[..], &[&domain.to_string()], options].concat());
        let mut talker = Talker::new(&node);
        for files in 1..=3 {
            talker.say(2);
            wait_until("the messages are in the file", || {
                said_on(&bag, "/chatter").len() == 2 * files && recorded_messages(&bag, "/map") > 0
            });
            if files < 3 {
                call::<SplitBagfile>(&node, "/rosbag2_recorder/split_bagfile", &Default::default());
            }
        }
        recorder.interrupt();
        drop(talker);
        open_with_stock_readers(&bag);
        let Some((files, whole)) = read_by_others(&bag) else { return };
        assert_eq!(files.len(), 3, "{files:?}");
        let copies = if options.is_empty() { 0 } else { 2 };
        assert_eq!(whole.iter().filter(|message| **message == map()).count(), 1 + copies, "{whole:?}");
        assert_eq!(whole.len(), 6 + 1 + copies);
        for number in 1..3 {
            let said =
                (2 * number..2 * number + 2).map(|said: u32| ["/chatter".to_owned(), said.to_string()]);
            let expected: Vec<_> = (copies > 0).then(map).into_iter().chain(said).collect();
            assert_eq!(files[&format!("{name}_{number}.mcap")], expected);
        }
    }
}

#[test]
fn other_readers_find_the_latched_message_that_a_snapshot_had_no_room_for() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let node = node("mapper", domain);
    let map_publisher = latched_map(&node);
    let mut talker = Talker::new(&node);
    for (name, options) in [("repeated", &["--repeat-latched"][..]), ("once", &[])] {
        let bag = folder.path().join(name);
        let arguments = ["bag", "record", "/map", "/chatter", "--snapshot-mode", "--max-cache-size", "4000"];
        let output = ["-o", text(&bag), "--domain", &domain.to_string()];
        let mut recorder = Running::start(&[&arguments[..], &output, options].concat());
        wait_until("the recorder is matched with the map", || map_publisher.matched_subscriptions() > 0);
        talker.say(500);
        let last = talker.next - 1;
        wait_until("a snapshot has the last message", || {
            assert!(call::<Snapshot>(&node, "/rosbag2_recorder/snapshot", &Default::default()).success);
            said_on(&bag, "/chatter").last() == Some(&last)
        });
        recorder.interrupt();
        open_with_stock_readers(&bag);
        let Some((files, whole)) = read_by_others(&bag) else { return };
        assert!(files[&format!("{name}_0.mcap")].len() < 500, "{files:?}");
        let found = whole.iter().position(|message| *message == map());
        assert_eq!(found, (!options.is_empty()).then_some(0), "{whole:?}");
    }
}

#[test]
fn a_bag_that_is_recorded_for_humble_is_read_as_one_of_humble() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let node = node("mapper", domain);
    let _map = latched_map(&node);
    let arguments = ["bag", "record", "/map", "--metadata-version", "5", "-o", text(&bag), "--domain"];
    let mut recorder = Running::start(&[&arguments[..], &[&domain.to_string()]].concat());
    wait_until("the map is in the file", || recorded_messages(&bag, "/map") == 1);
    recorder.interrupt();
    open_with_stock_readers(&bag);
    let Some(read) = python("../../bags/tests/python/read_humble.py", &[&bag]) else { return };
    // History and depth are not part of discovery: unknown and 0. Reliable, transient local, automatic.
    let qos = json!({ "/map": [[3, 0, 1, 1, 1]] });
    assert_eq!(read, json!({ "version": 5, "qos": qos, "in_file": qos, "messages": 1 }));
}

/// Records texts of 1 kB on a small disk until the recorder ends by itself or `files` files were begun;
/// returns whether it succeeded, and its output.
fn fill(disk: &SmallDisk, domain: u16, options: &[&str], files: usize) -> (bool, String) {
    let (bag, node) = (disk.path.join("bag"), node("talker", domain));
    let arguments = ["bag", "record", "/chatter", "--keep-free", "200000", "-o", text(&bag), "--domain"];
    let mut recorder = Running::start(&[&arguments[..], &[&domain.to_string()], options].concat());
    let message_type = MessageType::new(std_msgs::msg::String::TYPE_NAME).unwrap();
    let publisher = node.publish("/chatter", &message_type, QosProfile::DEFAULT).unwrap();
    wait_until("the recorder is matched", || publisher.matched_subscriptions() > 0);
    let message = std_msgs::msg::String { data: "x".repeat(1000) };
    let last = bag.join(format!("bag_{}.mcap", files - 1));
    let mut is_running = true;
    wait_until("the disk is filled", || {
        (0..20).for_each(|_| drop(publisher.publish(cdr::to_vec(&message).into())));
        is_running = recorder.is_running();
        !is_running || last.exists()
    });
    if is_running {
        recorder.interrupt();
    }
    (recorder.wait().success(), recorder.output())
}

#[test]
fn a_recorder_ends_before_it_takes_the_space_that_stays_free() {
    let Some(disk) = SmallDisk::mount(1000) else { return };
    let (is_success, output) = fill(&disk, free_domain(), &["--chunk-size", "20000"], 2);
    assert!(!is_success && output.contains("of 200000 to keep free"), "{output}");
    let bag = disk.path.join("bag");
    let reader = Reader::open(&bag).unwrap();
    assert!(reader.message_count() > 500 && reader.truncation().next().is_none(), "{output}");
    assert!(output.contains(&format!("recorded {} messages", reader.message_count())), "{output}");
    open_with_stock_readers(&bag);
}

#[test]
fn a_recorder_deletes_its_oldest_files_so_that_space_stays_free() {
    let Some(disk) = SmallDisk::mount(1000) else { return };
    let options = ["--chunk-size", "20000", "--max-bag-size", "100000", "--when-low", "drop-oldest"];
    let (is_success, output) = fill(&disk, free_domain(), &options, 20);
    assert!(is_success, "{output}");
    let bag = disk.path.join("bag");
    let metadata = Metadata::read(&bag.join("metadata.yaml")).unwrap();
    assert!((2..9).contains(&metadata.files.len()) && !bag.join("bag_0.mcap").exists(), "{metadata:?}");
    let deleted = &metadata.custom_data["deleted_messages"];
    assert!(output.contains(&format!("{deleted} more were in deleted files")), "{output}");
    open_with_stock_readers(&bag);
}
