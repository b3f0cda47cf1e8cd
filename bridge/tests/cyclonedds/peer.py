"""A participant of Cyclone DDS that executes commands, like `../rclpy/peer.py`: the second vendor of DDS.

Topics and types are named as ROS 2 names them; what they are on the wire is done here.
"""

import json
import os
import sys
import time
from dataclasses import dataclass, fields, is_dataclass

# On loopback, unless the test says otherwise.
os.environ.setdefault("CYCLONEDDS_URI", """<CycloneDDS><Domain id="any">
  <General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces><AllowMulticast>false</AllowMulticast></General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>
    <Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>""")

sys.path.append(os.path.join(os.path.dirname(__file__), "..", "common"))

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription  # noqa: E402
from cyclonedds.core import InstanceState, Policy, Qos  # noqa: E402, it reads the variable
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.idl import IdlStruct, types  # noqa: E402
from cyclonedds.pub import DataWriter  # noqa: E402
from cyclonedds.sub import DataReader  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402
from cyclonedds.util import duration  # noqa: E402
from texts import number_of, text_of  # noqa: E402


@dataclass
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str = ""


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: types.int32 = 0
    nanosec: types.uint32 = 0


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str = ""


@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header
    name: types.sequence[str]
    position: types.sequence[types.float64]
    velocity: types.sequence[types.float64]
    effort: types.sequence[types.float64]


@dataclass
class CompressedImage(IdlStruct, typename="sensor_msgs::msg::dds_::CompressedImage_"):
    header: Header
    format: str
    data: types.sequence[types.uint8]


@dataclass
class Leg(IdlStruct, typename="legs::msg::dds_::Leg_"):
    angles: types.sequence[types.float64]
    name: str = ""


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: types.float64
    y: types.float64
    z: types.float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: types.float64
    y: types.float64
    z: types.float64
    w: types.float64


@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: types.sequence[TransformStamped]


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
class Duration(IdlStruct, typename="builtin_interfaces::msg::dds_::Duration_"):
    sec: types.int32 = 0
    nanosec: types.uint32 = 0


@dataclass
class JointTrajectoryPoint(IdlStruct, typename="trajectory_msgs::msg::dds_::JointTrajectoryPoint_"):
    positions: types.sequence[types.float64]
    velocities: types.sequence[types.float64]
    accelerations: types.sequence[types.float64]
    effort: types.sequence[types.float64]
    time_from_start: Duration


@dataclass
class MultiDOFJointTrajectoryPoint(IdlStruct, typename="trajectory_msgs::msg::dds_::MultiDOFJointTrajectoryPoint_"):
    transforms: types.sequence[Transform]
    velocities: types.sequence[Twist]
    accelerations: types.sequence[Twist]
    time_from_start: Duration


@dataclass
class JointTrajectoryControllerState(
    IdlStruct, typename="control_msgs::msg::dds_::JointTrajectoryControllerState_"
):
    header: Header
    joint_names: types.sequence[str]
    reference: JointTrajectoryPoint
    feedback: JointTrajectoryPoint
    error: JointTrajectoryPoint
    output: JointTrajectoryPoint
    multi_dof_joint_names: types.sequence[str]
    multi_dof_reference: MultiDOFJointTrajectoryPoint
    multi_dof_feedback: MultiDOFJointTrajectoryPoint
    multi_dof_error: MultiDOFJointTrajectoryPoint
    multi_dof_output: MultiDOFJointTrajectoryPoint
    speed_scaling_factor: types.float64


@dataclass
class InterfaceValue(IdlStruct, typename="control_msgs::msg::dds_::InterfaceValue_"):
    interface_names: types.sequence[str]
    values: types.sequence[types.float64]


@dataclass
class DynamicJointState(IdlStruct, typename="control_msgs::msg::dds_::DynamicJointState_"):
    header: Header
    joint_names: types.sequence[str]
    interface_values: types.sequence[InterfaceValue]


@dataclass
class Status(IdlStruct, typename="bond::msg::dds_::Status_"):
    header: Header
    id: str
    instance_id: str
    active: bool
    heartbeat_timeout: types.float32
    heartbeat_period: types.float32


# The elements of lists, by field.
ELEMENTS = {"transforms": TransformStamped}

# Requests and responses as rmw_cyclonedds has them: in front of each who asks, and the number of the request
# (`cdds_request_header_t` in `rmw_cyclonedds_cpp/src/serdata.hpp`, branch jazzy).


@dataclass
class SetBoolRequest(IdlStruct, typename="std_srvs::srv::dds_::SetBool_Request_"):
    guid: types.uint64 = 0
    seq: types.int64 = 0
    data: bool = False


@dataclass
class SetBoolResponse(IdlStruct, typename="std_srvs::srv::dds_::SetBool_Response_"):
    guid: types.uint64 = 0
    seq: types.int64 = 0
    success: bool = False
    message: str = ""


@dataclass
class Resource(IdlStruct, typename="simulation_interfaces::msg::dds_::Resource_"):
    uri: str = ""
    resource_string: str = ""


@dataclass
class Outcome(IdlStruct, typename="simulation_interfaces::msg::dds_::Result_"):
    result: types.uint8 = 0
    error_message: str = ""


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Vector3
    orientation: Quaternion


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    header: Header
    pose: Pose


@dataclass
class SpawnEntityRequest(IdlStruct, typename="simulation_interfaces::srv::dds_::SpawnEntity_Request_"):
    guid: types.uint64
    seq: types.int64
    name: str
    allow_renaming: bool
    uri: str
    resource_string: str
    entity_namespace: str
    initial_pose: PoseStamped


@dataclass
class SpawnEntityRequest2(IdlStruct, typename="simulation_interfaces::srv::dds_::SpawnEntity_Request_"):
    """Of version 2.1."""

    guid: types.uint64
    seq: types.int64
    name: str
    allow_renaming: bool
    entity_resource: Resource
    entity_namespace: str
    initial_pose: PoseStamped


@dataclass
class SpawnEntityResponse(IdlStruct, typename="simulation_interfaces::srv::dds_::SpawnEntity_Response_"):
    guid: types.uint64
    seq: types.int64
    result: Outcome
    entity_name: str


@dataclass
class DeleteEntityRequest(IdlStruct, typename="simulation_interfaces::srv::dds_::DeleteEntity_Request_"):
    guid: types.uint64
    seq: types.int64
    entity: str


@dataclass
class DeleteEntityResponse(IdlStruct, typename="simulation_interfaces::srv::dds_::DeleteEntity_Response_"):
    guid: types.uint64
    seq: types.int64
    result: Outcome


@dataclass
class ChainConnection(IdlStruct, typename="controller_manager_msgs::msg::dds_::ChainConnection_"):
    name: str
    reference_interfaces: types.sequence[str]


@dataclass
class ControllerState(IdlStruct, typename="controller_manager_msgs::msg::dds_::ControllerState_"):
    name: str
    state: str
    type: str
    is_async: bool
    update_rate: types.uint16
    claimed_interfaces: types.sequence[str]
    required_command_interfaces: types.sequence[str]
    required_state_interfaces: types.sequence[str]
    is_chainable: bool
    is_chained: bool
    exported_state_interfaces: types.sequence[str]
    reference_interfaces: types.sequence[str]
    chain_connections: types.sequence[ChainConnection]


@dataclass
class HardwareInterface(IdlStruct, typename="controller_manager_msgs::msg::dds_::HardwareInterface_"):
    name: str
    data_type: str
    is_available: bool
    is_claimed: bool


# A request without fields has one on the wire, as rosidl makes it.


@dataclass
class ListControllersRequest(
    IdlStruct, typename="controller_manager_msgs::srv::dds_::ListControllers_Request_"
):
    guid: types.uint64
    seq: types.int64
    structure_needs_at_least_one_member: types.uint8


@dataclass
class ListControllersResponse(
    IdlStruct, typename="controller_manager_msgs::srv::dds_::ListControllers_Response_"
):
    guid: types.uint64
    seq: types.int64
    controller: types.sequence[ControllerState]


@dataclass
class ListHardwareInterfacesRequest(
    IdlStruct, typename="controller_manager_msgs::srv::dds_::ListHardwareInterfaces_Request_"
):
    guid: types.uint64
    seq: types.int64
    structure_needs_at_least_one_member: types.uint8


@dataclass
class ListHardwareInterfacesResponse(
    IdlStruct, typename="controller_manager_msgs::srv::dds_::ListHardwareInterfaces_Response_"
):
    guid: types.uint64
    seq: types.int64
    command_interfaces: types.sequence[HardwareInterface]
    state_interfaces: types.sequence[HardwareInterface]


@dataclass
class SwitchControllerRequest(
    IdlStruct, typename="controller_manager_msgs::srv::dds_::SwitchController_Request_"
):
    guid: types.uint64
    seq: types.int64
    activate_controllers: types.sequence[str]
    deactivate_controllers: types.sequence[str]
    strictness: types.int32
    activate_asap: bool
    timeout: Duration


@dataclass
class SwitchControllerResponse(
    IdlStruct, typename="controller_manager_msgs::srv::dds_::SwitchController_Response_"
):
    guid: types.uint64
    seq: types.int64
    ok: bool
    message: str


SERVICES = {
    "controller_manager_msgs/srv/ListControllers": (ListControllersRequest, ListControllersResponse),
    "controller_manager_msgs/srv/ListHardwareInterfaces": (
        ListHardwareInterfacesRequest,
        ListHardwareInterfacesResponse,
    ),
    "controller_manager_msgs/srv/SwitchController": (SwitchControllerRequest, SwitchControllerResponse),
    "simulation_interfaces/srv/SpawnEntity": (SpawnEntityRequest, SpawnEntityResponse),
    "simulation_interfaces/srv/SpawnEntity 2.1": (SpawnEntityRequest2, SpawnEntityResponse),
    "simulation_interfaces/srv/DeleteEntity": (DeleteEntityRequest, DeleteEntityResponse),
}

TYPES = {
    "bond/msg/Status": Status,
    "legs/msg/Leg": Leg,
    "tf2_msgs/msg/TFMessage": TFMessage,
    "std_msgs/msg/String": String,
    "control_msgs/msg/DynamicJointState": DynamicJointState,
    "control_msgs/msg/JointTrajectoryControllerState": JointTrajectoryControllerState,
    "sensor_msgs/msg/JointState": JointState,
    "sensor_msgs/msg/CompressedImage": CompressedImage,
}


def policies(qos):
    is_reliable = qos.get("reliability", "reliable") == "reliable"
    is_latched = qos.get("durability", "volatile") == "transient_local"
    is_whole = qos.get("history") == "keep_all"
    history = Policy.History.KeepAll if is_whole else Policy.History.KeepLast(qos.get("depth", 10))
    chosen = [
        Policy.Reliability.Reliable(duration(milliseconds=100)) if is_reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if is_latched else Policy.Durability.Volatile,
        history,
        # As rmw_cyclonedds: what late joiners get is the history.
        Policy.DurabilityService(0, history, -1, -1, -1),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    ]
    if "deadline_ms" in qos:
        chosen.append(Policy.Deadline(duration(milliseconds=qos["deadline_ms"])))
    if "lifespan_ms" in qos:
        chosen.append(Policy.Lifespan(duration(milliseconds=qos["lifespan_ms"])))
    if "lease_ms" in qos:
        lease = duration(milliseconds=qos["lease_ms"])
        is_manual = qos.get("liveliness") == "manual_by_topic"
        chosen.append(Policy.Liveliness.ManualByTopic(lease) if is_manual else Policy.Liveliness.Automatic(lease))
    return Qos(*chosen)


def message_of(kind, values):
    given = {}
    for field in fields(kind):
        value = values.get(field.name)
        nested = field.type if is_dataclass(field.type) else None
        if nested:
            given[field.name] = message_of(nested, value or {})
        elif field.name in ELEMENTS:
            given[field.name] = [message_of(ELEMENTS[field.name], item) for item in value]
        elif value is not None:
            given[field.name] = value
        else:
            given[field.name] = {"str": "", str: ""}.get(field.type, 0 if "int" in str(field.type)[:30] else [])
    return kind(**given)


def fields_of(message):
    if is_dataclass(message):
        return {field.name: fields_of(getattr(message, field.name)) for field in fields(message)}
    if isinstance(message, (bytes, bytearray)):
        return list(message)
    if isinstance(message, list):
        return [fields_of(item) for item in message]
    return message


class Peer:
    def __init__(self):
        self.participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
        self.writers = {}
        self.readers = {}
        self.services = {}
        self.clients = {}
        self.texts = set()
        self.builtin = [
            BuiltinDataReader(self.participant, topic)
            for topic in (BuiltinTopicDcpsPublication, BuiltinTopicDcpsSubscription)
        ]

    def service_topics(self, service):
        """Those of requests and of responses of std_srvs/srv/SetBool."""
        qos = policies({"depth": 100})
        return (
            Topic(self.participant, f"rq{service}Request", SetBoolRequest, qos=qos),
            Topic(self.participant, f"rr{service}Reply", SetBoolResponse, qos=qos),
            qos,
        )

    def serve(self, service):
        requests, responses, qos = self.service_topics(service)
        writer = DataWriter(self.participant, responses, qos=qos)
        self.services[service] = (DataReader(self.participant, requests, qos=qos), writer)

    def answer(self, service, suffix=""):
        """Answers what was asked since the last time; what that was."""
        reader, writer = self.services[service]
        # Of a client that has gone comes a sample without a request.
        asked = [sample for sample in reader.take(N=1000) if isinstance(sample, SetBoolRequest)]
        for request in asked:
            message = f"data is {request.data}{suffix}"
            writer.write(SetBoolResponse(request.guid, request.seq, request.data, message))
        return [request.data for request in asked]

    def client(self, service, name="client"):
        """A client knows itself by a number of its own, as the instance handle of its writer is in rmw_cyclonedds."""
        requests, responses, qos = self.service_topics(service)
        reader = DataReader(self.participant, responses, qos=qos)
        writer = DataWriter(self.participant, requests, qos=qos)
        self.clients[name] = (writer, reader, int.from_bytes(os.urandom(8), "little"))

    def is_available(self, name="client"):
        writer, reader, _ = self.clients[name]
        return len(writer.get_matched_subscriptions()) > 0 and len(reader.get_matched_publications()) > 0

    def call(self, requests, name="client"):
        """All requests at once; the answers in their order, nothing for those without an answer in 20 s."""
        writer, reader, guid = self.clients[name]
        for seq, data in enumerate(requests, 1):
            writer.write(SetBoolRequest(guid, seq, data))
        answers = {}
        deadline = time.monotonic() + 20.0
        while len(answers) < len(requests) and time.monotonic() < deadline:
            for response in reader.take(N=1000):
                # Every client reads all responses and keeps its own.
                if response.guid == guid:
                    answers.setdefault(response.seq, []).append([response.success, response.message])
            time.sleep(0.002)
        return [answers.get(seq) for seq in range(1, len(requests) + 1)]

    def request(self, service, type, fields):
        """One request of a client of its own; the response, nothing if there is none in 20 s."""
        request, response = SERVICES[type]
        qos = policies({"depth": 100})
        reader = DataReader(self.participant, Topic(self.participant, f"rr{service}Reply", response, qos=qos), qos=qos)
        writer = DataWriter(self.participant, Topic(self.participant, f"rq{service}Request", request, qos=qos), qos=qos)
        guid = int.from_bytes(os.urandom(8), "little")
        deadline = time.monotonic() + 20.0
        is_sent = False
        while time.monotonic() < deadline:
            if not is_sent and writer.get_matched_subscriptions() and reader.get_matched_publications():
                writer.write(message_of(request, {"guid": guid, "seq": 1, **fields}))
                is_sent = True
            for found in reader.take(N=100):
                if isinstance(found, response) and found.guid == guid:
                    return fields_of(found)
            time.sleep(0.002)
        return None

    def topic(self, name, type, qos):
        return Topic(self.participant, "rt" + name, TYPES[type], qos=policies(qos))

    def advertise(self, topic, type, qos={}):
        writer = DataWriter(self.participant, self.topic(topic, type, qos), qos=policies(qos))
        self.writers[topic] = (writer, TYPES[type])

    def publish(self, topic, fields):
        writer, kind = self.writers[topic]
        writer.write(message_of(kind, fields))

    def subscribe(self, topic, type, qos={}):
        self.readers[topic] = DataReader(self.participant, self.topic(topic, type, qos), qos=policies(qos))

    def publish_texts(self, topic, size, count, first=0, period_ms=0):
        """As the peer of rclpy."""
        writer, kind = self.writers[topic]
        for number in range(first, first + count):
            writer.write(kind(text_of(number, size)))
            time.sleep(period_ms / 1000)

    def subscribe_texts(self, topic, qos={}):
        self.subscribe(topic, "std_msgs/msg/String", qos)
        self.texts.add(topic)

    def endpoints(self, topic):
        """The publishers and subscriptions of a topic that discovery knows, each by its user data, such as the type hash."""
        found = []
        for reader in self.builtin:
            for sample in reader.read(N=1000):
                is_alive = sample.sample_info.instance_state == InstanceState.Alive
                if is_alive and sample.topic_name == "rt" + topic and Policy.Userdata in sample.qos:
                    found.append(sample.qos[Policy.Userdata].data.decode())
        return found

    def all_endpoints(self):
        """Every endpoint that is not of this participant: direction, topic and type on the wire, and user data."""
        own = str(self.participant.guid)[:24]
        found = []
        for direction, reader in zip(("out", "in"), self.builtin):
            for sample in reader.read(N=1000):
                is_alive = sample.sample_info.instance_state == InstanceState.Alive
                if is_alive and str(sample.participant_key)[:24] != own:
                    data = sample.qos[Policy.Userdata].data.decode() if Policy.Userdata in sample.qos else ""
                    found.append([direction, sample.topic_name, sample.type_name, data])
        return sorted(found)

    def matched(self, topic):
        if topic in self.writers:
            return len(self.writers[topic][0].get_matched_subscriptions())
        return len(self.readers[topic].get_matched_publications())

    def take(self, topic):
        """What has been received since the last call."""
        samples = self.readers[topic].take(N=1000)
        if topic in self.texts:
            return [number_of(sample.data) for sample in samples if isinstance(sample, String)]
        return [{"fields": fields_of(sample)} for sample in samples]

    def stop(self, topic):
        """Removes the endpoint."""
        self.writers.pop(topic, None)
        self.readers.pop(topic, None)


def main():
    peer = Peer()
    print(json.dumps("ready"), flush=True)
    for line in sys.stdin:
        command = json.loads(line)
        answer = getattr(peer, command.pop("do"))(**command)
        print(json.dumps(answer), flush=True)


main()
