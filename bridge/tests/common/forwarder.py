"""A line between two network interfaces that delays every frame, loses some and carries so many at a time: the kernel of a test machine may lack netem.

    forwarder.py PORT PORT --delay-ms 20 --loss 0.02 --seed 1

Prints `ready` when frames pass. Both directions have their own loss; a seed gives the same losses again for the same frames.
"""

import argparse
import random
import select
import socket
import time
from collections import deque

ALL_PROTOCOLS = 0x0003
SO_RCVBUFFORCE = 33
SOL_PACKET, PACKET_VNET_HDR = 263, 15
VNET_HEADER = 10  # before each frame: says which checksum the sender of a virtual interface left to the next
MOST_WAITING = 256_000  # bytes


class Way:
    """The frames on their way from one port to the other."""

    def __init__(self, source, target, line, seed):
        self.source, self.target, self.line = source, target, line
        self.random = random.Random(seed)
        self.frames = deque()
        self.free_at = 0.0  # when the last frame that waits is sent

    def receive(self, now):
        while True:
            try:
                frame, address = self.source.recvfrom(65536)
            except BlockingIOError:
                return
            except OSError:
                return  # the link is down
            if address[2] != socket.PACKET_OUTGOING and self.random.random() >= self.line.loss:
                self.send(now, frame)

    def send(self, now, frame):
        at = now
        if self.line.mbit_per_s:
            second = self.line.mbit_per_s * 1e6 / 8
            at = max(now, self.free_at)
            if (at - now) * second > MOST_WAITING:
                return
            self.free_at = at = at + (len(frame) - VNET_HEADER) / second
        self.frames.append((at + self.line.delay_ms / 1000, frame))

    def deliver(self, now):
        while self.frames and self.frames[0][0] <= now:
            try:
                self.target.send(self.frames.popleft()[1])
            except OSError:
                pass  # no room, or the link is down: lost, as on a real line


def port(name):
    opened = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ALL_PROTOCOLS))
    opened.setsockopt(SOL_PACKET, PACKET_VNET_HDR, 1)
    opened.bind((name, 0))
    opened.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 64 << 20)
    opened.setblocking(False)
    return opened


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("ports", nargs=2)
    arguments.add_argument("--delay-ms", type=float, default=0)
    arguments.add_argument("--loss", type=float, default=0)
    arguments.add_argument("--mbit-per-s", type=float)
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
