"""Message classes: construction, views, errors."""

from __future__ import annotations

import array
import copy
import gc
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import message_names

import downbeat as db
from downbeat.msgs.geometry_msgs.msg import Point, Polygon, Twist
from downbeat.msgs.sensor_msgs.msg import BatteryState, Image, Imu, JointState
from downbeat.msgs.std_msgs.msg import Header
from downbeat.msgs.std_srvs.srv import SetBool
from downbeat.msgs.test_msgs.action import Fibonacci
from downbeat.msgs.tf2_msgs.msg import TFMessage


def received(message: Any) -> Any:
    return type(message).from_cdr(message.to_cdr())


def test_a_message_is_built_by_name_and_printed() -> None:
    state = JointState(header={"frame_id": "body"}, name=["pan"], position=[0.5])
    assert repr(state) == (
        "sensor_msgs.msg.JointState(header=std_msgs.msg.Header(stamp=builtin_interfaces.msg.Time(sec=0, nanosec=0), frame_id='body'), "
        "name=['pan'], position=array([0.5]), velocity=array([], dtype=float64), effort=array([], dtype=float64))"
    )
    assert JointState.TYPE_NAME == "sensor_msgs/msg/JointState"
    assert JointState.TYPE_HASH.startswith("RIHS01_")
    assert BatteryState.POWER_SUPPLY_STATUS_FULL == 4


def test_services_and_actions_have_classes_of_their_messages() -> None:
    assert SetBool.Request(data=True).to_cdr() == b"\0\1\0\0\1"
    assert SetBool.Response(success=True, message="ok").message == "ok"
    assert SetBool.Event().request == []
    assert Fibonacci.Goal(order=3).order == 3
    assert list(Fibonacci.Result(sequence=[1, 1, 2]).sequence) == [1, 1, 2]
    assert Fibonacci.Feedback.TYPE_NAME == "test_msgs/action/Fibonacci_Feedback"


def test_new_messages_have_fields_of_their_own() -> None:
    one, two = Imu(), Imu()
    one.orientation_covariance[0] = 3.0
    one.header.frame_id = "one"
    assert two.orientation_covariance[0] == 0.0
    assert Imu().header.frame_id == ""
    assert received(one).orientation_covariance[0] == 3.0


def test_arrays_of_a_received_message_are_read_only_views_that_outlive_it() -> None:
    image = received(Image(data=np.arange(200, dtype=np.uint8)))
    data = image.data
    assert not data.flags.writeable
    assert not data.flags.owndata
    with pytest.raises(ValueError, match="read-only"):
        data[0] = 1
    del image
    gc.collect()
    assert bytes(data) == bytes(range(200))


def test_arrays_are_not_copied_if_they_are_aligned() -> None:
    cdr = Image(data=bytes(1000)).to_cdr()
    address = np.frombuffer(cdr, np.uint8).ctypes.data
    inside = Image.from_cdr(cdr).data.ctypes.data
    assert address < inside < address + len(cdr)
    # Doubles start at a multiple of 8 after the header of 4 bytes, so that either they or the bytes are aligned.
    padded = bytearray(len(state := JointState(position=[1.0, 2.0]).to_cdr()))
    padded[:] = state
    position = JointState.from_cdr(padded).position
    assert position.flags.aligned
    assert list(position) == [1.0, 2.0]


def test_writing_to_a_received_message_changes_neither_its_bytes_nor_other_messages() -> None:
    cdr = TFMessage(transforms=[{"child_frame_id": "a"}, {"child_frame_id": "b"}]).to_cdr()
    before = bytes(cdr)
    one, two = TFMessage.from_cdr(cdr), TFMessage.from_cdr(cdr)
    one.transforms[1].child_frame_id = "changed"
    one.transforms[0].transform.translation.x = 1.5
    one.transforms.append({"child_frame_id": "c"})
    assert [each.child_frame_id for each in received(one).transforms] == ["a", "changed", "c"]
    assert received(one).transforms[0].transform.translation.x == 1.5
    assert [each.child_frame_id for each in two.transforms] == ["a", "b"]
    assert cdr == before == two.to_cdr()


def test_big_endian_and_newer_representations_are_read() -> None:
    big = bytes([0, 0, 0, 0]) + np.array([1.5, 2.5, -3.0], ">f8").tobytes()
    assert Point.from_cdr(big) == Point(x=1.5, y=2.5, z=-3.0)
    plain2 = bytes([0, 7, 0, 0]) + np.array([1.5, 2.5, -3.0], "<f8").tobytes()
    assert Point.from_cdr(plain2).z == -3.0


@pytest.mark.parametrize("value", [[1, 2.5], (1, 2.5), np.array([1, 2.5]), array.array("d", [1, 2.5]), np.array([1, 2.5], np.float32)])
def test_sequences_of_numbers_become_arrays(value: Any) -> None:
    state = JointState(position=value)
    assert state.position.dtype == np.float64
    assert list(received(state).position) == [1.0, 2.5]


def test_arrays_that_fit_are_kept_and_others_converted() -> None:
    values = np.array([1.0, 2.0])
    state = JointState(position=values)
    values[0] = 5.0
    assert list(received(state).position) == [5.0, 2.0]
    assert list(Imu(orientation_covariance=np.eye(3)).orientation_covariance) == [1, 0, 0, 0, 1, 0, 0, 0, 1]
    assert list(JointState(position=np.arange(6.0)[::2]).position) == [0, 2, 4]
    assert list(Image(data=np.array([1, 255], np.int64)).data) == [1, 255]
    assert list(JointState(position=range(3)).position) == [0, 1, 2]


def test_single_precision_is_what_is_sent() -> None:
    battery = BatteryState(voltage=0.1)
    assert battery.voltage == np.float32(0.1)
    assert battery == received(battery)


def test_messages_are_compared_by_their_fields() -> None:
    assert JointState(position=[1.0]) == JointState(position=[1])
    assert JointState(position=[1.0]) != JointState(position=[1.0, 2.0])
    assert JointState(position=[float("nan")]) != JointState(position=[float("nan")])
    assert Point() != Twist()
    assert Point() != 3


def test_messages_are_copied_and_pickled(random_message: Callable[..., Any]) -> None:
    message = random_message("sensor_msgs/msg/Imu")
    assert pickle.loads(pickle.dumps(message)) == message
    other = copy.deepcopy(message)
    other.header.frame_id = "other"
    assert message.header.frame_id != "other"


@pytest.mark.parametrize("name", message_names())
def test_every_carried_message_survives_its_serialised_form(name: str, random_message: Callable[..., Any]) -> None:
    message = random_message(name)
    again = received(message)
    assert again.to_cdr() == message.to_cdr(), "without reading a field"
    assert again == message
    assert again.to_cdr() == message.to_cdr(), "with all fields read"
    assert repr(again) == repr(message)


@pytest.mark.parametrize("name", message_names())
def test_damaged_bytes_are_errors(name: str, random_message: Callable[..., Any]) -> None:
    made = db.msgs.message_class(name)
    cdr = random_message(name).to_cdr()
    for end in {0, 3, 4, 5, len(cdr) // 2, len(cdr) - 1}:
        try:
            repr(made.from_cdr(cdr[:end]))
        except ValueError as error:
            assert "the bytes are not a" in str(error)
    for position in range(4, min(len(cdr), 60)):
        damaged = bytearray(cdr)
        damaged[position] ^= 0xFF
        try:
            repr(made.from_cdr(bytes(damaged)))
        except ValueError as error:
            assert "the bytes are not a" in str(error)


ERRORS: list[tuple[Callable[[], Any], type[Exception], str]] = [
    (lambda: setattr(Imu(), "orientaton", 1), AttributeError, "sensor_msgs/msg/Imu has no field 'orientaton', did you mean 'orientation'?"),
    (lambda: Imu(orientaton=1), AttributeError, "sensor_msgs/msg/Imu has no field 'orientaton', did you mean 'orientation'?"),
    (lambda: Point(speed=1), AttributeError, "geometry_msgs/msg/Point has no field 'speed', its fields are x, y, z"),
    (lambda: Point(x="1"), TypeError, "geometry_msgs/msg/Point, field x: expected float64, got str '1'"),
    (lambda: Point(x=None), TypeError, "geometry_msgs/msg/Point, field x: expected float64, got NoneType"),
    (lambda: Header(stamp={"sec": 1.5}), TypeError, "std_msgs/msg/Header, field stamp.sec: expected int32, got float 1.5"),
    (
        lambda: Header(stamp={"nanosec": -1}),
        ValueError,
        "std_msgs/msg/Header, field stamp.nanosec: -1 is out of the range of uint32, 0 to 4294967295",
    ),
    (lambda: SetBool.Request(data=1), TypeError, "std_srvs/srv/SetBool_Request, field data: expected bool, got int 1"),
    (lambda: BatteryState(voltage=1e39), ValueError, "field voltage: 1e39 is out of the range of float32"),
    (lambda: JointState(name="pan"), TypeError, "sensor_msgs/msg/JointState, field name: expected string[], got str 'pan'"),
    (lambda: JointState(name=["pan", 2]), TypeError, "sensor_msgs/msg/JointState, field name[1]: expected str, got int 2"),
    (lambda: JointState(position=[0, "a"]), TypeError, "sensor_msgs/msg/JointState, field position[1]: expected float64, got str 'a'"),
    (
        lambda: JointState(position=np.array(["a"])),
        TypeError,
        "sensor_msgs/msg/JointState, field position: expected float64[], got an array of <U1",
    ),
    (lambda: Image(data=np.array([1, 300])), ValueError, "sensor_msgs/msg/Image, field data: 300 is out of the range of uint8, 0 to 255"),
    (lambda: Image(data=np.array([2**63], np.uint64)), ValueError, "9223372036854775808 is out of the range of uint8"),
    (lambda: Imu(orientation_covariance=[1]), ValueError, "field orientation_covariance: float64[9] needs exactly 9 elements, got 1"),
    (lambda: Imu(orientation=Point()), TypeError, "field orientation: expected geometry_msgs/msg/Quaternion, got geometry_msgs/msg/Point"),
    (lambda: Polygon(points=[{"x": "a"}]), TypeError, "geometry_msgs/msg/Polygon, field points[0].x: expected float32, got str 'a'"),
    (lambda: Point(1.0), TypeError, "geometry_msgs/msg/Point takes its fields by name, as in Point(x=...)"),
    (lambda: db.Message(), TypeError, "Message is the base of the message classes"),
    (lambda: db.msgs.message_class("sensor_msgs/msg/Imo"), KeyError, "did you mean sensor_msgs/msg/Imu?"),
    (lambda: db.msgs.message_class("Imu"), ValueError, "Imu"),
    (lambda: Point.from_cdr(b""), ValueError, "the bytes are not a geometry_msgs/msg/Point: "),
    (lambda: Point.from_cdr(bytes([0, 1, 0, 0, 1])).x, ValueError, "field `x`: needs 8 more bytes at byte 0, but only 1 bytes follow"),
    (lambda: Point.from_cdr(3), TypeError, "int"),
]


@pytest.mark.parametrize(("fails", "kind", "text"), ERRORS)
def test_errors_name_the_field_what_is_expected_and_what_was_given(
    fails: Callable[[], Any], kind: type[Exception], text: str
) -> None:
    with pytest.raises(kind) as caught:
        fails()
    assert text in str(caught.value)


def test_a_list_that_was_changed_is_checked_when_the_message_is_sent() -> None:
    state = JointState(name=["a"])
    state.name.append(3)
    with pytest.raises(TypeError, match=r"sensor_msgs/msg/JointState, field name\[1\]: expected str, got int 3"):
        state.to_cdr()


def test_unknown_packages_are_suggested() -> None:
    with pytest.raises(ModuleNotFoundError, match="did you mean sensor_msgs?"):
        import downbeat.msgs.sensor_msg.msg  # noqa: F401
    with pytest.raises(ModuleNotFoundError, match=r"downbeat\.msgs\.search"):
        import downbeat.msgs.lawn.msg  # noqa: F401


def test_interfaces_of_a_folder_and_of_ament_prefixes_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "leg_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Leg.msg").write_text("std_msgs/Header header\nfloat64[] angles [0.5, 1.0]\nstring<=4 side left\nuint8 LEFT=1\n")
    assert db.msgs.search(tmp_path) == 1
    from downbeat.msgs.leg_msgs.msg import Leg  # type: ignore[import-not-found,unused-ignore]

    leg = Leg()
    assert (list(leg.angles), leg.side, Leg.LEFT) == ([0.5, 1.0], "left", 1)
    with pytest.raises(ValueError, match="field side: has the length 5, its type allows 4"):
        leg.side = "right"

    installed = tmp_path / "prefix" / "share" / "arm_msgs" / "srv"
    installed.mkdir(parents=True)
    (installed / "Reach.srv").write_text("geometry_msgs/Point goal\n---\nbool is_near\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.fspath(tmp_path / "prefix"))
    from downbeat.msgs.arm_msgs.srv import Reach  # type: ignore[import-not-found,unused-ignore]

    assert Reach.Request(goal=Point(x=1.0)).goal.x == 1.0
    with pytest.raises(OSError, match="has no interfaces"):
        db.msgs.search(tmp_path / "prefix" / "share" / "arm_msgs" / "srv")
