"""Streams the messages of an MCAP file that may have no end, and prints their number and the last log time.

Usage: stream_bag.py FILE
"""

import json
import sys

from mcap.exceptions import McapError
from mcap.records import Message
from mcap.stream_reader import StreamReader

count, last = 0, 0
with open(sys.argv[1], "rb") as stream:
    try:
        for record in StreamReader(stream).records:
            if isinstance(record, Message):
                count, last = count + 1, max(last, record.log_time)
    except McapError:
        pass  # the missing end, as expected
print(json.dumps({"messages": count, "last_log_time": last}))
