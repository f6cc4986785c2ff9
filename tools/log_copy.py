"""What the copy of a log keeps besides its messages."""

from roadperc_stream.config import ReplayConfig
from roadperc_stream.input.replaced import attachments_about_log
from roadperc_stream.log import LogSummary, LogWriter
from roadperc_stream.schemas import record


def copy_records(summary: LogSummary, target: LogWriter, cfg: ReplayConfig, without: str = "") -> None:
    """Copy attachments and metadata except those of a replay and one record, and attach what ``cfg`` says."""
    own = (attachment for attachment in summary.attachments if attachment.name not in record.OWN_ATTACHMENTS)
    for attachment in (*own, *attachments_about_log(cfg)):
        target.attach(attachment)
    for metadata in summary.metadata:
        if metadata.name not in (record.METADATA_RECORD, without):
            target.describe(metadata)
