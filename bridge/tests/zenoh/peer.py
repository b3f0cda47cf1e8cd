"""A Zenoh router that speaks as rmw_zenoh_cpp does: a line of JSON on standard input for each thing to do, one on standard output for
each thing that happens. Usage: peer.py PORT [COMPRESSION]"""

import json
import struct
import sys
import threading
import time

import zenoh
from zenoh import ext

config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{sys.argv[1]}"]')
config.insert_json5("scouting/multicast/enabled", "false")
config.insert_json5("timestamping/enabled", "true")
config.insert_json5("transport/unicast/compression/enabled", (sys.argv[2:] or ["false"])[0])
session = zenoh.open(config)
kept = []
lock = threading.Lock()


def say(**what):
    with lock:
        print(json.dumps(what), flush=True)


def hexadecimal(data):
    return None if data is None else bytes(data).hex()


def sample(found):
    say(
        kind="sample",
        key=str(found.key_expr),
        payload=hexadecimal(found.payload),
        attachment=hexadecimal(found.attachment),
        congestion=str(found.congestion_control).split(".")[-1],
        priority=str(found.priority).split(".")[-1],
        express=found.express,
        encoding=str(found.encoding),
        has_time=found.timestamp is not None,
    )


def attachment(number, gid="11" * 16):
    return struct.pack("<qq", number, time.time_ns()) + bytes([16]) + bytes.fromhex(gid)


def serve(key, reply, complete=True, lost=0):
    """Does not answer the first queries, as if they had found no way."""
    left = [lost]

    def answer(query):
        if left[0] > 0:
            left[0] -= 1
            return
        say(kind="query", key=str(query.key_expr), payload=hexadecimal(query.payload), attachment=hexadecimal(query.attachment))
        asked = bytes(query.attachment)
        query.reply(key, bytes.fromhex(reply), attachment=asked[:8] + struct.pack("<q", time.time_ns()) + asked[16:])

    kept.append(session.declare_queryable(key, answer, complete=complete))


def get(key, payload, number, is_bare=False):
    """Without payload and attachment if bare."""

    def run():
        start = time.time()
        bare = {} if is_bare else dict(payload=bytes.fromhex(payload), attachment=attachment(number))
        replies = session.get(key, target=zenoh.QueryTarget.ALL_COMPLETE, consolidation=zenoh.ConsolidationMode.NONE, timeout=20.0, **bare)
        found = [
            dict(key=str(reply.ok.key_expr), payload=hexadecimal(reply.ok.payload), attachment=hexadecimal(reply.ok.attachment))
            for reply in replies
            if reply.ok
        ]
        say(kind="replies", replies=found, seconds=time.time() - start)

    threading.Thread(target=run, daemon=True).start()


def latched_publisher(key, payloads):
    publisher = ext.declare_advanced_publisher(
        session,
        key,
        cache=ext.CacheConfig(max_samples=len(payloads)),
        sample_miss_detection=ext.MissDetectionConfig(sporadic_heartbeat=0.5),
        publisher_detection=True,
    )
    for number, payload in enumerate(payloads, 1):
        publisher.put(bytes.fromhex(payload), attachment=attachment(number))
    kept.append(publisher)


def latched_subscription(key, depth):
    history = ext.HistoryConfig(detect_late_publishers=True, max_samples=depth)
    subscriber = ext.declare_advanced_subscriber(session, key, sample, history=history, subscriber_detection=True)
    kept.append(subscriber)


def tokens(key):
    say(kind="tokens", tokens=sorted(str(reply.ok.key_expr) for reply in session.liveliness().get(key, timeout=10.0) if reply.ok))


def act(do, **more):
    if do == "tokens":
        tokens(**more)
    elif do == "subscribe":
        kept.append(session.declare_subscriber(more["key"], sample))
    elif do == "ignore":
        kept.append(session.declare_subscriber(more["key"], lambda found: None))
    elif do == "put":
        bare = {} if more.get("attachment") == "none" else dict(attachment=bytes.fromhex(more["attachment"]) if "attachment" in more else attachment(more["number"]))
        session.put(more["key"], bytes.fromhex(more["payload"]), **bare)
    elif do == "announce":
        kept.append(session.liveliness().declare_token(more["token"]))
    else:
        {"serve": serve, "get": get, "latched_publisher": latched_publisher, "latched_subscription": latched_subscription}[do](**more)
    say(kind="done")


say(kind="ready", id=str(session.zid()))
for line in sys.stdin:
    act(**json.loads(line))
