"""Every result channel of the sample, including pictures on request, stays as recorded.

After an intended change, ``pytest tests/output/test_recorded.py --force-regen`` records them again.
"""

from collections import defaultdict

import pytest
from google.protobuf.json_format import MessageToDict
from google.protobuf.message import Message
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoders
from mcap_ros2.decoder import DecoderFactory as RosDecoders

from roadperc_stream import log
from roadperc_stream.cli import replay
from roadperc_stream.input.stream import Problems
from roadperc_stream.output.drawing.overlay import draw_frame
from roadperc_stream.schemas.topics import METRICS_TOPIC, RESULT_PREFIX
from roadperc_stream.view.result_frames import read_frames
from tests import summaries
from tests.test_sample import SAMPLE

VARYING = {"total_ms", "stage_ms", "timestamp", "stamp", "header"}


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """Some frames of the sample with all pictures on request."""
    path = tmp_path_factory.mktemp("recorded") / "out.mcap"
    assert replay.main([str(SAMPLE), str(path), "--start", "1", "--frames", "3", "--overlay", "--debug"]) == 0
    return path


def test_channels_equal_the_recorded_ones(result, ndarrays_regression):
    documents, found = defaultdict(list), {}
    with result.open("rb") as file:
        reader = make_reader(file, decoder_factories=[ProtobufDecoders(), RosDecoders()])
        for _, channel, _, message in reader.iter_decoded_messages():
            if not channel.topic.startswith(RESULT_PREFIX) or channel.topic == METRICS_TOPIC:
                continue
            if hasattr(message, "format"):
                found[channel.topic] = summaries.of_picture(summaries.decoded_picture(message.data))
            else:
                documents[channel.topic].append(fields_of(message))
    found |= {topic: summaries.of_document(messages) for topic, messages in documents.items()}
    summaries.check(ndarrays_regression, {topic.strip("/").replace("/", " "): value for topic, value in found.items()})


@pytest.mark.parametrize("width_px", [200, 640, 1280])
def test_a_drawn_frame_equals_the_recorded_one(result, width_px, ndarrays_regression):
    *_, (row, frame) = read_frames(log.summarise(result), Problems())
    summaries.check(ndarrays_regression, {"frame": summaries.of_picture(draw_frame(frame, row, 1.25, width_px))})


def fields_of(message):
    """The fields of a message by name; bytes as their sum."""
    if isinstance(message, Message):
        fields = MessageToDict(message, preserving_proto_field_name=True)
        return {name: value for name, value in fields.items() if name not in VARYING}
    if isinstance(message, list | tuple):
        return [fields_of(value) for value in message]
    if isinstance(message, bytes | bytearray | memoryview):
        return float(sum(bytes(message)))
    if hasattr(message, "__slots__"):
        return {name: fields_of(getattr(message, name)) for name in message.__slots__ if name not in VARYING}
    return message
