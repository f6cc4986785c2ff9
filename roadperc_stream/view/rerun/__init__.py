"""Shows a log in Rerun with Rerun's archetypes and a blueprint for the log's contents.

Rerun's MCAP importer is not used. It draws neither this project's messages nor annotations and scenes, and has no frame
numbers. Its memory grows with the log: with rerun-sdk 0.41 a log of 248 MB takes 468 MB (``log_file_from_path``) or
2.4 GB (``McapReader`` into ``send_chunks``). ``rerun LOG.mcap`` shows channels without a role. Log times are on the
timeline that the importer uses.
"""

import os

# This project reports errors in one line; the SDK would add its own log lines.
os.environ.setdefault("RUST_LOG", "off")

from roadperc_stream.view.rerun.pair import Opening
from roadperc_stream.view.rerun.recording import Exported, open_viewer, save_recording

__all__ = ["Exported", "Opening", "open_viewer", "save_recording"]
