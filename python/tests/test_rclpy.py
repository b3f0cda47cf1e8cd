"""Messages against those of rclpy: same bytes, same values."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from conftest import CANNOT_BE_HAD, message_names

from downbeat import msgs

serialization = pytest.importorskip("rclpy.serialization")


def theirs(name: str) -> type[Any]:
    """The class of rclpy, or a skipped test: its packages on PyPI do not have all interfaces."""
    package, kind, stem = name.split("/")
    owner, _, part = stem.partition("_")
    try:
        found: type[Any] = getattr(importlib.import_module(f"{package}.{kind}"), owner)
    except (ModuleNotFoundError, AttributeError):
        pytest.skip(CANNOT_BE_HAD)
    return getattr(found, part) if part else found


def is_same(theirs: bytes, ours: bytes) -> bool:
    """Compares bytes: the buffer of rclpy may be longer than the message, and its padding is not cleared."""
    padded = zip(theirs, ours, strict=False)
    return len(theirs) >= len(ours) and all(one == other or other == 0 for one, other in padded)


@pytest.mark.parametrize("name", message_names())
def test_every_carried_message_goes_to_rclpy_and_back(name: str, random_message: Callable[..., Any]) -> None:
    other = theirs(name)
    ours_class = msgs.message_class(name)
    for seed in "123":
        ours = random_message(name, seed)
        data = ours.to_cdr()
        received = serialization.deserialize_message(data, other)
        assert ours == received, "the values that rclpy reads"
        sent = serialization.serialize_message(received)
        assert is_same(sent, data), "the bytes that rclpy writes"
        back = ours_class.from_cdr(sent)
        assert back == ours
        assert back.to_cdr() == data, "with all fields read"


@pytest.mark.parametrize("name", message_names())
def test_defaults_and_names_of_types_are_those_of_rclpy(name: str) -> None:
    other = theirs(name)
    ours = msgs.message_class(name)
    data = ours().to_cdr()
    assert is_same(serialization.serialize_message(other()), data)
    assert ours.get_fields_and_field_types() == other.get_fields_and_field_types()
    for constant in _constants(other):
        assert _plain(getattr(ours, constant)) == _plain(getattr(other, constant)), constant


def _constants(other: type[Any]) -> list[str]:
    return [name for name in vars(type(other)) if name.isupper() and not name.startswith("_") and not name.endswith("__DEFAULT")]


def _plain(value: Any) -> Any:
    return value[0] if isinstance(value, bytes) and len(value) == 1 else value


def test_messages_of_rclpy_are_accepted_wherever_ours_are() -> None:
    from sensor_msgs.msg import JointState as Theirs
    from std_msgs.msg import Header as TheirHeader

    from downbeat.msgs.sensor_msgs.msg import Imu, JointState

    header = TheirHeader(frame_id="base")
    header.stamp.sec = 7
    assert Imu(header=header).header.stamp.sec == 7
    assert JointState(name=["a"]) == Theirs(name=["a"])
    assert JointState(name=["a"]) != Theirs(name=["b"])
    with pytest.raises(TypeError, match="field header: expected std_msgs/msg/Header, got sensor_msgs/msg/JointState"):
        Imu(header=Theirs())


def test_a_forwarded_message_keeps_what_was_not_touched(random_message: Callable[..., Any]) -> None:
    """Fields that move to another alignment are written again, the others are copied."""
    from downbeat.msgs.geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped

    received = PoseStamped.from_cdr(random_message("geometry_msgs/msg/PoseStamped").to_cdr())
    for frame in ["", "a", "four", "fives", "eight ch"]:
        received.header.frame_id = frame
        other = serialization.deserialize_message(received.to_cdr(), theirs("geometry_msgs/msg/PoseStamped"))
        assert received == other
        moved = PoseWithCovarianceStamped(header={"frame_id": frame + "x"}, pose={"pose": received.pose})
        again = PoseWithCovarianceStamped.from_cdr(moved.to_cdr())
        assert again.pose.pose == received.pose
        assert np.array_equal(again.pose.covariance, np.zeros(36))
