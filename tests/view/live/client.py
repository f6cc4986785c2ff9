"""A viewer for tests of the protocol foxglove.sdk.v1; it waits for messages, never for a fixed time."""

import base64
import json
import struct
import time
from collections import Counter, namedtuple
from itertools import count

from websockets.sync.client import connect

Shown = namedtuple("Shown", "topic log_time_ns data")
State = namedtuple("State", "status log_ns rate moved request_id")
PATIENCE_S = 60
STATUS = ["playing", "paused", "buffering", "ended"]


class Viewer:
    """Connects and stores the received messages."""

    def __init__(self, port, host="127.0.0.1"):
        self.socket = connect(
            f"ws://{host}:{port}",
            subprotocols=["foxglove.sdk.v1"],
            max_size=None,
            open_timeout=PATIENCE_S,
            ping_interval=None,
            close_timeout=1,  # unread messages may come before the answer
        )
        self.info, self.channels, self.heard, self.warnings, self.requests = {}, {}, [], [], count(1)
        self.sessions = []
        self.subscriptions, self.fresh, self.arrived = {}, count(1), set()
        self.until(lambda: self.channels)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def until(self, done):
        """Receive until ``done`` returns a true value, and return it."""
        deadline = time.monotonic() + PATIENCE_S
        while not (value := done()):
            self.hear(self.socket.recv(timeout=max(deadline - time.monotonic(), 0)))
        return value

    def hear(self, frame):
        if isinstance(frame, bytes):
            self.heard.append(self.binary(frame))
            return
        received = json.loads(frame)
        if received["op"] == "serverInfo":
            self.info = received
            self.sessions.append(received["sessionId"])
        elif received["op"] == "advertise":
            self.channels |= {channel["id"]: channel for channel in received["channels"]}
        elif received["op"] == "unadvertise":
            self.channels = {i: channel for i, channel in self.channels.items() if i not in received["channelIds"]}
        elif received["op"] == "status":
            self.warnings.append(received["message"])

    def binary(self, frame):
        if frame[0] == 1:
            subscription, log_time_ns = struct.unpack_from("<IQ", frame, 1)
            self.arrived.add(subscription)
            return Shown(self.subscriptions[subscription], log_time_ns, frame[13:])
        if frame[0] == 2:
            return struct.unpack_from("<Q", frame, 1)
        status, log_ns, rate, moved, length = struct.unpack_from("<BQfBI", frame, 1)
        return State(STATUS[status], log_ns, rate, bool(moved), frame[19 : 19 + length].decode())

    def subscribe(self, *topics):
        """Subscribe to some topics or to all, and return the subscription ids."""
        wanted = {next(self.fresh): c for c in self.channels.values() if not topics or c["topic"] in topics}
        self.subscriptions |= {i: channel["topic"] for i, channel in wanted.items()}
        ask = [{"id": i, "channelId": channel["id"]} for i, channel in wanted.items()]
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": ask}))
        return list(wanted)

    def settle(self):
        """Receive all messages that are under way during a pause.

        Answers and messages are not ordered. A new subscription makes the server send the held messages after all
        earlier messages.
        """
        counted = Counter((shown.topic, shown.log_time_ns) for shown in self.shown())
        topic = next((topic for (topic, _), number in counted.items() if number == 1), None)
        if topic is None:
            return
        old = max(i for i, known in self.subscriptions.items() if known == topic)
        self.socket.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [old]}))
        fresh = set(self.subscribe(topic))
        self.until(lambda: fresh <= self.arrived)

    def request(self, name, *, play, rate=1.0, seek_ns=None):
        """Send a playback request without waiting for the answer."""
        name = name.encode()
        fields = (3, 0 if play else 1, rate, seek_ns is not None, seek_ns or 0, len(name))
        self.socket.send(struct.pack("<BBfBQI", *fields) + name)

    def control(self, *, play, rate=1.0, seek_ns=None, request_id=None):
        """Send a playback request, return the answer, and drop messages from before the request.

        Messages of a seek during a pause are kept.
        """
        name = request_id or str(next(self.requests))
        known, self.heard = self.heard, []
        self.request(name, play=play, rate=rate, seek_ns=seek_ns)
        state = self.until(lambda: next((s for s in self.states() if s.request_id == name), None))
        if not play and not state.moved:
            self.heard = known + self.heard
            self.settle()
            self.heard.clear()
        return state

    def states(self):
        return [item for item in self.heard if isinstance(item, State)]

    def shown(self, topic=None):
        return [item for item in self.heard if isinstance(item, Shown) and topic in {None, item.topic}]

    def schema(self, channel):
        """The bytes of a schema; binary ones are sent as base64."""
        text = channel["schema"]
        return base64.b64decode(text) if channel["schemaEncoding"] == "protobuf" else text.encode()
