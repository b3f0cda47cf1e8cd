"""The projects of ``downbeat new`` with modules in Python: made, tested and run as their READMEs say."""

import subprocess
import sys

import pytest

PAGE_NAME = "the templates in Python"

pytestmark = pytest.mark.usefixtures("new_user")


@pytest.mark.parametrize(("template", "topic"), [("python", "/joint_commands"), ("camera", "/spot")])
def test_a_project_passes_its_tests_and_runs(tmp_path, program, template, topic):
    made = program("new", "my_robot", "--template", template)
    assert made.wait() == 0 and "python -m pytest" in made.text(), made.text()
    tests = subprocess.run(
        [sys.executable, "-m", "pytest", "--quiet", "-p", "no:cacheprovider"],
        cwd=tmp_path / "my_robot",
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert tests.returncode == 0 and "2 passed" in tests.stdout, tests.stdout + tests.stderr
    run = program("run", "my_robot/robot.toml", "--fast", "--duration", "4s")
    assert run.wait() == 0 and topic in run.text(), run.text()
