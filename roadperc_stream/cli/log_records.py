"""What libraries log: printed in a command with the escaping of the command's own lines."""

import logging
from typing import Any

from roadperc_stream.system.text import shown


class ShownRecord(logging.LogRecord):
    """A record whose message and traceback any handler prints escaped: a library may log what a file or client said."""

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        if self.exc_info:
            self.exc_text = shown(logging.Formatter().formatException(self.exc_info))

    def getMessage(self) -> str:
        """The message as ``shown`` gives it."""
        return shown(super().getMessage())
