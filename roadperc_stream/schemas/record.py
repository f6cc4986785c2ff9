"""Names of the metadata and attachments of a result, which identify it and its origin."""

from typing import Final

PRODUCER: Final = ("producer", "roadperc")
"""Channel metadata by which a later replay knows the results of an earlier one."""
TAG_TABLE_KEY: Final = "tag_table"
"""Names the table of a channel's tags: in the channel's metadata, or, where its recorder did not, in a result's record
of how it came about."""
CONVERSION_RECORD: Final = "roadperc_convert"
"""Metadata record of a log that ``roadperc-convert`` wrote."""
PIXEL_ORIGIN_KEY: Final = "pixel_origin"
METADATA_RECORD: Final = "roadperc"
"""Metadata record of a result: how it came about."""
VERSION_KEY: Final = "version"
SEED_KEY: Final = "seed"
DIGEST_KEY: Final = "digest"
"""Of the input's messages that were replayed."""
DIGEST_ALGORITHM_KEY: Final = "digest_algorithm"
"""What that digest, and with it ``log_id``, was made by: in that record and in the tables' footers."""
FIRST_DIGEST_ALGORITHM: Final = "sha256"
"""Of results that do not say."""
FRAMES_KEY: Final = "frames"
END_KEY: Final = "end_ns"
"""In that record of a part that was cut off a log: the log time at which the rest of the drive begins.

Messages behind it are late ones of earlier frames."""
TOPIC_KEY: Final = "topic."
"""Keys of that record which begin so name a role, and the topic that was chosen for it."""
DROPPED_KEY: Final = "dropped."
"""Keys of that record which begin so name a role, and how many of its messages belonged to no frame."""
CONFIG_ATTACHMENT: Final = "roadperc.toml"
"""Attachment of a result: the whole configuration."""
STATE_ATTACHMENT: Final = "roadperc.state"
"""Attachment of a result: what the replay of the next part of the drive needs of it."""
BEGIN_ATTACHMENT: Final = "roadperc.state.begin"
"""Attachment of a result that went on from an earlier part, or was warmed up: the state it began with."""
OWN_ATTACHMENTS: Final = (CONFIG_ATTACHMENT, STATE_ATTACHMENT, BEGIN_ATTACHMENT)
"""Attachments that a replay replaces: those of an input are not copied."""
CONTINUES_KEY: Final = "continues"
"""In that record, and in the tables' footers: the log_id of the part of the drive that this one goes on from."""
LOG_ID_KEY: Final = "log_id"
"""In the tables' footers, so that it is known without a row."""
FIRST_FRAME_KEY: Final = "first_frame"
"""In the tables' footers of a part that goes on from another: number of its first frame. The part before may have given
that frame and later ones as well, incomplete: they do not count."""


def log_id_of(digest: str) -> str:
    """The first digits of the digest of all input messages: name the log in every table."""
    return digest[:16]
