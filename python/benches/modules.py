"""What a module in Python costs: its runs at 1 kHz, and what the cycles of the modules in Rust beside it notice.

    python python/benches/modules.py

The interpreter is one with the wheel, built for release (`cargo xtask wheel`). A module receives a JointState of 20 joints
and answers with one; the limits are the same work without a robot (decode, read, encode): in a loop, and at the pace of the
module, with caches that are cold after a sleep and the cost of waking up. A robot with modules in Rust then runs
with and without that pair of modules, in turns, and prints the times of its cycles.
"""

import re
import statistics
import subprocess
import sys
import tempfile
import time
import timeit
from pathlib import Path

import downbeat
import numpy as np
from downbeat.msgs.sensor_msgs.msg import Image, JointState

NAMES = [f"joint_{number}" for number in range(20)]

MODULES = f"""
import time
import downbeat as db

NAMES = {NAMES!r}

class Source(db.Module):
    def setup(self):
        self.out = self.publish("states", "sensor_msgs/msg/JointState")

    @db.every("1ms")
    def tick(self):
        self.out(name=NAMES, position=[0.5] * 20, velocity=[0.1] * 20, effort=[0.0] * 20)

class Answer(db.Module):
    def setup(self):
        self.runs = 0
        self.out = self.publish("commands", "sensor_msgs/msg/JointState")

    @db.subscribe("states", "sensor_msgs/msg/JointState")
    def take(self, m):
        if self.runs == 1000:
            self.begin = time.thread_time_ns()
        self.runs += 1
        self.out(name=m.name, position=m.position * 0.9)
        if self.runs == 6000:
            self.log.info(f"RUN {{(time.thread_time_ns() - self.begin) / 5e6:.2f}} us")
"""

PAIR = """
[[module]]
kind = "python"
name = "source"
module = "modules.py:Source"

[[module]]
kind = "python"
name = "answer"
module = "modules.py:Answer"
"""

RUST = """
[robot]
name = "bench"

[[module]]
kind = "stand_nod_wave"

[[module]]
kind = "joint_command_mux"
settings = { sources = ["motion"] }
"""


def run(folder: Path, robot: str, seconds: float) -> str:
    (folder / "robot.toml").write_text(robot)
    command = [sys.executable, "-m", "downbeat", "run", "robot.toml", "--duration", f"{seconds}s"]
    ran = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=seconds + 60)
    assert ran.returncode == 0, ran.stderr
    return ran.stderr


def limits() -> tuple[float, float]:
    """Microseconds of processor time for the same work, in a loop and with a sleep of 1 ms before each."""
    state = JointState(name=NAMES, position=[0.5] * 20, velocity=[0.1] * 20, effort=[0.0] * 20).to_cdr()

    def work() -> bytes:
        m = JointState.from_cdr(state)
        return JointState(name=m.name, position=m.position * 0.9).to_cdr()

    paced = []
    for _ in range(3):
        begin = time.thread_time()
        for _ in range(2000):
            time.sleep(0.001)
            work()
        paced.append((time.thread_time() - begin) / 2000 * 1e6)
    return min(timeit.repeat(work, number=5000, repeat=5)) / 5000 * 1e6, statistics.median(paced)


def image() -> tuple[float, float]:
    """Microseconds from the bytes of an image of 1 MB to an array that can be read, and to a copy of it."""
    data = Image(height=512, width=682, encoding="rgb8", step=682 * 3, data=np.zeros(512 * 682 * 3, np.uint8)).to_cdr()

    def view() -> int:
        return int(Image.from_cdr(data).to_numpy()[100, 100, 0])

    def copy() -> int:
        return int(np.frombuffer(data, np.uint8).copy()[100])

    return tuple(min(timeit.repeat(work, number=2000, repeat=5)) / 2000 * 1e6 for work in (view, copy))


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "modules.py").write_text(MODULES)
        runs = [float(re.search(r"RUN ([\d.]+) us", run(folder, RUST + PAIR, 8))[1]) for _ in range(3)]
        alone, beside = [], []
        for _ in range(3):
            for robot, times in ((RUST, alone), (RUST + PAIR, beside)):
                times.append(re.search(r"busy (p50 .*)|cycles: (p50 .*)", run(folder, robot, 5))[0])
    work, paced = limits()
    view, copy = image()
    print(f"a run at 1 kHz, JointState of 20 in and out: {statistics.median(runs):.1f} us of processor time")
    run_time = statistics.median(runs)
    print(f"  the same work in a loop: {work:.1f} us; ratio {run_time / work:.2f}")
    print(f"  the same work at the same pace: {paced:.1f} us; ratio {run_time / paced:.2f}")
    print(f"an image of 1 MB to an array: {view:.2f} us; a copy of its bytes: {copy:.1f} us; ratio {view / copy:.3f}")
    print("cycles of the modules in Rust, alone and beside the pair, in turns:")
    for pair in zip(alone, beside, strict=True):
        print("  alone   " + pair[0] + "\n  beside  " + pair[1])


if __name__ == "__main__":
    main()
