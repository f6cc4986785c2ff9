"""A log in Rerun: everything as Rerun's own archetypes, with a blueprint that arranges what the log has.

Rerun's importer of MCAP is not used for the base. It draws neither the own messages nor annotations and scenes, gives
no frame numbers, and its memory grows with the log: for one of 248 MB 468 MB (``log_file_from_path``) and 2.4 GB
(``McapReader`` into ``send_chunks``), with rerun-sdk 0.41. Channels that fill no role and are no result are left to it:
``rerun LOG.mcap`` shows them. The log times stand on the timeline that the importer uses.
"""

import os

# What goes wrong is reported by this project, in one line; the SDK would add its own, coloured and with times.
os.environ.setdefault("RUST_LOG", "off")

from roadperc_stream.view.rerun.recording import Exported, open_viewer, save_recording

__all__ = ["Exported", "open_viewer", "save_recording"]
