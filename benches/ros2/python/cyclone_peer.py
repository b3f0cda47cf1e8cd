"""One end of a pair on Cyclone DDS."""

import os
import time
from dataclasses import dataclass

import peer
from cyclonedds.core import Listener, Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration


@dataclass
class Dimension(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayDimension_"):
    label: str
    size: uint32
    stride: uint32


@dataclass
class Layout(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayLayout_"):
    dim: sequence[Dimension]
    data_offset: uint32


@dataclass
class Bytes(IdlStruct, typename="std_msgs::msg::dds_::UInt8MultiArray_"):
    layout: Layout
    data: sequence[uint8]


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


LAYOUT = Layout(dim=[], data_offset=0)
QOS = Qos(
    Policy.Reliability.Reliable(max_blocking_time=duration(seconds=1)),
    Policy.Durability.Volatile,
    Policy.History.KeepLast(100),
)


class Arrivals(Listener):
    def __init__(self, take):
        super().__init__()
        self.take = take

    def on_data_available(self, reader):
        for sample in reader.take(N=100):
            if isinstance(sample, (Bytes, JointState)):
                self.take(sample)


def writer_of(participant, topic):
    return DataWriter(participant, Topic(participant, topic, Bytes), qos=QOS)


def reader_of(participant, topic, take):
    return DataReader(participant, Topic(participant, topic, Bytes), qos=QOS, listener=Arrivals(take))


def ping(participant, options):
    writer = writer_of(participant, "rt/ping")
    pinger = peer.Pinger(options, lambda data: writer.write(Bytes(layout=LAYOUT, data=data)))
    reader = reader_of(participant, "rt/pong", lambda pong: pinger.take(bytes(pong.data[:8])))
    peer.wait_for(lambda: writer.get_matched_subscriptions() and reader.get_matched_publications())
    pinger.start()
    while not pinger.is_over():
        time.sleep(0.01)
    pinger.report()


def echo(participant, options):
    writer = writer_of(participant, "rt/pong")

    def answer(sample):
        if options.role == "acknowledge":
            sample.data = sample.data[:8]
        writer.write(sample)

    reader = reader_of(participant, "rt/ping", answer)
    peer.end_of_input().wait()
    del reader


def camera(participant, options):
    """Sends numbered messages at a constant rate, best effort, and prints "go" when all are sent."""
    qos = Qos(Policy.Reliability.BestEffort, Policy.Durability.Volatile, Policy.History.KeepLast(10))
    writer = DataWriter(participant, Topic(participant, "rt/ping", Bytes), qos=qos)
    peer.wait_for(writer.get_matched_subscriptions)
    rest = b"\x5a" * (options.size - 8)
    start = time.monotonic()
    for number in range(options.messages):
        time.sleep(max(0.0, start + number / options.hz - time.monotonic()))
        writer.write(Bytes(layout=LAYOUT, data=number.to_bytes(8, "little") + rest))
    print("go", flush=True)
    peer.end_of_input().wait()


def joint_states(participant, options):
    """Measures how old joint states are."""
    ages = peer.Ages()
    topic = Topic(participant, "rt/joint_states", JointState)
    listener = Arrivals(lambda sample: ages.take(sample.header.stamp))
    reader = DataReader(participant, topic, qos=QOS, listener=listener)
    peer.end_of_input().wait()
    del reader
    ages.report()


ROLES = {"ping": ping, "echo": echo, "acknowledge": echo, "camera": camera, "joint-states": joint_states}


def main():
    options = peer.options()
    participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
    ROLES[options.role](participant, options)


main()
