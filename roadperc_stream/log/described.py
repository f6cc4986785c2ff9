"""What a log says beside its messages: header, schemas, channels, attachments, metadata."""

from dataclasses import dataclass, field

from mcap import records
from mcap.summary import Summary

from roadperc_stream.log.index import channel_of
from roadperc_stream.log.records import Attachment, Channel, Metadata


@dataclass
class Described:
    """Takes note of it record by record; the data's own descriptions hold, the index's only where there are none."""

    profile: str = ""
    library: str = ""
    """What wrote the log."""
    channels: dict[int, Channel] = field(default_factory=dict)
    """By ``Channel.source_id``."""
    attachments: list[Attachment] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    _schemas: dict[int, records.Schema] = field(default_factory=dict)
    _unsettled: set[int] = field(default_factory=set)
    """Channels that only the index has described yet; so of schemas."""
    _unsettled_schemas: set[int] = field(default_factory=set)

    def add_index(self, index: Summary) -> None:
        """Know what the index describes, for messages whose own description is lost."""
        self._schemas |= index.schemas
        for channel in index.channels.values():
            self.channels[channel.id] = channel_of(channel, self._schemas.get(channel.schema_id))
        self._unsettled_schemas, self._unsettled = set(self._schemas), set(self.channels)

    def add(self, item: records.McapRecord, *, in_data: bool) -> None:
        """Take note of a record; of any other kind there is nothing to note.

        Raises:
            ValueError: it describes a channel or a schema otherwise than an earlier one.
        """
        match item:
            case records.Header():
                self.profile, self.library = item.profile, item.library
            case records.Schema():
                self._add_schema(item, in_data=in_data)
            case records.Channel():
                self._add_channel(item, in_data=in_data)
            case records.Attachment():
                attachment = Attachment(item.name, item.media_type, item.data, item.log_time, item.create_time)
                self.attachments.append(attachment)
            case records.Metadata():
                self.metadata.append(Metadata(item.name, tuple(sorted(item.metadata.items()))))

    def _add_schema(self, schema: records.Schema, *, in_data: bool) -> None:
        if in_data and schema.id in self._unsettled_schemas:
            self._unsettled_schemas.discard(schema.id)
            self._schemas[schema.id] = schema
        if self._schemas.setdefault(schema.id, schema) != schema:
            raise ValueError(f"schema {schema.id} is described twice, differently")

    def _add_channel(self, channel: records.Channel, *, in_data: bool) -> None:
        if channel.schema_id and channel.schema_id not in self._schemas:
            raise ValueError(f"channel {channel.id} has schema {channel.schema_id}, which nothing describes")
        found = channel_of(channel, self._schemas.get(channel.schema_id))
        if in_data and channel.id in self._unsettled:
            self._unsettled.discard(channel.id)
            self.channels[channel.id] = found
        if self.channels.setdefault(channel.id, found) != found:
            raise ValueError(f"channel {channel.id} is described twice, differently")
