"""Definitions of the schemas that this project writes."""

from dataclasses import dataclass

from roadperc_stream.schemas import ros2
from roadperc_stream.schemas.protobuf import schema_data


@dataclass(frozen=True)
class Schema:
    """Name, encodings and definition of a schema, as a log stores them."""

    name: str
    message_encoding: str
    schema_encoding: str
    data: bytes


def schema(name: str) -> Schema:
    """Return the schema with this name."""
    if name in ros2.DEFINITIONS:
        return Schema(name, "cdr", "ros2msg", ros2.DEFINITIONS[name])
    return Schema(name, "protobuf", "protobuf", schema_data(name))
