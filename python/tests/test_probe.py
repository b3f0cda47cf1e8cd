"""Modules tested without a robot file."""

import re

import downbeat as db
import pytest
from downbeat.msgs.example_interfaces.action import Fibonacci
from downbeat.msgs.geometry_msgs.msg import Vector3
from downbeat.msgs.sensor_msgs.msg import Imu
from downbeat.msgs.std_srvs.srv import SetBool


class LevelHead(db.Module):
    gain = db.setting(0.5, unit="s", range=(0, 1))

    def setup(self):
        self.tilt = 0.0
        self.out = self.publish("joint_commands", "sensor_msgs/msg/JointState")
        self.is_on = True
        self.later = self.task(lambda: self.out(name=["later"]))

    @db.subscribe("imu/data_raw", "sensor_msgs/msg/Imu")
    def imu(self, m):
        if m.angular_velocity.y > 10:
            raise ValueError("that fast?")
        self.tilt += m.angular_velocity.y * self.gain

    @db.every("20ms")
    def tick(self):
        if self.is_on:
            self.out(name=["head_tilt"], position=[self.tilt])

    @db.serve("switch", "std_srvs/srv/SetBool")
    def switch(self, request):
        if request.data == self.is_on:
            raise db.Refused("it is already")
        self.is_on = request.data
        self.later.after("1s")
        return {"success": True}


@pytest.fixture
def robot():
    return db.test.Robot(level_head=LevelHead)


def test_the_head_turns_against_the_body(robot):
    robot.inject("imu/data_raw", angular_velocity={"y": 0.5})
    robot.inject("/imu/data_raw", Imu(angular_velocity={"y": 0.25}))
    robot.advance("20ms")
    assert robot.expect("joint_commands").position[0] == pytest.approx(0.375)
    robot.expect_none("joint_commands")
    robot.set("level_head", "gain", 0.0)
    robot.inject("imu/data_raw", angular_velocity={"y": 0.5})
    before = robot.now
    assert robot.expect("joint_commands", within="1s").position[0] == pytest.approx(0.375)
    assert robot.now - before == 20_000_000
    robot.advance(0.1)
    assert len(robot.heard("joint_commands")) == 5


class Typed(db.Module):
    """With classes for types, as users of rclpy write them."""

    def setup(self):
        self.out = self.publish("doubled", Vector3)
        self.subscribe("single", Vector3, lambda m: self.out(x=2 * m.x))
        self.serve("switch", SetBool, lambda request: {"success": request.data})
        self.count = self.action_client("count", Fibonacci)


def test_types_are_texts_or_classes():
    robot = db.test.Robot(typed=Typed)
    robot.inject("single", x=1.5)
    robot.advance("20ms")
    assert robot.expect("doubled").x == 3.0
    assert robot.call("switch", data=True).success

    class Wrong(db.Module):
        def setup(self):
            self.publish("out", 3)

    with pytest.raises(Exception, match='a type is a text such as "sensor_msgs/msg/Imu", or a class of downbeat.msgs, not 3'):
        db.test.Robot(wrong=Wrong)


def test_services_answer_or_refuse(robot):
    assert robot.call("switch", data=False).success
    with pytest.raises(db.Refused, match="it is already"):
        robot.call("switch", data=False)
    robot.advance("900ms")
    robot.expect_none("joint_commands")
    assert robot.expect("joint_commands", within="200ms").name == ["later"]


def test_mistakes_are_explained(robot):
    with pytest.raises(RuntimeError, match=r"(?s)level_head.*that fast\?"):
        robot.inject("imu/data_raw", angular_velocity={"y": 11.0})
    with pytest.raises(AssertionError, match="no message on 'joint_commands' within 1s"):
        robot.expect("joint_commands", within="1s")
    with pytest.raises(KeyError, match="imu/data_raw"):
        robot.inject("imu/data", angular_velocity={"y": 0.5})
    with pytest.raises(KeyError, match="there are the topics .*joint_commands"):
        robot.expect("joint_command")
    with pytest.raises(KeyError, match="switch"):
        robot.call("swich", data=True)
    with pytest.raises(ValueError, match="gain"):
        robot.set("level_head", "gain", 2.0)
    with pytest.raises(KeyError, match="check --kinds"):
        robot.add("base", "dif_drive")
    with pytest.raises(RuntimeError, match="head_gain"):
        db.test.Robot().add("level_head", LevelHead, head_gain=0.5)


def test_kinds_of_the_program_are_modules_too():
    robot = db.test.Robot()
    names = {"left_wheel_names": ["left"], "right_wheel_names": ["right"]}
    robot.add("base", "diff_drive", **names, wheel_separation=0.4, wheel_radius=0.1)
    robot.inject("cmd_vel", linear={"x": 0.1})
    assert robot.expect("joint_commands", within="1s").name == ["left", "right"]


def test_types_of_which_only_the_definition_is_known(tmp_path, monkeypatch):
    folder = tmp_path / "share" / "probe_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Leg.msg").write_text("float64 angle\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    db.msgs.search(tmp_path)
    from downbeat.msgs.probe_msgs.msg import Leg

    class Mirror(db.Module):
        def setup(self):
            self.out = self.publish("right", "probe_msgs/msg/Leg")

        @db.subscribe("left", "probe_msgs/msg/Leg")
        def leg(self, m):
            self.out(angle=-m.angle)

    robot = db.test.Robot(mirror=Mirror)
    robot.inject("left", Leg(angle=0.5))
    assert robot.expect("right").angle == -0.5
    robot.inject("left", angle=0.25)
    assert robot.expect("right").angle == -0.25


def test_lines_of_the_log_are_limited(write, program):
    write(
        "talker.py",
        """
        import downbeat as db

        class Talker(db.Module):
            @db.every("10ms")
            def tick(self):
                self.log.warn("hot", every="100ms")
                self.log.info("began", once=True)
        """,
    )
    write(
        "robot.toml",
        """
        [robot]
        name = "talker"

        [[module]]
        kind = "python"
        name = "talker"
        module = "talker.py:Talker"
        """,
    )
    running = program("run", "robot.toml", "--fast", "--duration", "1s")
    assert running.wait() == 0
    text = running.text()
    assert len(re.findall(r"\[WARN\].*\[talker\.talker\]: hot$", text, re.MULTILINE)) == 1, text
    assert len(re.findall(r"hot suppressed=9$", text, re.MULTILINE)) in (8, 9), text
    assert text.count("]: began") == 1, text
