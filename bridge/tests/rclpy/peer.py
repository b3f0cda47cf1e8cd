"""A node of the real rclpy that executes commands: one JSON command per line in, one JSON answer per line out.

It ends when its standard input closes.
"""

import importlib
import json
import math
import os
import re
import sys
import threading
import time

import rclpy
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import NodeNameNonExistentError
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from actions import Actions

sys.path.append(os.path.join(os.path.dirname(__file__), "..", "common"))
from texts import number_of, text_of  # noqa: E402, of the folder beside


def message_class(type_name):
    package, kind, name = type_name.split("/")
    if kind == "srv" and name.endswith("_Event"):
        # As `ros2 service echo` finds it.
        return message_class(type_name.removesuffix("_Event")).Event
    return getattr(importlib.import_module(f"{package}.{kind}"), name)


def profile(qos):
    more = {}
    if "deadline_ms" in qos:
        more["deadline"] = Duration(nanoseconds=qos["deadline_ms"] * 1_000_000)
    if "lease_ms" in qos:
        more["liveliness_lease_duration"] = Duration(nanoseconds=qos["lease_ms"] * 1_000_000)
    return QoSProfile(
        **more,
        liveliness=LivelinessPolicy[qos.get("liveliness", "automatic").upper()],
        depth=qos.get("depth", 10),
        reliability=ReliabilityPolicy[qos.get("reliability", "reliable").upper()],
        durability=DurabilityPolicy[qos.get("durability", "volatile").upper()],
    )


def fill(message, fields):
    for name, value in fields.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            package, kind = re.match(r"sequence<(\w+)/(\w+)", message.get_fields_and_field_types()[name]).groups()
            element = message_class(f"{package}/msg/{kind}")
            setattr(message, name, [fill(element(), item) for item in value])
        else:
            setattr(message, name, value)
    return message


def fields_of(message):
    if hasattr(message, "get_fields_and_field_types"):
        return {name: fields_of(getattr(message, name)) for name in message.get_fields_and_field_types()}
    if hasattr(message, "tolist"):
        return fields_of(message.tolist())  # of numpy: an array, or a number of one
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


EVENT_FIELDS = ["total_count", "current_count", "alive_count", "not_alive_count"]


class Peer(Actions):
    message_class = staticmethod(message_class)
    fill = staticmethod(fill)

    def __init__(self, name):
        super().__init__()
        rclpy.init()
        self.node = rclpy.create_node(name)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.publishers = {}
        self.subscriptions = {}
        self.received = {}
        self.events = {}
        self.services = {}
        self.requests = {}
        self.clients = {}
        self.parameter_clients = {}
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

    def noting(self, topic, kinds):
        """Callbacks that note what happens to the quality of service of an endpoint."""
        noted = self.events.setdefault(topic, [])

        def note(kind):
            def on_event(info):
                values = {name: getattr(info, name) for name in EVENT_FIELDS if hasattr(info, name)}
                noted.append({"event": kind, **values})

            return on_event

        return {kind: note(kind) for kind in kinds}

    def take_events(self, topic):
        """What has happened since the last call."""
        noted = self.events[topic]
        taken = noted[:]
        del noted[: len(taken)]
        return taken

    def advertise(self, topic, type, qos={}, events=False):
        kinds = ["deadline", "liveliness", "incompatible_qos", "matched"] if events else []
        callbacks = PublisherEventCallbacks(**self.noting(topic, kinds))
        self.publishers[topic] = self.node.create_publisher(
            message_class(type), topic, profile(qos), event_callbacks=callbacks
        )

    def publish(self, topic, fields):
        publisher = self.publishers[topic]
        publisher.publish(fill(publisher.msg_type(), fields))

    def matched(self, topic):
        if topic in self.publishers:
            return self.publishers[topic].get_subscription_count()
        return self.node.count_publishers(topic)

    def subscribe(self, topic, type, qos={}, events=False):
        received = self.received.setdefault(topic, [])
        kinds = ["deadline", "liveliness", "message_lost", "incompatible_qos", "matched"] if events else []
        callbacks = SubscriptionEventCallbacks(**self.noting(topic, kinds))
        kind = message_class(type)

        def on_message(cdr):
            message = deserialize_message(cdr, kind)
            received.append({"cdr": bytes(cdr).hex(), "fields": fields_of(message)})

        self.subscriptions[topic] = self.node.create_subscription(
            kind, topic, on_message, profile(qos), raw=True, event_callbacks=callbacks
        )

    def publish_texts(self, topic, size, count, first=0, period_ms=0):
        """Texts with the numbers from `first` on."""
        publisher = self.publishers[topic]
        for number in range(first, first + count):
            publisher.publish(publisher.msg_type(data=text_of(number, size)))
            time.sleep(period_ms / 1000)

    def subscribe_texts(self, topic, qos={}):
        """As `subscribe`, of texts of which only number and size are noted."""
        received = self.received.setdefault(topic, [])
        self.subscriptions[topic] = self.node.create_subscription(
            message_class("std_msgs/msg/String"),
            topic,
            lambda message: received.append(number_of(message.data)),
            profile(qos),
        )

    def stop(self, topic):
        """Removes the endpoints of a topic."""
        if topic in self.publishers:
            self.node.destroy_publisher(self.publishers.pop(topic))
        if topic in self.subscriptions:
            self.node.destroy_subscription(self.subscriptions.pop(topic))

    def second_node(self, name, topic):
        """Another node of this process, with a publisher; without a topic it goes."""
        if topic is None:
            self.other.destroy_node()
        else:
            self.other = rclpy.create_node(name)
            self.other.create_publisher(message_class("std_msgs/msg/String"), topic, 10)

    def many(self, count, type):
        """Publishers on /theirs_0, /theirs_1, … and subscriptions on /ours_0, …"""
        for number in range(count):
            self.advertise(f"/theirs_{number}", type)
            self.subscribe_texts(f"/ours_{number}")

    def publish_on_all(self, size):
        for topic in self.publishers:
            self.publish_texts(topic, size, 1)

    def take_from_all(self):
        """How many messages have been received since the last call, by topic."""
        return {topic: len(self.take(topic)) for topic in self.received}

    def type_hashes(self, topic):
        """Of the publishers and the subscriptions of a topic, as `ros2 topic info -v` prints them."""
        infos = self.node.get_publishers_info_by_topic(topic) + self.node.get_subscriptions_info_by_topic(topic)
        return [str(info.topic_type_hash) for info in infos]

    def serve(self, service, type, suffix="", qos={}):
        """A server of std_srvs/srv/SetBool or sensor_msgs/srv/SetCameraInfo that answers with what it was asked."""

        def on_request(request, response):
            self.requests.setdefault(service, []).append(fields_of(request))
            if hasattr(request, "camera_info"):
                response.status_message = request.camera_info.distortion_model
            else:
                response.success = request.data
                response.message = f"data is {request.data}{suffix}"
            return response

        kind = message_class(type)
        self.services[service] = self.node.create_service(kind, service, on_request, qos_profile=profile(qos))

    def requests_to(self, service):
        """What a server of ours was asked."""
        return self.requests.get(service, [])

    def client(self, service, type, qos={}):
        self.clients[service] = self.node.create_client(message_class(type), service, qos_profile=profile(qos))

    def is_available(self, service):
        return self.clients[service].service_is_ready()

    def wait_for_service(self, service):
        return self.clients[service].wait_for_service(timeout_sec=20.0)

    def call(self, service, requests):
        """All requests at once; the answers in their order, nothing for those without an answer in 20 s."""
        client = self.clients[service]
        futures = [client.call_async(fill(client.srv_type.Request(), request)) for request in requests]
        done = threading.Semaphore(0)
        for future in futures:
            future.add_done_callback(lambda _: done.release())
        deadline = time.monotonic() + 20.0
        for _ in futures:
            done.acquire(timeout=max(0.0, deadline - time.monotonic()))
        return [fields_of(future.result()) if future.done() else None for future in futures]

    def parameters(self, node, call, argument):
        """What `ros2 param` calls, through rclpy's client: the answer, or nothing in 20 s."""
        client = self.parameter_clients.get(node)
        if client is None:
            client = self.parameter_clients[node] = AsyncParameterClient(self.node, node)
        if not client.wait_for_services(timeout_sec=20.0):
            return "no services"
        if call.startswith("set"):
            argument = [Parameter(name, value=value) for name, value in argument.items()]
        done = threading.Event()
        future = getattr(client, call)(argument, callback=lambda _: done.set())
        return fields_of(future.result()) if done.wait(20.0) else None

    def services_and_types(self):
        return dict(self.node.get_service_names_and_types())

    def services_of(self, node, namespace):
        return self.by_node(self.node.get_service_names_and_types_by_node, node, namespace)

    def clients_of(self, node, namespace):
        return self.by_node(self.node.get_client_names_and_types_by_node, node, namespace)

    def by_node(self, get, node, namespace):
        try:
            return dict(get(node, namespace))
        except NodeNameNonExistentError:
            return {}

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
