"""The types that `rosbags` reads in the schema of a topic."""

from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.typesys import get_types_from_idl, get_types_from_msg

RULE = "=" * 80 + "\n"


def types_of(connection: Connection) -> dict:
    """As `rosbags.highlevel.AnyReader` reads them."""
    definition = connection.msgdef
    if definition.format == MessageDefinitionFormat.MSG:
        return get_types_from_msg(definition.data, connection.msgtype)
    types = {}
    for block in definition.data.split(RULE)[1:]:
        types.update(get_types_from_idl(block.split("\n", 1)[1]))
    return types
