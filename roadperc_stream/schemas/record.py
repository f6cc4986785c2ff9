"""Names of the metadata and attachments of a result."""

from typing import Final

PRODUCER: Final = ("producer", "roadperc")
"""Channel metadata that marks results."""
TAG_TABLE_KEY: Final = "tag_table"
"""Key of the tag table: in the metadata of a channel of tags, or in the replay record if the user named the table."""
CONVERSION_RECORD: Final = "roadperc_convert"
"""Metadata record of a log that ``roadperc-convert`` wrote."""
IMAGES_RECORD: Final = "roadperc_images"
"""Metadata record of a converted dataset of labelled images: the name of each in its label files, and its stamp."""
NETWORKS_RECORD: Final = "roadperc_infer"
"""Metadata record of a log that ``roadperc-infer`` wrote: each role's network, its digest, runtime and settings."""
DEGRADATION_RECORD: Final = "roadperc_degrade"
"""Metadata record of a log that ``roadperc-degrade`` wrote: the severity of each corruption, and the seed."""
NETWORKS_COMMENT: Final = "# networks "
"""Start of the comment with their digest, at the end of a result's configuration."""
PIXEL_ORIGIN_KEY: Final = "pixel_origin"
METADATA_RECORD: Final = "roadperc"
"""The replay record: a result's metadata record with its version, seed, counts and digest."""
VERSION_KEY: Final = "version"
SEED_KEY: Final = "seed"
DIGEST_KEY: Final = "digest"
"""Digest of the replayed input messages."""
DIGEST_ALGORITHM_KEY: Final = "digest_algorithm"
"""Algorithm of the digest and of ``log_id``, in the replay record and in the tables' footers."""
FRAMES_KEY: Final = "frames"
MOUNTING_KEY: Final = "mounting_height_m"
"""In the footer of a metrics table: median height of the surface's camera by the transforms, if there are any."""
FINDINGS_KEY: Final = "findings"
"""The findings as JSON: in the replay record if there are any, and in the footer of the table of frames."""
END_KEY: Final = "end_ns"
"""In the replay record of a cut log: the log time at which the rest of the log begins.

Messages after it are late ones of earlier frames."""
TOPIC_KEY: Final = "topic."
"""Prefix of keys in the replay record: the role follows, and the value is its chosen topic."""
DROPPED_KEY: Final = "dropped."
"""Prefix of keys in the replay record: the role follows, and the value is the number of its messages in no frame."""
CONFIG_ATTACHMENT: Final = "roadperc.toml"
"""Attachment of a result: the resolved configuration."""
STATE_ATTACHMENT: Final = "roadperc.state"
"""Attachment of a result: the state for a continued replay."""
OWN_ATTACHMENTS: Final = (CONFIG_ATTACHMENT, STATE_ATTACHMENT)
"""Attachments that a replay writes; those of an input are not copied."""
CONTINUES_KEY: Final = "continues"
"""In the replay record and the tables' footers: the log_id of the continued result."""
STATE_KEY: Final = "continued_state"
"""With CONTINUES_KEY: digest of the state that the continued result ended with."""
WARM_UP_KEY: Final = "warm_up_s"
"""In the replay record: seconds of log before the start whose frames built the state."""
LOG_ID_KEY: Final = "log_id"
"""In the tables' footers, so that tables without rows have it too."""
FIRST_FRAME_KEY: Final = "first_frame"
"""In the tables' footers of a continued replay: number of its first frame. The continued result may have this frame and
later ones too, incomplete; they do not count."""


def log_id_of(digest: str) -> str:
    """Return the log's name in every table: the first digits of the digest of its messages."""
    return digest[:16]
