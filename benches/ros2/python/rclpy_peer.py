"""One end of a pair on rclpy."""

import array
import json
import time

import peer
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import UInt8MultiArray

QOS = QoSProfile(depth=100)


def ping(node, options):
    publisher = node.create_publisher(UInt8MultiArray, "ping", QOS)
    pinger = peer.Pinger(options, lambda data: publisher.publish(UInt8MultiArray(data=array.array("B", data))))
    subscription = node.create_subscription(
        UInt8MultiArray, "pong", lambda pong: pinger.take(pong.data[:8].tobytes()), QOS
    )
    peer.wait_for(lambda: publisher.get_subscription_count() and node.count_publishers(subscription.topic_name))
    pinger.start()
    while not pinger.is_over():
        rclpy.spin_once(node, timeout_sec=0.01)
    pinger.report()


def echo(node, options):
    publisher = node.create_publisher(UInt8MultiArray, "pong", QOS)

    def answer(message):
        if options.role == "acknowledge":
            message.data = message.data[:8]
        publisher.publish(message)

    node.create_subscription(UInt8MultiArray, "ping", answer, QOS)
    ended = peer.end_of_input()
    while not ended.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)


def count(node, options):
    """Prints the number of received messages, once nothing more is sent."""
    heard = set()
    reliability = ReliabilityPolicy.BEST_EFFORT if options.best_effort else ReliabilityPolicy.RELIABLE
    take = lambda message: heard.add(message.data[:8].tobytes())
    node.create_subscription(UInt8MultiArray, "ping", take, QoSProfile(depth=10, reliability=reliability))
    ended = peer.end_of_input()
    while not ended.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)
    print(len(heard), flush=True)


def joint_states(node, options):
    """Measures how old joint states are."""
    ages = peer.Ages()
    node.create_subscription(JointState, "joint_states", lambda message: ages.take(message.header.stamp), 10)
    ended = peer.end_of_input()
    while not ended.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)
    ages.report()


LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def latch(node, options):
    """Offers a latched sample and a subscription."""
    publisher = node.create_publisher(UInt8MultiArray, "latched", LATCHED)
    publisher.publish(UInt8MultiArray(data=array.array("B", bytes(options.size))))
    node.create_subscription(UInt8MultiArray, "ping", lambda _: None, 10)
    ended = peer.end_of_input()
    while not ended.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)


def late(node, options):
    """Measures how long it takes to discover the process that offers a latched sample, since `options.start`."""
    times = {}
    elapsed = lambda: 1e3 * (time.perf_counter() - options.start)
    take = lambda _: times.setdefault("latched_ms", elapsed())
    publisher = node.create_publisher(UInt8MultiArray, "ping", 10)
    node.create_subscription(UInt8MultiArray, "latched", take, LATCHED)
    while len(times) < 2 and elapsed() < 20_000:
        rclpy.spin_once(node, timeout_sec=0.0002)
        if publisher.get_subscription_count():
            times.setdefault("matched_ms", elapsed())
    print(json.dumps(times), flush=True)


ROLES = {
    "ping": ping,
    "echo": echo,
    "acknowledge": echo,
    "count": count,
    "joint-states": joint_states,
    "latch": latch,
    "late": late,
}


def main():
    options = peer.options()
    options.start = time.perf_counter()
    rclpy.init()
    node = rclpy.create_node(f"rclpy_{options.role.replace('-', '_')}")
    ROLES[options.role](node, options)
    node.destroy_node()
    rclpy.shutdown()


main()
