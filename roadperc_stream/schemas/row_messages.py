"""The messages of a row and of its times, made of the declared columns: one field per column, in the table's order."""

from collections.abc import Mapping
from types import NoneType
from typing import Any, Final, get_args, get_type_hints

from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import Default
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.timestamp_pb2 import Timestamp

from roadperc_stream.model.reason import Reason
from roadperc_stream.schemas.columns import TIME_COLUMNS
from roadperc_stream.schemas.columns import FrameMetrics as Row
from roadperc_stream.schemas.roadperc_pb2 import Reason as ReasonMessage

_TYPES: Final[Mapping[Any, FieldDescriptorProto.Type.ValueType]] = {
    str: FieldDescriptorProto.TYPE_STRING,
    int: FieldDescriptorProto.TYPE_INT64,
    float: FieldDescriptorProto.TYPE_DOUBLE,
}
_MESSAGES: Final = {Timestamp: Timestamp.DESCRIPTOR, Reason: ReasonMessage.DESCRIPTOR}
_HEAD: Final = {"timestamp": Timestamp, "frame_id": str}


def _described(name: str, columns: Mapping[str, Any]) -> DescriptorProto:
    """Return a message with ``_HEAD`` and a field per column, from the columns' types; ``X | None`` is optional."""
    message = DescriptorProto(name=name)
    for number, (column, hint) in enumerate((_HEAD | dict(columns)).items(), 1):
        kinds = get_args(hint) or (hint,)
        field = message.field.add(name=column, number=number, label=FieldDescriptorProto.LABEL_OPTIONAL)
        if kinds[0] in _MESSAGES:
            field.type, field.type_name = FieldDescriptorProto.TYPE_MESSAGE, f".{_MESSAGES[kinds[0]].full_name}"
        else:
            field.type = _TYPES[kinds[0]]
        if ... in kinds:  # tuple[X, ...]
            field.label = FieldDescriptorProto.LABEL_REPEATED
        elif NoneType in kinds:  # in proto3, an optional field is alone in a oneof
            field.proto3_optional, field.oneof_index = True, len(message.oneof_decl)
            message.oneof_decl.add(name=f"_{column}")
    return message


_FILE: Final = FileDescriptorProto(
    name="roadperc_stream/schemas/columns.proto",
    package="roadperc",
    syntax="proto3",
    dependency=[described.file.name for described in _MESSAGES.values()],
    message_type=[
        _described("FrameMetrics", get_type_hints(Row)),
        _described("StageTimes", dict.fromkeys(TIME_COLUMNS, float | None)),
    ],
)
Default().AddSerializedFile(_FILE.SerializeToString())
FrameMetrics: Final[Any] = GetMessageClass(Default().FindMessageTypeByName("roadperc.FrameMetrics"))
StageTimes: Final[Any] = GetMessageClass(Default().FindMessageTypeByName("roadperc.StageTimes"))
