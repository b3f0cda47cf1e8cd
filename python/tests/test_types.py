"""What type checkers know."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import downbeat
from downbeat import _core, stubs

SAMPLE = '''
import numpy as np
import downbeat as db
from downbeat.msgs.geometry_msgs.msg import Point
from downbeat.msgs.sensor_msgs.msg import Image, Imu, JointState
from downbeat.msgs.std_srvs.srv import SetBool

state = JointState(header={"frame_id": "body"}, name=["pan"], position=np.zeros(1))
reveal_type(state.header.stamp.sec)
reveal_type(state.position)
reveal_type(Image().to_numpy())
reveal_type(SetBool.Request(data=True).data)
for topic, message, time in db.Bag("run").messages(["/imu"], start=3):
    reveal_type(time)
with db.Writer("run", compression="zstd") as writer:
    writer.write("/imu", Imu(), 1)
reveal_type(JointState.from_cdr(state.to_cdr()).name)
Point(x="1")
state.positon = [1.0]
state.header = Point()
'''

EXPECTED = [
    'note: Revealed type is "int"',
    'note: Revealed type is "numpy.ndarray[tuple[Any, ...], numpy.dtype[numpy.float64]]"',
    'note: Revealed type is "numpy.ndarray[tuple[Any, ...], numpy.dtype[Any]]"',
    'note: Revealed type is "bool"',
    'note: Revealed type is "int"',
    'note: Revealed type is "list[str]"',
    'error: Argument "x" to "Point" has incompatible type "str"; expected "float"',
    'error: "JointState" has no attribute "positon"; maybe "position"?',
    "error: Incompatible types in assignment",
]


def mypy(folder: Path, *arguments: str) -> list[str]:
    pytest.importorskip("mypy")
    settings = Path(__file__).with_name("pyproject.toml")
    settings = settings if settings.exists() else Path(__file__).parents[1] / "pyproject.toml"
    command = [sys.executable, "-m", "mypy", "--config-file", str(settings), *arguments]
    environment = {**os.environ, "MYPYPATH": str(folder)}
    result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=600)
    return (result.stdout + result.stderr).splitlines()


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package with the stubs of all interfaces."""
    folder = tmp_path_factory.mktemp("package")
    ours = Path(downbeat.__file__).parent
    shutil.copytree(ours, folder / "downbeat", ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    for path, text in stubs.stubs(_core.interface_packages()).items():
        file = folder / "downbeat" / "msgs" / path
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)
    return folder


def test_the_package_and_its_stubs_are_well_typed(package: Path) -> None:
    assert mypy(package, "-p", "downbeat")[-1].startswith("Success: no issues found")


def test_a_program_is_checked(package: Path) -> None:
    (package / "sample.py").write_text(SAMPLE)
    found = [line for line in mypy(package, "sample.py") if line.startswith("sample.py")]
    assert len(found) == len(EXPECTED), found
    for line, expected in zip(found, EXPECTED, strict=True):
        assert expected in line


def test_stubs_of_own_packages_are_written_to_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "src" / "arm_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Arm.msg").write_text("# An arm.\ngeometry_msgs/Point[] joints\nfloat32[3] lengths  # [m]\nuint8 LEFT=1\n")
    output = tmp_path / "typings"
    command = [sys.executable, "-m", "downbeat.stubs", "--search", str(tmp_path / "src"), "--output", str(output), "arm_msgs"]
    subprocess.run(command, check=True, timeout=60)
    text = (output / "downbeat-stubs" / "msgs" / "arm_msgs" / "msg.pyi").read_text()
    assert "LEFT: ClassVar[int] = 1" in text
    assert "def joints(self) -> list[downbeat.msgs.geometry_msgs.msg.Point]:" in text
    assert "def lengths(self) -> npt.NDArray[np.float32]:" in text
    assert (output / "downbeat-stubs" / "py.typed").read_text() == "partial\n"
