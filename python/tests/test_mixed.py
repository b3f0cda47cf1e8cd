"""Modules in Rust, Python and C++ in one robot: the same bag in every run in simulated time."""

import shutil

import downbeat
import pytest

PYTHON = """
    import downbeat as db

    class Source(db.Module):
        step = db.setting(1.0)

        def setup(self):
            self.out = self.publish("numbers_0", "std_msgs/msg/Float64")

        @db.every("10ms")
        def tick(self):
            self.out(data=self.random.uniform(0.0, self.step))

    class Next(db.Module):
        number = db.setting(0)

        def setup(self):
            self.sum = 0.0
            self.out = self.publish(f"numbers_{self.number + 1}", "std_msgs/msg/Float64")
            self.subscribe(f"numbers_{self.number}", "std_msgs/msg/Float64", self.take)

        def take(self, m):
            self.sum += m.data
            self.out(data=self.sum % 1.0)

    class Commands(db.Module):
        def setup(self):
            self.out = self.publish("joint_commands", "sensor_msgs/msg/JointState")

        @db.subscribe("numbers_5", "std_msgs/msg/Float64")
        def take(self, m):
            self.out(header={"stamp": self.now().to_msg()}, name=["head_tilt"], position=[m.data * 0.1])
"""

CPP = """
#include "downbeat.hpp"
#include "std_msgs/msg/float64.hpp"

using std_msgs::msg::Float64;

class Halver : public downbeat::Module {
    void setup() override {
        auto out = publish<Float64>("out");
        subscribe<Float64>("in", [this, out](const Float64 &message) {
            kept_ = 0.5 * kept_ + message.data;
            out({kept_});
        });
    }
    double kept_ = 0.0;
};

DOWNBEAT_MODULE(Halver)
"""


def robot() -> str:
    def python(name, kind, settings=""):
        return f'[[module]]\nkind = "python"\nname = "{name}"\nmodule = "modules.py:{kind}"\n{settings}\n'

    def library(name, number, keys=""):
        remap = f'remap = {{ in = "numbers_{number}", out = "numbers_{number + 1}" }}'
        return f'[[module]]\nkind = "library"\nname = "{name}"\npath = "libhalver.so"\n{remap}\n{keys}\n'

    def rust(kind):
        return f'[[module]]\nkind = "{kind}"\n'

    modules = [
        python("source", "Source"),
        library("halver_a", 0),
        rust("stand_nod_wave"),
        python("next_a", "Next", "settings = { number = 1 }"),
        library("halver_b", 2),
        python("next_b", "Next", "settings = { number = 3 }"),
        rust("imu_filter"),
        library("halver_c", 4, "isolate = true"),
        python("commands", "Commands"),
        rust("transform_server"),
    ]
    assert len(modules) == 10
    return '[robot]\nname = "mixed"\n\n' + "\n".join(modules)


@pytest.mark.skipif(shutil.which("c++") is None, reason="there is no C++ compiler")
def test_ten_modules_in_three_languages_give_the_same_bag_twice(write, program, tmp_path):
    write("modules.py", PYTHON)
    write("halver.cpp", CPP)
    generated = program("interface", "generate", "--lang", "cpp", "std_msgs/msg/Float64")
    assert generated.wait() == 0, generated.text()
    import subprocess

    compiler = ["c++", "-std=c++17", "-O2", "-shared", "-fPIC", "-Iinclude", "halver.cpp", "-o", "libhalver.so"]
    subprocess.run(compiler, cwd=tmp_path, check=True, timeout=120)
    file = write("robot.toml", robot())
    for bag in ("first", "second"):
        run = program("run", "robot.toml", "--fast", "--duration", "10s", "--record", bag)
        assert run.wait() == 0, run.text()
    topics = ["joint_commands", *(f"numbers_{number}" for number in range(6))]
    first, second = (
        [(m.topic, m.time, m.message.to_cdr()) for m in downbeat.Bag(tmp_path / bag) if m.topic.strip("/") in topics]
        for bag in ("first", "second")
    )
    assert len(first) > 6000 and first == second
    downbeat.replay(file, tmp_path / "first").assert_same()
