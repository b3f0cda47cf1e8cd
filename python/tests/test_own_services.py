"""Services and actions of a user's own, defined in a folder only: in Python, beside C++, called from outside, recorded and replayed."""

import os
import shutil
import subprocess
import sys
import textwrap

import downbeat
import pytest

INTERFACES = {
    "src/site_msgs/msg/Tilt.msg": "std_msgs/Header header\nfloat64 angle\n",
    "src/site_msgs/srv/Level.srv": "# Whether a tilt is level.\nTilt tilt\n---\nbool is_level\nstring why\n",
    "src/site_msgs/action/Turn.action": "float64 angle\n---\nfloat64 turned\n---\nfloat64 left\n",
}

MODULES = """
    import downbeat as db
    from downbeat.msgs.site_msgs.srv import Level

    class Spirit(db.Module):
        def setup(self):
            self.new, self.goals = [], []
            self.asked = self.publish("asked", "site_msgs/msg/Tilt")

        @db.serve("level", "site_msgs/srv/Level")
        def level(self, request):
            self.asked(request.tilt)
            return Level.Response(is_level=request.tilt.angle < 0.1, why=f"it leans {request.tilt.angle}")

        @db.action("turn", "site_msgs/action/Turn")
        def turn(self, goal):
            if goal.request.angle > 3:
                raise db.Refused("too far")
            self.new.append(goal)

        @db.every("50ms")
        def work(self):
            for goal in self.goals:
                goal.succeed(turned=goal.request.angle)
            for goal in self.new:
                goal.feedback(left=goal.request.angle / 2)
            self.new, self.goals = [], self.new

    class Mason(db.Module):
        def setup(self):
            self.angle = 0.0
            self.ask = self.client("level", "site_msgs/srv/Level", timeout="5s")
            self.turn = self.action_client("turn", "site_msgs/action/Turn")
            self.leaning = self.publish("leaning", "std_msgs/msg/String")

        @db.every("50ms")
        def tick(self):
            self.angle += 0.02
            self.ask(tilt={"angle": self.angle}, then=self.told)
            self.turn.send(angle=self.angle, then=self.turned)

        def told(self, response, problem):
            self.leaning(data=problem or f"{response.is_level} {response.why}")

        def turned(self, status, result):
            self.leaning(data=f"turned {status} {result.turned if status else result}")
"""

ROBOT = """
    [robot]
    name = "site"
    interfaces = ["src"]

    [[module]]
    kind = "python"
    name = "spirit"
    module = "modules.py:Spirit"

    [[module]]
    kind = "python"
    name = "mason"
    module = "modules.py:Mason"

    [expose]
    services = ["level"]
    actions = ["turn"]
    out = ["asked", "leaning"]

    [record]
    topics = "all"
"""


@pytest.fixture
def site(write, tmp_path, monkeypatch):
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    for name, text in INTERFACES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        write(name, text)
    write("modules.py", MODULES)
    return write("robot.toml", ROBOT)


def other(robot, *arguments):
    """Runs a command in the domain of a robot."""
    command = [sys.executable, "-m", "downbeat", *arguments]
    environment = {**os.environ, "ROS_DOMAIN_ID": robot.domain}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
    return done.stdout + done.stderr


def test_python_serves_and_calls_what_only_a_folder_defines(site, program, tmp_path):
    robot = program("run", "robot.toml", "--record", "morning")
    robot.wait_for("exposed to ROS 2: /asked")
    # From another folder: the definitions come from the robot's node.
    called = other(robot, "service", "call", "/level", "site_msgs/srv/Level", "{tilt: {angle: 0.75}}")
    assert "is_level=False, why='it leans 0.75'" in called, called + robot.text()
    sent = other(robot, "action", "send_goal", "/turn", "site_msgs/action/Turn", "{angle: 1.5}", "--feedback")
    assert "SUCCEEDED" in sent and "turned: 1.5" in sent and "left: 0.75" in sent, sent + robot.text()
    refused = other(robot, "action", "send_goal", "/turn", "site_msgs/action/Turn", "{angle: 4.0}")
    assert "rejected" in refused.lower(), refused
    shown = other(robot, "topic", "echo", "--once", "/asked")
    assert "angle: " in shown, shown
    assert robot.stop() == 0, robot.text()

    bag = downbeat.Bag(tmp_path / "morning")
    said = [message.data for topic, message, _ in bag.messages(topics=["/leaning"])]
    assert any(text.startswith("True it leans") for text in said) and any(text.startswith("turned 4 ") for text in said)
    assert bag.topics["/asked"].type_name == "site_msgs/msg/Tilt"
    downbeat.replay(site, tmp_path / "morning").assert_same()


def test_the_check_shows_the_types(site, program):
    check = program("check", "robot.toml")
    assert check.wait() == 0, check.text()
    for shown in ("site_msgs/srv/Level", "site_msgs/action/Turn", "site_msgs/msg/Tilt"):
        assert shown in check.text(), check.text()
    assert "downbeat_edge" not in check.text()


def test_a_module_brings_the_folder_that_the_robot_file_does_not_name(site, write, program):
    first = "import downbeat as db\n"
    write("modules.py", textwrap.dedent(MODULES).replace(first, f"{first}db.msgs.search('src')\n"))
    write("robot.toml", ROBOT.replace('interfaces = ["src"]', ""))
    robot = program("run", "robot.toml")
    robot.wait_for("exposed to ROS 2: /asked")
    called = other(robot, "service", "call", "/level", "site_msgs/srv/Level", "{tilt: {angle: 0.05}}")
    assert "is_level=True" in called, called + robot.text()


def test_a_type_that_nobody_knows_is_named(site, write, program):
    write("modules.py", MODULES.replace('"site_msgs/srv/Level", timeout', '"site_msgs/srv/Levl", timeout'))
    check = program("check", "robot.toml")
    assert check.wait() != 0
    assert "site_msgs/srv/Levl" in check.text() and "site_msgs/srv/Level" in check.text(), check.text()


UNRELIABLE = """
    import downbeat as db

    class Unreliable(db.Module):
        def setup(self):
            self.held = []
            self.serve_later("hold", "site_msgs/srv/Level", self.hold)
            self.serve_later("leave", "site_msgs/srv/Level", self.leave)

        @db.serve("refuse", "site_msgs/srv/Level")
        def refuse(self, request):
            raise db.Refused("the lamp is broken")

        @db.serve("fail", "site_msgs/srv/Level")
        def fail(self, request):
            raise ValueError("the vial is empty")

        @db.serve("wrong", "site_msgs/srv/Level")
        def wrong(self, request):
            return {"is_levl": True}

        def hold(self, request, open):
            if request.tilt.angle < 0:
                raise db.Refused("below the floor")
            self.log.info("holds a request")
            self.held.append(open)

        def leave(self, request, open):
            self.remove(self.name)

        @db.action("turn", "site_msgs/action/Turn")
        def turn(self, goal):
            if goal.request.angle > 3:
                raise ValueError("it cannot turn that far")
            self.held.append(goal)
"""

UNRELIABLE_ROBOT = """
    [robot]
    name = "site"
    interfaces = ["src"]

    [[module]]
    kind = "python"
    name = "unreliable"
    module = "unreliable.py:Unreliable"
    restart = { times = 100, backoff = "10ms" }

    [expose]
    services = ["refuse", "fail", "wrong", "leave", { service = "hold", timeout = "300ms" }]
    actions = ["turn"]
"""


def test_a_client_always_has_an_answer(site, write, program):
    write("unreliable.py", UNRELIABLE)
    write("robot.toml", UNRELIABLE_ROBOT)
    robot = program("run", "robot.toml")
    robot.wait_for("exposed service: /hold")

    def call(service, angle=0.0):
        return other(robot, "service", "call", service, "site_msgs/srv/Level", f"{{tilt: {{angle: {angle}}}}}")

    assert "is_level=False, why='the lamp is broken'" in call("/refuse"), robot.text()
    starts = 0
    for service, words in (("/fail", "ValueError: the vial is empty"), ("/wrong", "is_levl")):
        answer = call(service)
        assert "has failed: " in answer and words in answer and "Traceback" not in answer, answer + robot.text()
        starts += 1
        robot.wait_for("restarted after its panic", starts)
    assert "ValueError: the vial is empty" in robot.text() and "Traceback" in robot.text()
    assert "no answer in 300ms" in call("/hold")
    assert "below the floor" in call("/hold", -1.0)
    sent = other(robot, "action", "send_goal", "/turn", "site_msgs/action/Turn", "{angle: 4.0}")
    assert "rejected" in sent.lower(), sent
    robot.wait_for("restarted after its panic", starts + 1)
    assert 'module "unreliable" does not run and cannot answer' in call("/leave")
    assert "no module serves it" in call("/refuse")


CPP = """
#include "downbeat.hpp"
#include "site_msgs/srv/level.hpp"
#include "std_msgs/msg/string.hpp"

using site_msgs::srv::Level;

class Asker : public downbeat::Module {
    void setup() override {
        auto out = publish<std_msgs::msg::String>("told");
        auto ask = client<Level>("level", std::chrono::seconds(5), [out](const downbeat::Reply<Level::Response> &reply) {
            out({reply ? reply.response->why : reply.error});
        });
        every(std::chrono::milliseconds(50), [ask] {
            Level::Request request;
            request.tilt.angle = 0.5;
            ask(request);
        });
    }
};

DOWNBEAT_MODULE(Asker)
"""


@pytest.mark.skipif(shutil.which("c++") is None, reason="there is no C++ compiler")
@pytest.mark.parametrize("keys", ["", "isolate = true"])
def test_cpp_calls_what_python_serves(keys, site, write, program, tmp_path):
    write("asker.cpp", CPP)
    generated = program("interface", "generate", "--lang", "cpp", "--from", "src", "site_msgs")
    assert generated.wait() == 0, generated.text()
    generated = program("interface", "generate", "--lang", "cpp", "std_msgs/msg/String")
    assert generated.wait() == 0, generated.text()
    compiler = ["c++", "-std=c++17", "-shared", "-fPIC", "-Iinclude", "asker.cpp", "-o", "libasker.so"]
    subprocess.run(compiler, cwd=tmp_path, check=True, timeout=300)
    mason = '[[module]]\n    kind = "python"\n    name = "mason"\n    module = "modules.py:Mason"'
    robot = ROBOT.replace(mason, f'[[module]]\n    kind = "library"\n    name = "asker"\n    path = "libasker.so"\n    {keys}')
    file = write("robot.toml", robot.replace('"leaning"', '"told"'))
    run = program("run", "robot.toml", "--duration", "3s", "--record", "bag")
    assert run.wait() == 0, run.text()
    told = [message.data for topic, message, _ in downbeat.Bag(tmp_path / "bag").messages(topics=["/told"])]
    assert told and set(told) == {"it leans 0.5"}, told
    downbeat.replay(file, tmp_path / "bag").assert_same()
