"""The other end of the interop tests: rclpy, rosbags and cyclonedds write and read messages.

    peer.py COMMAND FILE [ARGUMENT...]

Lines of FILE and of the output have parts separated by tabs. Bytes and definitions are in hexadecimal; values are in
JSON, their floating-point numbers as texts of their bits in hexadecimal, so that each bit counts.
"""

import sys


def lines(path):
    with open(path, encoding='utf-8', newline='\n') as file:
        return [line.rstrip('\n').split('\t') for line in file]


def main(command, path, *arguments):
    if command.startswith('ros_'):
        import ros as witness
    elif command.startswith('bags_'):
        import bags as witness
    else:
        import cyclone as witness
    function = getattr(witness, command.split('_', 1)[1])
    for parts in function(lines(path), *arguments):
        print(*parts, sep='\t')


if __name__ == '__main__':
    main(*sys.argv[1:])
