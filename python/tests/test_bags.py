"""Bags against rosbags and mcap; pictures and point clouds; tables."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import downbeat as db
from downbeat.msgs.sensor_msgs.msg import CompressedImage, Image, Imu, JointState, PointCloud2, PointField
from downbeat.msgs.std_msgs.msg import String

TYPES = [
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/Imu",
    "tf2_msgs/msg/TFMessage",
    "diagnostic_msgs/msg/DiagnosticArray",
    "nav_msgs/msg/OccupancyGrid",
    "std_msgs/msg/ColorRGBA",
    "test_msgs/msg/Arrays",
]


@pytest.fixture
def bag(tmp_path: Path, random_message: Callable[..., Any]) -> Path:
    """Seven topics of random messages, a nanosecond apart."""
    path = tmp_path / "bag"
    with db.Writer(path, custom_data={"robot": "seven"}) as writer:
        for number in range(70):
            name = TYPES[number % len(TYPES)]
            writer.write(topic_of(name), random_message(name, str(number)), 1000 + number, publish_time=900 + number)
        writer.add_topic("/quiet", String)
    return path


def topic_of(name: str) -> str:
    return "/" + name.rpartition("/")[2].lower()


def same(ours: Any, theirs: Any) -> bool:
    """Compares a message with one of another library, field by field.

    rclpy's `byte` and `char` are numbers from 0 to 255; rosbags and mcap-ros2-support read some as signed, and some as `bytes`.
    """
    if isinstance(theirs, bytes):
        theirs = np.frombuffer(theirs, np.uint8)
    if isinstance(ours, db.Message):
        return all(same(getattr(ours, field), getattr(theirs, field)) for field in ours.get_fields_and_field_types())
    if isinstance(ours, list):
        return len(ours) == len(theirs) and all(map(same, ours, theirs))
    if isinstance(ours, np.ndarray):
        unsigned = [int(value) % 256 for value in theirs] if ours.dtype == np.uint8 else theirs
        return np.array_equal(ours, np.asarray(unsigned, ours.dtype).reshape(-1))
    return bool(ours == theirs) or (isinstance(theirs, int) and -128 <= theirs < 0 and bool(ours == theirs + 256))


def test_a_bag_reads_what_was_written(bag: Path, random_message: Callable[..., Any]) -> None:
    read = db.Bag(bag)
    assert len(read) == read.message_count == 70
    assert (read.start_time, read.end_time, read.duration, read.missing) == (1000, 1069, 69, [])
    assert list(read.topics) == [*map(topic_of, TYPES), "/quiet"]
    imu = read.topics["/imu"]
    assert (imu.name, imu.type_name, imu.message_count) == ("/imu", "sensor_msgs/msg/Imu", 10)
    assert imu.message_class is Imu
    assert imu.type_hash == Imu.TYPE_HASH
    for number, (topic, message, time) in enumerate(read):
        name = TYPES[number % len(TYPES)]
        assert (topic, time) == (topic_of(name), 1000 + number)
        assert message == random_message(name, str(number))


def test_messages_are_chosen_by_topic_and_time(bag: Path) -> None:
    read = db.Bag(bag)
    assert [each.time for each in read.messages("imu", end=1020)] == [1001, 1008, 1015]
    times = [each.time for each in read.messages(["/imu", "/tfmessage"], start=1008, end=1015)]
    assert times == [1008, 1009, 1015]
    assert {each.topic for each in read.messages(topic for topic in ["/imu"])} == {"/imu"}
    assert next(read.messages()).message.header is not None


def test_a_single_file_is_a_bag(bag: Path) -> None:
    (file,) = bag.glob("*.mcap")
    assert [each.message for each in db.Bag(file).messages("/imu")] == [each.message for each in db.Bag(bag).messages("/imu")]


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_rosbags_reads_our_bags(tmp_path: Path, compression: str, random_message: Callable[..., Any]) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    names = [name for name in TYPES if "test_msgs" not in name]
    with db.Writer(tmp_path / "bag", compression=compression) as writer:
        for number, name in enumerate(names):
            writer.write(topic_of(name), random_message(name), number)
    with rosbag2.Reader(tmp_path / "bag") as reader:
        read = list(reader.messages())
    assert len(read) == len(names)
    for number, (connection, time, data) in enumerate(read):
        assert (connection.topic, connection.msgtype, time) == (topic_of(names[number]), names[number], number)
        assert same(random_message(names[number]), store.deserialize_cdr(data, connection.msgtype))


def test_mcap_reads_our_bags(bag: Path, random_message: Callable[..., Any]) -> None:
    reader = pytest.importorskip("mcap.reader")
    decoder = pytest.importorskip("mcap_ros2.decoder")
    (file,) = bag.glob("*.mcap")
    with file.open("rb") as opened:
        decoded = list(reader.make_reader(opened, decoder_factories=[decoder.DecoderFactory()]).iter_decoded_messages())
    assert len(decoded) == 70
    for number, (schema, channel, message, value) in enumerate(decoded):
        name = TYPES[number % len(TYPES)]
        assert (schema.name, channel.topic) == (name, topic_of(name))
        assert (message.log_time, message.publish_time) == (1000 + number, 900 + number)
        assert same(random_message(name, str(number)), value)


def test_we_read_bags_of_rosbags(tmp_path: Path) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    state = JointState(header={"frame_id": "body"}, name=["pan", "tilt"], position=[0.5, -1.0])
    with rosbag2.Writer(tmp_path / "bag", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/state", JointState.TYPE_NAME, typestore=store)
        for time in range(5):
            writer.write(connection, time, state.to_cdr())
    read = db.Bag(tmp_path / "bag")
    assert read.topics["/state"].message_class is JointState
    assert [(each.message == state, each.time) for each in read] == [(True, time) for time in range(5)]


def test_types_of_a_bag_need_no_other_definition(tmp_path: Path) -> None:
    folder = tmp_path / "own_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Tilt.msg").write_text("std_msgs/Header header\nfloat64 angle\n")
    # Another process, so that this one does not know the definition.
    script = f"import downbeat as db\ndb.msgs.search({str(tmp_path)!r})\nfrom downbeat.msgs.own_msgs.msg import Tilt\n"
    script += f"with db.Writer({str(tmp_path / 'bag')!r}) as bag: bag.write('/tilt', Tilt(angle=0.5), 7)\n"
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)
    ((topic, message, time),) = db.Bag(tmp_path / "bag")
    assert (topic, message.angle, message.TYPE_NAME, time) == ("/tilt", 0.5, "own_msgs/msg/Tilt", 7)
    # Parts with the usual definition are of the usual class.
    assert type(message.header) is db.msgs.message_class("std_msgs/msg/Header")


def test_a_known_class_has_its_constants_although_a_bag_lacks_them(tmp_path: Path) -> None:
    pytest.importorskip("mcap_ros2.writer")
    # In a process that has not used the class before.
    script = """
import sys
import downbeat as db
from mcap_ros2.writer import Writer

with open(sys.argv[1], "wb") as file:
    writer = Writer(file)
    schema = writer.register_msgdef("sensor_msgs/msg/NavSatStatus", "int8 status\\nuint16 service\\n")
    writer.write_message("/status", schema, {"status": 1, "service": 2})
    writer.finish()
((_, message, _),) = db.Bag(sys.argv[1])
assert message.status == 1
assert type(message).STATUS_FIX == 0
assert type(message)().status == -2, "the default"
"""
    subprocess.run([sys.executable, "-c", script, str(tmp_path / "status.mcap")], check=True, timeout=60)


def test_messages_of_rclpy_are_written(tmp_path: Path) -> None:
    module = pytest.importorskip("std_msgs.msg")
    with db.Writer(tmp_path / "bag") as writer:
        writer.add_topic("/first", module.String)
        writer.write("/chatter", module.String(data="hello"))
    ((topic, message, _),) = db.Bag(tmp_path / "bag")
    assert (topic, message) == ("/chatter", String(data="hello"))


def test_pictures_become_arrays() -> None:
    for encoding, shape, dtype in [
        ("rgb8", (4, 6, 3), np.uint8),
        ("bgr8", (4, 6, 3), np.uint8),
        ("rgba8", (4, 6, 4), np.uint8),
        ("mono8", (4, 6), np.uint8),
        ("mono16", (4, 6), np.uint16),
        ("16UC1", (4, 6), np.uint16),
        ("32FC1", (4, 6), np.float32),
        ("32FC3", (4, 6, 3), np.float32),
        ("bayer_rggb8", (4, 6), np.uint8),
    ]:
        pixels = np.arange(np.prod(shape)).reshape(shape).astype(dtype)
        image = Image.from_cdr(Image.from_numpy(pixels, encoding).to_cdr())
        assert (image.height, image.width, image.encoding) == (4, 6, encoding)
        array = image.to_numpy()
        assert array.dtype == dtype
        assert np.array_equal(array, pixels)
        assert array.flags.aligned
    assert Image.from_numpy(np.zeros((2, 2, 3), np.uint8)).encoding == "rgb8"
    assert Image.from_numpy(np.zeros((2, 2), np.float32)).encoding == "32FC1"


def test_rows_and_byte_order_of_pictures_are_respected() -> None:
    padded = np.arange(16, dtype=np.uint8)
    image = Image(height=2, width=3, step=8, encoding="mono8", data=padded)
    assert image.to_numpy().tolist() == [[0, 1, 2], [8, 9, 10]]
    image = Image(height=1, width=2, step=4, encoding="mono16", is_bigendian=1, data=[1, 0, 0, 2])
    assert image.to_numpy().tolist() == [[256, 2]]


def test_a_picture_is_a_view_that_outlives_its_message() -> None:
    cdr = Image.from_numpy(np.full((480, 640, 3), 7, np.uint8)).to_cdr()
    picture = Image.from_cdr(cdr).to_numpy()
    inside = picture.ctypes.data - np.frombuffer(cdr, np.uint8).ctypes.data
    assert 0 < inside < len(cdr)
    assert not picture.flags.writeable
    assert picture.sum() == 7 * picture.size


@pytest.mark.parametrize(
    ("image", "text"),
    [
        (Image(encoding="yuv999"), "no array for the encoding 'yuv999'"),
        (Image(height=2, width=2, step=1, encoding="mono8", data=bytes(4)), "rows of 2 pixels of mono8 have 2 bytes, but step is 1"),
        (Image(height=2, width=2, step=2, encoding="mono8", data=bytes(3)), "2x2 pixels of mono8 have 4 bytes, but data has 3"),
        (CompressedImage(format="jpeg"), r"the picture is compressed \(jpeg\); decode it with a library of pictures"),
    ],
)
def test_what_is_no_array_says_why(image: Any, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        image.to_numpy()


def test_point_clouds_become_structured_arrays() -> None:
    points = np.zeros(5, {"names": ["x", "y", "ring"], "formats": ["<f4", "<f4", "<u2"], "offsets": [0, 4, 8], "itemsize": 12})
    points["x"] = np.arange(5)
    points["ring"] = 7
    fields = [
        PointField(name="x", offset=0, datatype=PointField.FLOAT32, count=1),
        PointField(name="y", offset=4, datatype=PointField.FLOAT32, count=1),
        PointField(name="ring", offset=8, datatype=PointField.UINT16, count=1),
    ]
    cloud = PointCloud2(height=1, width=5, fields=fields, point_step=12, row_step=60, data=points.tobytes())
    array = PointCloud2.from_cdr(cloud.to_cdr()).to_numpy()
    assert array.shape == (5,)
    assert array["x"].tolist() == [0, 1, 2, 3, 4]
    assert array["ring"].tolist() == [7] * 5
    cloud.width = 6
    with pytest.raises(ValueError, match="6x1 points of 12 bytes in rows of 60 bytes do not fit data of 60 bytes"):
        cloud.to_numpy()


@pytest.fixture
def states(tmp_path: Path) -> db.Bag:
    path = tmp_path / "states"
    with db.Writer(path) as writer:
        writer.write("/joint_states", JointState(name=["pan"], position=[0.5]), 1_000_000_000)
        writer.write("/joint_states", JointState(name=["pan", "tilt"], position=[1.0, 2.0]), 2_000_000_000)
    return db.Bag(path)


def test_a_topic_becomes_columns(states: db.Bag) -> None:
    table = states.table("joint_states")
    assert len(table) == 2
    assert table.columns[:5] == ["header.stamp.sec", "header.stamp.nanosec", "header.frame_id", "name[0]", "name[1]"]
    assert table.time.tolist() == [1_000_000_000, 2_000_000_000]
    assert table["position[0]"].tolist() == [0.5, 1.0]
    assert table["position[1]"].tolist() == [None, 2.0]
    assert table["name[1]"].tolist() == [None, "tilt"]


def test_a_topic_becomes_a_data_frame(states: db.Bag) -> None:
    pandas = pytest.importorskip("pandas")
    frame = states.table("joint_states").to_pandas()
    assert frame.index[1] == pandas.Timestamp(2, unit="s", tz="UTC")
    assert frame["position[0]"].tolist() == [0.5, 1.0]
    assert frame["position[1]"].isna().tolist() == [True, False]
    assert str(frame["header.stamp.sec"].dtype) == "int64"


def test_a_topic_becomes_a_table_of_arrow(states: db.Bag) -> None:
    pytest.importorskip("pyarrow")
    table = states.table("joint_states").to_arrow()
    assert table.column_names[:2] == ["time", "publish_time"]
    assert table["position[1]"].to_pylist() == [None, 2.0]
    assert table["name[1]"].to_pylist() == [None, "tilt"]


def test_integers_with_gaps_stay_integers(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    grid = db.msgs.message_class("std_msgs/msg/Int32MultiArray")
    with db.Writer(tmp_path / "bag") as writer:
        writer.write("/grid", grid(data=[1]), 1)
        writer.write("/grid", grid(data=[1, 2]), 2)
    frame = db.Bag(tmp_path / "bag").table("/grid").to_pandas()
    assert str(frame["data[1]"].dtype) == "Int64"
    assert frame["data[1]"].isna().tolist() == [True, False]


def test_missing_libraries_are_named(states: db.Bag, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    table = states.table("joint_states")
    with pytest.raises(ImportError, match="Table.to_pandas needs pandas: pip install pandas"):
        table.to_pandas()
    with pytest.raises(ImportError, match="Table.to_arrow needs pyarrow: pip install pyarrow"):
        table.to_arrow()


def test_errors_of_bags_name_the_file_and_the_topic(bag: Path, tmp_path: Path) -> None:
    read = db.Bag(bag)
    with pytest.raises(KeyError, match="has no topic /imo: did you mean /imu?"):
        read.messages("/imo")
    with pytest.raises(KeyError, match="has no topic /imo"):
        read.table("/imo")
    with pytest.raises(FileNotFoundError, match="nowhere"):
        db.Bag(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="empty is not a bag"):
        db.Bag(tmp_path / "empty")
    with pytest.raises(FileExistsError, match="bag"):
        db.Writer(bag)
    with pytest.raises(ValueError, match='there is no compression "zsdt", did you mean "zstd"?'):
        db.Writer(tmp_path / "other", compression="zsdt")
    writer = db.Writer(tmp_path / "another")
    writer.write("/chatter", String(), 1)
    with pytest.raises(TypeError, match="topic /chatter has the type std_msgs/msg/String, got a message of sensor_msgs/msg/Imu"):
        writer.write("/chatter", Imu())
    with pytest.raises(TypeError, match="expected a message of downbeat.msgs or of rclpy, got str"):
        writer.write("/chatter", "hello")
    with pytest.raises(ValueError, match="negative|before|-1"):
        writer.write("/chatter", String(), -1)
    writer.close()
    writer.close()
    with pytest.raises(ValueError, match="another is closed"):
        writer.write("/chatter", String())


def test_a_damaged_bag_is_read_as_far_as_possible(bag: Path, tmp_path: Path) -> None:
    (file,) = bag.glob("*.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    read = db.Bag(cut)
    assert read.missing
    assert len(list(read)) == len(read) <= 70


def test_an_abandoned_writer_leaves_a_readable_bag(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="stop"), db.Writer(tmp_path / "bag") as writer:
        writer.write("/chatter", String(data="kept"), 1)
        raise RuntimeError("stop")
    assert [each.message.data for each in db.Bag(tmp_path / "bag")] == ["kept"]
