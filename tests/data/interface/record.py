"""Records the output of the real `ros2 interface show` for comparison in tests.

    AMENT_PREFIX_PATH=VENV PYTHONPATH=ROS2CLI/ros2cli:ROS2CLI/ros2interface:ROSIDL_RUNTIME_PY VENV/bin/python record.py

VENV is the Python environment of the tests (target/venv), the others are checkouts of ros2/ros2cli and
ros2/rosidl_runtime_py, branch jazzy, which are not on PyPI. Writes in its own folder:

    ros2_interface_show.txt   what it prints for the types of shown_msgs, as it is
    ros2_interface_show.tsv   for each type of the wheels: name, option, SHA-256 of what it prints, leftovers taken away
"""

import contextlib
import hashlib
import io
import os
import pathlib
import tempfile

from ros2interface.verb.show import _show_interface
from rosidl_runtime_py import get_interfaces

HERE = pathlib.Path(__file__).parent
OPTIONS = {'': (True, False), '--no-comments': (False, False), '--all-comments': (True, True)}


def show(name, option):
    has_comments, has_nested_comments = OPTIONS[option]
    output = io.StringIO()
    with contextlib.redirect_stdout(output):
        _show_interface(name, is_show_comments=has_comments, is_show_nested_comments=has_nested_comments)
    return output.getvalue()


def without_leftovers(text, option):
    """Removes what the real command leaves of hidden comments: a `#` of each and some whole ones."""
    lines = []
    for line in text.splitlines():
        if option == '--no-comments' or option == '' and line.startswith('\t'):
            line = line.split('#')[0].rstrip()
            if not line:
                continue
        lines.append(line + '\n')
    return ''.join(lines)


def shown_msgs():
    with tempfile.TemporaryDirectory() as prefix:
        share = pathlib.Path(prefix, 'share')
        (share / 'ament_index/resource_index/packages').mkdir(parents=True)
        for package in ('shown_msgs', 'other_msgs'):
            (share / 'ament_index/resource_index/packages' / package).touch()
            (share / package).symlink_to(HERE / package)
        os.environ['AMENT_PREFIX_PATH'] = prefix + ':' + os.environ['AMENT_PREFIX_PATH']
        for path in sorted((HERE / 'shown_msgs').glob('*/*')):
            for option in OPTIONS:
                name = f'shown_msgs/{path.parent.name}/{path.stem}'
                yield ' '.join(['$ ros2 interface show', name, option]).rstrip() + '\n' + show(name, option)


def wheels():
    for package, names in sorted(get_interfaces().items()):
        for name in sorted(names):
            for option in OPTIONS:
                text = without_leftovers(show(f'{package}/{name}', option), option)
                yield f'{package}/{name}\t{option}\t{hashlib.sha256(text.encode()).hexdigest()}\n'


(HERE / 'ros2_interface_show.tsv').write_text(''.join(wheels()))
(HERE / 'ros2_interface_show.txt').write_text(''.join(shown_msgs()))
