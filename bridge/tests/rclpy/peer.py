"""A ROS 2 node of the real rclpy that does what it is told: one JSON command a line in, one JSON answer a line out.

It ends when its standard input closes.
"""

import importlib
import json
import math
import sys
import threading

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message


def message_class(type_name):
    package, kind, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), name)


def profile(qos):
    return QoSProfile(
        depth=qos.get("depth", 10),
        reliability=ReliabilityPolicy[qos.get("reliability", "reliable").upper()],
        durability=DurabilityPolicy[qos.get("durability", "volatile").upper()],
    )


def fill(message, fields):
    for name, value in fields.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        else:
            setattr(message, name, value)
    return message


def fields_of(message):
    if hasattr(message, "get_fields_and_field_types"):
        return {name: fields_of(getattr(message, name)) for name in message.get_fields_and_field_types()}
    if isinstance(message, float) and not math.isfinite(message):
        return None  # JSON has no other word for it
    if isinstance(message, (str, bool, int, float)):
        return message
    return [fields_of(item) for item in message]


def endpoint_of(info):
    return {
        "node": info.node_namespace.rstrip("/") + "/" + info.node_name,
        "type": info.topic_type,
        "reliability": info.qos_profile.reliability.name,
        "durability": info.qos_profile.durability.name,
    }


class Peer:
    def __init__(self, name):
        rclpy.init()
        self.node = rclpy.create_node(name)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.publishers = {}
        self.subscriptions = {}
        self.received = {}
        self.thread = threading.Thread(target=self.executor.spin)
        self.thread.start()

    def close(self):
        self.executor.shutdown()
        self.thread.join()
        self.node.destroy_node()
        rclpy.shutdown()

    def nodes(self):
        return [space.rstrip("/") + "/" + name for name, space in self.node.get_node_names_and_namespaces()]

    def topics(self):
        return dict(self.node.get_topic_names_and_types())

    def publishers_of(self, topic):
        return [endpoint_of(info) for info in self.node.get_publishers_info_by_topic(topic)]

    def published_by(self, node, namespace="/"):
        """What `ros2 node info` lists."""
        return dict(self.node.get_publisher_names_and_types_by_node(node, namespace))

    def subscriptions_of(self, topic):
        return [endpoint_of(info) for info in self.node.get_subscriptions_info_by_topic(topic)]

    def advertise(self, topic, type, qos={}):
        self.publishers[topic] = self.node.create_publisher(message_class(type), topic, profile(qos))

    def publish(self, topic, fields):
        publisher = self.publishers[topic]
        publisher.publish(fill(publisher.msg_type(), fields))

    def matched(self, topic):
        if topic in self.publishers:
            return self.publishers[topic].get_subscription_count()
        return self.node.count_publishers(topic)

    def subscribe(self, topic, type, qos={}):
        received = self.received.setdefault(topic, [])
        kind = message_class(type)

        def on_message(cdr):
            message = deserialize_message(cdr, kind)
            received.append({"cdr": bytes(cdr).hex(), "fields": fields_of(message)})

        self.subscriptions[topic] = self.node.create_subscription(kind, topic, on_message, profile(qos), raw=True)

    def take(self, topic):
        """What has been received since the last call."""
        received = self.received[topic]
        taken = received[:]
        del received[: len(taken)]
        return taken


def main():
    peer = Peer(sys.argv[1])
    print(json.dumps("ready"), flush=True)
    for line in sys.stdin:
        command = json.loads(line)
        answer = getattr(peer, command.pop("do"))(**command)
        print(json.dumps(answer), flush=True)
    peer.close()


main()
