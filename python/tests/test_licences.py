"""What has to be passed on with the wheel."""

from __future__ import annotations

import importlib.metadata


def test_the_wheel_has_the_licences_of_what_it_contains() -> None:
    files = importlib.metadata.files("downbeat-robotics") or []
    licences = {file.name: file for file in files if ".dist-info/licenses" in str(file)}
    assert {"LICENSE", "NOTICE", "THIRD-PARTY.txt"} <= licences.keys()
    assert "control_msgs" in licences["NOTICE"].read_text()
    assert "serialport 4." in licences["THIRD-PARTY.txt"].read_text()
