"""Prints the packets that dynamixel-sdk sends for the instructions in a JSON file, as hexadecimal digits.

Each instruction is [protocol, name, arguments...]. Prints null if dynamixel-sdk is not installed.
"""

import json
import sys

try:
    import dynamixel_sdk
except ImportError:
    print("null")
    sys.exit()


class Port:
    """Replaces a serial port: keeps the sent bytes, and never answers."""

    is_using = False

    def __init__(self):
        self.sent = b""

    def clearPort(self):
        pass

    def writePort(self, packet):
        self.sent += bytes(packet)
        return len(packet)

    def readPort(self, _length):
        return b""

    def setPacketTimeout(self, _length):
        pass

    def setPacketTimeoutMillis(self, _time):
        pass

    def isPacketTimeout(self):
        return True


def packet(protocol, name, *arguments):
    handler, port = dynamixel_sdk.PacketHandler(float(protocol)), Port()
    if protocol == 2:
        # dynamixel-sdk 4.1.0 computes the stuffed packet, and then sends the one without it.
        stuff = handler.addStuffing

        def stuff_in_place(sent):
            sent[:] = stuff(list(sent))

        handler.addStuffing = stuff_in_place
    calls = {
        "ping": handler.ping,
        "read": handler.readTx,
        "write": lambda p, i, a, d: handler.writeTxOnly(p, i, a, len(d), d),
        "reg_write": lambda p, i, a, d: handler.regWriteTxOnly(p, i, a, len(d), d),
        "action": handler.action,
        "reboot": getattr(handler, "reboot", None),
        "sync_write": lambda p, a, n, d: handler.syncWriteTxOnly(p, a, n, d, len(d)),
        "sync_read": lambda p, a, n, d: handler.syncReadTx(p, a, n, d, len(d), False),
        "fast_sync_read": lambda p, a, n, d: handler.syncReadTx(p, a, n, d, len(d), True),
        "bulk_read": lambda p, d: handler.bulkReadTx(p, d, len(d), *([False] if protocol == 2 else [])),
        "fast_bulk_read": lambda p, d: handler.bulkReadTx(p, d, len(d), True),
        "bulk_write": lambda p, d: handler.bulkWriteTxOnly(p, d, len(d)),
    }
    calls[name](port, *arguments)
    return port.sent.hex()


with open(sys.argv[1]) as instructions:
    print(json.dumps([packet(*instruction) for instruction in json.load(instructions)]))
