"""A line between two network interfaces that delays every frame and loses some: the kernel of a test machine may lack netem.

    forwarder.py PORT PORT --delay-ms 20 --loss 0.02 --seed 1

Prints `ready` when frames pass. Both directions have their own loss; a seed gives the same losses again for the same frames.
"""

import argparse
import random
import select
import socket
import struct
import time
from collections import deque

ALL_PROTOCOLS = 0x0003
SO_RCVBUFFORCE = 33
HEADERS = struct.Struct("!12xHB5xHxB")  # EtherType, version and header length, flags and fragment offset, protocol
IPV4, UDP = 0x0800, 17


def without_checksum(frame):
    """The sender of a virtual interface leaves the checksum to hardware that is not there; zero says that there is none."""
    if len(frame) < HEADERS.size:
        return frame
    ether_type, version, fragment, protocol = HEADERS.unpack_from(frame)
    udp = 14 + 4 * (version & 0x0F)
    if (ether_type, protocol) == (IPV4, UDP) and fragment & 0x1FFF == 0 and len(frame) >= udp + 8:
        frame[udp + 6 : udp + 8] = b"\0\0"
    return frame


class Way:
    """The frames on their way from one port to the other."""

    def __init__(self, source, target, line, seed):
        self.source, self.target, self.line = source, target, line
        self.random = random.Random(seed)
        self.frames = deque()

    def receive(self, now):
        while True:
            try:
                frame, address = self.source.recvfrom(65536)
            except BlockingIOError:
                return
            except OSError:
                return  # the link is down
            if address[2] != socket.PACKET_OUTGOING and self.random.random() >= self.line.loss:
                self.frames.append((now + self.line.delay_ms / 1000, without_checksum(bytearray(frame))))

    def deliver(self, now):
        while self.frames and self.frames[0][0] <= now:
            try:
                self.target.send(self.frames.popleft()[1])
            except OSError:
                pass  # no room, or the link is down: lost, as on a real line


def port(name):
    opened = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ALL_PROTOCOLS))
    opened.bind((name, 0))
    opened.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 64 << 20)
    opened.setblocking(False)
    return opened


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("ports", nargs=2)
    arguments.add_argument("--delay-ms", type=float, default=0)
    arguments.add_argument("--loss", type=float, default=0)
    arguments.add_argument("--seed", type=int, default=1)
    line = arguments.parse_args()
    one, two = map(port, line.ports)
    ways = [Way(one, two, line, line.seed), Way(two, one, line, line.seed + 1)]
    print("ready", flush=True)
    while True:
        due = [way.frames[0][0] for way in ways if way.frames]
        timeout = max(0.0, min(due) - time.monotonic()) if due else None
        select.select([one, two], [], [], timeout)
        for way in ways:
            way.receive(time.monotonic())
            way.deliver(time.monotonic())


main()
