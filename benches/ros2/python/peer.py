"""Common code of the Python ends of a pair: their options, and the end that sends and waits for answers."""

import argparse
import json
import sys
import threading
import time

ROLES = ["ping", "echo", "acknowledge", "count", "camera", "latch", "late", "joint-states"]
PATIENCE = 2.0
"""How long a message may be in flight before it counts as lost, in seconds."""


def options():
    parser = argparse.ArgumentParser()
    parser.add_argument("--role", choices=ROLES, required=True)
    parser.add_argument("--size", type=int, default=100)
    parser.add_argument("--window", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--best-effort", action="store_true")
    parser.add_argument("--hz", type=float, default=30.0)
    parser.add_argument("--messages", type=int, default=300)
    return parser.parse_args()


def wait_for(matched):
    end = time.monotonic() + 20
    while not matched():
        if time.monotonic() > end:
            sys.exit("no peer within 20 s")
        time.sleep(0.02)
    time.sleep(0.5)  # one end may not have discovered the other yet


def end_of_input():
    """An event that is set when the input ends."""
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    return ended


def quantile_us(sorted_seconds, part):
    if not sorted_seconds:
        return 0.0
    return sorted_seconds[min(int(len(sorted_seconds) * part), len(sorted_seconds) - 1)] * 1e6


class Ages:
    """How old messages are when they arrive, by the clock that all processes of this machine share."""

    def __init__(self):
        self.ages = []

    def take(self, stamp):
        self.ages.append(time.time() - stamp.sec - stamp.nanosec * 1e-9)

    def report(self):
        self.ages.sort()
        p50, p99 = (quantile_us(self.ages, part) for part in (0.5, 0.99))
        print(json.dumps({"messages": len(self.ages), "p50_us": p50, "p99_us": p99}), flush=True)


class Pinger:
    """Keeps a window of messages in flight. `publish` sends the given bytes."""

    def __init__(self, options, publish):
        self.options, self.publish = options, publish
        self.rest = b"\x5a" * max(0, options.size - 8)
        self.lock = threading.RLock()
        self.under_way, self.times = {}, []
        self.next, self.lost, self.started, self.last = 1, 0, None, None

    def start(self):
        print("go", flush=True)
        with self.lock:
            self.started = time.perf_counter()
            self.send()

    def is_over(self):
        """Returns whether all messages are sent and either answered or lost. Must be called often, because it detects losses."""
        with self.lock:
            now = time.perf_counter()
            late = [number for number, sent in self.under_way.items() if now - sent > PATIENCE]
            for number in late:
                del self.under_way[number]
            self.lost += len(late)
            self.send()
            return now - self.started >= self.options.seconds and not self.under_way

    def send(self):
        while len(self.under_way) < self.options.window:
            if time.perf_counter() - self.started >= self.options.seconds:
                return
            number, self.next = self.next, self.next + 1
            self.under_way[number] = time.perf_counter()
            self.publish(number.to_bytes(8, "little") + self.rest)

    def take(self, first_bytes):
        with self.lock:
            sent = self.under_way.pop(int.from_bytes(first_bytes, "little"), None)
            if sent is not None:
                self.last = time.perf_counter()
                self.times.append(self.last - sent)
            if self.started is not None:
                self.send()

    def report(self):
        self.times.sort()
        outcome = {
            "messages": len(self.times),
            "lost": self.lost,
            "seconds": self.last - self.started if self.times else 0.0,
            "p50_us": quantile_us(self.times, 0.5),
            "p99_us": quantile_us(self.times, 0.99),
        }
        print(json.dumps(outcome), flush=True)
