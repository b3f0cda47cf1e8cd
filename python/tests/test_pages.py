"""The page "Modules in Python": its files and commands, as a reader with an empty home types them."""

import re
from pathlib import Path

import downbeat
import pytest
from conftest import run_script

PAGE = Path(__file__).parents[2] / "docs" / "python.md"

PAGE_NAME = "docs/python.md"

pytestmark = [
    pytest.mark.skipif(not PAGE.exists(), reason="the pages are not beside the package"),
    pytest.mark.usefixtures("new_user"),
]


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(), re.DOTALL)


def test_the_first_module_runs_as_the_page_says(tmp_path, program):
    (tmp_path / "level_head.py").write_text(blocks("python")[0])
    (tmp_path / "robot.toml").write_text(blocks("toml")[0])
    for command in blocks("sh")[1].splitlines():
        name, *arguments = command.split()
        assert name == "downbeat"
        run = program(*arguments)
        if arguments[0] == "run":
            run.wait_for("exposes|running|joined|my_robot|cycles")
            assert run.stop() == 0, run.text()
        else:
            assert run.wait() == 0, run.text()
            assert "level_head" in run.text() and "joint_commands" in run.text()


def test_the_script_runs_the_robot_with_its_class(tmp_path):
    (tmp_path / "level_head.py").write_text(blocks("python")[0])
    (tmp_path / "robot.toml").write_text(
        blocks("toml")[0].replace('kind = "python"', 'kind = "level_head"').replace("module =", "# module =")
    )
    script = tmp_path / "robot.py"
    script.write_text(blocks("python")[1].replace("LevelHead})", "LevelHead}, duration=0.5)"))
    ran = run_script(PAGE_NAME, script)
    assert ran.returncode == 0, ran.stderr


def test_a_run_is_recorded_and_replayed_as_the_page_says(tmp_path, program):
    (tmp_path / "level_head.py").write_text(blocks("python")[0])
    (tmp_path / "robot.toml").write_text(blocks("toml")[0])
    record, replay = (command.replace("10s", "1s").split()[1:] for command in blocks("sh")[3].splitlines())
    for arguments in (record, replay):
        run = program(*arguments)
        assert run.wait() == 0, run.text()
    downbeat.replay(tmp_path / "robot.toml", tmp_path / "walk").assert_same()


def test_the_test_of_a_module_runs_as_the_page_says(tmp_path):
    (tmp_path / "level_head.py").write_text(blocks("python")[0])
    (test,) = (block for block in blocks("python") if "db.test.Robot" in block)
    script = tmp_path / "test.py"
    script.write_text(test)
    ran = run_script(PAGE_NAME, script)
    assert ran.returncode == 0, ran.stderr


@pytest.mark.parametrize("code", blocks("python") if PAGE.exists() else [])
def test_every_example_is_python(code):
    compile(code, "docs/python.md", "exec")


def test_the_page_about_messages_and_bags_runs(tmp_path):
    page = PAGE.with_name("python_messages.md")
    script = tmp_path / "page.py"
    script.write_text("\n".join(re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)))
    ran = run_script("docs/python_messages.md", script)
    assert ran.returncode == 0, ran.stderr
    # What the comments say.
    assert "did you mean 'orientation'?" in ran.stdout
    assert "field position[1]: expected float64, got str 'a'" in ran.stdout
    assert "field header.stamp.sec: 1099511627776 is out of the range of int32" in ran.stdout
    assert "(480, 640, 3) uint8" in ran.stdout
