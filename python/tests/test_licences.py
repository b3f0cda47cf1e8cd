"""What has to be passed on with the wheel."""

from __future__ import annotations

import importlib.metadata


def test_the_wheel_has_the_licences_of_what_it_contains() -> None:
    files = importlib.metadata.files("downbeat-robotics") or []
    licences = {file.name: file for file in files if ".dist-info/licenses" in str(file)}
    assert {"LICENSE", "NOTICE", "THIRD-PARTY.txt"} <= licences.keys()
    assert "control_msgs" in licences["NOTICE"].read_text()
    assert "serialport 4." in licences["THIRD-PARTY.txt"].read_text()


def test_the_wheel_says_what_it_is_and_where_it_comes_from() -> None:
    metadata = importlib.metadata.metadata("downbeat-robotics")
    urls = dict(url.split(", ", 1) for url in metadata.get_all("Project-URL") or [])
    assert {"Documentation", "Source", "Issues", "Changelog"} <= urls.keys()
    assert metadata["Author"] == "the downbeat authors"
    assert "ros2" in metadata["Keywords"].split(",")
    assert "Typing :: Typed" in (metadata.get_all("Classifier") or [])


def test_the_wheel_has_no_list_of_crates_with_paths_of_the_machine_that_built_it() -> None:
    files = importlib.metadata.files("downbeat-robotics") or []
    assert files
    assert not [file for file in files if "sboms" in file.parts]
