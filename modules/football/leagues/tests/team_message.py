"""Reads a team message with Google's Protobuf, prints its fields, and the message as that writes it."""

import sys

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

FLOAT, UINT32, INT64, INT32, MESSAGE = 2, 13, 3, 5, 11
file = descriptor_pb2.FileDescriptorProto(name="robocup.proto", package="robocup.humanoid", syntax="proto3")


def message(name, **fields):
    added = file.message_type.add(name=name)
    for field, (number, kind) in fields.items():
        described = added.field.add(name=field, number=number, label=1)
        if isinstance(kind, str):
            described.type, described.type_name = MESSAGE, f".robocup.humanoid.{kind}"
        else:
            described.type = kind
        if field == "others":
            described.label = 3  # repeated


message("Timestamp", seconds=(1, INT64), nanos=(2, INT32))
message("fvec3", x=(1, FLOAT), y=(2, FLOAT), z=(3, FLOAT))
message("fmat3", x=(1, "fvec3"), y=(2, "fvec3"), z=(3, "fvec3"))
message("Robot", player_id=(1, UINT32), position=(2, "fvec3"), covariance=(3, "fmat3"), team=(4, UINT32))
message("Ball", position=(1, "fvec3"), velocity=(2, "fvec3"), covariance=(3, "fmat3"))
message(
    "Message",
    timestamp=(1, "Timestamp"),
    state=(2, UINT32),
    current_pose=(3, "Robot"),
    ball=(7, "Ball"),
    others=(8, "Robot"),
    time_to_ball=(102, FLOAT),
    role=(103, UINT32),
)
pool = descriptor_pool.DescriptorPool()
pool.Add(file)
read = message_factory.GetMessageClass(pool.FindMessageTypeByName("robocup.humanoid.Message"))()
read.ParseFromString(bytes.fromhex(sys.argv[1]))
pose, ball = read.current_pose, read.ball
print(
    pose.player_id,
    read.state,
    read.timestamp.seconds,
    read.timestamp.nanos,
    pose.position.x,
    pose.position.y,
    pose.covariance.x.x,
    pose.covariance.z.z,
    ball.position.x,
    ball.velocity.y,
    ball.covariance.x.x,
    read.time_to_ball,
    read.role,
    [(other.player_id, other.team, other.position.x, other.covariance.y.y) for other in read.others],
)
print(read.SerializeToString().hex())
