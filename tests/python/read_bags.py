"""Reads bags with mcap and prints the number of messages of each.

Usage: read_bags.py FOLDER. Each bag in the folder is a directory with MCAP files. Anything that is not as it should be
raises.
"""

import json
import sys
from pathlib import Path

from mcap.reader import make_reader

counts = {}
for bag in sorted(Path(sys.argv[1]).iterdir()):
    count = 0
    for path in sorted(bag.glob("*.mcap")):
        with path.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            count += sum(1 for _ in reader.iter_messages())
            statistics = reader.get_summary().statistics
            assert statistics is not None, path
    counts[bag.name] = count
print(json.dumps(counts))
