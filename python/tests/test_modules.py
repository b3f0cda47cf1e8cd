"""Modules in Python, as their users write them: robot files and classes, run by the command ``downbeat``."""

import itertools
import re
import time

import downbeat
import pytest

LEVEL_HEAD = """
    import downbeat as db
    import numpy as np

    class LevelHead(db.Module):
        gain = db.setting(0.008, unit="s", range=(0, 1))

        def setup(self):
            self.tilt = 0.0
            self.out = self.publish("joint_commands", "sensor_msgs/msg/JointState")

        @db.subscribe("imu/data_raw", "sensor_msgs/msg/Imu")
        def imu(self, m):
            self.tilt += m.angular_velocity.y * self.gain

        @db.every("20ms")
        def tick(self):
            self.out(name=["head_tilt"], position=[np.clip(self.tilt, -0.4, 0.9)])
"""

SOURCE = """
    import downbeat as db

    class Source(db.Module):
        def setup(self):
            self.out = self.publish("imu/data_raw", "sensor_msgs/msg/Imu")

        @db.every("5ms")
        def tick(self):
            self.out(angular_velocity={"y": self.random.uniform(-1.0, 2.0)}, header={"stamp": self.now().to_msg()})
"""

ROBOT = """
    [robot]
    name = "level"

    [[module]]
    kind = "python"
    name = "source"
    module = "source.py:Source"

    [[module]]
    kind = "python"
    name = "level_head"
    module = "level_head.py:LevelHead"
"""


@pytest.fixture
def level(write):
    write("source.py", SOURCE)
    write("level_head.py", LEVEL_HEAD)
    return write("robot.toml", ROBOT)


def one_module(name="module", extra=""):
    return f"""
    [robot]
    name = "one"

    [[module]]
    kind = "python"
    name = "{name}"
    module = "module.py:M"
    {extra}
    """


def test_a_recorded_run_replays_bit_for_bit_and_a_changed_source_is_reported(level, program, write, tmp_path):
    run = program("run", "robot.toml", "--record", "bag", "--duration", "2s")
    assert run.wait() == 0, run.text()
    report = downbeat.replay(level, tmp_path / "bag")
    report.assert_same()
    assert report.compared > 100, str(report)
    assert report.changed_sources == []

    write("level_head.py", LEVEL_HEAD.replace("0.9)", "0.01)"))
    report = downbeat.replay(level, tmp_path / "bag")
    assert report.changed_sources == ["level_head"]
    assert "the source of level_head has changed since the recording" in str(report)
    with pytest.raises(AssertionError, match="/joint_commands"):
        report.assert_same()


@pytest.mark.parametrize("synchrony", ["when_due", "detached"])
def test_another_version_of_a_module_is_tried(level, program, write, synchrony):
    write("robot.toml", ROBOT.replace('kind = "python"', f'kind = "python"\n    synchrony = "{synchrony}"'))
    run = program("run", "robot.toml", "--record", "bag", "--duration", "2s")
    assert run.wait() == 0, run.text()
    write("other.py", LEVEL_HEAD.replace("0.9)", "0.01)"))
    tried = program("bag", "replay", "robot.toml", "bag", "--with", "level_head=other.py")
    assert tried.wait() == 0, tried.text()
    assert re.search(r"they part .* from level_head: in /joint_commands #\d+, position\[0\] is 0\.01, and", tried.text()), tried.text()
    write("same.py", LEVEL_HEAD.replace("as db", "as db  # the same", 1))
    tried = program("bag", "replay", "robot.toml", "bag", "--with", "level_head=same.py")
    assert tried.wait() == 0 and "the two runs are the same" in tried.text(), tried.text()
    tried = program("bag", "replay", "robot.toml", "bag", "--with", "level_head=missing.py")
    assert tried.wait() != 0 and "missing.py" in tried.text(), tried.text()


def test_a_script_runs_a_robot_with_its_own_classes(write, program, tmp_path):
    write(
        "robot.toml",
        """
        [robot]
        name = "script"

        [[module]]
        kind = "counter"
        settings = { start = 40 }
        """,
    )
    script = write(
        "script.py",
        """
        import downbeat as db

        class Counter(db.Module):
            "counts"
            start = db.setting(0)

            def setup(self):
                self.count = self.start
                self.each = self.task(self.again)

            def activate(self):
                self.each.after("10ms")

            def again(self):
                self.count += 1
                self.log.info(f"count {self.count}")
                if self.count == 42:
                    self.remove()
                else:
                    self.each.after(0.01)

            def shutdown(self):
                self.log.warning("done")

        db.run("robot.toml", kinds={"counter": Counter}, duration=1)
        """,
    )
    import subprocess
    import sys

    ran = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert ran.returncode == 0, ran.stderr
    assert re.search("count 41.*count 42.*done", ran.stderr, re.DOTALL), ran.stderr
    assert "count 43" not in ran.stderr


def test_services_are_served_called_refused_and_answered_later(write, program):
    write(
        "module.py",
        """
        import downbeat as db

        class M(db.Module):
            def setup(self):
                self.call = self.client("enable", "std_srvs/srv/SetBool", timeout="2s")
                self.later = self.client("later", "std_srvs/srv/Trigger")
                self.missing = self.client("missing", "std_srvs/srv/Trigger", timeout="100ms")
                self.serve_later("later", "std_srvs/srv/Trigger", self.take)
                self.open = None

            @db.serve("enable", "std_srvs/srv/SetBool")
            def enable(self, request):
                if not request.data:
                    raise db.Refused("it stays on")
                return {"success": True, "message": "on"}

            def take(self, request, open):
                self.open = open

            def activate(self):
                for data in (True, False):
                    self.call(data=data, then=lambda response, problem: self.log.info(f"answer {response} {problem}"))
                self.later(then=lambda response, problem: self.log.info(f"later: {response.message}"))
                self.missing(then=lambda response, problem: self.log.info(f"missing: {problem}"))

            @db.every("50ms")
            def tick(self):
                if self.open is not None:
                    self.open.reply(success=True, message="now")
                    self.open = None
        """,
    )
    write("robot.toml", one_module())
    run = program("run", "robot.toml")
    run.wait_for("answer .*on.*answer None .*it stays on")
    run.wait_for("later: now")
    run.wait_for('missing: service "missing"')
    assert run.stop() == 0


def test_an_action_is_served_and_called_with_feedback_result_and_cancel(write, program):
    write(
        "module.py",
        """
        import downbeat as db

        class M(db.Module):
            def setup(self):
                self.goals = []
                self.gripper = self.action_client("gripper", "control_msgs/action/GripperCommand")

            @db.action("gripper", "control_msgs/action/GripperCommand")
            def take(self, goal):
                if goal.request.command.position < 0:
                    raise db.Refused("no")
                self.goals.append([goal, 0.0])

            def activate(self):
                self.send(3.0)
                self.send(-1.0)
                self.endless = self.send(1000.0)

            def send(self, position):
                return self.gripper.send(
                    command={"position": position},
                    then=lambda status, result: self.log.info(f"to {position}: {status} {result}"),
                    feedback=lambda feedback: self.log.info(f"feedback {feedback.position}"),
                )

            @db.every("20ms")
            def work(self):
                for entry in list(self.goals):
                    entry[1] += 1.0
                    goal, position = entry
                    goal.feedback(position=position)
                    if goal.is_canceling:
                        goal.canceled(position=position)
                    elif position == goal.request.command.position:
                        goal.succeed(position=position, reached_goal=True)
                        self.gripper.cancel(self.endless)
                    else:
                        continue
                    self.goals.remove(entry)
        """,
    )
    write("robot.toml", one_module())
    run = program("run", "robot.toml")
    run.wait_for(r"feedback 2\.0")
    run.wait_for(r"to 3\.0: 4 .*reached_goal=True")
    run.wait_for(r"to -1\.0: 0 the goal was refused")
    run.wait_for(r"to 1000\.0: 5 ")
    assert run.stop() == 0


def test_an_exception_ends_the_module_alone_with_its_traceback_and_is_restarted(write, program):
    write(
        "module.py",
        """
        import downbeat as db

        class M(db.Module):
            @db.every("50ms")
            def fail(self):
                raise KeyError("servo_21")

        class Other(db.Module):
            @db.every("50ms")
            def go_on(self):
                self.log.info("goes on")
        """,
    )
    other = '[[module]]\n    kind = "python"\n    name = "other"\n    module = "module.py:Other"'
    write("robot.toml", one_module(extra=f'restart = {{ times = 2, backoff = "10ms" }}\n    {other}'))
    run = program("run", "robot.toml")
    run.wait_for(r'Traceback.*module\.py", line 7, in fail.*raise KeyError\("servo_21"\)', times=1)
    run.wait_for("restarted after its panic", times=2)
    run.wait_for("and was stopped; the other modules continue")
    before = run.text().count("goes on")
    run.wait_for("goes on", times=before + 5)
    assert run.stop() == 0


@pytest.mark.parametrize(
    ("source", "module", "told"),
    [
        ("", "missing.py:M", r"missing\.py: there is no such file"),
        ("import downbeat as db\nclass N(db.Module): pass", "module.py:M", 'there is no class "M"; there is N'),
        ("class M: pass", "module.py:M", "M is no subclass of downbeat.Module"),
        ("def f(:\n  pass", "module.py:M", r"module\.py:1: .*invalid syntax.*def f\(:"),
        ("import nowhere", "module.py:M", "No module named 'nowhere'"),
        ("", "nowhere.part:M", 'there is no Python module "nowhere.part": install it'),
        ("", "module.py", 'names no class: write "file.py:Class"'),
        (
            "import downbeat as db\nclass M(db.Module):\n  def setup(self): self.publish('a', 'std_msgs/msg/Strnig')",
            "module.py:M",
            'std_msgs/msg/Strnig.*did you mean std_msgs/msg/String\\?',
        ),
        (
            "import downbeat as db\nclass M(db.Module):\n  x = db.setting(1)\n  def setup(self): self.x = 2",
            "module.py:M",
            r'write self\.set\("x", value\)',
        ),
    ],
)
def test_what_cannot_be_loaded_is_reported_with_file_line_and_remedy(source, module, told, write, program):
    write("module.py", source)
    write("robot.toml", one_module().replace("module.py:M", module))
    run = program("run", "robot.toml")
    assert run.wait() == 1
    assert re.search(r"robot\.toml:\d+: ", run.text()), run.text()
    assert re.search(told, run.text(), re.DOTALL), run.text()


def test_a_module_that_does_not_return_is_reported_with_file_line_and_function(write, program):
    write(
        "module.py",
        """
        import time
        import downbeat as db

        class M(db.Module):
            @db.every("10ms")
            def wait(self):
                time.sleep(1.5)
        """,
    )
    write("robot.toml", one_module(extra='deadline = "100ms"'))
    run = program("run", "robot.toml")
    run.wait_for(r"has not returned for 0\.\d+ s: \S*module\.py:8, in wait")
    assert run.stop() == 0


def test_a_process_that_a_callback_forked_does_not_run_as_a_second_robot(write, program):
    write(
        "module.py",
        """
        import os
        import downbeat as db

        class M(db.Module):
            count = 0

            @db.every("20ms")
            def fork(self):
                self.count += 1
                if self.count == 5:
                    child = os.fork()
                    if child == 0:
                        raise KeyError("the child comes back")
                    _, status = os.waitpid(child, 0)
                    self.log.info(f"the child ended with {os.waitstatus_to_exitcode(status)}")
                if self.count == 10:
                    child = os.fork()
                    if child == 0:
                        os._exit(7)
                    _, status = os.waitpid(child, 0)
                    self.log.info(f"another ended with {os.waitstatus_to_exitcode(status)}")
                if self.count > 10:
                    self.log.info("goes on")
        """,
    )
    write("robot.toml", one_module())
    run = program("run", "robot.toml")
    run.wait_for("a callback returned in a process that it had forked")
    run.wait_for("the child ended with 1")
    run.wait_for("another ended with 7")
    run.wait_for("goes on", times=5)
    assert "Traceback" not in run.text()
    assert run.stop() == 0


def test_a_module_that_never_returns_does_not_keep_an_impatient_user(write, program):
    write(
        "module.py",
        """
        import downbeat as db

        class M(db.Module):
            @db.every("10ms")
            def spin(self):
                self.log.info("spins")
                while True:
                    pass
        """,
    )
    write("robot.toml", one_module())
    run = program("run", "robot.toml")
    run.wait_for("spins")
    run.process.terminate()
    time.sleep(1.5)
    assert run.process.poll() is None
    run.process.terminate()
    assert run.wait() == 128 + 15


def test_settings_are_checked_and_changed(write):
    write(
        "module.py",
        """
        import downbeat as db

        class M(db.Module):
            speed = db.setting(1.0, unit="m/s", range=(0, 2), about="of walking")
            names = db.setting(["a"])

            def accept(self, name, value):
                if name == "names" and not value:
                    raise ValueError("at least one name")
        """,
    )
    robot = write("robot.toml", one_module())
    with downbeat.start(robot) as running:
        running.set("module", "speed", 2)
        with pytest.raises(RuntimeError, match="3 is out of range"):
            running.set("module", "speed", 3.0)
        with pytest.raises(RuntimeError, match="at least one name"):
            running.set("module", "names", [])
        with pytest.raises(RuntimeError, match="no such setting; there is speed, names"):
            running.set("module", "spede", 1.0)
        assert running.is_running
    assert not running.is_running


def test_a_changed_file_takes_over_twenty_times_under_load_and_a_broken_one_does_not(write, program):
    template = """
        import downbeat as db

        class M(db.Module):
            def setup(self):
                self.count = 0
                self.out = self.publish("counts", "std_msgs/msg/Int64")

            @db.every("5ms")
            def tick(self):
                self.count += 1
                self.out(data=self.count)
                if self.count % 20 == 0:
                    self.log.info(f"version VERSION at {self.count}")

            def save(self):
                return self.count

            def restore(self, state):
                self.count = state
    """
    write("module.py", template.replace("VERSION", "0"))
    load = """
        import downbeat as db

        class Load(db.Module):
            def setup(self):
                self.last = 0

            @db.subscribe("counts", "std_msgs/msg/Int64")
            def take(self, m):
                if m.data != self.last + 1:
                    self.log.error(f"LOST: {m.data} after {self.last}")
                self.last = m.data

            @db.every("2ms")
            def work(self):
                sum(range(10_000))
    """
    write("load.py", load)
    other = '[[module]]\n    kind = "python"\n    name = "load"\n    module = "load.py:Load"'
    write("robot.toml", one_module(extra=f"reload = true\n    {other}"))
    run = program("run", "robot.toml")
    run.wait_for("version 0 at")
    for version in range(1, 21):
        write("module.py", template.replace("VERSION", str(version)))
        run.wait_for(f"version {version} at")
    broken = [
        ("def setup(self):", "def setup(self:"),
        ("self.count = 0", "self.count = unknown"),
        ('"std_msgs/msg/Int64"', '"std_msgs/msg/Int46"'),
        ("self.count = state", "raise ValueError('another state')"),
        ('"std_msgs/msg/Int64"', '"std_msgs/msg/Float64"'),
    ]
    for number, (old, new) in enumerate(broken):
        write("module.py", template.replace("VERSION", f"broken {number}").replace(old, new))
        run.wait_for("the version before goes on|not added", times=number + 1)
        before = run.text().count("version 20 at")
        run.wait_for("version 20 at", times=before + 2)
    assert run.stop() == 0
    assert "broken" not in re.sub(r"broken\W+\w+", "", "") and "version broken" not in run.text()
    assert "LOST" not in run.text(), run.text()
    counts = [int(count) for count in re.findall(r"version \d+ at (\d+)", run.text())]
    assert all(later == earlier + 20 for earlier, later in itertools.pairwise(counts)), counts


def test_attached_modules_run_inside_the_cycle(write, program):
    write("source.py", SOURCE)
    write("level_head.py", LEVEL_HEAD)
    write("robot.toml", ROBOT.replace('LevelHead"', 'LevelHead"\n    synchrony = "when_due"'))
    run = program("run", "robot.toml", "--record", "bag", "--duration", "1s")
    assert run.wait() == 0, run.text()
    downbeat.replay(run.log.parent / "robot.toml", run.log.parent / "bag").assert_same()


COUNTER = """
    import downbeat as db

    class M(db.Module):
        def setup(self):
            self.count = 0
            self.out = self.publish("counts", "std_msgs/msg/Float64")

        @db.every("10ms")
        def tick(self):
            self.count += 1
            self.out(data=self.count * STEP)
            if self.count % 20 == 0:
                self.log.info(f"{self.count} steps of STEP")
            if self.count == RAISES_AT:
                raise ValueError("as this test wants it")

        def save(self):
            return self.count

        def restore(self, state):
            self.count = state
"""


def counter(step, raises_at=-1):
    return COUNTER.replace("STEP", str(step)).replace("RAISES_AT", str(raises_at))


@pytest.mark.parametrize("keys", ["", 'synchrony = "when_due"'])
def test_a_module_that_raised_starts_again_when_it_is_saved_and_all_versions_replay(write, program, tmp_path, keys):
    write("module.py", counter(0.1, 20))
    write("robot.toml", one_module(extra=f"reload = true\n    {keys}\n    [record]\n    topics = \"all\""))
    run = program("run", "robot.toml", "--record", "bag")
    run.wait_for("panicked and was stopped; the other modules continue.*as this test wants it")
    write("module.py", counter(0.2).replace("def setup(self)", "def setup(self"))
    run.wait_for(r"module.py was saved and still does not start: \S*module.py:5: ")
    write("module.py", counter(0.2).replace("self.count = 0", "self.count = unknown"))
    run.wait_for("module.py was saved and still does not start: Traceback.*NameError")
    write("module.py", counter(0.2))
    run.wait_for("module.py was saved: it starts again with it")
    run.wait_for("steps of 0.2", times=3)
    write("module.py", counter(0.3))
    run.wait_for("module.py was saved and is reloaded")
    run.wait_for("steps of 0.3", times=3)
    assert run.stop() == 0
    report = downbeat.replay(tmp_path / "robot.toml", tmp_path / "bag")
    report.assert_same()
    assert report.compared > 60 and report.changed_sources == [], str(report)
    assert "module.py of module was saved and taken 2 times during the recording" in str(report)
    write("module.py", counter(0.4))
    report = downbeat.replay(tmp_path / "robot.toml", tmp_path / "bag")
    assert report.changed_sources == ["module"] and report.different > 10, str(report)


def test_a_robot_starts_without_a_module_that_raises_in_its_constructor_until_it_is_saved(write, program):
    write("module.py", counter(0.1).replace("def setup(self):", "def __init__(self):\n            raise ValueError('no')"))
    write("robot.toml", one_module(extra="reload = true"))
    run = program("run", "robot.toml")
    run.wait_for("ValueError: no; it starts when its file is saved")
    write("module.py", counter(0.1).replace("self.count += 1", "self.count += 1; self.log.info('ticks', once=True)"))
    run.wait_for("module.py was saved: it starts again with it.*ticks")
    assert run.stop() == 0


def test_the_debugger_shows_the_fields_of_a_module_forwards_and_backwards(write, program):
    write("module.py", counter(0.1))
    write("robot.toml", one_module(extra='[record]\n    topics = "all"'))
    run = program("run", "robot.toml", "--record", "bag", "--duration", "2s")
    assert run.wait() == 0, run.text()
    look = ("-c", "module module")
    lines = ("-c", "go 1s", *look, "-c", "next module", *look, "-c", "last module", *look, "-c", "go end", "-c", "go 1s", *look)
    debugger = program("bag", "debug", "robot.toml", "bag", *lines, "-c", "quit")
    assert debugger.wait() == 0, debugger.text()
    counts = [int(count) for count in re.findall(r"\bcount: (\d+)", debugger.text())]
    assert len(counts) == 4 and counts[0] > 50, debugger.text()
    assert counts == [counts[0], counts[0] + 1, counts[0], counts[0]], debugger.text()


def test_a_replay_uses_the_recorded_settings(level, program, write, tmp_path):
    run = program("run", "robot.toml", "--record", "bag", "--duration", "2s", "-p", "level_head.gain:=0.01")
    assert run.wait() == 0, run.text()
    report = downbeat.replay(level, tmp_path / "bag")
    report.assert_same()
    assert "level_head.gain: replayed with 0.01 as recorded; the robot file no longer gives it" in str(report)
    other = program("bag", "replay", "robot.toml", "bag", "-p", "level_head.gain:=0.02")
    assert other.wait() != 0
    assert "level_head.gain: recorded with 0.01, replayed with 0.02 as given for the replay" in other.text()


def test_a_line_of_the_log_has_its_place_in_the_python_file(write, program, monkeypatch):
    monkeypatch.setenv("RCUTILS_CONSOLE_OUTPUT_FORMAT", "{file_name}:{line_number} {function_name}: {message}")
    module = """
        import downbeat as db

        class M(db.Module):
            @db.every("10ms")
            def tick(self):
                self.log.info("here", once=True)
                self.log.warning("there", every="1h")
    """
    path = write("module.py", module)
    write("robot.toml", one_module())
    run = program("run", "robot.toml", "--duration", "1s")
    assert run.wait() == 0, run.text()
    lines = path.read_text().splitlines()
    for text in ("here", "there"):
        number = next(number for number, line in enumerate(lines, 1) if text in line)
        assert f"{path}:{number} tick: {text}" in run.text(), run.text()
